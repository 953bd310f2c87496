"""Schedules: what changes inside an episode, from readable dicts to the kernels' rows.

One entry of a schedule changes one parameter, from its value at the start of the episode (or
from the entry before it) to `target`; the formulas are in `tracked_env.physics.parameter_events`:
    {"parameter": "mass", "kind": "ramp", "target": 2000.0, "start": 10.0, "duration": 0.0}
    {"parameter": "cohesion", "kind": "region", "target": 9650.0,
     "x": 5.0, "y": 0.0, "radius": 3.0, "edge": 0.5}
    {"parameter": "lateral_resistance", "kind": "line", "target": 0.5,
     "x": 5.0, "y": 0.0, "direction": 0.0, "edge": 1.0}      beyond it, looking along direction
    {"parameter": "longitudinal_resistance", "kind": "wave", "target": 0.7,
     "amplitude": 0.02, "k_x": 0.0, "k_y": 0.3, "phase": 0.0, "decay": 0.0}
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.parameter_events import KINDS
from tracked_env.physics.parameters import PARAMETER_NAMES, RANGES, Range
from tracked_env.validation import checked_choice, checked_keys, checked_number

Event = dict[str, Any]

_PLACE = Range(-1e6, 1e6, "m", "It is a world coordinate.")
_WAVE = Range(-100.0, 100.0, "-", "Wave numbers are in rad/m, the phase in rad.")
# For each kind, its fields in the order of the kernel's row: (name, default, range).
_FIELDS: dict[str, tuple[tuple[str, float | None, Range], ...]] = {
    "ramp": (
        ("start", None, Range(0.0, 1e6, "s", "It is the time since reset.")),
        ("duration", 0.0, Range(0.0, 1e6, "s", "0 makes it a step.")),
    ),
    "region": (
        ("x", None, _PLACE),
        ("y", None, _PLACE),
        ("radius", None, Range(0.0, 1e6, "m", "It is the radius of a disc.")),
        ("edge", 0.5, Range(1e-3, 1e3, "m", "It is the width of the transition, not 0.")),
    ),
    "line": (
        ("x", None, _PLACE),
        ("y", None, _PLACE),
        ("direction", None, Range(-100.0, 100.0, "rad", "Did you pass degrees?")),
        ("edge", 0.5, Range(1e-3, 1e3, "m", "It is the width of the transition, not 0.")),
    ),
    "wave": (
        ("amplitude", None, Range(-10.0, 10.0, "1/m", "It multiplies X.")),
        ("k_x", 0.0, _WAVE),
        ("k_y", 0.0, _WAVE),
        ("phase", 0.0, _WAVE),
        ("decay", 0.0, Range(0.0, 10.0, "1/m", "It damps towards positive Y.")),
    ),
}
_NAMES = {number: kind for kind, number in KINDS.items()}
CHANGEABLE = tuple(name for name in PARAMETER_NAMES if name != "torque_limit")


def encode_event(event: object) -> list[float]:
    """One row of eight numbers for the kernel. Raises ValueError for anything not understood.

    `torque_limit` cannot change inside an episode: the action is measured in it.
    """
    if not isinstance(event, Mapping):
        raise ValueError(f"schedule entry {event!r}; must be a dict with 'parameter' and 'kind'")
    kind = checked_choice("schedule kind", event.get("kind"), KINDS)
    fields = _FIELDS[kind]
    allowed = ("parameter", "kind", "target", *(name for name, _, _ in fields))
    checked_keys(f"schedule entry of kind '{kind}'", event, allowed)
    parameter = checked_choice("schedule parameter", event.get("parameter"), CHANGEABLE)
    target = checked_number(f"target of {parameter}", event.get("target"), RANGES[parameter])
    values = []
    for name, default, allowed_range in fields:
        given = event.get(name, default)
        if given is None:
            raise ValueError(f"schedule entry of kind '{kind}' for {parameter} lacks '{name}'")
        values.append(checked_number(f"{name} of a {kind}", given, allowed_range))
    if kind == "line":
        x, y, direction, edge = values
        values = [x, y, math.cos(direction), math.sin(direction), edge]
    if kind == "wave" and not parameter.endswith("_resistance"):
        raise ValueError(f"a wave of {parameter} is not modelled; only of resistance coefficients")
    row = [float(KINDS[kind]), float(PARAMETER_NAMES.index(parameter)), target, *values]
    return row + [0.0] * (8 - len(row))


def decode_event(row: Sequence[float]) -> Event:
    """The entry of a schedule that a row of eight numbers says; a ninth is the direction of a line.

    With it `encode_event` gives back the row, to the bit.
    """
    kind, parameter, target = _NAMES[int(row[0])], PARAMETER_NAMES[int(row[1])], row[2]
    values = list(row[3:8])
    if kind == "line":
        x, y, cosine, sine, edge = values
        direction = row[8] if len(row) > 8 else math.atan2(sine, cosine)
        values = [x, y, direction, edge]
    fields = zip((name for name, _, _ in _FIELDS[kind]), values, strict=False)
    return {"parameter": parameter, "kind": kind, "target": target, **dict(fields)}


def encode_schedule(schedule: Sequence[Mapping[str, Any]]) -> NDArray[np.float64]:
    """Rows (E, 8) of a whole schedule, in the order in which its entries act."""
    if isinstance(schedule, (str, Mapping)) or not isinstance(schedule, Sequence):
        raise ValueError(f"schedule = {schedule!r}; must be a list of dicts, one per change")
    return np.array([encode_event(event) for event in schedule]).reshape(-1, 8)


def ramp_events(targets: Mapping[str, float], start: float, duration: float) -> list[Event]:
    """Several parameters that change together in time; start, duration [s]."""
    return [
        {"parameter": name, "kind": "ramp", "target": target, "start": start, "duration": duration}
        for name, target in targets.items()
    ]


def wave(
    parameter: str,
    mean: float,
    amplitude: float,
    k_x: float = 0.0,
    k_y: float = 0.0,
    phase: float = 0.0,
    decay: float = 0.0,
) -> Event:
    """A parameter that varies in the plane: mean + amplitude X cos(k_x X + k_y Y + phase) ..."""
    return {
        "parameter": parameter, "kind": "wave", "target": mean, "amplitude": amplitude,
        "k_x": k_x, "k_y": k_y, "phase": phase, "decay": decay,
    }  # fmt: skip
