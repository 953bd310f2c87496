"""Rewards and costs that the compiled control step does not have.

`reward=` of an environment is a name, a dict or a function:
    "default"                        the terms of `tracked_env.step`, in its kernel
    "mine"                           what `register("mine", reward)` names: a dict or a function
    "my_rewards:mine"                the same, registered by a module that is imported first
    {"position": {"weight": 0.7, "scale": 0.015}, "heading": {"weight": 0.0}}
                                     other weights and scales of the terms; the rest as by default
    reward(outcome) -> (n,)          a function of an `Outcome`, in NumPy or compiled by Numba
Scales are distance over contact length [-], heading error [rad], speed error over contact length
[1/s]. A function gets all vehicles that have taken the step at once, one or many. It is to compute
each of them from its own entries alone, without memory: then a row of many is equal to one alone.

`costs=` is a dict of limits, each a term that is 1 in a step in which it is exceeded, else 0:
    tilt         angle between the up axis and the vertical [rad]
    slip         the larger magnitude of both slip ratios [-]
    corridor     distance across the reference, to either side [m]
    torque       the larger magnitude of both sprocket torques over the torque limit [-]
    obstacles    discs [[x, y, radius], ...] [m], world frame: the vehicle's origin is nearer to an
                 edge than `clearance` [m], by default half the diagonal of the vehicle
`budget` is what the costs of an episode may add up to, for learners to read.
A vehicle whose motion is no longer finite has the worst of every term and exceeds every limit. A
function sees it standing at the error limit behind its reference, `diverged` and `terminated`.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env.entry_points import registered_name
from tracked_env.physics import parameters as s
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX, PlantParameters, Range
from tracked_env.step import HEADING_SCALE, POSITION_SCALE, SPEED_SCALE, WEIGHTS, is_finite
from tracked_env.validation import checked_keys, checked_number

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
DEFAULT = "default"
SCALES = {"position": POSITION_SCALE, "heading": HEADING_SCALE, "speed": SPEED_SCALE}
_WEIGHT = Range(-1e3, 1e3, "-", "It is what the term is worth in a control step.")
_SCALE = Range(1e-6, 1e3, "SI", "It is the error at which the term is half its weight.")
LIMITS = {
    "tilt": Range(0.0, math.pi, "rad", "Did you pass degrees?"),
    "slip": Range(0.0, 1.0, "-", "It is a magnitude."),
    "corridor": Range(0.0, 1e6, "m", "It is half the width of the corridor."),
    "torque": Range(0.0, 10.0, "-", "It is a share of the torque limit, no N m."),
}
_LENGTH = Range(0.0, 1e6, "m", "It is a length.")
_PLACE = Range(-1e6, 1e6, "m", "It is a world coordinate.")
_BUDGET = Range(0.0, 1e9, "-", "It is a sum over the steps of an episode.")


class Outcome(NamedTuple):
    """What a control step came to, for n vehicles; SI, true values, errors reference less vehicle.

    Arrays (n,), pairs (n, 2) left and right.
    """

    error_along: Floats  # [m] position error along the reference heading, horizontal
    error_across: Floats  # [m] the same to the left of it
    distance: Floats  # [m] to the reference; of a tilted vehicle in its own plane
    heading_error: Floats  # [rad] in (-pi, pi]
    speed_error: Floats  # [m/s]
    speed: Floats  # [m/s] forward velocity, body frame
    yaw_rate: Floats  # [rad/s]
    reference_speed: Floats  # [m/s]
    reference_yaw_rate: Floats  # [rad/s]
    x: Floats  # [m] world
    y: Floats  # [m] world
    yaw: Floats  # [rad] world, not wrapped
    tilt: Floats  # [rad] of the up axis against the vertical
    contact_length: Floats  # [m]
    action: Floats  # (n, 2) [-] in force in this step, in [-1, 1]
    last_action: Floats  # (n, 2) [-] of the step before, 0 at first
    slip: Floats  # (n, 2) [-] slip ratios
    torque: Floats  # (n, 2) [-] sprocket torques over the torque limit
    terminated: Bools  # the episode has ended badly
    diverged: Bools  # so, because the motion is not finite


_LENGTH_NOW = b.PARAMETERS + PARAMETER_INDEX["contact_length"]
_TORQUE_LIMIT = b.PARAMETERS + PARAMETER_INDEX["torque_limit"]
_PAIRS = ("action", "last_action", "slip", "torque")
_FLAGS = ("terminated", "diverged")


@loop
def _read(floats, counters, rows, out):
    """Write the last step of these rows into an `Outcome` of zeros."""
    for k in range(rows.size):
        i = rows[k]
        out.contact_length[k] = floats[i, _LENGTH_NOW]
        out.reference_speed[k] = floats[i, b.REFERENCE_MOTION]
        out.reference_yaw_rate[k] = floats[i, b.REFERENCE_MOTION + 3]
        for side in range(2):
            out.action[k, side] = floats[i, b.ACTION + side]
            out.last_action[k, side] = floats[i, b.LAST_ACTION + side]
        out.terminated[k] = counters[i, b.TERMINATED] != 0
        if not is_finite(floats, i):
            out.diverged[k] = True
            out.error_along[k] = out.distance[k] = floats[i, b.ERROR_LIMIT]
            continue
        x, y = floats[i, b.STATE + s.X], floats[i, b.STATE + s.Y]
        dx, dy = floats[i, b.REFERENCE_X] - x, floats[i, b.REFERENCE_Y] - y
        cosine, sine = floats[i, b.REFERENCE_COSINE], floats[i, b.REFERENCE_COSINE + 1]
        out.error_along[k], out.error_across[k] = cosine * dx + sine * dy, cosine * dy - sine * dx
        out.distance[k], out.heading_error[k] = floats[i, b.ERROR_DISTANCE], floats[i, b.ERROR_YAW]
        out.speed[k], out.yaw_rate[k] = floats[i, b.STATE + s.V_X], floats[i, b.STATE + s.YAW_RATE]
        out.speed_error[k] = floats[i, b.REFERENCE_MOTION] - floats[i, b.STATE + s.V_X]
        out.x[k], out.y[k], out.yaw[k] = x, y, floats[i, b.STATE + s.YAW]
        upright = math.cos(floats[i, b.STATE + s.PITCH]) * math.cos(floats[i, b.STATE + s.ROLL])
        out.tilt[k] = math.acos(min(max(upright, -1.0), 1.0))
        for side in range(2):
            out.slip[k, side] = floats[i, b.STATE + s.SLIP_LEFT + side]
            torque = floats[i, b.STATE + s.TORQUE_LEFT + side]
            out.torque[k, side] = torque / floats[i, _TORQUE_LIMIT]


def _blank(count: int) -> Outcome:
    """An outcome of zeros."""
    shape = {**dict.fromkeys(Outcome._fields, (count,)), **dict.fromkeys(_PAIRS, (count, 2))}
    return Outcome(*(np.zeros(shape[n], np.bool_ if n in _FLAGS else float) for n in shape))


class WeightedTerms(NamedTuple):
    """The terms of `tracked_env.step` with other weights and scales."""

    weights: Mapping[str, float]  # by name, in the order of `arrays.REWARD_TERMS`
    scales: Mapping[str, float]

    def __call__(self, its: Outcome) -> list[Floats]:
        """Each term (n,), in order."""
        ratios = {
            "position": its.distance / its.contact_length / self.scales["position"],
            "heading": its.heading_error / self.scales["heading"],
            "speed": its.speed_error / its.contact_length / self.scales["speed"],
        }
        sizes = {name: 1.0 / (1.0 + ratio * ratio) for name, ratio in ratios.items()}
        change = its.action - its.last_action
        sizes["effort"] = 0.5 * _square(its.action)
        sizes["smoothness"] = 0.125 * _square(change)
        return [
            np.where(its.diverged, min(weight, 0.0), weight * sizes[name])
            for name, weight in self.weights.items()
        ]


def _square(pair: Floats) -> Floats:
    return pair[:, 0] * pair[:, 0] + pair[:, 1] * pair[:, 1]


Function = Callable[[Outcome], Any]
Reward = str | Mapping[str, Any] | Function
_REGISTERED: dict[str, Reward] = {}


def register(name: str, reward: Reward) -> None:
    """Give a reward a name, by which environments of this process find it.

    reward: a dict or a function, see the head of this file. Raises ValueError for a name that is
    taken, for a dict with an unknown term or a number out of range, and for a function that does
    not return an array (n,) of numbers.
    """
    taken = [DEFAULT, *_REGISTERED]
    if name in ("", *taken) or name != str(name):
        raise ValueError(f"reward name = {name!r}; must be text, and none of {taken}")
    _checked_reward(reward)
    _REGISTERED[name] = reward


def reward_record(reward: Any) -> Any:
    """A reward as records keep it: the dict that a name stands for, all others as they are."""
    is_name = isinstance(reward, str) and reward != DEFAULT
    registered = _REGISTERED[_name(reward)] if is_name else reward
    return registered if isinstance(registered, Mapping) else reward


def _name(reward: str) -> str:
    """A name that is known, without its module. Raises ValueError."""
    return registered_name("reward", reward, lambda: (DEFAULT, *_REGISTERED))


def _checked_reward(reward: Any) -> WeightedTerms | Function | None:
    """The reward as a function of an outcome; None: the kernel's. Raises ValueError."""
    if isinstance(reward, str):
        name = _name(reward)
        return None if name == DEFAULT else _checked_reward(_REGISTERED[name])
    if callable(reward):
        _numbers(reward(_blank(2)._replace(contact_length=np.ones(2))), 2)
        return reward
    if not isinstance(reward, Mapping):
        raise ValueError(
            f"reward = {reward!r:.100}; must be a name, a dict of terms or a function of an "
            "Outcome. Did you pass a weight itself?"
        )
    weights, scales = dict(WEIGHTS), dict(SCALES)
    for term, changes in checked_keys("reward", reward, WEIGHTS).items():
        keys = ("weight", "scale") if term in SCALES else ("weight",)
        for key, value in checked_keys(f"reward {term}:", changes, keys).items():
            of, allowed = (weights, _WEIGHT) if key == "weight" else (scales, _SCALE)
            of[term] = checked_number(f"reward {term} {key}", value, allowed)
    return WeightedTerms(weights, scales)


