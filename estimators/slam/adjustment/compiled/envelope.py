"""Envelope (skyline) storage of a symmetric matrix of 3 x 3 blocks, and its Cholesky factor with the same envelope.

Of block row ``i`` the upper triangle is stored up to block column ``reach[i]``, which never decreases with ``i``.
Landmarks are in view for a limited time, so that the reduced matrix of many views is banded; that of a small window is
full. Marginalisation eliminates variables from the matrix in dense form.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from boresight.estimators.slam.adjustment.compiled import inner, kernel
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray


class Envelope(NamedTuple):
    """Shape of the stored upper triangle of n block rows.

    ``reach`` (n,) is the last block column of each block row, ``width`` (n,) the stored length of each of its three
    rows: 3 (reach - i + 1). ``begin`` (n + 1,) is the index of its first stored value, and of the end.
    """

    reach: IndexArray
    width: IndexArray
    begin: IndexArray


@kernel
def make_envelope(reach: IndexArray) -> Envelope:
    """Return the envelope for ``reach`` (n,), the last block column that each block row is coupled with."""
    n = len(reach)
    width, begin = np.empty(n, np.int64), np.zeros(n + 1, np.int64)
    last = 0
    for i in range(n):
        # Elimination of a row fills the rows that it reaches up to its own reach. With a running maximum the factor
        # needs no place outside the envelope.
        last = max(last, reach[i], i)
        reach[i] = last
        # From the diagonal block on; its entries below the diagonal are stored, but not used.
        width[i] = 3 * (last - i + 1)
        begin[i + 1] = begin[i] + 3 * width[i]
    return Envelope(reach, width, begin)


@kernel
def add_entry(values: FloatArray, shape: Envelope, i: int, row: int, j: int, column: int, added: float) -> None:
    """Add to one entry of the block at block row ``i`` and block column ``j >= i``."""
    values[shape.begin[i] + row * shape.width[i] + 3 * (j - i) + column] += added


@inner
def add_symmetric(
    values: FloatArray,
    shape: Envelope,
    i: int,
    j: int,
    block: tuple[float, float, float, float, float, float],
    sign: float,
) -> None:
    """Add a symmetric block xx, xy, xz, yy, yz, zz at block row ``i`` and block column ``j >= i``."""
    xx, xy, xz, yy, yz, zz = block
    for row, entries in enumerate(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))):
        at = shape.begin[i] + row * shape.width[i] + 3 * (j - i)
        for column in range(3):
            values[at + column] += sign * entries[column]


@inner
def add_diagonal(values: FloatArray, shape: Envelope, added: float) -> None:
    """Add a multiple of the identity."""
    for i in range(len(shape.reach)):
        for row in range(3):
            # A step of width + 1 goes down and right by one: along the diagonal.
            values[shape.begin[i] + row * (shape.width[i] + 1)] += added


@kernel
def factorise(values: FloatArray, shape: Envelope) -> bool:
    """Replace the matrix U'U by its Cholesky factor U; False, with undefined values, if it is not positive definite."""
    for i in range(len(shape.reach)):
        begin, width = shape.begin[i], shape.width[i]
        if not _factorise_rows(values, begin, width):
            return False
        # Right-looking: row i, once final, is subtracted from all later rows that it reaches; each value is read and
        # written in the order of storage.
        for j in range(i + 1, shape.reach[i] + 1):
            _subtract_multiples(values, shape.begin[j], shape.width[j], begin, width, 3 * (j - i))
    return True


@inner
def _factorise_rows(values: FloatArray, begin: int, width: int) -> bool:
    """Factorise the three rows of a block row in place."""
    for row in range(3):
        own = _part(values, begin + row * width, width)
        for above in range(row):
            upper = _part(values, begin + above * width, width)
            part = upper[row]
            for column in range(row, width):
                own[column] -= part * upper[column]
        pivot = own[row]
        # Written so that NaN fails too.
        if not pivot > 0.0:
            return False
        root = np.sqrt(pivot)
        own[row] = root
        for column in range(row + 1, width):
            own[column] /= root
    return True


