"""What an agent sees: the layouts that are made of groups of fields, see `observation_fields`.

The observation is a float32 vector of dimensionless numbers: each quantity in SI units divided by
its scale (so that a network sees values of order one) and clipped to its bound. Only sensors and
the reference enter it; no true state, no true parameter. Left/right and signs follow NOTATION.md.

A `Layout` is a sequence of groups; an environment is made with one: `observation="v0"`, or the
names of the groups. `register` adds a group. Columns are looked up by the name of their field, so
that a policy drives wherever the fields that it needs are shown: `columns`, `View`.
The compiled loops write the fields of `V0` and nothing else; see `tracked_env.engine.composing`.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.observation_fields import GROUPS as GROUPS
from tracked_env.observation_fields import VERSIONS, Group
from tracked_env.observation_fields import Field as Field  # of groups to be registered
from tracked_env.physics.jit import formula
from tracked_env.validation import checked_choice, unknown

FEATURE_BOUND = 10.0  # [-] features that are appended are clipped to this; they are of order one


class Layout:
    """The fields of some groups, in order; see `make_layout`. It is never changed."""

    def __init__(self, groups: tuple[Group, ...]) -> None:
        self.parts = groups
        self.groups = tuple(group.name for group in groups)
        self.fields = tuple(field for group in groups for field in group.fields)
        self.names = tuple(field.name for field in self.fields)
        # Registered sensor channels that its groups read.
        self.channels = tuple(dict.fromkeys(name for group in groups for name in group.channels))
        self.size = len(self.fields)
        self.index = {name: column for column, name in enumerate(self.names)}
        self.scale: NDArray[np.float64] = np.array([field.scale for field in self.fields])
        self.inverse_scale: NDArray[np.float64] = 1.0 / self.scale
        bound = [field.bound / field.scale for field in self.fields]
        self.bound: NDArray[np.float32] = np.array(bound, dtype=np.float32)
        self.low: NDArray[np.float32] = np.where(
            [field.signed for field in self.fields], -self.bound, 0.0
        ).astype(np.float32)
        self.high = self.bound
        self.limits = (self.low, self.high)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled by the names of its groups."""
        return make_layout, (self.groups,)

    def __repr__(self) -> str:
        return f"Layout{self.groups}"

    def columns(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Columns of the fields `names`. Raises ValueError, which names the missing group."""
        return columns(self.names, names)

    def pack(self, values: Mapping[str, NDArray[np.float64] | float]) -> NDArray[np.float32]:
        """Build an observation from SI values by name; shape (size,) or (N, size).

        Raises ValueError when a name is missing or unknown.
        """
        wrong = set(values) ^ set(self.names)
        if wrong:
            raise ValueError(
                f"observation fields missing or unknown: {sorted(wrong)}; needed are {self.names}"
            )
        stacked = np.stack([np.asarray(values[n], dtype=float) for n in self.names], axis=-1)
        bound = self.bound.astype(np.float64)
        return np.clip(stacked * self.inverse_scale, -bound, bound).astype(np.float32)

    def unpack(self, observation: NDArray[np.floating]) -> dict[str, NDArray[np.float64]]:
        """SI values by name from observations of shape (..., size); each value has shape (...).

        Raises ValueError when the last axis is not `size` long.
        """
        observation = np.asarray(observation, dtype=np.float64)
        if observation.shape[-1:] != (self.size,):
            raise ValueError(
                f"observation has shape {observation.shape}; its last axis must be {self.size} "
                "long. Did a wrapper stack or append to it?"
            )
        values = np.moveaxis(observation * self.scale, -1, 0)
        return dict(zip(self.names, values, strict=True))

    def mirror(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same situation with left and right exchanged; shape (..., size)."""
        mirrored = np.array(observation, copy=True)
        for column, field in enumerate(self.fields):
            left, right = "_left" in field.name, "_right" in field.name
            if field.mirrored and not left and not right:
                mirrored[..., column] *= -1.0
            elif left or right:
                sides = ("_left", "_right") if left else ("_right", "_left")
                mirrored[..., column] = observation[..., self.index[field.name.replace(*sides)]]
        return mirrored

    def markdown_table(self) -> str:
        """The layout as a Markdown table, for the documentation."""
        lines = [
            "| index | group | name | unit | shown as 1 | clipped at | meaning |",
            "|--|--|--|--|--|--|--|",
        ]
        rows = [(group.name, field) for group in self.parts for field in group.fields]
        for index, (group, f) in enumerate(rows):
            lines.append(
                f"| {index} | `{group}` | `{f.name}` | {f.unit} | {f.scale:g} | {f.bound:g} | "
                f"{f.meaning} |"
            )
        return "\n".join(lines)


@lru_cache(maxsize=64)
def _layout(names: tuple[str, ...]) -> Layout:
    return Layout(tuple(GROUPS[name] for name in names))


def make_layout(spec: Any) -> Layout:
    """A layout from its version ("v0") or from a sequence of the names of its groups.

    Raises ValueError for an unknown version or group, for a group named twice, and for none.
    """
    if isinstance(spec, str):
        return _layout(VERSIONS[checked_choice("observation", spec, VERSIONS)])
    if isinstance(spec, Mapping) or not isinstance(spec, Sequence) or not spec:
        raise ValueError(f"observation = {spec!r}; must be 'v0' or a list of groups: {[*GROUPS]}")
    names = tuple(checked_choice("observation group", name, GROUPS) for name in spec)
    if len(set(names)) < len(names):
        raise ValueError(f"observation = {list(names)}; each group can be shown once")
    return _layout(names)


def register(group: Group) -> Group:
    """Add a group, from then on a name for `observation=[...]`; returns it.

    Its channels are registered beforehand, with `tracked_env.sensors.register`. Raises ValueError
    for a name that is taken, a field without a positive scale and bound, and for a left field
    without its right one.
    """
    own = [field.name for field in group.fields]
    taken = {field.name: other.name for other in GROUPS.values() for field in other.fields}
    if group.name in GROUPS or not own:
        raise ValueError(f"observation group {group.name!r} is taken, or has no field")
    for field in group.fields:
        if field.name in taken or own.count(field.name) > 1:
            where = taken.get(field.name, group.name)
            raise ValueError(f"observation field {field.name!r} is in the group {where!r} already")
        if not (field.scale > 0.0 and field.bound > 0.0):  # NaN is refused
            raise ValueError(f"field {field.name!r}: scale and bound must be positive")
        for sides in (("_left", "_right"), ("_right", "_left")):
            if sides[0] in field.name and field.name.replace(*sides) not in own:
                raise ValueError(f"field {field.name!r} is without its {sides[1][1:]} one")
    made = group.values is not None or group.compiled is not None
    _check_reads(group)
    channels = group.channels if made else tuple(own)
    GROUPS[group.name] = group._replace(channels=channels)
    return GROUPS[group.name]


def _check_reads(group: Group) -> None:
    """Raise ValueError where a compiled group is not complete, or has another form as well."""
    if (group.compiled is None) != (not group.reads) or (group.compiled and group.values):
        raise ValueError(
            f"observation group {group.name!r} must have `compiled` with `reads`, or `values`, or "
            "neither"
        )
    for name in group.reads:
        if name not in (*NAMES, *group.channels):
            raise unknown(f"field that {group.name!r} reads", name, (*NAMES, *group.channels))


def columns(names: Sequence[str], wanted: Sequence[str]) -> NDArray[np.int64]:
    """Columns of the fields `wanted` in an observation with the fields `names`.

    Raises ValueError, which names the missing group.
    """
    place = {name: column for column, name in enumerate(names)}
    lacking = [name for name in wanted if name not in place]
    if lacking:
        groups = {f.name: group.name for group in GROUPS.values() for f in group.fields}
        for name in lacking:
            if name not in groups:
                raise unknown("observation field", name, groups)
        missing: dict[str, list[str]] = {}
        for name in lacking:
            missing.setdefault(groups[name], []).append(name)
        parts = [f"group {group} ({', '.join(names)})" for group, names in missing.items()]
        shown = list(dict.fromkeys(groups[name] for name in names if name in groups))
        enough = list(dict.fromkeys((*shown, *missing)))
        raise ValueError(
            f"the observation lacks {' and '.join(parts)}; it shows {shown}. Make the environment "
            f"with observation={enough}"
        )
    return np.array([place[name] for name in wanted], dtype=np.int64)


V0 = make_layout("v0")
FIELDS, NAMES, SIZE, INDEX = V0.fields, V0.names, V0.size, V0.index
SCALE, BOUND, LOW, HIGH = V0.scale, V0.bound, V0.low, V0.high
pack, unpack, mirror, markdown_table = V0.pack, V0.unpack, V0.mirror, V0.markdown_table
_INVERSE_SCALE = V0.inverse_scale
_BOUND64: NDArray[np.float64] = BOUND.astype(np.float64)


@formula
def store(out, row, column, value):
    """Write an SI value into out[row, column] of an observation of V0: scale and clip."""
    scaled = value * _INVERSE_SCALE[column]
    bound = _BOUND64[column]
    out[row, column] = min(max(scaled, -bound), bound)


def joined(observation: NDArray[np.float32], features: NDArray[np.float32]) -> NDArray[np.float32]:
    """Observation (..., D) and features (..., F), those finite and clipped, as one."""
    bounded = np.clip(np.nan_to_num(features), -FEATURE_BOUND, FEATURE_BOUND)
    return np.concatenate([observation, bounded], axis=-1, dtype=np.float32)


class View:
    """Observations with the fields `names` as those of V0; what is not shown there is 0.

    needs: fields that must be shown; registered ones stand behind those of V0, in this order.
    hint: likely cause of another shape. Raises ValueError, which names the missing group.
    """

    def __init__(
        self,
        names: Sequence[str] = NAMES,
        needs: Sequence[str] = NAMES,
        hint: str = "Did a wrapper stack or append to it?",
    ) -> None:
        self.size, self.hint = len(names), hint
        added = [name for name in dict.fromkeys(needs) if name not in INDEX]
        self.same = tuple(names) == NAMES and not added
        shown = [name for name in NAMES if name in names or name in needs]
        given = (*NAMES, *added)
        self._from = columns(names, (*shown, *added))
        self._to = columns(given, (*shown, *added))
        self._width = len(given)

    def __call__(self, observation: NDArray[np.floating]) -> NDArray[np.float32]:
        """(N, SIZE + registered fields) float32, from (size,) or (N, size); the array itself where
        nothing changes.

        Raises ValueError for another shape.
        """
        batch = np.ascontiguousarray(observation, dtype=np.float32)
        if batch.ndim == 1:
            batch = batch.reshape(1, -1)
        if batch.ndim != 2 or batch.shape[1] != self.size:
            raise ValueError(
                f"observation has shape {np.shape(observation)}; must be ({self.size},) or "
                f"(N, {self.size}). {self.hint}"
            )
        if self.same:
            return batch
        chosen = np.zeros((len(batch), self._width), dtype=np.float32)
        chosen[:, self._to] = batch[:, self._from]
        return chosen
