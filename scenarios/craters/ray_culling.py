"""Candidate facets of a tiled surface for a set of rays, by projecting facets and rays to a plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray, SingleArray
from boresight.scenarios.bodies.topology import tangent_axes
from boresight.scenarios.craters.kernels import TileLayout, inner, kernel, number_tile, tile_buffer
from boresight.scenarios.craters.surface import CrateredSurface
from boresight.scenarios.geometry import View

_Point = tuple[float, float, float]  # on the projection plane, and distance along its third axis

_RAYS_A_CELL = 1  # on average
# Single precision of the tracer displaces a ray by some 1e-7 of the body's radius; the tolerance is 40 times that.
_SLACK = 4e-6
# The origin of a ray is a point on a facet and is known to rounding: ten times that.
_DEPTH_SLACK = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class RayProjection:
    """Projection to a plane in which each ray of a bundle is one point.

    A ray can only intersect facets whose projection contains its point. Each point has the depth along the third axis
    at which the ray begins; there are no intersections before that. ``axes`` (3, 3) are two axes of the plane and the
    direction of the parallel rays or of the boresight, as rows, body frame. Rays of a ``pencil`` all pass through
    ``origin_m`` (3,) (perspective); otherwise they are parallel, and it is arbitrary.
    """

    axes: FloatArray
    origin_m: FloatArray
    pencil: bool

    @classmethod
    def of_view(cls, view: View) -> RayProjection:
        """Make the projection of a camera's lines of sight (with any lens distortion)."""
        # A writable copy: numba would compile the kernels again for a read-only array.
        return cls(np.array(view.T_cam_body.rotation, order="C"), view.T_cam_body.camera_position_m, True)

    @classmethod
    def of_parallel(cls, direction: FloatArray) -> RayProjection:
        """Make the projection along one unit direction (3,)."""
        return cls(np.concatenate([*tangent_axes(direction[None], np.zeros(1)), direction[None]]), np.zeros(3), False)

    def of_directions(self, directions: FloatArray) -> FloatArray:
        """Return points and start depths (N, 3) of the rays of a pencil along (N, 3), which start at the origin."""
        rays = np.empty(directions.shape)
        _project(rays, directions, self.axes, np.zeros(3))
        # Perspective: slopes at unit depth. The camera is the start of all rays, at depth 0.
        rays[:, 0] /= rays[:, 2]
        rays[:, 1] /= rays[:, 2]
        rays[:, 2] = 0.0
        return rays

    def of_points(self, points_m: FloatArray) -> FloatArray:
        """Return points and start depths (N, 3) of parallel rays from points (N, 3)."""
        rays = np.empty(points_m.shape)
        _project(rays, points_m, self.axes, self.origin_m)
        return rays


def candidate_facets(ground: CrateredSurface, tiles: IndexArray, fan: RayProjection, rays: FloatArray) -> SingleArray:
    """Find the facets of some tiles that projected rays (N, 3) may intersect: their corners (F, 3, 3).

    The selection is conservative: it contains every facet that a single-precision tracer could hit. Rays with NaN are
    ignored.
    """
    cells = _sorted_by_cell(rays)
    if cells is None or not len(tiles):
        return np.empty((0, 3, 3), dtype=np.float32)
    found = np.empty((int((ground.tiling.tile_pieces[tiles] ** 2).sum()), 3), dtype=np.int64)
    radius_m = float(np.linalg.norm(ground.corners_m, axis=1).max())
    slack_m = _SLACK * radius_m, _DEPTH_SLACK * radius_m
    count = _find_candidates(
        found,
        tiles,
        ground.vertices_m,
        fan.axes,
        fan.origin_m,
        fan.pencil,
        slack_m,
        cells,
        ground.tiling.layout,
    )
    return np.asarray(ground.vertices_m[found[:count].ravel()]).reshape(-1, 3, 3)


class _Cells(NamedTuple):
    """Projected rays (N, 3) sorted into cells of a grid with origin ``low`` (2,), and the first ray of each cell."""

    rays: FloatArray
    start: IndexArray
    low: FloatArray
    step: float
    n_columns: int
    n_rows: int


def _sorted_by_cell(rays: FloatArray) -> _Cells | None:
    """Sort finite rays into cells; None if there is no finite ray."""
    rays, low, high = _finite_rays(rays)
    if not len(rays):
        return None
    # Cells of as many rays; the second bound keeps a grid about rays on a line from having more columns than rays, the
    # third is for a single point.
    step = max(
        float(np.sqrt(np.prod(high - low) * _RAYS_A_CELL / len(rays))),
        float((high - low).max()) * _RAYS_A_CELL / len(rays),
        float(np.finfo(np.float64).tiny),
    )
    n_columns, n_rows = (int(n) for n in np.floor((high - low) / step) + 1)
    start, order = _sorted_into_cells(rays, low, step, n_columns, n_rows)
    return _Cells(rays[order], start, low, step, n_columns, n_rows)


