"""The affine map of a layer: its bits are those of sums in order, whatever the batch."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from baselines.learned import matrix_product
from baselines.learned.matrix_product import COLUMNS, ROWS, linear


def arrays(rows, count, width, seed=0):
    """Inputs, weights and bias; every number has all of its digits."""
    rng = np.random.default_rng(seed)
    shapes = (rows, count), (count, width), (width,)
    return [rng.normal(size=shape).astype(np.float32) for shape in shapes]


def in_order(x, w, b):
    """Sums in the order of the inputs, each step rounded to single precision by numpy."""
    y = np.tile(b, (len(x), 1))
    for k in range(len(w)):
        y += x[:, k : k + 1] * w[k]
    return y


@pytest.mark.parametrize("rows", [1, ROWS - 1, ROWS, ROWS + 1, 2 * ROWS + 3, 64])
@pytest.mark.parametrize("width", [1, 2, COLUMNS - 1, COLUMNS, COLUMNS + 1, 50, 64])
@pytest.mark.parametrize("count", [1, 4, 7, 78])
def test_its_bits_are_those_of_sums_in_order_and_nothing_else_is_written(rows, width, count):
    x, w, b = arrays(rows, count, width)
    around = np.full((rows + 2, width), np.float32(np.nan))
    linear(x, w, b, around[1:-1])
    assert np.array_equal(around[1:-1], in_order(x, w, b))
    assert np.isnan(around[[0, -1]]).all()


def test_what_is_not_finite_stays_in_its_row_and_column():
    x, w, b = arrays(9, 12, 40)
    x[5, 3], w[2, 33] = np.inf, np.nan
    out = np.empty((9, 40), dtype=np.float32)
    linear(x, w, b, out)
    wrong = ~np.isfinite(out)
    assert wrong[5].all() and wrong[:, 33].all()
    assert not np.delete(np.delete(wrong, 5, axis=0), 33, axis=1).any()


def test_without_a_compiler_a_tile_is_the_same():
    x, w, b = arrays(6, 11, 2 * COLUMNS)
    out, tile = np.zeros((2, 6, 2 * COLUMNS), dtype=np.float32)
    linear(x, w, b, out)
    matrix_product._tile_in_python(x, w, b, tile, 1, 5)
    assert np.array_equal(tile[1 : 1 + ROWS, 5 : 5 + COLUMNS], out[1 : 1 + ROWS, 5 : 5 + COLUMNS])
    tile[1 : 1 + ROWS, 5 : 5 + COLUMNS] = 0.0
    assert not tile.any()


@pytest.mark.parametrize("change", [np.asfortranarray, np.float64, lambda x: x[:, ::2]])
def test_arrays_that_lie_otherwise_are_refused(change):
    x, w, b = arrays(8, 12, 32)
    with pytest.raises(TypingError, match="must be float32 in C order"):
        linear(change(x), w, b, np.empty((8, 32), dtype=np.float32))
