"""A controller that runs beside an agent: its state, put back in some rows, and its correction."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def chosen(old: Any, new: Any, rows: NDArray[np.bool_]) -> Any:
    """`old` in the rows marked, `new` in the others; arrays (N, ...), tuples of them, or None of
    a network that carries nothing on."""
    if old is None or new is None:
        return new if old is None else old
    if isinstance(old, tuple):
        parts = [chosen(one, other, rows) for one, other in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    return np.where(rows.reshape(-1, *[1] * (old.ndim - 1)), old, new)


class HeldState:
    """An augmentation that remembers the state of its policy, which never changes in place."""

    _state: Any = None
    policy: Any
    learned: tuple[str, ...] = ()

    def freeze(self, rows: NDArray[np.bool_]) -> None:
        """The controller keeps what it knows in these rows (N,)."""
        self.policy.freeze(rows)

    def memories(self) -> Any:
        """The policy's state, None before the first observation."""
        return self._state

    def restore(self, memories: Any, rows: NDArray[np.bool_] | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        if rows is None:
            self._state = memories
        elif rows.any():
            known = self._state is not None and memories is not None
            self._state = chosen(memories, self._state, rows) if known else memories


def checked_scale(scale: float) -> float:
    """How far an agent may correct an action. Raises ValueError for one outside (0, 2]."""
    if not 0.0 < scale <= 2.0:
        raise ValueError(f"residual scale = {scale}; must be in (0, 2]: actions lie in [-1, 1]")
    return scale


def corrected(
    action: NDArray[np.float32], scale: float, correction: NDArray[np.float32]
) -> NDArray[np.float32]:
    """The controller's action plus the agent's, scaled, within [-1, 1]; (N, 2) each."""
    return np.clip(action + np.float32(scale) * correction, -1.0, 1.0)
