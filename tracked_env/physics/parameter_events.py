"""How a parameter changes inside an episode: ramps in time, regions and waves in space.

An event changes one parameter. With w in [0, 1] its weight:
    ramp, region, line:  value <- value + w (target - value)
    wave:                value <- target + a X cos(k_x X + k_y Y + phase) exp(-decay Y), in
                         [WAVE_LOW, WAVE_HIGH]: resistance coefficients only
The wave form contains S (44) and (45), the resistance maps of S section 8.2.2.
An event is one row of eight numbers: kind, parameter index, target, then five more:
    RAMP    start [s], duration [s] (0 = step)
    REGION  x [m], y [m], radius [m], width of the edge [m]: inside a disc
    LINE    x [m], y [m], cos, sin of the normal, width [m]: beyond a straight line
    WAVE    amplitude per metre of X, k_x, k_y [rad/m], phase [rad], decay [1/m]
Every finite position gives a finite value: coordinates count at most as FAR, the exponent as
EXPONENT_LIMIT, both far outside any map.

References: [1] Strawa et al., Electronics 10 (2021) 187, (44) and (45).
"""

import math

from tracked_env.physics.jit import formula

WAVE_LOW, WAVE_HIGH = 0.2, 1.5  # [-] a wave is clipped here: (44) leaves the physical range
FAR = 1e100  # [m] its square is finite, and so is its product with every field of an event
EXPONENT_LIMIT = 700.0  # [-] exp of it, and of its negative, are finite and not 0
RAMP, REGION, LINE, WAVE = range(4)
KINDS = {"ramp": RAMP, "region": REGION, "line": LINE, "wave": WAVE}


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
