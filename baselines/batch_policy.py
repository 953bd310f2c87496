"""Base class of the controllers: `predict` for one vehicle or a batch, with its checks.

A subclass implements `act` for a batch. The signature of `predict` is that of
Stable-Baselines3, so that the benchmark drives controllers and trained agents alike.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.measurement import ATTITUDE
from tracked_env import observation as layout
from tracked_env.physics.parameters import RANGES, PlantParameters
from tracked_env.validation import checked_number

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Array = NDArray[np.float64]
State = TypeVar("State")


class Context(Protocol):
    """What the factory of a policy needs to know of the environment.

    control_period [s]: between two actions. lateral: model of the plant. sensors: data sheet, an
    object with the attributes of estimators.measurement.DataSheet. drive: what the actions are,
    "torque" or "speed". vehicle: nominal, on its nominal soil. observation: fields that are shown.
    """

    @property
    def control_period(self) -> float: ...
    @property
    def lateral(self) -> str: ...
    @property
    def sensors(self) -> Any: ...
    @property
    def drive(self) -> str: ...
    @property
    def vehicle(self) -> PlantParameters: ...
    @property
    def observation(self) -> Sequence[str]: ...


def shows_attitude(observation: Sequence[str]) -> bool:
    """Whether an observation with these fields shows the slope that the vehicle feels."""
    return all(name in observation for name in ATTITUDE)


def parameter_rows(values: Mapping[str, ArrayLike]) -> Array:
    """Parameters as rows (len(values), 1 or N), each a number or (N,).

    Raises ValueError for a value outside its physical range, or lengths that disagree.
    """
    arrays = [np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in values.values()]
    for (name, low_to_high), array in zip(((n, RANGES[n]) for n in values), arrays, strict=True):
        if array.ndim > 1:
            raise ValueError(f"{name} has shape {array.shape}; must be a number or shape (N,)")
        inside = (array >= low_to_high.low) & (array <= low_to_high.high)  # NaN is outside
        for number in array[~inside]:
            checked_number(f"nominal {name}", number, low_to_high)
    lengths = {len(array) for array in arrays} - {1}
    if len(lengths) > 1:
        raise ValueError(
            f"parameters for {sorted(lengths)} vehicles; all must have one and the same length"
        )
    return np.array(np.broadcast_arrays(*arrays))


def body_errors(reference: Any, x: Any, y: Any, yaw: Any) -> tuple[Any, Any, Any]:
    """Reference (x, y [m], yaw [rad]) minus a pose, position in body axes; (N,) each."""
    ahead, left, turn = reference[0] - x, reference[1] - y, reference[2] - yaw
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5)
    return cosine * ahead + sine * left, cosine * left - sine * ahead, turn


def check_columns(count: int, columns: int) -> None:
    """Raises ValueError where parameters of `columns` vehicles are not those of `count`, or one."""
    if columns not in (1, count):
        raise ValueError(f"{count} observations but parameters of {columns} vehicles")


def not_finite(observation: Floats, row: int) -> ValueError:
    """The error that names the first field of a row (N, >= SIZE) that is not finite."""
    column = int(np.argmin(np.isfinite(observation[row])))
    name = (*layout.NAMES, *ATTITUDE)[column]
    return ValueError(
        f"observation[{row}]: {name} = {observation[row, column]}; must be finite. Did the state "
        "diverge, or a wrapper divide by zero?"
    )


class BatchPolicy(Generic[State]):
    """A policy for one vehicle or a batch of N; its state belongs to the caller.

    `_view` finds the fields of the observation; a subclass sets one for the fields that its
    environment gives and those that it needs.
    """

    _view = layout.View()

    def predict(
        self,
        observation: Floats,
        state: State | None = None,
        episode_start: Bools | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[Floats, State]:
        """The action, and the state to pass to the next call.

        observation: (D,) or (N, D), in the layout of the environment. state: that of the last
        call, None begins. episode_start: (N,) or a bool; those rows begin an episode.
        deterministic: without effect, there is no randomness. The action is float32, (2,) or
        (N, 2), in [-1, 1], left then right. Raises ValueError for a wrong shape, a state of
        another number of vehicles, and a value that is not finite where it has to be; then the
        state passed in is still good.
        """
        batch = self._view(observation).copy()
        count = len(batch)
        start = np.ones(count, dtype=bool) if state is None else np.zeros(count, dtype=bool)
        if episode_start is not None:
            first = np.asarray(episode_start, dtype=bool)
            if first.shape not in ((), (1,), (count,)):
                raise ValueError(f"episode_start has shape {first.shape}; must be ({count},)")
            start |= first
        action, state = self.act(batch, state, start)
        return (action[0] if np.ndim(observation) == 1 else action), state

    def act(self, observation: Floats, state: State | None, start: Bools) -> tuple[Floats, State]:
        """Action (N, 2) and state of N vehicles; `start` (N,) is True everywhere without a state.

        observation (N, SIZE), layout v0, is a copy of its own, C-contiguous float32: it may be
        written to.
        """
        raise NotImplementedError

    def same_count(self, vehicles: int, count: int) -> None:
        """Raises ValueError where a state of `vehicles` comes with `count` observations."""
        if vehicles != count:
            raise ValueError(
                f"state of {vehicles} vehicles for {count} observations. Is it of another batch?"
            )


class LearningPolicy(BatchPolicy[State]):
    """A policy whose `_learned` values can be frozen, row by row."""

    _frozen: Bools | None = None  # rows that learn no more, until they start anew
    _frozen_values: tuple[Array, ...] = ()

    def _learned(self) -> tuple[Array, ...]:
        """What has been learned, arrays with a row per vehicle that may be written to."""
        raise NotImplementedError

    def freeze(self, rows: Bools) -> None:
        """Keep what has been learned in these rows (N,), until they start anew; filters and
        estimators go on."""
        self._frozen_values = tuple(values.copy() for values in self._learned())
        self._frozen = rows.copy() if self._frozen is None else self._frozen | rows

    def _hold_frozen(self, start: Bools) -> None:
        """Put back what was learned in the rows that are frozen."""
        if self._frozen is not None:
            self._frozen &= ~start
            for values, frozen in zip(self._learned(), self._frozen_values, strict=True):
                values[self._frozen] = frozen[self._frozen]
