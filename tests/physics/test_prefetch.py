"""A prefetch asks for a cache line: it reads nothing, and any address will do."""

import numpy as np
from numba import njit

from tracked_env.physics.jit import prefetch


@njit  # not from disk, where the code cannot be looked at
def fetch(values, i, j):
    prefetch(values, (i, j))


def test_a_prefetch_is_one_instruction_that_changes_nothing():
    values = np.arange(12.0).reshape(3, 4)
    fetch(values, 2, 3)
    assert np.array_equal(values, np.arange(12.0).reshape(3, 4))
    (code,) = fetch.inspect_llvm().values()
    assert "call void @llvm.prefetch" in code


def test_an_entry_outside_of_the_array_is_no_fault():
    values = np.zeros((3, 4))
    for place in (3, -1, 10**12, -(10**12)):
        fetch(values, place, 0)
