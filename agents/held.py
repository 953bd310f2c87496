"""The state of a policy that a memory drives along: handed out, and put back in some rows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def chosen(old: Any, new: Any, rows: NDArray[np.bool_]) -> Any:
    """`old` in the rows marked, `new` in the others; arrays (N, ...), or tuples of them."""
    if isinstance(old, tuple):
        parts = [chosen(one, other, rows) for one, other in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    return np.where(rows.reshape(-1, *[1] * (old.ndim - 1)), old, new)


class HeldState:
    """A memory whose memories are the state of its policy; it is never changed in place."""

    _state: Any = None

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
