"""Beliefs of a policy: its estimates, taken down step by step beside the true values.

A policy with the hook `estimates` is asked after each `predict`. Row k holds its estimate and
standard deviation at time k h, when it has seen k + 1 observations, and the true value that was in
force when the last of them was taken. Estimates of parameters outside KNOWN, or that the plant does
not read, have no true value and are not taken down. `identification_metrics` evaluates the rows.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine.columns import columns
from tracked_env.physics.parameters import PARAMETER_NAMES

SLIPS = ("slip_left", "slip_right")
KNOWN = (*PARAMETER_NAMES, "effort_maximum", *SLIPS)  # what may be estimated


class Beliefs(NamedTuple):
    """Estimates of a policy for n vehicles over T control steps, and the true values."""

    names: tuple[str, ...]  # (P,)
    value: NDArray[np.float32]  # (T, P, n) SI
    deviation: NDArray[np.float32]  # (T, P, n)
    truth: NDArray[np.float32]  # (T, P, n)
    excited: NDArray[np.bool_]  # (T, P, n)
    reports_excitation: tuple[bool, ...]  # (P,) whether `excited` is known
    nis: dict[str, NDArray[np.float32]]  # (T, n) by filter


class Recorder:
    """Takes down the beliefs of one batch, step by step."""

    def __init__(self, count: int, max_steps: int, read: frozenset[str] = frozenset(KNOWN)) -> None:
        """read: parameters that the plant reads; others have no true value."""
        self.truths = read | {"effort_maximum", *SLIPS}
        self.count, self.max_steps = count, max_steps
        self.rows = 0
        self.names: tuple[str, ...] = ()
        self.reports_excitation: tuple[bool, ...] = ()
        self._columns: list[int] = []

    def _allocate(self, estimates: Mapping[str, Any], excited: Mapping[str, Any]) -> None:
        """Fix the names by the first answer. Raises ValueError if none of them is known."""
        self.names = tuple(name for name in estimates if name in KNOWN and name in self.truths)
        if not self.names:
            raise ValueError(f"estimates of {sorted(estimates)}; none of them is in {KNOWN}")
        for name in self.names:
            answer = estimates[name]
            if len(answer) != 2 or any(np.shape(part) != (self.count,) for part in answer):
                raise ValueError(
                    f"estimate of {name} has shapes {[np.shape(part) for part in answer]}; must be "
                    f"(value, standard deviation), each ({self.count},): one number per vehicle"
                )
        self.reports_excitation = tuple(name in excited for name in self.names)
        self._columns = columns(self.names)
        shape = (self.max_steps, len(self.names), self.count)
        self.value, self.deviation, self.truth = (np.empty(shape, np.float32) for _ in range(3))
        self.excited = np.zeros(shape, dtype=bool)
        self.nis: dict[str, NDArray[np.float32]] = {}

    def take(self, policy: Any, floats: NDArray[np.float64]) -> None:
        """One row. floats: those of the batch, before the step that follows.

        Raises ValueError for names or shapes that are not understood.
        """
        k = self.rows
        estimates = policy.estimates()
        excited = policy.excited() if hasattr(policy, "excited") else {}
        if k == 0:
            self._allocate(estimates, excited)
        for j, name in enumerate(self.names):
            self.value[k, j], self.deviation[k, j] = estimates[name]
            if self.reports_excitation[j]:
                self.excited[k, j] = excited[name]
        self.truth[k] = floats[:, self._columns].T
        for name, nis in (policy.nis() if hasattr(policy, "nis") else {}).items():
            if name not in self.nis:
                self.nis[name] = np.full((self.max_steps, self.count), np.nan, dtype=np.float32)
            self.nis[name][k] = nis
        self.rows += 1

    def beliefs(self) -> Beliefs:
        """All that was taken down."""
        n = self.rows
        parts = (self.value[:n], self.deviation[:n], self.truth[:n], self.excited[:n])
        return Beliefs(
            self.names,
            *parts,
            self.reports_excitation,
            {name: nis[:n] for name, nis in self.nis.items()},
        )
