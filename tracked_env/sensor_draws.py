"""The draw of one vehicle's sensors for one episode, as the kernels take it.

Laws of the draws, once per episode and vehicle:
    gyro and accelerometer bias     = s b, s = -1 or +1 with equal odds, b the data-sheet bias
    noise, every sample             = N(0, sigma^2)
    dropout, every sample and group : lost with probability p; the last sample stays
    outages of the pose = U(gap), U(length), U(gap), ... [s], a renewal process; the first sample of
                          an episode comes always
Outages are drawn while the episode runs (`engine.observing.outage`), by numbers of its noise that
no sample uses, so that all other numbers stay what they are.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env.physics.channels import GROUPS, TABLE, Channel
from tracked_env.physics.jit import formula
from tracked_env.sensors import ADDED, DELAY_LIMIT, PERIOD_LIMIT, Sensors
from tracked_env.streams import addresses, random

_BIASED = np.array([column for column, channel in enumerate(TABLE) if channel.bias])


class SensorDraw(NamedTuple):
    """The sensors of one vehicle in one episode, as the kernels take them."""

    sigma: NDArray[np.float64]  # (CHANNEL_COUNT,)
    bias: NDArray[np.float64]  # (CHANNEL_COUNT,)
    cross_coupling: float
    dropout: NDArray[np.float64]  # (3,) a standard normal number below it loses the sample
    period: NDArray[np.int64]  # (3,) [control steps]
    delay: NDArray[np.int64]  # (3,) [control steps]
    noisy: bool  # False: no random number is needed
    velocity: float  # 1, or 0 where v_x and v_y are not measured
    added: tuple[tuple[str, float, float], ...] = ()  # registered channels: name, sigma, |bias|
    outage: tuple[float, ...] = ()  # [control steps] gap low, high, length low, high; empty: none


def _error(sensors: Sensors, channel: Channel, field: str) -> float:
    """Sigma or bias magnitude of a channel, from a field of the sensors.

    Two sensors a distance D apart, each with that error: sqrt(2) times it, over D.
    """
    if not field or (channel.switch and not sensors.value(channel.switch)):
        return 0.0
    if channel.differential:
        return float(np.sqrt(2.0)) * sensors.value(field) / sensors.accelerometer_distance
    return sensors.value(field)


def _steps(sensors: Sensors, control_period: float) -> tuple[list[int], list[int]]:
    rates = [getattr(sensors, f"{group}_rate") for group in GROUPS]
    delays = [getattr(sensors, f"{group}_delay") for group in GROUPS]
    longest = round(PERIOD_LIMIT / control_period)
    periods = [
        1 if rate <= 0.0 else min(max(round(1.0 / (rate * control_period)), 1), longest)
        for rate in rates
    ]
    return periods, [round(delay / control_period) for delay in delays]


def fixed_part(sensors: Sensors, control_period: float, added: tuple[str, ...]) -> SensorDraw:
    """The draw with the magnitudes of its biases, which get a sign."""
    further = (
        (name, _error(sensors, ADDED[name], ADDED[name].noise),
         _error(sensors, ADDED[name], ADDED[name].bias))
        for name in added
    )  # fmt: skip
    return _own_part(sensors, control_period)._replace(added=tuple(further))


@lru_cache(maxsize=256)
def _own_part(sensors: Sensors, control_period: float) -> SensorDraw:
    """The same without registered channels."""
    probability = np.array([getattr(sensors, f"{group}_dropout") for group in GROUPS])
    periods, delays = _steps(sensors, control_period)
    bounds = (*sensors.pose_outage_gap, *sensors.pose_outage_length)
    outage = tuple(time / control_period for time in bounds) if any(bounds) else ()
    sigma = np.array([_error(sensors, channel, channel.noise) for channel in TABLE])
    # The two accelerometers' biases differ by sqrt(2) of one, in the mean square.
    bias = np.array([_error(sensors, channel, channel.bias) for channel in TABLE])
    return SensorDraw(
        sigma,
        bias,
        sensors.cross_coupling,
        ndtri(probability),
        np.array(periods, dtype=np.int64),
        np.array(delays, dtype=np.int64),
        bool(np.any(sigma > 0.0) or np.any(probability > 0.0) or outage),
        sensors.velocity_measured,
        outage=outage,
    )


@formula
def draw_signs(rng, bias):
    """Give the magnitudes of the biases (CHANNEL_COUNT,) their signs for one episode."""
    for k in range(_BIASED.size):  # also of zero biases: keeps the stream aligned
        if random(rng) < 0.5:
            bias[_BIASED[k]] = -bias[_BIASED[k]]


def draw_sensors(
    sensors: Sensors, control_period: float, rng: np.random.Generator, added: tuple[str, ...] = ()
) -> SensorDraw:
    """Draw biases; turn rates and delays [s] into control steps of `control_period` [s].

    added: registered channels that are sampled.
    """
    fixed = fixed_part(sensors, control_period, added)
    bias = fixed.bias.copy()
    draw_signs(addresses([rng])[0], bias)
    return fixed._replace(bias=bias)


def longest_delay_steps(control_period: float) -> int:
    """Control steps that the longest allowed delay takes."""
    return round(DELAY_LIMIT / control_period)
