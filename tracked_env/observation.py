"""What an agent sees: named fields in named groups, and the layouts that are made of groups.

The observation is a float32 vector of dimensionless numbers: each quantity in SI units divided by
its scale (so that a network sees values of order one) and clipped to its bound. Only sensors and
the reference enter it; no true state, no true parameter. Left/right and signs follow NOTATION.md.

A `Layout` is a sequence of groups; an environment is made with one: `observation="v0"`, or the
names of the groups. `register` adds a group. Columns are looked up by the name of their field, so
that a policy drives wherever the fields that it needs are shown: `columns`, `View`.
The compiled loops write the fields of `V0` and nothing else; see `tracked_env.engine.extra_groups`.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.validation import checked_choice, unknown

FEATURE_BOUND = 10.0  # [-] features that are appended are clipped to this; they are of order one
LOOK_AHEAD = (0.25, 0.5, 1.0, 2.0)  # [s] times at which the coming reference is shown


class Field(NamedTuple):
    """One entry of the observation."""

    name: str
    unit: str
    scale: float  # SI value that is shown as 1
    bound: float  # SI value at which it is clipped, both signs
    meaning: str
    mirrored: bool = False  # changes sign when left and right are exchanged; True for L/R pairs
    signed: bool = True  # False: it is never negative


class Group(NamedTuple):
    """Fields that are shown together: each the channel of its name, or all by one function.

    compute: (inputs (n, K), outputs (n, F)) writes the fields from what `reads` names: fields of
    `V0` and samples of `channels`, in SI units, one column each. In Python it costs 10 us and more
    a step; compiled, by `physics.jit.loop`, a tenth, and threads run side by side. A group with
    `scan` shows heights of the ground there, one with `goal` that of the reference, which has to
    be planned, one with `sheet` what a data sheet says of the vehicle, or fields in its units.
    """

    name: str
    fields: tuple[Field, ...]
    channels: tuple[str, ...] = ()  # registered sensor channels that it reads
    compute: Callable[[NDArray[np.float64], NDArray[np.float64]], None] | None = None
    reads: tuple[str, ...] = ()  # in the order of the columns of `inputs`
    scan: tuple[tuple[float, float], ...] = ()  # [contact lengths] (ahead, left) of each field
    goal: bool = False  # its fields are those of the goal, see `engine.extra_groups`
    # The parameter of each field on the data sheet, or what a field of V0 is divided by: UNITS
    sheet: tuple[str, ...] = ()


@loop
def _in_plane(inputs, outputs):
    """The measured pose error in the plane of the vehicle, by the measured roll and pitch."""
    for k in range(inputs.shape[0]):
        ahead, left, turn = inputs[k, 0], inputs[k, 1], inputs[k, 2]
        roll, pitch = rotation(inputs[k, 3]), rotation(inputs[k, 4])
        outputs[k, 0], outputs[k, 1], outputs[k, 2] = in_body_plane(ahead, left, turn, pitch, roll)


def _scanned(ahead: float, left: float) -> Field:
    name = f"height_{'behind' if ahead < 0.0 else 'ahead'}_{abs(ahead):g}"
    name += f"_{'left' if left > 0.0 else 'right'}_{abs(left):g}" if left else ""
    meaning = f"ground {ahead:g} l ahead, {left:g} l to the left, less the vehicle's height"
    return Field(name, "m", 0.25, 5.0, meaning, bool(left))


def _ahead(name: str, unit: str, scale: float, bound: float, mirrored: bool) -> tuple[Field, ...]:
    words = f"reference {name.replace('_', ' ')}"
    return tuple(
        Field(
            f"reference_{name}_ahead_{t:g}", unit, scale, bound, f"{words} {t:g} s ahead", mirrored
        )
        for t in LOOK_AHEAD
    )


# Name, unit, scale, bound, meaning, mirrored, signed
_COMPILED = {  # the groups of V0, which the kernels write
    "pose_error": (
        Field("position_error_x", "m", 1.0, 20.0, "reference ahead of the measured position"),
        Field("position_error_y", "m", 1.0, 20.0, "reference to the left of it", True),
        Field("heading_error", "rad", 0.5, 4.0, "reference heading minus measured yaw", True),
    ),
    "motion": (
        Field("v_x", "m/s", 2.0, 40.0, "measured forward velocity", False),
        Field("v_y", "m/s", 0.5, 40.0, "measured lateral velocity", True),
        Field("yaw_rate", "rad/s", 0.5, 20.0, "gyro", True),
        Field("acceleration_x", "m/s^2", 2.0, 200.0, "forward accelerometer", False),
        Field("acceleration_y", "m/s^2", 2.0, 200.0, "lateral accelerometer", True),
        Field("yaw_acceleration", "rad/s^2", 2.0, 400.0, "from two accelerometers", True),
    ),
    "drive": (
        Field("sprocket_speed_left", "rad/s", 6.0, 2e3, "left sprocket encoder", True),
        Field("sprocket_speed_right", "rad/s", 6.0, 2e3, "right sprocket encoder", True),
        Field("torque_left", "N m", 4e3, 2e6, "torque transmitted at the left sprocket", True),
        Field("torque_right", "N m", 4e3, 2e6, "torque transmitted at the right sprocket", True),
    ),
    "reference": (
        Field("reference_speed", "m/s", 2.0, 40.0, "reference speed v, signed", False),
        Field("reference_acceleration", "m/s^2", 2.0, 100.0, "dv/dt of the reference", False),
        Field("reference_jerk", "m/s^3", 4.0, 400.0, "d2v/dt2 of the reference", False),
        Field("reference_yaw_rate", "rad/s", 0.5, 20.0, "reference yaw rate w", True),
        Field("reference_yaw_acceleration", "rad/s^2", 1.0, 100.0, "dw/dt of the reference", True),
    ),
    "look_ahead": (
        *_ahead("speed", "m/s", 2.0, 40.0, False),
        *_ahead("yaw_rate", "rad/s", 0.5, 20.0, True),
    ),
    "action": tuple(
        Field(f"previous_action_{side}", "-", 1.0, 1.0, f"{side} action of the step before", True)
        for side in ("left", "right")
    ),
    "age": (
        Field("pose_age", "s", 1.0, 60.0, "age of position, heading and velocity", False, False),
        Field("inertial_age", "s", 1.0, 60.0, "age of accelerations and yaw rates", False, False),
        Field("drive_age", "s", 1.0, 60.0, "age of sprocket speeds and torques", False, False),
    ),
}
# On slopes; the third gyro and two axes of the specific force are in the group `motion`.
_ATTITUDE = (
    Field("roll", "rad", 0.5, 4.0, "roll of the IMU, left side up", True),
    Field("pitch", "rad", 0.5, 4.0, "pitch of the IMU, nose down", False),
    Field("roll_rate", "rad/s", 0.5, 20.0, "gyro about the body's x axis", True),
    Field("pitch_rate", "rad/s", 0.5, 20.0, "gyro about the body's y axis", False),
    Field("specific_force_z", "m/s^2", 10.0, 200.0, "vertical accelerometer, g at rest", False),
)
_TANGENT_ERROR = (
    Field("tangent_error_x", "m", 1.0, 20.0, "reference ahead, in the vehicle's plane", False),
    Field("tangent_error_y", "m", 1.0, 20.0, "reference to the left, in that plane", True),
    Field("tangent_heading_error", "rad", 0.5, 4.0, "heading error about its normal", True),
)
_GOAL = (  # of references of the kind "plan"
    Field("goal_x", "m", 2.0, 200.0, "goal ahead of the measured position", False),
    Field("goal_y", "m", 2.0, 200.0, "goal to the left of it", True),
    Field("goal_cosine", "-", 1.0, 1.0, "cosine of the goal's heading less the yaw", False),
    Field("goal_sine", "-", 1.0, 1.0, "sine of the same", True),
    Field("goal_time", "s", 10.0, 3600.0, "until the plan arrives", signed=False),
)
# Of the nominal vehicle; a drive without lag has no logarithm, so none is shown.
SHEET = (
    *("contact_length", "track_gauge", "track_width", "sprocket_radius", "mass", "inertia"),
    *("torque_limit", "sprocket_speed_limit"),
)
_SHEET = tuple(
    Field(f"sheet_{name}", "-", 1.0, 20.0, f"ln of the data sheet's {name.replace('_', ' ')}, SI")
    for name in SHEET
)
# What a unit is divided by, for a vehicle of length l: powers of l and of g, or a limit of a drive.
UNITS = {
    **{"m": (1.0, 0.0), "m/s": (0.5, 0.5), "m/s^2": (0.0, 1.0), "m/s^3": (-0.5, 1.5)},
    **{"rad/s": (-0.5, 0.5), "rad/s^2": (-1.0, 1.0), "s": (0.5, -0.5)},
}


def _divisor(field: Field) -> str:
    """What the data sheet divides a field of V0 by: a limit of the drive, a unit, or nothing."""
    if field.name.startswith("sprocket_speed"):
        return "sprocket_speed_limit"
    return "torque_limit" if field.unit == "N m" else field.unit if field.unit in UNITS else ""


_V0_FIELDS = tuple(field for fields in _COMPILED.values() for field in fields)
_RELATIVE = tuple(
    f._replace(name=f"relative_{f.name}", unit="-", scale=1.0, bound=50.0, meaning=f"{f.name}, so")
    for f in _V0_FIELDS
)
_IN_PLANE = ("position_error_x", "position_error_y", "heading_error", "roll", "pitch")
_SCAN = tuple(
    (ahead, left)
    for ahead in (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0)
    for left in (-1.0, -0.5, 0.0, 0.5, 1.0)
)
_ADDED = (
    Group("attitude", _ATTITUDE, tuple(field.name for field in _ATTITUDE)),
    Group("tangent_error", _TANGENT_ERROR, ("roll", "pitch"), _in_plane, _IN_PLANE),
    Group("height_scan", tuple(_scanned(*point) for point in _SCAN), scan=_SCAN),
    Group("goal", _GOAL, goal=True),
    Group("data_sheet", _SHEET, sheet=SHEET),
    Group("relative", _RELATIVE, sheet=tuple(_divisor(field) for field in _V0_FIELDS)),
)
GROUPS: dict[str, Group] = {
    **{name: Group(name, fields) for name, fields in _COMPILED.items()},
    **{group.name: group for group in _ADDED},
}
# Layouts by name; what a name stands for never changes.
VERSIONS = {"v0": tuple(_COMPILED), "relative-v0": ("relative", "data_sheet")}


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
        signed = [field.signed for field in self.fields]
        # Lowest and highest values that are shown.
        self.limits = np.where(signed, -self.bound, np.float32(0.0)), self.bound

    def __reduce__(self) -> tuple[Any, ...]:
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
        return dict(zip(self.names, np.moveaxis(observation * self.scale, -1, 0), strict=True))

    def mirror(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same situation with left and right exchanged; shape (..., size)."""
        mirrored = np.array(observation, copy=True)
        for column, field in enumerate(self.fields):
            other = self.index[_other_side(field.name)]
            mirrored[..., column] = observation[..., other]
            if field.mirrored and other == column:
                mirrored[..., column] *= -1.0
        return mirrored

    def markdown_table(self) -> str:
        """The layout as a Markdown table, for the documentation."""
        fields = enumerate((g.name, *f) for g in self.parts for f in g.fields)
        rows = [
            f"| {k} | `{group}` | `{name}` | {unit} | {scale:g} | {bound:g} | {meaning} |"
            for k, (group, name, unit, scale, bound, meaning, *_) in fields
        ]
        head = "| index | group | name | unit | shown as 1 | clipped at | meaning |"
        return "\n".join([head, "|--|--|--|--|--|--|--|", *rows])


