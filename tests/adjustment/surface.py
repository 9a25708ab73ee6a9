"""Nearest points of a shape to landmarks, and the place of a shape among landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from adjustment.bundle import Block, Surface
from boresight.scenarios.arrays import MAD_TO_SIGMA, FloatArray
from boresight.scenarios.geometry import TriangleMesh

_NEIGHBOURS = 12
_OUTLIER_M = 42.0


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Facets of a shape, searched by their centres."""

    corners_m: FloatArray
    normals: FloatArray
    tree: KDTree

    @classmethod
    def of(cls, mesh: TriangleMesh) -> Shape:
        """Return the facets of a mesh."""
        return cls(mesh.corners_m, mesh.normals, KDTree(mesh.corners_m.mean(axis=1)))

    def offsets(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances (k,) of points (k, 3) above their nearest facets, m, and the normals (k, 3) of these."""
        _, near = self.tree.query(points_m, k=_NEIGHBOURS)
        found = np.stack([trimesh.triangles.closest_point(self.corners_m[one], points_m) for one in near.T])
        best = np.linalg.norm(found - points_m, axis=2).argmin(axis=0)
        row = np.arange(len(points_m))
        normal = self.normals[near[row, best]]
        return np.einsum("ki,ki->k", normal, points_m - found[best, row]), normal

    def surface(self, points_m: FloatArray, scale: float, sigma_m: float) -> Surface:
        """Return the residuals of landmarks that lie at ``1 + scale`` times their places on the shape."""
        residual_m, normal = self.offsets(points_m / (1.0 + scale))
        weight = 1.0 / (1.0 + (residual_m / _OUTLIER_M) ** 2) / sigma_m**2
        return Surface(residual_m, normal, weight, -np.einsum("ki,ki->k", normal, points_m))

    def placed(self, block: Block, steps: int = 40) -> Block:
        """Move a block by the similarity that brings its landmarks next to the shape, point to plane."""
        for _ in range(steps):
            residual_m, normal = self.offsets(block.landmarks_m)
            spread = max(MAD_TO_SIGMA * float(np.median(np.abs(residual_m))), 5.0)
            w = 1.0 / np.sqrt(1.0 + (residual_m / (2.0 * spread)) ** 2)
            along = np.einsum("ki,ki->k", normal, block.landmarks_m)
            jacobian = np.c_[np.cross(block.landmarks_m, normal), normal, along]
            z = np.linalg.lstsq(jacobian * w[:, None], -residual_m * w, rcond=None)[0]
            block = block.moved(1.0 + z[6], Rotation.from_rotvec(z[:3]).as_matrix(), z[3:6])
        return block
