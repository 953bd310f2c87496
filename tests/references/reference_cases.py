"""What the tests of references share: every kind, and one of each with its defaults."""

from tracked_env.references import REFERENCES, make_reference

DURATION = 30.0
POINTS = [[0.0, 0.0], [8.0, 1.0], [14.0, 6.0], [15.0, 14.0], [8.0, 18.0], [1.0, 15.0]]
KINDS = sorted(REFERENCES)
SMOOTH_KINDS = [kind for kind in KINDS if kind != "chicane"]


def build(kind, rng, **parameters):
    if kind == "waypoints":
        parameters = {"points": POINTS} | parameters
    return make_reference({"kind": kind} | parameters, DURATION, rng)
