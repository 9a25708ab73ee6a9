"""A finer shape of a part of the surface: the facets of the whole shape are divided there, and moved onto it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.bodies.topology import (
    IntArray,
    find_edges,
    is_closed,
    refine_where,
    smoothstep,
    tangent_axes,
    vertex_normals,
)
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.mesh import unit
from boresight.scenarios.spec.body import MOST_FACETS, LocalSpec

LOCAL_VERSION = 1
"""Part of the digest of every body with a local shape: increase it when the same files give another mesh."""

_FARTHEST = 0.5  # of the width of the local shape, from the body's surface
_LEAST_ONE_WAY = 0.5  # length of the mean of the facets' normals: that of a hemisphere
# Between a normal and the side from which the local shape is seen: the far side of the body is below it, overhangs of
# the near side are not.
_LEAST_FACING = -0.5
_MOST_FOLDED = 0.001  # of the surface
_BLEND = 0.1  # of the width, where blend_m is left out
_MOST_FACETS = 13_000_000
_PER_EDGE = 8  # points in the mean length of an edge, to which distances from the rim are measured


def with_local(
    mesh: TriangleMesh, vertices_m: FloatArray, faces: IndexArray, spec: LocalSpec, where: Path
) -> tuple[TriangleMesh, str]:
    """Divide the facets of a closed mesh within a local shape, and move their vertices onto it; return a note too.

    The local shape is an open mesh in the same frame, ``vertices_m`` (n, 3) and ``faces`` (m, 3), seen from the side of
    the mean of its normals. Vertices move along that direction, by the whole way where they are ``spec.blend_m`` or
    more within its edge, by less towards the edge, and not at all at the edge and in its holes. The mesh stays closed,
    and facets that are not divided stay as they are. Raise BoresightError, which names the file ``where``, if the local
    shape is closed, has no side, or does not lie along the body's surface, or that one overhangs.
    """
    terrain = _terrain(mesh, TriangleMesh(vertices_m, faces.astype(np.int32)), spec, where)
    edge_m, farthest_m = spec.edge_m or terrain.edge_m, _FARTHEST * terrain.width_m
    count, most = _facets(terrain.width_m, edge_m), min(_MOST_FACETS, MOST_FACETS - len(mesh.faces))
    if count > most:
        raise BoresightError(
            f"{where}: body.local: edges of {edge_m:.3g} m make about {count:.2g} facets, more than"
            f" {max(most, 0):.2g}; give a greater edge_m"
        )
    values = np.column_stack([mesh.vertices_m] if mesh.albedo is None else [mesh.vertices_m, mesh.albedo])
    fine, fine_faces = refine_where(values, mesh.faces, edge_m, terrain.is_near(farthest_m))
    points_m = fine[:, :3]
    facing = np.einsum("ni,i->n", vertex_normals(points_m, fine_faces), terrain.up)
    near = np.flatnonzero(facing > _LEAST_FACING)
    rises_m = terrain.rises_m(points_m[near])
    near, rises_m = near[np.isfinite(rises_m)], rises_m[np.isfinite(rises_m)]
    above_m = np.abs(rises_m[facing[near] > 0.0])
    if not len(above_m):
        raise BoresightError(f"{where}: body.local: no part of the body's surface is below it; check its frame")
    if np.median(above_m) > farthest_m:
        raise BoresightError(
            f"{where}: body.local: it is {np.median(above_m):.3g} m from the body's surface (median), more than half of"
            f" its width of {terrain.width_m:.3g} m; check its frame"
        )
    near, rises_m = near[np.abs(rises_m) <= farthest_m], rises_m[np.abs(rises_m) <= farthest_m]
    if (folded := _folded(points_m, fine_faces, near, terrain.up)) > _MOST_FOLDED:
        raise BoresightError(
            f"{where}: body.local: {100.0 * folded:.2g} % of the body's surface below it overhangs, seen along the mean"
            " of its normals; cut it into smaller ones"
        )
    within_m, blend_m = terrain.from_rim_m(points_m[near]), spec.blend_m or _BLEND * terrain.width_m
    if within_m.max() < blend_m:
        raise BoresightError(
            f"{where}: body.local: its surface is {within_m.max():.3g} m at most from its edge, less than blend_m:"
            f" {blend_m:.3g}; lower it"
        )
    moved_m = points_m.copy()
    moved_m[near] += (smoothstep(within_m / blend_m) * rises_m)[:, None] * terrain.up
    note = (
        f"{where.name}: {len(fine_faces)} facets in place of {len(mesh.faces)}; the surface there moved by"
        f" {np.median(above_m):.3g} m (median)"
    )
    return TriangleMesh(moved_m, fine_faces.astype(np.int32), None if mesh.albedo is None else fine[:, 3]), note


def local_facets(vertices_m: FloatArray, faces: IndexArray, spec: LocalSpec) -> int:
    """Return about how many facets a local shape, (n, 3) and (m, 3), adds to a body."""
    mesh = TriangleMesh(vertices_m, faces.astype(np.int32))
    edge_m = spec.edge_m or float(find_edges(mesh.faces).lengths(mesh.vertices_m).mean())
    return round(_facets(float(np.sqrt(mesh.areas_m2.sum())), edge_m))


def _facets(width_m: float, edge_m: float) -> float:
    return 4.0 * (width_m / edge_m) ** 2


def _folded(points_m: FloatArray, faces: IntArray, moved: IndexArray, up: FloatArray) -> float:
    """Return the area of facets that face away from ``up`` over that of the others, of those all of whose corners move.

    Seen along ``up``, which is how the corners move: these facets would lie in folds under the others.
    """
    moves = np.zeros(len(points_m), dtype=bool)
    moves[moved] = True
    a, b, c = np.moveaxis(points_m[faces[moves[faces].all(axis=1)]], 1, 0)
    area_m2 = np.einsum("fi,i->f", np.cross(b - a, c - a), up)
    return float(-area_m2[area_m2 < 0.0].sum() / max(area_m2[area_m2 > 0.0].sum(), np.finfo(float).tiny))


def _terrain(mesh: TriangleMesh, local: TriangleMesh, spec: LocalSpec, where: Path) -> _Terrain:
    """Check form and place of a local shape, and find the side from which it is seen."""
    distance_m = float(np.median(np.linalg.norm(local.vertices_m, axis=1)))
    radii_m = np.linalg.norm(mesh.vertices_m, axis=1)
    low_m, high_m = 0.5 * float(radii_m.min()), 2.0 * float(radii_m.max())
    if not low_m <= distance_m <= high_m:
        other, factor = ("km", 1000.0) if spec.unit == "m" else ("m", 0.001)
        fits = low_m <= factor * distance_m <= high_m
        hint = f"is the file in {other}? set unit: {other}" if fits else "its origin and axes must be the body's"
        raise BoresightError(
            f"{where}: body.local: with unit {spec.unit} it is {distance_m:.4g} m from the body's origin, the surface"
            f" {radii_m.min():.4g} to {radii_m.max():.4g} m; {hint}"
        )
    area_m2 = float(local.areas_m2.sum())
    mean = local.area_vectors_m2.sum(axis=0) / area_m2
    if is_closed(local.faces) or np.linalg.norm(mean) < _LEAST_ONE_WAY:
        raise BoresightError(
            f"{where}: body.local: it must be open, and seen whole from one side; cut it, or mend its winding"
        )
    nearest = np.linalg.norm(mesh.vertices_m - local.vertices_m.mean(axis=0), axis=1).argmin()
    # It may be wound inward.
    side = np.sign(vertex_normals(mesh.vertices_m, mesh.faces)[nearest] @ mean)
    first, second = tangent_axes(side * unit(mean)[None], np.zeros(1))
    axes = np.concatenate([first, second, side * unit(mean)[None]])
    return _Terrain(TriangleMesh(_turned(local.vertices_m, axes), local.faces), axes, float(np.sqrt(area_m2)))


def _turned(vectors: FloatArray, axes: FloatArray) -> FloatArray:
    # einsum and not BLAS: its sums do not depend on the number of threads.
    turned: FloatArray = np.einsum("...i,ji->...j", vectors, axes)
    return turned


@dataclass(frozen=True, eq=False)
class _Terrain:
    """A local shape in axes of its own: two across, and up; ``axes`` (3, 3) are these in the body frame, as rows.

    ``width_m`` is the root of its area.
    """

    mesh: TriangleMesh
    axes: FloatArray
    width_m: float

    @property
    def up(self) -> FloatArray:
        up: FloatArray = self.axes[2]
        return up

    @cached_property
    def edge_m(self) -> float:
        """Mean length of an edge."""
        return float(find_edges(self.mesh.faces).lengths(self.mesh.vertices_m).mean())

    def is_near(self, farthest_m: float) -> Callable[[FloatArray, FloatArray], BoolArray]:
        """Return a test of facets by their corners (n, 3, 3) and longest edges (n,): whether they may be below."""
        from scipy.spatial import cKDTree

        vertices = self.mesh.vertices_m
        tree = cKDTree(vertices[:, :2])

        def test(corners_m: FloatArray, reach_m: FloatArray) -> BoolArray:
            corners = _turned(corners_m, self.axes)
            normals: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            near: BoolArray = normals[:, 2] > _LEAST_FACING * np.linalg.norm(normals, axis=1)
            middle = corners[near].mean(axis=1)
            distance_m, vertex = tree.query(middle[:, :2])
            rise_m = np.abs(vertices[vertex, 2] - middle[:, 2])
            near[near] = (distance_m <= reach_m[near] + self.edge_m) & (rise_m <= farthest_m + reach_m[near])
            return near

        return test

    def rises_m(self, points_m: FloatArray) -> FloatArray:
        """(n,) ways up from points (n, 3) of the body to the outermost facet there, infinite where there is none."""
        # Imported here: it brings orbits and tracks, and most bodies are in the cache.
        from boresight.scenarios.sequences.ground import FacetTree

        tree, points = FacetTree.of(self.mesh), _turned(points_m, self.axes)
        top_m = float(self.mesh.vertices_m[:, 2].max()) + self.width_m
        rises_m = np.full(len(points), np.inf)
        # Rounding may lead a ray between two facets: a second one beside it meets either.
        for aside_m in (0.0, 1e-6 * self.edge_m):
            rest = np.flatnonzero(~np.isfinite(rises_m))
            origins = np.column_stack([points[rest, :2] + aside_m, np.full(len(rest), top_m)])
            down_m, _ = tree.first_met(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
            rises_m[rest] = top_m - down_m - points[rest, 2]
        return rises_m

    def from_rim_m(self, points_m: FloatArray) -> FloatArray:
        """(n,) distances of points (n, 3) across to the nearest edge of a single facet, at the rim or a hole."""
        from scipy.spatial import cKDTree

        edges = find_edges(self.mesh.faces)
        rim = edges.ends[np.bincount(edges.of_face.ravel()) == 1]
        start, end = self.mesh.vertices_m[rim, :2].swapaxes(0, 1)
        counts = 1 + (_PER_EDGE * np.linalg.norm(end - start, axis=1) / self.edge_m).astype(np.int64)
        one = np.repeat(np.arange(len(rim)), counts)
        share = (np.arange(len(one)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[one]
        tree = cKDTree(start[one] + share[:, None] * (end - start)[one])
        distances, _ = tree.query(_turned(points_m, self.axes)[:, :2])
        return np.asarray(distances)