@inner
def _subtract_multiples(
    values: FloatArray, target: int, target_width: int, source: int, width: int, column: int
) -> None:
    """Subtract multiples of three factorised rows, from ``column`` on, from the three rows of a later block row.

    The values below the diagonal that this leaves are not used.
    """
    count = width - column
    x = _part(values, source + column, count)
    y = _part(values, source + width + column, count)
    z = _part(values, source + 2 * width + column, count)
    first = _part(values, target, count)
    second = _part(values, target + target_width, count)
    third = _part(values, target + 2 * target_width, count)
    # Entry (a, b) of U'U has the sum of U_ka U_kb over the rows k above: here three of them, and three rows a.
    x0, y0, z0, x1, y1, z1, x2, y2, z2 = x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]
    for k in range(count):
        first[k] -= x0 * x[k] + y0 * y[k] + z0 * z[k]
        second[k] -= x1 * x[k] + y1 * y[k] + z1 * z[k]
        third[k] -= x2 * x[k] + y2 * y[k] + z2 * z[k]


@inner
def _part(values: FloatArray, begin: int, count: int) -> FloatArray:
    """Return a slice; a loop over it from 0 has no negative indices, so that the compiler can vectorise it."""
    return values[begin : begin + count]


@kernel
def solve(factor: FloatArray, shape: Envelope, right: FloatArray) -> None:
    """Solve U'U x = ``right`` (3n,) in place."""
    # Forward with U' (its columns are the stored rows), then backward with U.
    n = len(shape.reach)
    for i in range(n):
        width = shape.width[i]
        for row in range(3):
            at = shape.begin[i] + row * width
            value = right[3 * i + row] / factor[at + row]
            right[3 * i + row] = value
            for column in range(row + 1, width):
                right[3 * i + column] -= value * factor[at + column]
    for i in range(n - 1, -1, -1):
        width = shape.width[i]
        for row in range(2, -1, -1):
            at = shape.begin[i] + row * width
            value = right[3 * i + row]
            for column in range(row + 1, width):
                value -= factor[at + column] * right[3 * i + column]
            right[3 * i + row] = value / factor[at + row]


@kernel
def block_of_inverse(factor: FloatArray, shape: Envelope, i: int) -> FloatArray:
    """(3, 3) diagonal block of the inverse of U'U."""
    block, column = np.empty((3, 3)), np.empty(3 * len(shape.reach))
    # Three columns of the inverse, of which only the diagonal block is kept: the whole inverse would be dense.
    for axis in range(3):
        for k in range(len(column)):
            column[k] = 1.0 if k == 3 * i + axis else 0.0
        solve(factor, shape, column)
        for row in range(3):
            block[row, axis] = column[3 * i + row]
    # Symmetric up to rounding: take the mean of both halves.
    for axis in range(3):
        for row in range(axis):
            block[row, axis] = block[axis, row] = 0.5 * (block[row, axis] + block[axis, row])
    return block


@kernel
def dense(values: FloatArray, shape: Envelope) -> FloatArray:
    """Return the matrix as a dense array (3n, 3n)."""
    n = len(shape.reach)
    matrix = np.zeros((3 * n, 3 * n))
    for i in range(n):
        for row in range(3):
            at = shape.begin[i] + row * shape.width[i]
            for column in range(row, shape.width[i]):
                matrix[3 * i + row, 3 * i + column] = values[at + column]
                matrix[3 * i + column, 3 * i + row] = values[at + column]
    return matrix


