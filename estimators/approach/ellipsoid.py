"""The ellipsoid of a shape: its Lambertian image, and the position of the camera from its horizon."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import TriangleMesh, View
from boresight.scenarios.geometry.mesh import kept_with_mesh, sealed


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """A triaxial ellipsoid: its centre (3,), m, and A (3, 3), 1 / m^2, of ``(x - c)^T A (x - c) = 1`` in body axes."""

    centre_m: FloatArray
    form: FloatArray

    @classmethod
    def of(cls, mesh: TriangleMesh) -> Self:
        """Return the ellipsoid whose volume has the centre and the directions of the moments of a closed mesh.

        The second moments of a full ellipsoid are its squared semi-axes over five; they are scaled to the mesh's
        volume, so that the ellipsoid of a rugged shape is as large as the shape.
        """
        corners = mesh.corners_m
        volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        total, sums = volume.sum(), corners.sum(axis=1)
        # Tetrahedra from the origin: their centre is a quarter of the sum of the corners, and their second moment
        # V / 20 times the sum of x x^T over the corners, plus that of the sum.
        centre = volume @ sums / (4.0 * total)
        second = np.einsum("f,fki,fkj->ij", volume, corners, corners) + np.einsum("f,fi,fj->ij", volume, sums, sums)
        values, axes = np.linalg.eigh(second / (20.0 * total) - np.outer(centre, centre))
        semi = np.sqrt(5.0 * values)
        semi *= (total / (4.0 / 3.0 * np.pi * semi.prod())) ** (1.0 / 3.0)
        return cls(sealed(centre), sealed((axes / semi**2) @ axes.T))

    @property
    def radius_m(self) -> float:
        """Radius of a sphere about the body's origin that holds the ellipsoid."""
        return float(np.linalg.norm(self.centre_m) + 1.0 / np.sqrt(np.linalg.eigvalsh(self.form)[0]))

    def misfit_m(self, mesh: TriangleMesh) -> float:
        """Return the RMS distance of the vertices of a mesh from the ellipsoid, m, along the radii from its centre."""
        offset = mesh.vertices_m - self.centre_m
        share = np.sqrt(np.einsum("vi,ij,vj->v", offset, self.form, offset))
        distance = np.linalg.norm(offset, axis=1) * (1.0 - 1.0 / np.maximum(share, 1e-12))
        return float(np.sqrt((distance**2).mean()))

    def render(self, view: View) -> NDArray[np.float32]:
        """(H, W) cosine of the incidence on the first point of each line of sight; 0 off the body and in the dark."""
        camera, pose = view.camera, view.T_cam_body
        u, v = np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5
        x, y = ((u - camera.cx_px) / camera.fx_px)[None], ((v - camera.cy_px) / camera.fy_px)[:, None]
        A, c = pose.rotation @ self.form @ pose.rotation.T, pose.transform(self.centre_m)
        # A point s d on the ray d = (x, y, 1): (s d - c)^T A (s d - c) = 1.
        Ad = [A[i, 0] * x + A[i, 1] * y + A[i, 2] for i in range(3)]
        Ac = A @ c
        square, mixed = x * Ad[0] + y * Ad[1] + Ad[2], x * Ac[0] + y * Ac[1] + Ac[2]
        discriminant = mixed**2 - square * (c @ Ac - 1.0)
        s = (mixed - np.sqrt(np.maximum(discriminant, 0.0))) / square
        normal = [s * Ad[i] - Ac[i] for i in range(3)]
        sun = pose.rotation @ view.sun_dir_body
        cosine = sum(sun[i] * normal[i] for i in range(3)) / np.sqrt(sum(part**2 for part in normal))
        return np.asarray(np.where((discriminant > 0.0) & (s > 0.0), np.maximum(cosine, 0.0), 0.0), dtype=np.float32)

    def from_horizon(self, directions_cam: FloatArray, R_cam_body: FloatArray) -> FloatArray | None:
        """Return the translation (3,) of T_cam_body, m, by directions (n, 3) of the horizon; None if it has none.

        Christian and Robinson (2016), Journal of Guidance, Control, and Dynamics 39, 2757; Christian (2021), IEEE
        Access 9, 19819: with A = B^T B the body is a unit sphere about B c after x' = B x, and the unit directions s'
        of its horizon have s'^T B c = sqrt(|B c|^2 - 1). So s'^T n = 1 is linear in n = B c / sqrt(|B c|^2 - 1).
        """
        B = np.linalg.cholesky(R_cam_body @ self.form @ R_cam_body.T).T
        turned = directions_cam @ B.T
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        n, _, rank, _ = np.linalg.lstsq(turned, np.ones(len(turned)), rcond=1e-12)
        excess = float(n @ n) - 1.0
        if rank < 3 or not excess > 0.0:
            return None
        found: FloatArray = np.linalg.solve(B, n) / np.sqrt(excess) - R_cam_body @ self.centre_m
        return found


ellipsoid_of = kept_with_mesh(Ellipsoid.of)
"""Return the ellipsoid of a mesh; of one that was seen before, without working it out again."""