def _numbers(value: Any, count: int) -> Floats:
    """What a function of the user's own returns, as (count,) floats. Raises ValueError."""
    numbers = np.asarray(value)
    if numbers.shape != (count,) or numbers.dtype.kind not in "fiub":
        raise ValueError(
            f"reward has shape {numbers.shape} and dtype {numbers.dtype}; must be ({count},) "
            "numbers, one a vehicle. Did the function average over vehicles, or return nothing?"
        )
    return numbers.astype(np.float64)


class Costs:
    """The cost terms of a dict of limits. Raises ValueError."""

    def __init__(self, costs: Any, vehicle: PlantParameters) -> None:
        """vehicle: the nominal one, of whose size is the default clearance."""
        keys = (*LIMITS, "obstacles", "clearance", "budget")
        costs = checked_keys("costs", costs, keys)
        self._limits = {
            name: checked_number(f"costs {name}", costs[name], allowed)
            for name, allowed in LIMITS.items()
            if name in costs
        }
        self._discs = _discs(costs["obstacles"]) if "obstacles" in costs else None
        width = vehicle.track_gauge + vehicle.track_width
        half_diagonal = 0.5 * math.hypot(vehicle.contact_length, width)
        clearance = costs.get("clearance", half_diagonal)
        self._clearance = checked_number("costs clearance", clearance, _LENGTH)
        if "clearance" in costs and self._discs is None:
            raise ValueError("costs clearance is of obstacles; name these too, or leave it out")
        budget = costs.get("budget")
        self.budget = None if budget is None else checked_number("costs budget", budget, _BUDGET)
        names = [*self._limits, *(["obstacles"] if self._discs is not None else [])]
        self.names = ("cost", *(f"cost_{name}" for name in names)) if names else ()
        if costs and not names:
            raise ValueError(f"costs has no limit; must have one of {[*LIMITS, 'obstacles']}")

    def __call__(self, its: Outcome) -> Floats:
        """(n, C): how many limits are exceeded, then 1 or 0 of each."""
        sizes = {
            "tilt": its.tilt,
            "slip": np.abs(its.slip).max(axis=1),
            "corridor": np.abs(its.error_across),
            "torque": np.abs(its.torque).max(axis=1),
        }
        exceeded = [sizes[name] > limit for name, limit in self._limits.items()]
        if self._discs is not None:
            x, y, radius = self._discs.T
            dx, dy = its.x[:, None] - x, its.y[:, None] - y
            exceeded.append((np.sqrt(dx * dx + dy * dy) - radius < self._clearance).any(axis=1))
        terms = np.array(exceeded, dtype=np.float64) + 0.0
        terms[:, its.diverged] = 1.0
        return np.vstack([terms.sum(axis=0), terms]).T


