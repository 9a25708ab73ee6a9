"""The heights of a surface above a plane, on a regular grid: what a maplet is cut from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_LEAST_FACING = 0.1
_EDGE_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A square grid of S x S nodes in a local frame.

    Parameters
    ----------
    centre_m
        (3,) its middle, body frame.
    axes
        (3, 3) rows: the unit vectors x and y along the columns and the rows of the grid, and the upward normal,
        right-handed, body frame.
    spacing_m
        Between neighbouring nodes.
    side
        S, odd, so that the centre is a node.
    """

    centre_m: FloatArray
    axes: FloatArray
    spacing_m: float
    side: int

    @property
    def half_m(self) -> float:
        """From the centre to an edge of the grid."""
        return 0.5 * (self.side - 1) * self.spacing_m


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh that heights are read from, with its facets in a search tree."""

    mesh: TriangleMesh

    @cached_property
    def centroids_m(self) -> FloatArray:
        """(F, 3) middles of the facets."""
        return np.asarray(self.mesh.corners_m.mean(axis=1), dtype=np.float64)

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree over them."""
        return cKDTree(self.centroids_m)

    @cached_property
    def reach_m(self) -> float:
        """The largest distance of a facet's corner from its middle."""
        return float(np.linalg.norm(self.mesh.corners_m - self.centroids_m[:, None], axis=2).max())

    def mean_normal(self, centre_m: FloatArray, radius_m: float) -> FloatArray:
        """Average the surface within a radius of a point to a unit normal (3,), by the area vectors of its facets.

        Facets that face away from the nearest one belong to another part of the body and are left out.
        """
        nearest = int(self.tree.query(centre_m)[1])
        near = np.asarray(self.tree.query_ball_point(centre_m, radius_m), dtype=np.int64)
        area_vectors = self.mesh.area_vectors_m2[near]
        total = area_vectors[area_vectors @ self.mesh.area_vectors_m2[nearest] > 0.0].sum(axis=0)
        if not total.any():
            total = self.mesh.area_vectors_m2[nearest]
        unit: FloatArray = total / np.linalg.norm(total)
        return unit


def sample_heights(surface: Surface, plane: Plane) -> tuple[FloatArray, FloatArray | None]:
    """Heights of the surface above the nodes of a plane, and its albedo there.

    The surface is seen from above: of several layers the highest counts that lies no farther from the plane than
    the grid reaches to the side, and faces up.

    Returns
    -------
    heights_m
        (S, S), rows along y; NaN where there is no surface.
    albedo
        (S, S), or None where the mesh has none.
    """
    mesh = surface.mesh
    reach_m = float(np.hypot(np.sqrt(2.0) * plane.half_m, plane.half_m)) + surface.reach_m
    near = np.asarray(surface.tree.query_ball_point(plane.centre_m, reach_m), dtype=np.int64)
    near = near[mesh.normals[near] @ plane.axes[2] > _LEAST_FACING]
    corners = (mesh.corners_m[near] - plane.centre_m) @ plane.axes.T
    near, corners = (part[np.abs(corners[:, :, 2]).max(axis=1) <= plane.half_m] for part in (near, corners))
    grid = corners[:, :, :2] / plane.spacing_m + (plane.side - 1) / 2
    facet, node, weights = _covered_nodes(grid, plane.side)
    heights = np.einsum("nk,nk->n", weights, corners[facet, :, 2])
    order = np.argsort(heights, kind="stable")  # the highest is written last
    heights_m = np.full(plane.side**2, np.nan)
    heights_m[node[order]] = heights[order]
    shape = (plane.side, plane.side)
    if mesh.albedo is None:
        return heights_m.reshape(shape), None
    values = np.einsum("nk,nk->n", weights, mesh.albedo[mesh.faces[near[facet]]])
    albedo = np.full(plane.side**2, np.nan)
    albedo[node[order]] = values[order]
    return heights_m.reshape(shape), albedo.reshape(shape)


def _covered_nodes(corners: FloatArray, side: int) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Find the nodes under each facet.

    Parameters
    ----------
    corners
        (F, 3, 2) in grid units, x (column) and y (row).
    side
        Nodes along each axis.

    Returns
    -------
    facet, node
        (P,) pairs; nodes are numbered row by row.
    weights
        (P, 3) barycentric coordinates.
    """
    low = np.clip(np.ceil(corners.min(axis=1) - _EDGE_TOLERANCE), 0, side).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) + _EDGE_TOLERANCE), -1, side - 1).astype(np.int64)
    size = np.maximum(high - low + 1, 0)
    count = size[:, 0] * size[:, 1]
    facet = np.repeat(np.arange(len(corners)), count)
    offset = np.arange(len(facet)) - np.repeat(np.cumsum(count) - count, count)
    column = low[facet, 0] + offset % np.maximum(size[facet, 0], 1)
    row = low[facet, 1] + offset // np.maximum(size[facet, 0], 1)
    first, second, third = corners[facet, 0], corners[facet, 1], corners[facet, 2]
    area = _cross(second - first, third - first)
    point = np.stack([column, row], axis=1).astype(np.float64)
    w1 = _cross(point - first, third - first)
    w2 = _cross(second - first, point - first)
    weights = np.stack([area - w1 - w2, w1, w2], axis=1) / np.where(area == 0.0, np.nan, area)[:, None]
    inside = weights.min(axis=1) >= -_EDGE_TOLERANCE
    return facet[inside], (row * side + column)[inside], weights[inside]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    value: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return value
