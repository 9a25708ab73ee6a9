"""A symmetric matrix of 3 x 3 blocks within an envelope, and its Cholesky factor, which stays within it.

Of block row ``i`` the upper triangle is stored as far as block column ``reach[i]``, which never decreases with ``i``.
Landmarks are seen for a while and then lost, so that a matrix over many views is a band; a small window fills it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.jit import kernel

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class Envelope(NamedTuple):
    """(n,) last block column of each block row, (n,) numbers in one of its three rows, (n + 1,) where it begins."""

    reach: IndexArray
    width: IndexArray
    begin: IndexArray


@kernel
def make_envelope(reach: IndexArray) -> Envelope:
    """Return the envelope that holds the couplings: (n,) last block that each is coupled with."""
    n = len(reach)
    width, begin = np.empty(n, np.int64), np.zeros(n + 1, np.int64)
    last = 0
    for i in range(n):
        last = max(last, reach[i], i)
        reach[i] = last
        width[i] = 3 * (last - i + 1)
        begin[i + 1] = begin[i] + 3 * width[i]
    return Envelope(reach, width, begin)


@kernel
def add_block(values: FloatArray, shape: Envelope, i: int, j: int, block: FloatArray, sign: float) -> None:
    """Add a (3, 3) block at block row ``i`` and block column ``j >= i``."""
    at = shape.begin[i] + 3 * (j - i)
    for row in range(3):
        for column in range(3):
            values[at + column] += sign * block[row, column]
        at += shape.width[i]


@kernel
def add_diagonal(values: FloatArray, shape: Envelope, added: float) -> None:
    """Add a multiple of the identity."""
    for i in range(len(shape.reach)):
        for row in range(3):
            values[shape.begin[i] + row * (shape.width[i] + 1)] += added


@kernel
def factorise(values: FloatArray, shape: Envelope) -> bool:
    """Replace the matrix by U, where U'U is the matrix; False, with rubbish, if it is not positive definite."""
    for i in range(len(shape.reach)):
        width = shape.width[i]
        rows = values[shape.begin[i] : shape.begin[i + 1]].reshape(3, width)
        if not _factorise_rows(rows):
            return False
        for j in range(i + 1, shape.reach[i] + 1):
            below = values[shape.begin[j] : shape.begin[j + 1]]
            for row in range(3):
                column = 3 * (j - i) + row
                _take(below[row * shape.width[j] + row :], rows[:, column:])
    return True


@kernel
def _factorise_rows(rows: FloatArray) -> bool:
    """Finish the three rows of a block in place."""
    width = rows.shape[1]
    for row in range(3):
        for above in range(row):
            part = rows[above, row]
            for column in range(row, width):
                rows[row, column] -= part * rows[above, column]
        pivot = rows[row, row]
        if not pivot > 0.0:
            return False
        root = np.sqrt(pivot)
        rows[row, row] = root
        for column in range(row + 1, width):
            rows[row, column] /= root
    return True


@kernel
def _take(target: FloatArray, rows: FloatArray) -> None:
    """Subtract the multiples of three rows (3, w) that their first entries tell from ``target``, at its beginning."""
    first, second, third = rows[0], rows[1], rows[2]
    a, b, c = first[0], second[0], third[0]
    for k in range(rows.shape[1]):
        target[k] -= a * first[k] + b * second[k] + c * third[k]


@kernel
def solve(factor: FloatArray, shape: Envelope, right: FloatArray) -> None:
    """Solve U'U x = ``right`` (3n,) in place."""
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
def dense(values: FloatArray, shape: Envelope) -> FloatArray:
    """Lay the matrix out as (3n, 3n)."""
    n = len(shape.reach)
    matrix = np.zeros((3 * n, 3 * n))
    for i in range(n):
        for row in range(3):
            at = shape.begin[i] + row * shape.width[i]
            for column in range(row, shape.width[i]):
                matrix[3 * i + row, 3 * i + column] = values[at + column]
                matrix[3 * i + column, 3 * i + row] = values[at + column]
    return matrix