@kernel
def _project(out: FloatArray, vectors: FloatArray, axes: FloatArray, origin: FloatArray) -> None:
    """Write the components (N, 3) of vectors (N, 3) from an origin along axes (3, 3)."""
    for k in range(len(vectors)):
        x, y, z = vectors[k, 0] - origin[0], vectors[k, 1] - origin[1], vectors[k, 2] - origin[2]
        for d in range(3):
            out[k, d] = axes[d, 0] * x + axes[d, 1] * y + axes[d, 2] * z


@kernel
def _finite_rays(rays: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rays without those that are not finite, and the least and largest place (2,) on the plane."""
    kept, count = np.empty(rays.shape), 0
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(len(rays)):
        if np.isfinite(rays[k, 0]) and np.isfinite(rays[k, 1]) and np.isfinite(rays[k, 2]):
            for d in range(2):
                low[d], high[d] = min(low[d], rays[k, d]), max(high[d], rays[k, d])
            for d in range(3):  # numba compiles an assignment of arrays for two seconds
                kept[count, d] = rays[k, d]
            count += 1
    return kept[:count], low, high


@inner
def _cell(x: float, low: float, per_m: float, n: int) -> int:
    """Return the column or row of a coordinate, clamped to the grid."""
    return int(min(max((x - low) * per_m, 0.0), n - 1.0))


@kernel
def _sorted_into_cells(
    rays: FloatArray, low: FloatArray, step: float, n_columns: int, n_rows: int
) -> tuple[IndexArray, IndexArray]:
    """Return cell offsets (cells + 1,) and the order of the rays by cell (counting sort, stable)."""
    cell = np.empty(len(rays), dtype=np.int64)
    start = np.zeros(n_columns * n_rows + 1, dtype=np.int64)
    for k in range(len(rays)):
        row = _cell(rays[k, 1], low[1], 1.0 / step, n_rows)
        cell[k] = row * n_columns + _cell(rays[k, 0], low[0], 1.0 / step, n_columns)
        start[cell[k] + 1] += 1
    # Cumulated counts are the offsets of the cells.
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    order = np.empty(len(rays), dtype=np.int64)
    # Filled in the order of the rays: the sort is stable and the result reproducible.
    filled = start[:-1].copy()
    for k in range(len(rays)):
        order[filled[cell[k]]] = k
        filled[cell[k]] += 1
    return start, order


@kernel
def _find_candidates(
    found: IndexArray,
    tiles: IndexArray,
    vertices: SingleArray,
    axes: FloatArray,
    origin: FloatArray,
    pencil: bool,
    slack_m: tuple[float, float],
    cells: _Cells,
    layout: TileLayout,
) -> int:
    """Write the vertices of the candidate facets and return their number."""
    count, ids = 0, tile_buffer(layout)
    # Plane coordinates, depth, and tolerance in the plane at that depth; the tolerance is negative behind the camera.
    u, v, depth_m, slack = np.empty(ids.shape), np.empty(ids.shape), np.empty(ids.shape), np.empty(ids.shape)
    low = cells.low
    right, bottom = low[0] + cells.step * cells.n_columns, low[1] + cells.step * cells.n_rows
    for f in tiles:
        n = number_tile(ids, f, layout)
        least_u, least_v, most_u, most_v = np.inf, np.inf, -np.inf, -np.inf
        for i in range(n + 1):
            for j in range(n + 1 - i):
                w = ids[i, j]
                x, y, z = vertices[w, 0] - origin[0], vertices[w, 1] - origin[1], vertices[w, 2] - origin[2]
                depth_m[i, j] = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
                # The same tolerance in metres is a smaller slope farther away.
                scale = 1.0 / depth_m[i, j] if pencil else 1.0
                u[i, j] = scale * (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z)
                v[i, j] = scale * (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z)
                slack[i, j] = scale * slack_m[0]
                least_u, most_u = min(least_u, u[i, j]), max(most_u, u[i, j])
                least_v, most_v = min(least_v, v[i, j]), max(most_v, v[i, j])
        # Twice the tolerance at the first vertex stands for that of the whole tile.
        wide = abs(slack[0, 0]) * 2.0
        if most_u + wide < low[0] or most_v + wide < low[1] or least_u - wide > right or least_v - wide > bottom:
            continue
        if not _any_near(least_u - wide, least_v - wide, most_u + wide, most_v + wide, cells):
            continue
        for i in range(n):
            for j in range(n - i):
                for half in range(1 if i + j == n - 1 else 2):
                    a, b = i + half, j + half
                    # Negative behind the camera: a facet that reaches there is left out.
                    near = min(slack[a, j], slack[i + 1, b], slack[i, j + 1])
                    if near > 0.0 and _may_be_hit(
                        (u[a, j], v[a, j], depth_m[a, j]),
                        (u[i + 1, b], v[i + 1, b], depth_m[i + 1, b]),
                        (u[i, j + 1], v[i, j + 1], depth_m[i, j + 1]),
                        # The smallest tolerance of the three corners is that of the farthest one.
                        1.5 * near,
                        slack_m[1],
                        cells,
                    ):
                        found[count, 0], found[count, 1], found[count, 2] = ids[a, j], ids[i + 1, b], ids[i, j + 1]
                        count += 1
    return count


@inner
def _cells_about(left: float, top: float, right: float, bottom: float, cells: _Cells) -> tuple[int, int, int, int]:
    """Return first and last column and row of the cells that a box overlaps."""
    low, per_m = cells.low, 1.0 / cells.step
    first, last = _cell(left, low[0], per_m, cells.n_columns), _cell(right, low[0], per_m, cells.n_columns)
    return first, last, _cell(top, low[1], per_m, cells.n_rows), _cell(bottom, low[1], per_m, cells.n_rows)


@inner
def _any_near(left: float, top: float, right: float, bottom: float, cells: _Cells) -> bool:
    """Return whether the cells that a box overlaps contain a ray."""
    first, last, upper, lower = _cells_about(left, top, right, bottom, cells)
    for row in range(upper, lower + 1):
        # Cells of a row are contiguous: there is a ray if the offsets of both ends differ.
        if cells.start[row * cells.n_columns + first] < cells.start[row * cells.n_columns + last + 1]:
            return True
    return False


@inner
def _may_be_hit(p: _Point, q: _Point, r: _Point, slack: float, depth_slack_m: float, cells: _Cells) -> bool:
    """Return whether a ray lies in the triangle p q r, within the tolerance, and starts before it."""
    left, right = min(p[0], q[0], r[0]) - slack, max(p[0], q[0], r[0]) + slack
    top, bottom = min(p[1], q[1], r[1]) - slack, max(p[1], q[1], r[1]) + slack
    nearest_m, farthest_m = min(p[2], q[2], r[2]), max(p[2], q[2], r[2]) + depth_slack_m
    # Counter-clockwise, so that the inside is left of all three sides.
    if (q[0] - p[0]) * (r[1] - p[1]) < (q[1] - p[1]) * (r[0] - p[0]):
        q, r = r, q
    first, last, upper, lower = _cells_about(left, top, right, bottom, cells)
    for row in range(upper, lower + 1):
        for k in range(cells.start[row * cells.n_columns + first], cells.start[row * cells.n_columns + last + 1]):
            x, y, from_m = cells.rays[k, 0], cells.rays[k, 1], cells.rays[k, 2]
            if x < left or x > right or y < top or y > bottom or from_m > farthest_m:
                continue
            if (
                _left_of(p, q, x, y, slack)
                and _left_of(q, r, x, y, slack)
                and _left_of(r, p, x, y, slack)
                and (from_m < nearest_m or not _behind(x, y, from_m, p, q, r, depth_slack_m))
            ):
                return True
    return False


@inner
def _left_of(a: _Point, b: _Point, x: float, y: float, slack: float) -> bool:
    """Return whether a point lies left of the line from a to b, or right of it within the tolerance."""
    along, across = b[0] - a[0], b[1] - a[1]
    distance = along * (y - a[1]) - across * (x - a[0])
    # `distance` is the distance times the length of the side: compared as squares, without a root.
    return distance >= 0.0 or distance * distance <= slack * slack * (along * along + across * across)


@inner
def _behind(x: float, y: float, from_m: float, p: _Point, q: _Point, r: _Point, slack_m: float) -> bool:
    """Return whether a ray starts beyond the plane through p, q and r; False if the plane is edge-on."""
    qu, qv, q_m = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    ru, rv, r_m = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    area = qu * rv - qv * ru
    if area <= 0.0:
        return False
    # Slopes of depth over the plane, by Cramer's rule.
    by_u, by_v = (q_m * rv - r_m * qv) / area, (r_m * qu - q_m * ru) / area
    plane_m = p[2] + by_u * (x - p[0]) + by_v * (y - p[1])
    # An error of the tolerance in the plane changes the depth by the slope times as much.
    return plane_m + slack_m * (1.0 + abs(by_u) + abs(by_v)) < from_m
