"""The affine map of a layer, y = x W + b, in single precision.

A sum begins with b and goes on over the inputs in their order, each product and each sum rounded
by itself: so a batch has the bits of its single rows, on every processor. For several rows the sums
of a tile of outputs stay in registers, and a weight that was read serves all rows of the tile.
Compilers do not find that by themselves where the order of a sum is kept; batches take 0.55 to 0.7
of the time.
"""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic

from tracked_env.physics.jit import COMPILED, copy_entries, loop

ROWS, COLUMNS = 4, 16  # of a tile: 8 sums in registers of 8 numbers, of which there are 16
_LANES = 8  # numbers of a vector


def _tile_in_python(x: Any, w: Any, b: Any, y: Any, row: int, column: int) -> None:
    across = slice(column, column + COLUMNS)
    for i in range(row, row + ROWS):
        y[i, across] = b[across]
        for k in range(len(w)):
            y[i, across] += x[i, k] * w[k, across]


def _tile(typing_context, x, w, b, y, row, column):
    """Fill the ROWS and COLUMNS of y (N, M) from a row and a column on; see `linear`."""
    for kind in (x, w, b, y):  # their memory is read as it lies
        if kind.layout != "C" or kind.dtype != types.float32:
            raise TypingError(f"{kind}: must be float32 in C order")
    # Made here, where the key of a compiled kernel sees what they are made of.
    numbers = ir.VectorType(ir.FloatType(), _LANES)
    from_first = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), None)

    def code(context, builder, signature, arguments):
        kinds = signature.args
        inputs, weights, bias, out = (
            context.make_array(kind)(context, builder, each)
            for kind, each in zip(kinds[:4], arguments[:4], strict=True)
        )
        first_row, first_column = (
            context.cast(builder, each, kind, types.intp)
            for each, kind in zip(arguments[4:], kinds[4:], strict=True)
        )
        count, width = cgutils.unpack_tuple(builder, weights.shape)

        def after(index, steps):
            return builder.add(index, context.get_constant(types.intp, steps))

        def place(array, index, kind):
            return builder.bitcast(builder.gep(array.data, [index]), kind.as_pointer())

        def vector(array, index):
            return builder.load(place(array, index, numbers), align=4)

        rows = [after(first_row, i) for i in range(ROWS)]
        parts = [after(first_column, at) for at in range(0, COLUMNS, _LANES)]
        begin = [vector(bias, part) for part in parts]
        sums = [[cgutils.alloca_once_value(builder, each) for each in begin] for _ in rows]
        with cgutils.for_range(builder, count) as step:
            of_k = builder.mul(step.index, width)
            weight = [vector(weights, builder.add(of_k, part)) for part in parts]
            for row, of_row in zip(rows, sums, strict=True):
                entry = builder.add(builder.mul(row, count), step.index)
                one = builder.load(place(inputs, entry, ir.FloatType()))
                lane = builder.insert_element(
                    ir.Constant(numbers, ir.Undefined), one, ir.IntType(32)(0)
                )
                lanes = builder.shuffle_vector(lane, lane, from_first)
                for total, each in zip(of_row, weight, strict=True):
                    product = builder.fmul(lanes, each)
                    builder.store(builder.fadd(builder.load(total), product), total)
        for row, of_row in zip(rows, sums, strict=True):
            for part, total in zip(parts, of_row, strict=True):
                entry = builder.add(builder.mul(row, width), part)
                builder.store(builder.load(total), place(out, entry, numbers), align=4)
        return context.get_dummy_value()

    return types.void(x, w, b, y, row, column), code


_fill_tile: Any = intrinsic(_tile) if COMPILED else _tile_in_python


@loop
def linear(inputs, weights, bias, out):
    """out (N, M) = inputs (N, K) weights (K, M) + bias (M,). All float32, in C order."""
    (rows, width), count = out.shape, weights.shape[0]
    if rows >= ROWS and width >= COLUMNS:
        for begin in range(0, width, COLUMNS):
            column = min(begin, width - COLUMNS)  # the last tiles lie over those before
            for row in range(0, rows, ROWS):
                _fill_tile(inputs, weights, bias, out, min(row, rows - ROWS), column)
        return
    whole = count - count % 4
    for row in range(rows):  # four inputs at a time halve the time
        x, y = inputs[row], out[row]
        copy_entries(bias, y)
        for k in range(0, whole, 4):
            x_0, x_1, x_2, x_3 = x[k], x[k + 1], x[k + 2], x[k + 3]
            w_0, w_1, w_2, w_3 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
            for m in range(y.shape[0]):
                y[m] = (((y[m] + x_0 * w_0[m]) + x_1 * w_1[m]) + x_2 * w_2[m]) + x_3 * w_3[m]
        for k in range(whole, count):
            x_0, w_0 = x[k], weights[k]
            for m in range(y.shape[0]):
                y[m] += x_0 * w_0[m]
