"""Compiled kernels of the batch filter: elimination of the landmarks (Schur complement), and sets of rays that meet."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.compiled import compiler

_MIN_PARALLAX = 0.03  # sine of the angle between two rays; below it their midpoint is poorly determined

kernel, inner = compiler(Path(__file__).parent)


@kernel
def whiten_landmarks(
    begin: IndexArray, by_point: FloatArray, by_image: FloatArray, residuals: FloatArray, damping: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``L`` (L, 3, 3), ``L^-1 b`` (L, 3) and ``H' P L^-T`` (K, 7, 3) of each landmark and sighting.

    ``C = L L'`` is the normal matrix of a landmark with its Cholesky factor, b the right-hand side. Sightings are
    sorted by landmark: those of landmark j have the rows from ``begin[j]`` to before ``begin[j + 1]``.
    """
    count = len(begin) - 1
    factors, pulls = np.zeros((count, 3, 3)), np.zeros((count, 3))
    links = np.empty((len(residuals), 7, 3))
    for j in range(count):
        C, b = np.zeros((3, 3)), np.zeros(3)
        for d in range(3):
            C[d, d] = damping[j]
        # Normal equations of the landmark alone; the damping keeps the factor real where rays are parallel.
        for k in range(begin[j], begin[j + 1]):
            for row in range(2):
                for d in range(3):
                    b[d] += by_point[k, row, d] * residuals[k, row]
                    for e in range(3):
                        C[d, e] += by_point[k, row, d] * by_point[k, row, e]
        # Cholesky factor, row by row; numpy's would call LAPACK, which costs more than 3 x 3 arithmetic.
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
                    # Row c of H' P for this sighting, solved against L: products of these rows are H' P C^-1 P' H
                    # without forming C^-1.
                    total = by_image[k, 0, c] * by_point[k, 0, d] + by_image[k, 1, c] * by_point[k, 1, d]
                    for f in range(d):
                        total -= L[d, f] * links[k, c, f]
                    links[k, c, d] = total / L[d, d]
    return factors, pulls, links


@kernel
def shared_links(begin: IndexArray, image: IndexArray, links: FloatArray, shared: FloatArray) -> FloatArray:
    """Return (L, 3, q) the coupling of each whitened landmark to the shared unknowns; ``shared`` is (I, 7, q)."""
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
    """Subtract the landmarks' Schur complement from the lower triangle of the reduced normal matrix, in place.

    ``matrix`` has two rows for each image, its pan and tilt, and then the shared unknowns. The block of the shared
    unknowns alone is subtracted by the caller. ``common`` is what `shared_links` returns.
    """
    first = matrix.shape[0] - common.shape[2]
    for j in range(len(begin) - 1):
        for k in range(begin[j], begin[j + 1]):
            # A landmark couples each two of its images: components 3 and 4 of the camera are pan and tilt.
            for m in range(begin[j], begin[j + 1]):
                # The matrix is symmetric: only the lower triangle is filled.
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
    """Label (K,) the rays of each landmark: 0 the largest set that meets in one place, 1 the second, -1 the others.

    A set is all rays that pass the midpoint between two of them within ``tolerance`` (K,), small angles, rad. The
    second set needs ``least`` rays. The rays of landmark j have the rows from ``begin[j]`` to before ``begin[j + 1]``.
    """
    found = np.full(len(origins), -1)
    first_label, second_label = np.int64(0), np.int64(1)  # no literals, for which numba would compile twice
    for j in range(len(begin) - 1):
        first = _label_largest_set(origins, directions, begin[j], begin[j + 1], tolerance, found, first_label)
        if first < 2:  # no two rays meet: their errors cannot be judged, so all are kept
            for k in range(begin[j], begin[j + 1]):
                found[k] = 0
            continue
        second = _label_largest_set(origins, directions, begin[j], begin[j + 1], tolerance, found, second_label)
        if second < least:
            for k in range(begin[j], begin[j + 1]):
                if found[k] == 1:
                    found[k] = -1
    return found


@inner
def _label_largest_set(
    origins: FloatArray,
    directions: FloatArray,
    first: int,
    last: int,
    tolerance: FloatArray,
    found: IndexArray,
    label: np.int64,
) -> int:
    """Give ``label`` to the largest set among the rays with label -1, and return its size."""
    best, place = 0, np.zeros(3)
    for a in range(first, last):
        for b in range(a + 1, last):
            # All pairs are tried instead of random ones, so that the result does not depend on a draw.
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


@inner
def _ray_midpoint(origins: FloatArray, directions: FloatArray, a: int, b: int, place: FloatArray) -> bool:
    """Fill ``place`` with the midpoint of the shortest line between two rays; return False if nearly parallel."""
    aa, ab, ao, bo = 1.0, 0.0, 0.0, 0.0
    for i in range(3):
        ab += directions[a, i] * directions[b, i]
        offset = origins[b, i] - origins[a, i]
        ao += directions[a, i] * offset
        bo += directions[b, i] * offset
    determinant = aa - ab * ab
    # The determinant is the squared sine of the angle between the rays.
    if determinant < _MIN_PARALLAX**2:
        return False
    # Distances along both rays at which they are closest to each other.
    s, t = (ao - ab * bo) / determinant, (ab * ao - bo) / determinant
    for i in range(3):
        place[i] = 0.5 * (origins[a, i] + s * directions[a, i] + origins[b, i] + t * directions[b, i])
    return True


@inner
def _angle_off_ray(origins: FloatArray, directions: FloatArray, k: int, place: FloatArray) -> float:
    """Return the tangent of the angle between a ray and the direction to a place; 10 if that is behind the camera."""
    along, squares = 0.0, 0.0
    for i in range(3):
        offset = place[i] - origins[k, i]
        along += directions[k, i] * offset
        squares += offset * offset
    # Both lines meet also behind a camera, where nothing can be seen.
    if along <= 0.0:
        return 10.0
    return float(np.sqrt(max(squares - along * along, 0.0)) / along)
