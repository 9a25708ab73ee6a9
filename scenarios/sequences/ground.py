"""Surfaces on which landmarks lie: sampling uniform over the area, and occlusion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.sequences.bvh import FacetTree

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
        return np.cumsum(np.linalg.norm(self.mesh.area_vectors_m2, axis=1))

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