def _other_side(name: str) -> str:
    """The field on the other side of the vehicle; the field itself where it is of neither."""
    sides = ("_left", "_right") if "_left" in name else ("_right", "_left")
    return name.replace(*sides)


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
    without its right one, and for `compute` without `reads`.
    """
    names = [field.name for field in group.fields]
    places = {field.name: other.name for other in GROUPS.values() for field in other.fields}
    if group.name in GROUPS or not names:
        raise ValueError(f"observation group {group.name!r} is taken, or has no field")
    for field in group.fields:
        name = field.name
        if name in places or names.count(name) > 1:
            where = places.get(name, group.name)
            raise ValueError(f"observation field {name!r} is in the group {where!r} already")
        if not (field.scale > 0.0 and field.bound > 0.0):  # NaN is refused
            raise ValueError(f"field {name!r}: scale and bound must be positive")
        if _other_side(name) not in names:
            side = "right" if "_left" in name else "left"
            raise ValueError(f"field {name!r} is without its {side} one")
    if (group.compute is None) != (not group.reads):
        raise ValueError(f"observation group {group.name!r} must have `compute` with `reads`")
    for name in group.reads:
        if name not in (*NAMES, *group.channels):
            raise unknown(f"field that {group.name!r} reads", name, (*NAMES, *group.channels))
    GROUPS[group.name] = group._replace(channels=group.channels if group.compute else tuple(names))
    return GROUPS[group.name]


def columns(names: Sequence[str], wanted: Sequence[str]) -> NDArray[np.int64]:
    """Columns of the fields `wanted` in an observation with the fields `names`.

    Raises ValueError, which names the missing group.
    """
    place = {name: column for column, name in enumerate(names)}
    groups = {f.name: group.name for group in GROUPS.values() for f in group.fields}
    missing: dict[str, list[str]] = {}
    for name in wanted:
        if name not in place:
            if name not in groups:
                raise unknown("observation field", name, groups)
            missing.setdefault(groups[name], []).append(name)
    if missing:
        parts = [f"group {group} ({', '.join(names)})" for group, names in missing.items()]
        shown = list(dict.fromkeys(groups[name] for name in names if name in groups))
        raise ValueError(
            f"the observation lacks {' and '.join(parts)}; it shows {shown}. Make the environment "
            f"with observation={list(dict.fromkeys((*shown, *missing)))}"
        )
    return np.array([place[name] for name in wanted], dtype=np.int64)


V0 = make_layout("v0")
FIELDS, NAMES, SIZE, INDEX = V0.fields, V0.names, V0.size, V0.index
SCALE, BOUND, (LOW, HIGH) = V0.scale, V0.bound, V0.limits
pack, unpack, mirror, markdown_table = V0.pack, V0.unpack, V0.mirror, V0.markdown_table
_INVERSE_SCALE = V0.inverse_scale
_BOUND64: NDArray[np.float64] = BOUND.astype(np.float64)


@formula
def store(out, row, column, value):
    """Write an SI value into out[row, column] of an observation of V0: scale and clip."""
    scaled = value * _INVERSE_SCALE[column]
    bound = _BOUND64[column]
    out[row, column] = min(max(scaled, -bound), bound)


def append_features(
    observation: NDArray[np.float32], features: NDArray[np.float32]
) -> NDArray[np.float32]:
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
        shown = [*(name for name in NAMES if name in names or name in needs), *added]
        self._from = columns(names, shown)
        self._to = columns((*NAMES, *added), shown)
        self._width = SIZE + len(added)

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
        selected = np.zeros((len(batch), self._width), dtype=np.float32)
        selected[:, self._to] = batch[:, self._from]
        return selected
