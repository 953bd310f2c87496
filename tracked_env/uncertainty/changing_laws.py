"""Laws of what changes every 1.5 to 4.5 s: loads, resistances, drives, floors, ground, boxes.

Vehicles and ground are those of `soils` and `laws`, outdoors, on floors and on uneven ground.
"""

import math

from tracked_env.physics.jit import formula
from tracked_env.streams import random, uniform
from tracked_env.uncertainty.drawing_laws import LOAD, RESISTANCES, ROW, law, ramp
from tracked_env.uncertainty.laws import (
    GAINS,
    PAYLOAD,
    begin_with,
    box,
    floor,
    incline,
    uneven_ground,
)
from tracked_env.uncertainty.soils import ACROSS, ALONG, firm_ground, largest_load, resistance

OFTEN, OFTEN_CHANGES = 2.5, 11  # [s], [-] of each load, ground or pair of drives, in an episode
FLICKER_PERIOD, FLICKER_CHANGES = 1.5, 19  # [s], [-] of one drive that fails and comes back
GROUND_PERIOD, GROUND_CHANGES = 2.0, 14  # [s], [-] of slippery and rough ground in turn
BOX_PERIOD, BOX_CHANGES = 4.5, 6  # [s], [-] of a box that is put down and taken up


@formula
def _next_load(rng, nominal, changes, time):
    """At `time` [s] mass and inertia become *U(0.6, 2), the same share."""
    share = largest_load(nominal, uniform(rng, 0.6, 2.0))
    ramp(changes, LOAD, (nominal.mass * share, nominal.inertia * share), time, 0.0)


@formula
def _next_resistances(rng, nominal, changes, time):
    """At `time` [s] mu_l becomes =U(0.1, 0.7), mu_t =U(0.3, 0.9), of heavy clay."""
    along, across = uniform(rng, 0.1, 0.7), uniform(rng, 0.3, 0.9)
    along = resistance(along, nominal.longitudinal_resistance, ALONG)
    across = resistance(across, nominal.lateral_resistance, ACROSS)
    ramp(changes, RESISTANCES, (along, across), time, 0.0)


@formula
def _next_gains(rng, changes, time):
    """At `time` [s] the drives settle at =U(0.4, 1) of their torque, each at its own."""
    gains = uniform(rng, 0.4, 1.0), uniform(rng, 0.4, 1.0)
    ramp(changes, GAINS, gains, time, 0.0)


@law("alternating-loads")
def _alternating_loads(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle that takes up or puts down a load every 2.5 s."""
    firm_ground(rng, nominal, truth)
    for k in range(1, OFTEN_CHANGES + 1):
        _next_load(rng, nominal, changes, k * OFTEN)


@law("alternating-resistances")
def _alternating_resistances(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle on ground whose resistances are others every 2.5 s."""
    firm_ground(rng, nominal, truth)
    for k in range(1, OFTEN_CHANGES + 1):
        _next_resistances(rng, nominal, changes, k * OFTEN)


@law("flickering-drive")
def _flickering_drive(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle, one of whose drives fails and comes back every 1.5 s."""
    firm_ground(rng, nominal, truth)
    side = ROW.actuator_gain_left if random(rng) < 0.5 else ROW.actuator_gain_right  # odds 1/2
    for k in range(1, FLICKER_CHANGES + 1):
        gain = uniform(rng, 0.3, 0.5) if k % 2 == 1 else 1.0  # =U(0.3, 0.5)
        ramp(changes, (side,), (gain,), k * FLICKER_PERIOD, 0.0)


@law("alternating-all")
def _alternating_all(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle; every 2.5 s other resistances and other torques of the drives."""
    firm_ground(rng, nominal, truth)
    for k in range(1, OFTEN_CHANGES + 1):
        _next_resistances(rng, nominal, changes, k * OFTEN)
        _next_gains(rng, changes, k * OFTEN)


@formula
def _changing_friction(rng, truth, changes, slippery, rough):
    """Every 2 s slippery ground or rough one in turn, mu =U(..) drawn anew each time."""
    odd = 1 if random(rng) < 0.5 else 0  # which comes first
    for k in range(GROUND_CHANGES + 1):
        low, high = slippery if (k + odd) % 2 == 0 else rough
        friction_angle = math.atan(uniform(rng, low, high))
        if k == 0:
            truth.friction_angle = friction_angle
        else:
            ramp(changes, (ROW.friction_angle,), (friction_angle,), k * GROUND_PERIOD, 0.0)


@law("changing-floors")
def _changing_floors(rng, nominal, path, truth, changes):
    """A `friction` vehicle; every 2 s another floor, a slippery one and a rough one in turn."""
    floor(rng, nominal, truth, 0.1)
    _changing_friction(rng, truth, changes, (0.1, 0.15), (0.5, 0.8))


@law("changing-slope")
def _changing_slope(rng, nominal, path, truth, changes):
    """Unknown slope; every 2 s another ground, a slippery one and a rough one in turn."""
    floor(rng, nominal, truth, 0.4)
    incline(rng, changes, 0.3)  # grade =U(0, 0.3)
    _changing_friction(rng, truth, changes, (0.4, 0.5), (0.7, 0.9))


@law("changing-hills")
def _changing_hills(rng, nominal, path, truth, changes):
    """Unknown hills; every 2 s another ground, a slippery one and a rough one in turn."""
    floor(rng, nominal, truth, 0.4)
    uneven_ground(rng, nominal, changes)
    _changing_friction(rng, truth, changes, (0.4, 0.5), (0.7, 0.9))


@law("slope-boxes")
def _slope_boxes(rng, nominal, path, truth, changes):
    """A vehicle of `slope` that takes up a box, another one each time, or puts it down, in turn."""
    floor(rng, nominal, truth, 0.4)
    incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    odd = 1 if random(rng) < 0.5 else 0  # whether it begins with a box
    for k in range(BOX_CHANGES + 1):
        without, carrying = box(rng, nominal)
        values = carrying if (k + odd) % 2 == 1 else without
        if k == 0:
            begin_with(truth, values)
        else:
            ramp(changes, PAYLOAD, values, k * BOX_PERIOD, 0.0)
