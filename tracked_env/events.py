"""How a parameter changes inside an episode: ramps in time, regions and waves in space.

An event changes one parameter, from its value at the start of the episode (or from the event before
it) towards a target. With w in [0, 1] its weight:
    ramp, region, line:  value <- value + w (target - value)
    wave:                value <- target + a X cos(k_x X + k_y Y + phase) exp(-decay Y), in
                         [WAVE_LOW, WAVE_HIGH]: resistance coefficients only
The wave form contains S (44) and (45), the resistance maps of S section 8.2.2.
A schedule lists events as dicts:
    {"parameter": "mass", "kind": "ramp", "target": 2000.0, "start": 10.0, "duration": 0.0}
    {"parameter": "cohesion", "kind": "region", "target": 9650.0,
     "x": 5.0, "y": 0.0, "radius": 3.0, "edge": 0.5}
    {"parameter": "lateral_resistance", "kind": "line", "target": 0.5,
     "x": 5.0, "y": 0.0, "direction": 0.0, "edge": 1.0}      beyond it, looking along direction
    {"parameter": "longitudinal_resistance", "kind": "wave", "target": 0.7,
     "amplitude": 0.02, "k_x": 0.0, "k_y": 0.3, "phase": 0.0, "decay": 0.0}
For kernels an event is one row of eight numbers: kind, parameter index, target, then five more:
    RAMP    start [s], duration [s] (0 = step)
    REGION  x [m], y [m], radius [m], width of the edge [m]: inside a disc
    LINE    x [m], y [m], cos, sin of the normal, width [m]: beyond a straight line
    WAVE    amplitude per metre of X, k_x, k_y [rad/m], phase [rad], decay [1/m]
Every finite position gives a finite value: coordinates count at most as FAR, the exponent as
EXPONENT_LIMIT, both far outside any map.

References: [1] Strawa et al., Electronics 10 (2021) 187, (44) and (45).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import PARAMETER_NAMES, RANGES, Range
from tracked_env.validation import checked_choice, checked_keys, checked_number

WAVE_LOW, WAVE_HIGH = 0.2, 1.5  # [-] a wave is clipped here: (44) leaves the physical range
FAR = 1e100  # [m] its square is finite, and so is its product with every field of an event
EXPONENT_LIMIT = 700.0  # [-] exp of it, and of its negative, are finite and not 0
RAMP, REGION, LINE, WAVE = range(4)
KINDS = {"ramp": RAMP, "region": REGION, "line": LINE, "wave": WAVE}
Event = dict[str, Any]

_PLACE = Range(-1e6, 1e6, "m", "It is a world coordinate.")
_WAVE = Range(-100.0, 100.0, "-", "Wave numbers are in rad/m, the phase in rad.")
_EDGE = ("edge", 0.5, Range(1e-3, 1e3, "m", "It is the width of the transition, not 0."))
_XY = ("x", None, _PLACE), ("y", None, _PLACE)
# For each kind, its fields in the order of the kernel's row: (name, default, range).
_FIELDS: dict[str, tuple[tuple[str, float | None, Range], ...]] = {
    "ramp": (
        ("start", None, Range(0.0, 1e6, "s", "It is the time since reset.")),
        ("duration", 0.0, Range(0.0, 1e6, "s", "0 makes it a step.")),
    ),
    "region": (*_XY, ("radius", None, Range(0.0, 1e6, "m", "It is the radius of a disc.")), _EDGE),
    "line": (
        *_XY,
        ("direction", None, Range(-100.0, 100.0, "rad", "Did you pass degrees?")),
        _EDGE,
    ),
    "wave": (
        ("amplitude", None, Range(-10.0, 10.0, "1/m", "It multiplies X.")),
        *((name, 0.0, _WAVE) for name in ("k_x", "k_y", "phase")),
        ("decay", 0.0, Range(0.0, 10.0, "1/m", "It damps towards positive Y.")),
    ),
}
_NAMES = {number: kind for kind, number in KINDS.items()}
CHANGEABLE = tuple(name for name in PARAMETER_NAMES if name != "torque_limit")


@formula
def clip_weight(value):
    """Weight in [0, 1]."""
    return min(max(value, 0.0), 1.0)


@formula
def ramp_weight(time, start, duration):
    """0 before `start` [s], 1 after `start + duration` [s], linear between."""
    if duration <= 0.0:
        return 1.0 if time >= start else 0.0
    return clip_weight((time - start) / duration)


@formula
def changed_value(value, events, i, e, time, x, y):
    """Parameter value after event e of vehicle i, at `time` [s] and position (x, y) [m]."""
    kind, target = events[i, e, 0], events[i, e, 2]
    first, second, third = events[i, e, 3], events[i, e, 4], events[i, e, 5]
    fourth, fifth = events[i, e, 6], events[i, e, 7]
    x, y = min(max(x, -FAR), FAR), min(max(y, -FAR), FAR)
    if kind == WAVE:
        phase = second * x + third * y + fourth
        exponent = min(max(-fifth * y, -EXPONENT_LIMIT), EXPONENT_LIMIT)
        wave = target + first * x * math.cos(phase) * math.exp(exponent)
        return min(max(wave, WAVE_LOW), WAVE_HIGH)
    if kind == RAMP:
        weight = ramp_weight(time, first, second)
    elif kind == REGION:
        distance = math.sqrt((x - first) * (x - first) + (y - second) * (y - second))
        weight = clip_weight(0.5 + (third - distance) / fourth)
    else:
        weight = clip_weight(0.5 + ((x - first) * third + (y - second) * fourth) / fifth)
    return value + weight * (target - value)


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
        value = event.get(name, default)
        if value is None:
            raise ValueError(f"schedule entry of kind '{kind}' for {parameter} lacks '{name}'")
        values.append(checked_number(f"{name} of a {kind}", value, allowed_range))
    if kind == "line":
        values[2:3] = math.cos(values[2]), math.sin(values[2])
    if kind == "wave" and not parameter.endswith("_resistance"):
        raise ValueError(f"a wave of {parameter} is not modelled; only of resistance coefficients")
    row = [float(KINDS[kind]), float(PARAMETER_NAMES.index(parameter)), target, *values]
    return row + [0.0] * (8 - len(row))


def decode_event(row: Sequence[float]) -> Event:
    """The entry of a schedule that a row of eight numbers says; a ninth is the direction of a line.

    With it `encode_event` gives back the row, to the bit.
    """
    kind, parameter, values = _NAMES[int(row[0])], PARAMETER_NAMES[int(row[1])], list(row[3:8])
    if kind == "line":
        values[2:4] = [row[8] if len(row) > 8 else math.atan2(values[3], values[2])]
    fields = zip((name for name, _, _ in _FIELDS[kind]), values, strict=False)
    return {"parameter": parameter, "kind": kind, "target": row[2], **dict(fields)}


def encode_schedule(schedule: Sequence[Mapping[str, Any]]) -> NDArray[np.float64]:
    """Rows (E, 8) of a whole schedule, in the order in which its entries act."""
    if isinstance(schedule, (str, Mapping)) or not isinstance(schedule, Sequence):
        raise ValueError(f"schedule = {schedule!r}; must be a list of dicts, one per change")
    return np.array([encode_event(event) for event in schedule]).reshape(-1, 8)


def ramp_events(targets: Mapping[str, float], start: float, duration: float) -> list[Event]:
    """Several parameters that change together in time; start, duration [s]."""
    times = {"start": start, "duration": duration}
    return [
        {"parameter": name, "kind": "ramp", "target": target, **times}
        for name, target in targets.items()
    ]