@kernel
def without(matrix: FloatArray, gradient: FloatArray, out: BoolArray) -> tuple[bool, FloatArray, FloatArray]:
    """Eliminate rows of a dense matrix, those marked in ``out`` (n,); False first if they are not determined."""
    # Eliminated rows first; the remaining rows keep their order and the sums their rounding. Loops, because numba
    # compiles them in a fraction of the time of array expressions.
    n, count = len(out), 0
    order = np.empty(n, np.int64)
    for eliminated in (True, False):
        for i in range(n):
            if out[i] == eliminated:
                order[count] = i
                count += 1
    matrix, gradient = gathered(matrix, gradient, order)
    # Elimination pivot by pivot shows an undetermined variable by a pivot that is not positive; an inverse would return
    # large numbers instead.
    gone = np.int64(0)  # no literal, for which numba would compile twice
    for i in range(n):
        gone += int(out[i])
    known = eliminate(matrix, gradient, gone)
    return known, matrix[gone:, gone:].copy(), gradient[gone:]


@inner
def gathered(matrix: FloatArray, gradient: FloatArray, rows: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Return the rows and columns ``rows`` (k,) of a matrix, and those rows of a vector."""
    part, values = np.empty((len(rows), len(rows))), np.empty(len(rows))
    for i in range(len(rows)):
        values[i] = gradient[rows[i]]
        for j in range(len(rows)):
            part[i, j] = matrix[rows[i], rows[j]]
    return part, values


@inner
def eliminate(matrix: FloatArray, right: FloatArray, count: np.int64) -> bool:
    """Eliminate the first ``count`` rows: the other rows and ``right`` (n,) become their Schur complement.

    False if the eliminated part is not positive definite; the values are then undefined.
    """
    n = len(matrix)
    for i in range(count):
        pivot = matrix[i, i]
        # NaN fails too.
        if not pivot > 0.0:
            return False
        for j in range(i + 1, n):
            # Only the upper triangle is used: column i of a symmetric matrix is its row i.
            part = matrix[i, j] / pivot
            # Uncoupled rows stay exactly as they are: a row of zeros remains one.
            if part != 0.0:
                right[j] -= part * right[i]
                for k in range(j, n):
                    matrix[j, k] -= part * matrix[i, k]
    # The lower triangle was not updated: mirror the upper one.
    for i in range(count, n):
        for j in range(i):
            matrix[i, j] = matrix[j, i]
    return True


@kernel
def marginal(
    values: FloatArray,
    right: FloatArray,
    shape: Envelope,
    view_slot: IndexArray,
    point_slot: IndexArray,
    view_stays: BoolArray,
    point_stays: BoolArray,
) -> tuple[bool, IndexArray, IndexArray, FloatArray, FloatArray]:
    """Eliminate the views and landmarks that do not stay from a reduced matrix and right-hand side.

    Returns the views and landmarks that remain, by their numbers, and their information and gradient; unconstrained
    variables do not remain. The first value is False if the eliminated variables are not determined.
    """
    n = len(shape.reach)
    number, out, gradient = np.empty(n, np.int64), np.empty(3 * n, np.bool_), np.empty(3 * n)
    count = views = 0
    # Slots are in the order of the numbers, views first.
    for slots, stays in ((view_slot, view_stays), (point_slot, point_stays)):
        views = count  # of the views alone, once their slots are done
        for i in range(len(slots)):
            slot = slots[i]
            if slot >= 0:
                for k in range(3 * slot, 3 * slot + 3):
                    out[k] = not stays[i]
                if stays[i]:
                    number[count] = i
                    count += 1
    # The right-hand side is minus the gradient. At x0, the state, this is g of the prior g' (x - x0).
    for k in range(3 * n):
        gradient[k] = -right[k]
    known, matrix, gradient = without(dense(values, shape), gradient, out)
    # An exact test of which variables are constrained: nothing is ever added to the rows of the others.
    rows, kept, kept_views = np.empty(3 * count, np.int64), 0, 0
    for i in range(count):
        constrained = False
        for row in range(3 * i, 3 * i + 3):
            for column in range(3 * count):
                constrained |= matrix[row, column] != 0.0
        if constrained:
            number[kept] = number[i]
            for axis in range(3):
                rows[3 * kept + axis] = 3 * i + axis
            kept += 1
            kept_views += int(i < views)
    matrix, gradient = gathered(matrix, gradient, rows[: 3 * kept])
    return known, number[:kept_views], number[kept_views:kept], matrix, gradient
