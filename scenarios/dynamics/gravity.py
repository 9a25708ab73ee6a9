"""Gravity of a point mass and of a homogeneous polyhedron."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry.mesh import TriangleMesh, solid_angles


@dataclass(frozen=True, slots=True)
class PointMass:
    """A point mass at the origin."""

    gm_m3_s2: float

    def acceleration(self, position_m: FloatArray) -> FloatArray:
        """-GM r / r^3: the first term of equation (6) of Delpech et al. (2015), which is printed without its sign."""
        return np.asarray(-self.gm_m3_s2 * position_m / np.linalg.norm(position_m) ** 3, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """A closed mesh of constant density, after Werner and Scheeres (1997), Celest. Mech. Dyn. Astron. 65, 313.

    Their sums over edges are evaluated facet by facet: an edge's dyad is the sum of its two facets' terms,
    ``E_e = n_A (m_A)^T + n_B (m_B)^T`` with m the normal of the edge in the plane of the facet, so that

    ``a = (G sigma) sum_f n_f [(n_f . r_f) omega_f - sum_(e of f) (m_fe . r_e) L_e]``,

    r from the field point to a point of the facet or edge. G sigma is GM over the volume. The formula holds inside the
    body as well, but not on an edge.
    """

    mesh: TriangleMesh
    gm_m3_s2: float

    def acceleration(self, position_m: FloatArray) -> FloatArray:
        """(3,) m/s2 at a position (3,) m in the mesh's axes."""
        corners = self.mesh.corners_m - position_m
        distances = np.sqrt(np.einsum("fki,fki->fk", corners, corners))
        # (n_f . r_f) omega_f: r_f may be any corner, as all have the same distance from the facet's plane.
        flux = np.einsum("fi,fi->f", self.mesh.normals, corners[:, 0]) * solid_angles(corners, distances)
        # (m_fe . r_e) L_e of the three edges, L_e = ln((a + b + e) / (a + b - e)) the potential of a wire along an edge
        # of length e with distances a and b of its ends; both facets of an edge have the same L_e.
        both = distances + np.roll(distances, -1, axis=1)
        logs = np.log((both + self._lengths_m) / (both - self._lengths_m))
        edges = np.einsum("fki,fki->fk", self._edge_normals, corners) * logs
        return np.asarray((flux - edges.sum(axis=1)) @ self.mesh.normals * self._g_sigma, dtype=np.float64)

    def laplacian(self, position_m: FloatArray) -> float:
        """Divergence of the acceleration, 1/s2: -4 pi G sigma inside and 0 outside."""
        corners = self.mesh.corners_m - position_m
        return float(-self._g_sigma * solid_angles(corners, np.linalg.norm(corners, axis=2)).sum())

    @cached_property
    def _g_sigma(self) -> float:
        return self.gm_m3_s2 / self.mesh.volume_m3

    @cached_property
    def _edges_m(self) -> FloatArray:
        """(F, 3, 3) edge vectors of each facet, from corner k to the next one."""
        return np.roll(self.mesh.corners_m, -1, axis=1) - self.mesh.corners_m

    @cached_property
    def _lengths_m(self) -> FloatArray:
        lengths: FloatArray = np.linalg.norm(self._edges_m, axis=2)
        return lengths

    @cached_property
    def _edge_normals(self) -> FloatArray:
        """(F, 3, 3) unit vectors in the plane of the facet, perpendicular to each edge and pointing outward."""
        # Edge times normal points away from a counter-clockwise facet.
        across = np.cross(self._edges_m, self.mesh.normals[:, None])
        out: FloatArray = np.divide(
            across, self._lengths_m[..., None], out=np.zeros_like(across), where=self._lengths_m[..., None] > 0.0
        )
        return out
