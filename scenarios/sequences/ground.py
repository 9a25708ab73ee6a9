"""Surfaces on which landmarks lie: sampling uniform over the area, and occlusion by a hierarchy of boxes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import TriangleMesh

_LEAF_FACETS = 4
_SLACK = 1e-9  # in lengths of a ray
_PAIRS_AT_ONCE = 1 << 18  # of a ray and a box, which bounds the memory


@dataclass(frozen=True, slots=True, eq=False)
class FacetTree:
    """A bounding volume hierarchy, complete and binary: the children of node i are 2 i + 1 and 2 i + 2.

    All rays are traversed together, level by level, as pairs of a ray and a box that it intersects. ``facets`` (L, K)
    are those of each leaf, padded by repetition, ``corners_m`` (L, K, 3, 3) their corners. ``low_m`` and ``high_m`` (2
    L - 1, 3) are corners of the boxes, those of the leaves last.
    """

    facets: IndexArray
    corners_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray

    @classmethod
    def of(cls, mesh: TriangleMesh) -> FacetTree:
        """Build the tree by median splits of the facet centres along the longest side."""
        corners = mesh.corners_m
        # A complete tree: the number of leaves is a power of two.
        levels = max(0, int(np.ceil(np.log2(len(corners) / _LEAF_FACETS))))
        groups = _halved(corners.mean(axis=1), levels)
        leaves = corners[groups]
        low, high = [leaves.min(axis=(1, 2))], [leaves.max(axis=(1, 2))]
        # The box of a parent encloses those of its two children, level by level up to the root.
        while len(low[0]) > 1:
            low.insert(0, np.minimum(low[0][0::2], low[0][1::2]))
            high.insert(0, np.maximum(high[0][0::2], high[0][1::2]))
        return cls(groups, leaves, np.concatenate(low), np.concatenate(high))

    def hidden(self, points_m: FloatArray, origin_m: FloatArray) -> BoolArray:
        """(n,) whether a facet obstructs the line from ``origin_m``, (3,), to each point, (n, 3).

        The facet of the point itself, at the end of the line within rounding, does not count.
        """
        rays = points_m - origin_m
        hidden = np.zeros(len(rays), dtype=bool)
        # About 64 boxes for each ray.
        share = max(1, _PAIRS_AT_ONCE // 64)
        for start in range(0, len(rays), share):
            some = rays[start : start + share]
            ray, leaf = self._leaves(some, np.broadcast_to(origin_m, some.shape), 1.0)
            for k in range(self.corners_m.shape[1]):
                along = _crossing(self.corners_m[leaf, k], origin_m, some[ray])
                hidden[start + ray[(along > 0.0) & (along < 1.0 - _SLACK)]] = True
        return hidden

    def first_met(self, origins_m: FloatArray, rays_m: FloatArray) -> tuple[FloatArray, IndexArray]:
        """Find the first intersections of (n, 3) rays from (n, 3) origins.

        Return (n,) distances in lengths of the ray, infinite for misses, and (n,) facets, -1 for misses.
        """
        # About 256 boxes for each ray, which does not end at a point of the surface.
        share = max(1, _PAIRS_AT_ONCE // 256)
        nearest, facets = np.full(len(rays_m), np.inf), np.full(len(rays_m), -1, dtype=np.int64)
        for start in range(0, len(rays_m), share):
            rays, origins = rays_m[start : start + share], origins_m[start : start + share]
            ray, leaf = self._leaves(rays, origins, np.inf)
            for k in range(self.corners_m.shape[1]):
                along = _crossing(self.corners_m[leaf, k], origins[ray], rays[ray])
                before = np.flatnonzero((along > 0.0) & (along < nearest[start + ray]))
                before = before[np.argsort(-along[before], kind="stable")]  # the nearest is written last
                nearest[start + ray[before]] = along[before]
                facets[start + ray[before]] = self.facets[leaf[before], k]
        return nearest, facets

    def _leaves(self, rays: FloatArray, origins: FloatArray, end: float) -> tuple[IndexArray, IndexArray]:
        """Return pairs of rays, (P,), and leaves, (P,), whose boxes they intersect before ``end`` lengths."""
        with np.errstate(divide="ignore"):
            # A component of 0 gives infinity, with which the slabs work.
            inverse = 1.0 / rays
        ray = np.arange(len(rays), dtype=np.int64)
        node = np.zeros(len(rays), dtype=np.int64)
        first_leaf = len(self.corners_m) - 1
        while len(ray):
            meets = self._meets(node, origins[ray], inverse[ray], end)
            ray, node = ray[meets], node[meets]
            # All pairs are on the same level.
            if len(node) and node[0] >= first_leaf:
                break
            ray, node = np.repeat(ray, 2), np.stack([2 * node + 1, 2 * node + 2], axis=1).ravel()
        return ray, node - first_leaf

    def _meets(self, node: IndexArray, origin: FloatArray, inverse: FloatArray, end: float) -> BoolArray:
        """(P,) whether each ray intersects its box before its end (slab method, Kay and Kajiya 1986)."""
        with np.errstate(invalid="ignore"):
            one, other = (self.low_m[node] - origin) * inverse, (self.high_m[node] - origin) * inverse
        # 0 times infinity is NaN, where a ray runs within a side of the box: fmax and fmin ignore that axis.
        enter = np.fmax.reduce(np.minimum(one, other), axis=1)
        leave = np.fmin.reduce(np.maximum(one, other), axis=1)
        met: BoolArray = (enter <= leave + _SLACK) & (leave >= 0.0) & (enter < end)
        return met


def _halved(middles: FloatArray, levels: int) -> IndexArray:
    """(2^levels, K) indices of the centres in each group; smaller groups repeat a facet."""
    order, sizes = np.arange(len(middles)), np.array([len(middles)])
    for _ in range(levels):
        group, begins = np.repeat(np.arange(len(sizes)), sizes), np.cumsum(sizes) - sizes
        placed = middles[order]
        axis = (np.maximum.reduceat(placed, begins) - np.minimum.reduceat(placed, begins)).argmax(axis=1)
        # lexsort is stable: the tree is the same on every machine.
        order = order[np.lexsort((placed[np.arange(len(placed)), axis[group]], group))]
        sizes = np.stack([sizes - sizes // 2, sizes // 2], axis=1).ravel()
    begins = np.cumsum(sizes) - sizes
    found: IndexArray = order[begins[:, None] + np.arange(sizes.max()) % sizes[:, None]]
    return found


def _crossing(corners: FloatArray, origin: FloatArray, rays: FloatArray) -> FloatArray:
    """(P,) intersection of each ray with its facet, (P, 3, 3), in lengths of the ray; NaN for misses.

    After Moeller and Trumbore (1997). A ray that ends on the facet gives 1 within rounding.
    """
    edge1, edge2, offset = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], origin - corners[:, 0]
    p, q = np.cross(rays, edge2), np.cross(offset, edge1)
    determinant = np.einsum("pi,pi->p", edge1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("pi,pi->p", offset, p) / determinant
        v = np.einsum("pi,pi->p", rays, q) / determinant
        t = np.einsum("pi,pi->p", edge2, q) / determinant
        # Comparisons with NaN or infinity, of rays parallel to their facet, are false.
        return np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0), t, np.nan)


# The real root of x^3 = x + 1: its powers give the R2 lattice, as the golden ratio gives the spiral.
_PLASTIC = 1.32471795724474602596
_LATTICE = np.array([1.0 / _PLASTIC, 1.0 / _PLASTIC**2])
_GOLDEN = 0.5 * (1.0 + np.sqrt(5.0))


class LandmarkGround(Protocol):
    """Surface on which landmarks lie; immutable and hashable, so that results can be cached."""

    def __hash__(self) -> int:
        """Hash, for caches."""
        ...

    @property
    def reach_m(self) -> float:
        """Largest distance of the surface from the origin."""
        ...

    def sample(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw n points, (n, 3) m, uniform over the area, and their outward normals (n, 3)."""
        ...

    def spread(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Return n points, evenly and deterministically distributed over the area, and their outward normals."""
        ...

    def in_sight(self, points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
        """(n,) whether points are not occluded, regardless of the field of view."""
        ...

    def heights_m(self, positions_m: FloatArray) -> FloatArray:
        """(n,) distances of positions (n, 3) from the ground towards the body's origin."""
        ...


@dataclass(frozen=True, slots=True)
class SphereGround:
    """A sphere about the origin; points are visible up to the limb."""

    radius_m: float

    @property
    def reach_m(self) -> float:
        """The radius."""
        return self.radius_m

    def sample(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw points: z is uniform on a sphere (Archimedes)."""
        return self._at(rng.uniform(-1.0, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n))

    def spread(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Place points on a Fibonacci spiral."""
        steps = np.arange(n)
        # Middles of bands of equal area; each next point is a golden section of the circle on.
        return self._at(1.0 - (2.0 * steps + 1.0) / n, 2.0 * np.pi * (steps / _GOLDEN % 1.0))

    def _at(self, z: FloatArray, longitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        across = np.sqrt(1.0 - z * z)
        normals = np.column_stack([across * np.cos(longitude), across * np.sin(longitude), z])
        return self.radius_m * normals, normals

    def in_sight(self, points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
        """(n,) whether the camera is above the tangent plane of each point."""
        return faces_camera(points_m, normals, camera_position_m)

    def heights_m(self, positions_m: FloatArray) -> FloatArray:
        """(n,) distances of positions (n, 3) from the sphere."""
        return np.asarray(np.linalg.norm(positions_m, axis=1) - self.radius_m, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class MeshGround:
    """A closed mesh with occlusion by its facets."""

    mesh: TriangleMesh

    @property
    def reach_m(self) -> float:
        """Distance of the farthest vertex."""
        return self.mesh.radius_m

    @cached_property
    def _cumulated_areas(self) -> FloatArray:
        return np.cumsum(self.mesh.areas_m2)

    def sample(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw facets by their area, and a point uniform on each."""
        return self._at(rng.uniform(0.0, self.area_m2, n), rng.uniform(size=(2, n)))

    def spread(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Place points by the area in the order of the facets, and on each by the R2 lattice of Roberts (2018)."""
        steps = np.arange(n)
        return self._at((steps + 0.5) / n * self.area_m2, np.outer(_LATTICE, steps + 0.5) % 1.0)

    @property
    def area_m2(self) -> float:
        """Area of the surface."""
        return float(self._cumulated_areas[-1])

    def _at(self, areas_m2: FloatArray, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Map (n,) cumulated areas and (2, n) points of the unit square to points on facets, with their normals."""
        total = self._cumulated_areas
        facet = np.minimum(np.searchsorted(total, areas_m2, side="right"), len(total) - 1)
        u, v = uv
        # The half of the parallelogram beyond the triangle is folded back: uniform without a rejection.
        folded = u + v > 1.0
        u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
        a, b, c = np.moveaxis(self.mesh.corners_m[facet], 1, 0)
        return a + u[:, None] * (b - a) + v[:, None] * (c - a), self.mesh.normals[facet]

    @cached_property
    def _tree(self) -> FacetTree:
        return FacetTree.of(self.mesh)

    def in_sight(self, points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
        """(n,) whether points face the camera and no facet obstructs the line of sight."""
        seen = faces_camera(points_m, normals, camera_position_m)
        rows = np.flatnonzero(seen)
        # Points that face away need no ray.
        seen[rows] = ~self._tree.hidden(points_m[rows], camera_position_m)
        return seen

    def heights_m(self, positions_m: FloatArray) -> FloatArray:
        """(n,) distances of positions (n, 3) from the facets below; from the origin where there is none."""
        along, _ = self.first_met(positions_m, -positions_m)
        return np.asarray(np.minimum(along, 1.0) * np.linalg.norm(positions_m, axis=1), dtype=np.float64)

    def intersect(self, origin_body_m: FloatArray, directions_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) points and (n, 3) outward normals where (n, 3) rays hit the body; NaN for misses."""
        along, facet = self.first_met(origin_body_m, directions_body)
        # Misses are infinite, and infinity times 0 must not be a point.
        met = np.where(facet >= 0, along, np.nan)[:, None]
        return origin_body_m + met * directions_body, np.where(facet[:, None] >= 0, self.mesh.normals[facet], np.nan)

    def first_met(self, origin_body_m: FloatArray, directions_body: FloatArray) -> tuple[FloatArray, IndexArray]:
        """Return (n,) distances in lengths of (n, 3) rays to the facets (n,) that they hit first; -1 for misses."""
        return self._tree.first_met(origin_body_m, directions_body)


def faces_camera(points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
    """(n,) whether the camera is on the outer side of each point's tangent plane."""
    towards: BoolArray = np.einsum("ni,ni->n", normals, camera_position_m - points_m) > 0.0
    return towards
