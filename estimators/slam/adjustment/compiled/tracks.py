"""Tracks of a map as arrays: their measurements numbered within a problem, and triangulation of their points."""

from __future__ import annotations

import numpy as np

from boresight.estimators.slam.adjustment.compiled import inner, kernel
from boresight.scenarios.arrays import FloatArray, IndexArray


@kernel
def select_pixels(
    tracks: IndexArray, sizes: IndexArray, sigmas_px: FloatArray, track: IndexArray, uv_px: FloatArray
) -> tuple[IndexArray, IndexArray, FloatArray, FloatArray]:
    """View, point, pixel and sigma of the pixels of ``tracks`` (sorted), numbered by their indices.

    ``track`` (k,) and ``uv_px`` (k, 2) are those of all views, one after the other; ``sizes`` and ``sigmas_px`` (V,).
    """
    view, point = np.empty(len(track), np.int64), np.empty(len(track), np.int64)
    seen_px, sigma_px = np.empty((len(track), 2)), np.empty(len(track))
    count, k = 0, 0
    for i in range(len(sizes)):
        for _ in range(sizes[i]):
            place = _index(tracks, track[k])
            if place >= 0:
                view[count], point[count], sigma_px[count] = i, place, sigmas_px[i]
                seen_px[count, 0], seen_px[count, 1] = uv_px[k, 0], uv_px[k, 1]
                count += 1
            k += 1
    return view[:count], point[:count], seen_px[:count], sigma_px[:count]


@kernel
def lookup(keys: IndexArray, wanted: IndexArray) -> IndexArray:
    """(n,) index of each of ``wanted`` in the sorted ``keys``; -1 if it is not there."""
    found = np.empty(len(wanted), np.int64)
    for k in range(len(wanted)):
        found[k] = _index(keys, wanted[k])
    return found


@inner
def _index(keys: IndexArray, wanted: int) -> int:
    """Return the index of a number in the sorted ``keys``; -1 if it is not there."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low if low < len(keys) and keys[low] == wanted else -1


@kernel
def median_distance(points_m: FloatArray, position_m: FloatArray) -> float:
    """Return the median distance (m) of points (n, 3) from a position; NaN without points."""
    n = len(points_m)
    if n == 0:
        return np.nan
    squares = np.empty(n)
    for k in range(n):
        x, y, z = points_m[k, 0] - position_m[0], points_m[k, 1] - position_m[1], points_m[k, 2] - position_m[2]
        squares[k] = x * x + y * y + z * z
    squares.sort()
    median: float = 0.5 * (np.sqrt(squares[(n - 1) // 2]) + np.sqrt(squares[n // 2]))
    return median


@kernel
def triangulate(origins_m: FloatArray, rays: FloatArray, begin: IndexArray, depths_m: FloatArray) -> FloatArray:
    """(n, 3) midpoint triangulation: the points nearest to their lines of sight, least squares.

    The lines of point p, from ``origins_m`` (k, 3) along unit ``rays`` (k, 3), are those from ``begin[p]`` to
    ``begin[p + 1]``. If they are parallel, or a depth is unlike ``depths_m`` (n,), the point is at that depth on its
    last line.
    """
    points_m = np.empty((len(begin) - 1, 3))
    for p in range(len(begin) - 1):
        # Sums of I - d d' and (I - d d') o; see `scenarios.geometry.camera.triangulation_equations`.
        xx, xy, xz, yy, yz, zz, x, y, z = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(begin[p], begin[p + 1]):
            a, b, c = rays[k, 0], rays[k, 1], rays[k, 2]
            along = dot(rays[k], origins_m[k])
            xx += 1.0 - a * a
            yy += 1.0 - b * b
            zz += 1.0 - c * c
            xy, xz, yz = xy - a * b, xz - a * c, yz - b * c
            x += origins_m[k, 0] - a * along
            y += origins_m[k, 1] - b * along
            z += origins_m[k, 2] - c * along
        # The inverse is the adjugate over the determinant. The least eigenvalue is about the determinant over the sum
        # of the principal minors; of two lines at an angle a it is 1 - cos a, about a^2 / 2: 1e-12 is a parallax of
        # 1.4e-6 rad, far below the noise of any pixel.
        i, j, o = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        m, n, q = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        determinant = xx * i + xy * j + xz * o
        good = determinant >= 1e-12 * (i + m + q)
        if good:
            points_m[p, 0] = (i * x + j * y + o * z) / determinant
            points_m[p, 1] = (j * x + m * y + n * z) / determinant
            points_m[p, 2] = (o * x + n * y + q * z) / determinant
        # With a small parallax the noise of the pixels may put the point anywhere along the line, also behind the
        # camera.
        for k in range(begin[p], begin[p + 1]):
            depth = dot(points_m[p] - origins_m[k], rays[k]) if good else 0.0
            good &= 0.3 * depths_m[p] < depth < 3.0 * depths_m[p]
        if not good:
            last = begin[p + 1] - 1
            for axis in range(3):
                points_m[p, axis] = origins_m[last, axis] + depths_m[p] * rays[last, axis]
    return points_m


@kernel
def dot(a: FloatArray, b: FloatArray) -> float:
    """Scalar product of 3-vectors, added in the order of NumPy's einsum."""
    product: float = a[0] * b[0] + a[2] * b[2] + a[1] * b[1]
    return product
