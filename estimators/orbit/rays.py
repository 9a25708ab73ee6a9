"""Landmarks from lines of sight alone: triangulation, and numbers that stand for two places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenarios.compiled import compiler

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_LEAST_PARALLAX = 0.03

kernel = compiler(Path(__file__).parent)


@kernel
def agreeing(
    origins: FloatArray, directions: FloatArray, begin: IndexArray, tolerance: FloatArray, least: int
) -> IndexArray:
    """(K,): 0 for the largest set of rays of a landmark that meet in one place, 1 for the next, -1 for what is left.

    A set is the rays that pass the place where two of them come nearest each other within ``tolerance`` (K,), an angle,
    rad. The second needs ``least`` rays. Rays of j stand from ``begin[j]`` to ``begin[j + 1]``.
    """
    found = np.full(len(origins), -1)
    for j in range(len(begin) - 1):
        first = _largest(origins, directions, begin[j], begin[j + 1], tolerance, found, 0)
        if first < 2:
            for k in range(begin[j], begin[j + 1]):
                found[k] = 0  # too few to tell
            continue
        second = _largest(origins, directions, begin[j], begin[j + 1], tolerance, found, 1)
        if second < least:
            for k in range(begin[j], begin[j + 1]):
                if found[k] == 1:
                    found[k] = -1
    return found


@kernel
def _largest(
    origins: FloatArray,
    directions: FloatArray,
    first: int,
    last: int,
    tolerance: FloatArray,
    found: IndexArray,
    label: int,
) -> int:
    """Mark the largest set among the rays that are still -1, and return its size."""
    best, place = 0, np.zeros(3)
    for a in range(first, last):
        for b in range(a + 1, last):
            if found[a] != -1 or found[b] != -1:
                continue
            if not _meet(origins, directions, a, b, place):
                continue
            count = 0
            for k in range(first, last):
                if found[k] == -1 and _off(origins, directions, k, place) < tolerance[k]:
                    count += 1
            if count > best:
                best, best_a, best_b = count, a, b
    if best > 0:
        _meet(origins, directions, best_a, best_b, place)
        for k in range(first, last):
            if found[k] == -1 and _off(origins, directions, k, place) < tolerance[k]:
                found[k] = label
    return best


@kernel
def _meet(origins: FloatArray, directions: FloatArray, a: int, b: int, place: FloatArray) -> bool:
    """Fill the middle of the shortest line between two rays; False where they are all but parallel."""
    aa, ab, ao, bo = 1.0, 0.0, 0.0, 0.0
    for i in range(3):
        ab += directions[a, i] * directions[b, i]
        offset = origins[b, i] - origins[a, i]
        ao += directions[a, i] * offset
        bo += directions[b, i] * offset
    determinant = aa - ab * ab
    if determinant < _LEAST_PARALLAX**2:
        return False
    s, t = (ao - ab * bo) / determinant, (ab * ao - bo) / determinant
    for i in range(3):
        place[i] = 0.5 * (origins[a, i] + s * directions[a, i] + origins[b, i] + t * directions[b, i])
    return True


@kernel
def _off(origins: FloatArray, directions: FloatArray, k: int, place: FloatArray) -> float:
    """Angle between a ray and the direction to a place, rad; large where it is behind."""
    along, squares = 0.0, 0.0
    for i in range(3):
        offset = place[i] - origins[k, i]
        along += directions[k, i] * offset
        squares += offset * offset
    if along <= 0.0:
        return 10.0
    return float(np.sqrt(max(squares - along * along, 0.0)) / along)