def _discs(value: Any) -> Floats:
    """Obstacles (K, 3): x, y, radius [m]. Raises ValueError."""
    if not isinstance(value, (list, tuple, np.ndarray)) or np.shape(value)[1:] != (3,):
        raise ValueError(
            f"costs obstacles = {value!r:.100}; must be [[x, y, radius], ...] in m. Did you pass "
            "one obstacle without the outer list?"
        )
    of = (("x", _PLACE), ("y", _PLACE), ("radius", _LENGTH))
    rows = [list(row) for row in value]
    return np.array([
        [checked_number(f"obstacle {n}", row[k], allowed) for k, (n, allowed) in enumerate(of)]
        for row in rows
    ])  # fmt: skip


class Scoring:
    """Reward and costs of a batch, from its arrays after each control step."""

    def __init__(self, reward: Any, costs: Any, vehicle: PlantParameters) -> None:
        """vehicle: the nominal one. Raises ValueError."""
        self._reward = _checked_reward(reward)
        self.costs = Costs(costs, vehicle)

    def write(self, batch: b.Batch, vehicles: NDArray[np.int64]) -> None:
        """Rewards and costs of the vehicles that have taken a step; the others have no cost.

        Costs stand in the last columns of the batch. Raises ValueError for a reward that is not
        finite.
        """
        rows = np.ascontiguousarray(vehicles, dtype=np.int64)
        its = _blank(rows.size)
        _read(batch.floats, batch.counters, rows, its)
        if self.costs.names:
            kept = batch.floats[:, -len(self.costs.names) :]
            kept[:] = 0.0
            kept[rows] = self.costs(its)
        if isinstance(self._reward, WeightedTerms):
            terms = self._reward(its)
            batch.floats[rows, b.TERMS : b.TERMS + len(terms)] = np.array(terms).T
            batch.floats[rows, b.REWARD] = sum(terms[1:], terms[0])
        elif self._reward is not None:
            reward = _numbers(self._reward(its), rows.size)
            if not np.isfinite(reward).all():
                k = int(np.flatnonzero(~np.isfinite(reward))[0])
                raise ValueError(
                    f"reward of vehicle {rows[k]} = {reward[k]}; must be finite. Does it divide by "
                    "a speed or an error that is 0?"
                )
            batch.floats[rows, b.REWARD] = reward
