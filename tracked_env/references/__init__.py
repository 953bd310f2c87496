"""Reference motions for the vehicle to follow.

A reference is a profile of speed and yaw rate with a start pose; its path follows from them.
`make_reference` builds one from a name or a JSON-able dictionary, `sample` tabulates it, `register`
adds a kind; `fit` makes the tables of a profile from speeds and their derivatives at `knot_times`.
"""

from tracked_env.references.profile import (
    ReferenceProfile,
    ReferenceSamples,
    constant,
    fit,
    knot_times,
    number_of_segments,
    sample,
)
from tracked_env.references.specification import (
    REFERENCES,
    batch_reference,
    make_reference,
    reference_scale,
    register,
)

__all__ = [
    "REFERENCES",
    "ReferenceProfile",
    "ReferenceSamples",
    "batch_reference",
    "constant",
    "fit",
    "knot_times",
    "make_reference",
    "number_of_segments",
    "reference_scale",
    "register",
    "sample",
]
