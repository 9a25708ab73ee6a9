"""The ground that landmarks lie on: points uniform over its area, and which of them a camera has in sight."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_SLACK = 1e-9
_RAYS_AT_ONCE = 64


class Ground(Protocol):
    """A surface that landmarks lie on; it never changes, so that what costs much of it can be kept."""

    def __hash__(self) -> int:
        """Tell grounds apart."""
        ...

    @property
    def reach_m(self) -> float:
        """Largest distance of the surface from the origin."""
        ...

    def sample(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw n points, (n, 3) m, uniform over the area, and their outward normals (n, 3)."""
        ...

    def in_sight(self, points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
        """(n,): points with nothing between them and the camera, whatever its field of view."""
        ...


@dataclass(frozen=True, slots=True)
class SphereGround:
    """A sphere about the origin: a point is in sight up to the limb."""

    radius_m: float

    @property
    def reach_m(self) -> float:
        """The radius."""
        return self.radius_m

    def sample(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw points: z is uniform on a sphere (Archimedes)."""
        z, longitude = rng.uniform(-1.0, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
        across = np.sqrt(1.0 - z * z)
        normals = np.column_stack([across * np.cos(longitude), across * np.sin(longitude), z])
        return self.radius_m * normals, normals

    def in_sight(self, points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
        """Tell whether the tangent plane of each point has the camera above it."""
        return faces(points_m, normals, camera_position_m)


@dataclass(frozen=True, eq=False)
class MeshGround:
    """A closed mesh; the ground between hides what lies behind."""

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
        total = self._cumulated_areas
        facet = np.minimum(np.searchsorted(total, rng.uniform(0.0, total[-1], n), side="right"), len(total) - 1)
        u, v = rng.uniform(size=(2, n))
        folded = u + v > 1.0
        u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
        a, b, c = np.moveaxis(self.mesh.corners_m[facet], 1, 0)
        return a + u[:, None] * (b - a) + v[:, None] * (c - a), self.mesh.normals[facet]

    def in_sight(self, points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
        """Tell whether a point faces the camera and no facet stands on the line of sight."""
        seen = faces(points_m, normals, camera_position_m)
        candidates = np.flatnonzero(seen)
        for start in range(0, len(candidates), _RAYS_AT_ONCE):
            rows = candidates[start : start + _RAYS_AT_ONCE]
            seen[rows] = ~self._hidden(points_m[rows], camera_position_m)
        return seen

    def _hidden(self, points_m: FloatArray, origin: FloatArray) -> BoolArray:
        """(n,): whether a facet that faces the camera stands between it and each point.

        A closed body hides with a facet that faces the camera. A sphere about each facet tells which lines come near.
        """
        corners = self.mesh.corners_m
        facing = np.einsum("fi,fi->f", self.mesh.area_vectors_m2, origin - corners[:, 0]) > 0.0
        corners = corners[facing]
        middle = corners.mean(axis=1)
        radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        rays = points_m - origin
        units = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        offset = middle - origin
        along = units @ offset.T
        apart_m2 = np.einsum("fi,fi->f", offset, offset) - along**2
        ray, facet = np.nonzero((apart_m2 <= ((1.0 + _SLACK) * radius) ** 2 + _SLACK) & (along > 0.0))
        hidden = np.zeros(len(points_m), dtype=bool)
        hidden[ray[_blocks(corners[facet], origin, rays[ray])]] = True
        return hidden


def faces(points_m: FloatArray, normals: FloatArray, camera_position_m: FloatArray) -> BoolArray:
    """(n,): points whose outward normal points towards the camera."""
    towards: BoolArray = np.einsum("ni,ni->n", normals, camera_position_m - points_m) > 0.0
    return towards


def _blocks(corners: FloatArray, origin: FloatArray, rays: FloatArray) -> BoolArray:
    """(P,): whether each ray meets its facet before its end, by Moeller and Trumbore (1997).

    The end is the point itself: the facet that it lies on, met at 1 but for rounding, does not count.
    """
    edge1, edge2, offset = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], origin - corners[:, 0]
    p, q = np.cross(rays, edge2), np.cross(offset, edge1)
    determinant = np.einsum("pi,pi->p", edge1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("pi,pi->p", offset, p) / determinant
        v = np.einsum("pi,pi->p", rays, q) / determinant
        t = np.einsum("pi,pi->p", edge2, q) / determinant
    met: BoolArray = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0 - _SLACK)
    return met
