"""Laws of heavy vehicles whose drives answer late, or give less torque than commanded."""

from tracked_env.physics.jit import formula, loop
from tracked_env.streams import integer, random, uniform
from tracked_env.uncertainty import compiled as c
from tracked_env.uncertainty.soils import firm_ground

GAIN_PERIOD = 4.0  # [s] from one pair of gains to the next
GAIN_CHANGES = 8  # [-] of each drive, in an episode


@formula
def _slow_drive(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle whose motors answer late."""
    firm_ground(rng, nominal, truth)
    truth.drive_time_constant = uniform(rng, 0.15, 0.3)  # =U(0.15, 0.3)


@formula
def _weak_actuator(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle whose drives, one or both, give less torque than commanded."""
    firm_ground(rng, nominal, truth)
    weak = integer(rng, 3)  # the left drive, the right drive or both, with equal odds
    left, right = uniform(rng, 0.4, 0.7), uniform(rng, 0.4, 0.7)  # =U(0.4, 0.7) each
    if weak != 1:
        truth.actuator_gain_left = left
    if weak != 0:
        truth.actuator_gain_right = right


@formula
def _actuator_fault(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle, one of whose drives loses a part of its torque on the way."""
    firm_ground(rng, nominal, truth)
    start = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    gain = uniform(rng, 0.4, 0.7)  # =U(0.4, 0.7)
    side = c.ACTUATOR_GAIN_LEFT if random(rng) < 0.5 else c.ACTUATOR_GAIN_RIGHT  # odds 1/2
    c.ramp(changes, side, gain, start, 0.0)


@formula
def _alternating_gains(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle; every 4 s, for 32 s, both drives settle at another torque."""
    firm_ground(rng, nominal, truth)
    truth.actuator_gain_left = uniform(rng, 0.4, 1.0)  # =U(0.4, 1)
    truth.actuator_gain_right = uniform(rng, 0.4, 1.0)  # =U(0.4, 1)
    for k in range(1, GAIN_CHANGES + 1):
        left, right = uniform(rng, 0.4, 1.0), uniform(rng, 0.4, 1.0)  # =U(0.4, 1) each
        c.ramp(changes, c.ACTUATOR_GAIN_LEFT, left, k * GAIN_PERIOD, 0.0)
        c.ramp(changes, c.ACTUATOR_GAIN_RIGHT, right, k * GAIN_PERIOD, 0.0)


@loop
def _each_slow_drive(*call):
    c.draw_each(_slow_drive, call)


@loop
def _each_weak_actuator(*call):
    c.draw_each(_weak_actuator, call)


@loop
def _each_actuator_fault(*call):
    c.draw_each(_actuator_fault, call)


@loop
def _each_alternating_gains(*call):
    c.draw_each(_alternating_gains, call)


LAWS = c.laws(
    ("slow-drive", _each_slow_drive, _slow_drive),
    ("weak-actuator", _each_weak_actuator, _weak_actuator),
    ("actuator-fault", _each_actuator_fault, _actuator_fault),
    ("alternating-gains", _each_alternating_gains, _alternating_gains),
)
