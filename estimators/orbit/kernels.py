"""Landmarks from lines of sight alone: triangulation, and numbers that stand for two places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenarios.compiled import compiler

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_MIN_PARALLAX = 0.03

kernel = compiler(Path(__file__).parent)


@kernel
def whiten_landmarks(
    begin: IndexArray, by_point: FloatArray, by_image: FloatArray, residuals: FloatArray, damping: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``L`` (L, 3, 3), ``L^-1 b`` (L, 3) and ``H' P L^-T`` (K, 7, 3) of each landmark and sighting.

    ``C = L L'`` is the normal matrix of a landmark, b its gradient. Sightings stand in the order of their landmarks,
    those of j from ``begin[j]`` to ``begin[j + 1]``.
    """
    count = len(begin) - 1
    factors, pulls = np.zeros((count, 3, 3)), np.zeros((count, 3))
    links = np.empty((len(residuals), 7, 3))
    for j in range(count):
        C, b = np.zeros((3, 3)), np.zeros(3)
        for d in range(3):
            C[d, d] = damping[j]
        for k in range(begin[j], begin[j + 1]):
            for row in range(2):
                for d in range(3):
                    b[d] += by_point[k, row, d] * residuals[k, row]
                    for e in range(3):
                        C[d, e] += by_point[k, row, d] * by_point[k, row, e]
        L = factors[j]
        for d in range(3):
            for e in range(d + 1):
                total = C[d, e]
                for f in range(e):
                    total -= L[d, f] * L[e, f]
                L[d, e] = np.sqrt(total) if d == e else total / L[e, e]
        for d in range(3):
            total = b[d]
            for f in range(d):
                total -= L[d, f] * pulls[j, f]
            pulls[j, d] = total / L[d, d]
        for k in range(begin[j], begin[j + 1]):
            for c in range(7):
                for d in range(3):
                    total = by_image[k, 0, c] * by_point[k, 0, d] + by_image[k, 1, c] * by_point[k, 1, d]
                    for f in range(d):
                        total -= L[d, f] * links[k, c, f]
                    links[k, c, d] = total / L[d, d]
    return factors, pulls, links


@kernel
def shared_links(begin: IndexArray, image: IndexArray, links: FloatArray, shared: FloatArray) -> FloatArray:
    """(L, 3, q): how each whitened landmark hangs on the shared unknowns; ``shared`` is (I, 7, q)."""
    count, q = len(begin) - 1, shared.shape[2]
    found = np.zeros((count, 3, q))
    for j in range(count):
        for k in range(begin[j], begin[j + 1]):
            for c in range(7):
                for d in range(3):
                    factor = links[k, c, d]
                    for p in range(q):
                        found[j, d, p] += factor * shared[image[k], c, p]
    return found


@kernel
def subtract_landmarks(
    matrix: FloatArray, begin: IndexArray, image: IndexArray, links: FloatArray, common: FloatArray
) -> None:
    """Subtract what landmarks carry from image to image, and from images to shared unknowns; the lower triangle.

    ``matrix`` has two rows for each image, its pan and tilt, and then the shared unknowns; ``common`` is what
    `shared_links` returns.
    """
    first = matrix.shape[0] - common.shape[2]
    for j in range(len(begin) - 1):
        for k in range(begin[j], begin[j + 1]):
            for m in range(begin[j], begin[j + 1]):
                if image[m] > image[k]:
                    continue
                for r in range(2):
                    for s in range(2):
                        total = 0.0
                        for d in range(3):
                            total += links[k, 3 + r, d] * links[m, 3 + s, d]
                        matrix[2 * image[k] + r, 2 * image[m] + s] -= total
            for r in range(2):
                row = 2 * image[k] + r
                for p in range(common.shape[2]):
                    total = 0.0
                    for d in range(3):
                        total += links[k, 3 + r, d] * common[j, d, p]
                    matrix[first + p, row] -= total


@kernel
def consistent_rays(
    origins: FloatArray, directions: FloatArray, begin: IndexArray, tolerance: FloatArray, least: int
) -> IndexArray:
    """(K,): 0 for the largest set of rays of a landmark that meet in one place, 1 for the next, -1 for what is left.

    A set is the rays that pass the place where two of them come nearest each other within ``tolerance`` (K,), an angle,
    rad. The second needs ``least`` rays. Rays of j stand from ``begin[j]`` to ``begin[j + 1]``.
    """
    found = np.full(len(origins), -1)
    for j in range(len(begin) - 1):
        first = _label_largest_set(origins, directions, begin[j], begin[j + 1], tolerance, found, 0)
        if first < 2:
            for k in range(begin[j], begin[j + 1]):
                found[k] = 0  # too few to tell
            continue
        second = _label_largest_set(origins, directions, begin[j], begin[j + 1], tolerance, found, 1)
        if second < least:
            for k in range(begin[j], begin[j + 1]):
                if found[k] == 1:
                    found[k] = -1
    return found


@kernel
def _label_largest_set(
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
            if not _ray_midpoint(origins, directions, a, b, place):
                continue
            count = 0
            for k in range(first, last):
                if found[k] == -1 and _angle_off_ray(origins, directions, k, place) < tolerance[k]:
                    count += 1
            if count > best:
                best, best_a, best_b = count, a, b
    if best > 0:
        _ray_midpoint(origins, directions, best_a, best_b, place)
        for k in range(first, last):
            if found[k] == -1 and _angle_off_ray(origins, directions, k, place) < tolerance[k]:
                found[k] = label
    return best


@kernel
def _ray_midpoint(origins: FloatArray, directions: FloatArray, a: int, b: int, place: FloatArray) -> bool:
    """Fill the middle of the shortest line between two rays; False where they are all but parallel."""
    aa, ab, ao, bo = 1.0, 0.0, 0.0, 0.0
    for i in range(3):
        ab += directions[a, i] * directions[b, i]
        offset = origins[b, i] - origins[a, i]
        ao += directions[a, i] * offset
        bo += directions[b, i] * offset
    determinant = aa - ab * ab
    if determinant < _MIN_PARALLAX**2:
        return False
    s, t = (ao - ab * bo) / determinant, (ab * ao - bo) / determinant
    for i in range(3):
        place[i] = 0.5 * (origins[a, i] + s * directions[a, i] + origins[b, i] + t * directions[b, i])
    return True


@kernel
def _angle_off_ray(origins: FloatArray, directions: FloatArray, k: int, place: FloatArray) -> float:
    """Angle between a ray and the direction to a place, rad; large where it is behind."""
    along, squares = 0.0, 0.0
    for i in range(3):
        offset = place[i] - origins[k, i]
        along += directions[k, i] * offset
        squares += offset * offset
    if along <= 0.0:
        return 10.0
    return float(np.sqrt(max(squares - along * along, 0.0)) / along)
