"""What can be read of N vehicles between their steps: copies, by name, in SI units."""

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.physics.parameters import PARAMETER_NAMES
from tracked_env.physics.state import STATE_NAMES

SUCCESS_RMSE = 0.25  # [-] an episode that ends with less, over the contact length, is a success


def ending_flags(failures: tuple[str, ...]) -> list[str]:
    """Names of the flags of `info` for a plant that can fail so, `Plant.failures`."""
    return [f"ended_{name}" for name in ("off_path", *failures)]


class Readings:
    """Of the arrays `batch`, one row per vehicle."""

    batch: b.Batch
    # Which episodes have ended, looked up when it is asked for after a step in which one did:
    _ended: NDArray[np.bool_]
    _ended_known: bool
    _some_resting: bool

    def column(self, name: str) -> NDArray[np.float64]:
        """A copy (N,) of one column of the floats; names: `columns.COLUMN`."""
        return self.batch.column(name).copy()

    def report(self) -> b.Report:
        """A copy of tracking error, reward and its terms."""
        return self.batch.report()

    @property
    def steps(self) -> NDArray[np.int64]:
        """(N,) control steps since reset."""
        return self.batch.counter("step").copy()

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """(N,) off the path, or non-finite."""
        return self.batch.counter("terminated") != 0

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """(N,) out of time."""
        return self.batch.counter("truncated") != 0

    @property
    def ended(self) -> NDArray[np.bool_]:
        """(N,) the episode has ended, and none was started since; such rows are not to be stepped.

        The array itself, which a reset changes.
        """
        if not self._ended_known:
            counters = self.batch.counters
            self._ended = (counters[:, b.TERMINATED] | counters[:, b.TRUNCATED]) != 0
            self._ended_known = True
        return self._ended

    def resting(self) -> NDArray[np.bool_] | None:
        """A copy of `ended`, or None where no episode has ended."""
        if not self._some_resting:
            return None
        self._some_resting = bool(self.ended.any())
        return self.ended.copy() if self._some_resting else None

    @property
    def rmse(self) -> NDArray[np.float64]:
        """(N,) root mean square distance to the reference since reset [m]."""
        steps = np.maximum(self.batch.counter("step"), 1)
        return np.sqrt(self.batch.column("squared_error_sum") / steps)

    @property
    def success(self) -> NDArray[np.bool_]:
        """(N,) the episode has ended by time with an RMSE below SUCCESS_RMSE."""
        return self.truncated & (self.rmse < SUCCESS_RMSE * self.batch.column("contact_length"))

    def endings(self, failures: tuple[str, ...]) -> dict[str, NDArray[np.bool_]]:
        """Why episodes have terminated, (N,) each: off the path, or a failure of the plant.

        failures: `Plant.failures`. A state that is not finite has no flag.
        """
        names, over = ending_flags(failures), self.terminated
        if not np.count_nonzero(over):  # nearly always: nothing to look up
            return {name: np.zeros_like(over) for name in names}
        code = self.batch.floats[:, b.FAILURE]
        finite = np.isfinite(self.batch.state()).all(axis=1)
        return {name: over & finite & (code == k) for k, name in enumerate(names)}

    def reference_position(self, i: int) -> NDArray[np.float64]:
        """(2,) position [m] of the reference of vehicle i now, world frame."""
        return self.batch.floats[i, b.REFERENCE_X : b.REFERENCE_Y + 1].copy()

    def truth(self) -> dict[str, NDArray[np.float64]]:
        """True state and parameters in force, by name; each (N,)."""
        return {name: self.column(name) for name in (*STATE_NAMES, *PARAMETER_NAMES)}
