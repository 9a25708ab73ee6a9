"""Pinhole camera of Rowell et al. (2015), equation (2), with a lens; views, lines of sight and triangulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry.lens import Lens
from boresight.scenarios.geometry.pose import Pose


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera, with distortion or without: focal lengths along columns and rows, and principal point.

    (width / 2, height / 2) is the middle of the image. Estimators get images of the ``pinhole`` only: those of a
    distorting lens are resampled once before.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: Lens | None = None

    @classmethod
    def from_fov(cls, width_px: int, height_px: int, fov_rad: float) -> Camera:
        """Build with square pixels and the point in the middle; ``fov_rad`` is the full field across the width."""
        focal_px = 0.5 * width_px / np.tan(0.5 * fov_rad)
        return cls(width_px, height_px, focal_px, focal_px, 0.5 * width_px, 0.5 * height_px)

    @property
    def matrix(self) -> FloatArray:
        """The calibration matrix K, (3, 3)."""
        return np.array(  # eq. (2)
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    @property
    def pixel_angle_rad(self) -> float:
        """The angle that one pixel subtends on the boresight."""
        return 2.0 / (self.fx_px + self.fy_px)

    @property
    def pinhole(self) -> Camera:
        """The same camera with an ideal lens."""
        return replace(self, distortion=None)

    def project(self, points_cam_m: FloatArray) -> FloatArray:
        """Project camera-frame points (..., 3) to pixels (..., 2).

        Pixels are NaN for points behind the camera (z <= 0) and beyond the invertible range of the distortion.
        """
        points = np.asarray(points_cam_m, dtype=np.float64)
        z = np.where(points[..., 2] > 0.0, points[..., 2], np.nan)
        u = self.fx_px * points[..., 0] / z + self.cx_px  # eqs. (5), (6)
        v = self.fy_px * points[..., 1] / z + self.cy_px
        return self.distorted(np.stack([u, v], axis=-1))

    def unproject(self, uv_px: FloatArray) -> FloatArray:
        """Turn pixels (..., 2) into unit directions (..., 3) in the camera frame."""
        uv = self.undistorted(uv_px)
        rays = np.stack(  # eq. (11); a pixel's centre carries its half pixel already
            [
                (uv[..., 0] - self.cx_px) / self.fx_px,
                (uv[..., 1] - self.cy_px) / self.fy_px,
                np.ones(uv.shape[:-1]),
            ],
            axis=-1,
        )
        unit: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit

    def jacobian(self, points_cam_m: FloatArray) -> FloatArray:
        """Differentiate the pixel by the camera-frame point, (..., 2, 3).

        Without distortion this is the transpose of the matrix J printed as equation (10).
        """
        points = np.asarray(points_cam_m, dtype=np.float64)
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        zero = np.zeros_like(z)
        row_u = np.stack([self.fx_px / z, zero, -self.fx_px * x / z**2], axis=-1)  # eq. (10)
        row_v = np.stack([zero, self.fy_px / z, -self.fy_px * y / z**2], axis=-1)
        pinhole = np.stack([row_u, row_v], axis=-2)
        if self.distortion is None:
            return pinhole
        focal_px = np.array([self.fx_px, self.fy_px])
        seen = self.distortion.seen(points[..., :2] / z[..., None])
        # Derivatives of the seen slopes by those of the ideal ones are the inverse of the lens's Jacobian.
        by_slope = np.linalg.solve(self.distortion.ideal_jacobian(seen), pinhole / focal_px[:, None])
        return np.asarray(by_slope * focal_px[:, None], dtype=np.float64)

    def distorted(self, uv_px: FloatArray) -> FloatArray:
        """Convert pixels (..., 2) of the pinhole to distorted pixels of this camera.

        NaN far outside the field of view, where the distortion polynomial cannot be inverted.
        """
        uv = np.asarray(uv_px, dtype=np.float64)
        return uv if self.distortion is None else self._pixel(self.distortion.seen(self._slope(uv)))

    def undistorted(self, uv_px: FloatArray) -> FloatArray:
        """Convert distorted pixels (..., 2) of this camera to pixels of the pinhole."""
        uv = np.asarray(uv_px, dtype=np.float64)
        return uv if self.distortion is None else self._pixel(self.distortion.ideal(self._slope(uv)))

    def _slope(self, uv_px: FloatArray) -> FloatArray:
        """Convert pixels (..., 2) to x / z and y / z of the pinhole."""
        return np.asarray((uv_px - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px], dtype=np.float64)

    def _pixel(self, slope: FloatArray) -> FloatArray:
        return np.asarray(slope * [self.fx_px, self.fy_px] + [self.cx_px, self.cy_px], dtype=np.float64)

    def contains(self, uv_px: FloatArray, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Return whether each pixel position (..., 2) lies in the image, at least ``margin_px`` from its edge."""
        uv = np.asarray(uv_px, dtype=np.float64)
        u, v = uv[..., 0], uv[..., 1]
        inside: NDArray[np.bool_] = (
            (u >= margin_px) & (u <= self.width_px - margin_px) & (v >= margin_px) & (v <= self.height_px - margin_px)
        )
        return inside


def pixel_from_opencv(uv_px: FloatArray) -> FloatArray:
    """Convert pixels of OpenCV or array indices (centre of the first pixel at (0, 0)) to this package's convention."""
    return np.asarray(uv_px, dtype=np.float64) + 0.5


def pixel_to_opencv(uv_px: FloatArray) -> FloatArray:
    """Convert pixels of this package to those of OpenCV or array indices (centre of the first pixel at (0, 0))."""
    return np.asarray(uv_px, dtype=np.float64) - 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceHits:
    """First intersections of N lines of sight with a body, body frame.

    Points (N, 3) and the outward unit normals (N, 3) used for shading are NaN for misses, ``facets`` (N,) -1, and
    ``lit`` (N,), whether the point is sunlit, False.
    """

    points_body_m: NDArray[np.float64]
    normals_body: NDArray[np.float64]
    facets: NDArray[np.int64]
    lit: NDArray[np.bool_]

    @property
    def hit(self) -> NDArray[np.bool_]:
        """(N,) whether the line of sight hits the body."""
        return self.facets >= 0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Camera with any distortion, pose, and unit vector (3,) towards the Sun in the body frame, normalised here.

    ``T_body_second`` takes coordinates of a second body to those of the body; None where there is none.
    """

    camera: Camera
    T_cam_body: Pose
    sun_dir_body: NDArray[np.float64]
    T_body_second: Pose | None = None

    def __post_init__(self) -> None:
        sun = np.array(self.sun_dir_body, dtype=np.float64)
        norm = float(np.linalg.norm(sun))
        if sun.shape != (3,) or not np.isfinite(norm) or norm == 0.0:
            raise BoresightError(f"the direction to the Sun must be a finite vector of 3 numbers, not {sun}")
        sun /= norm
        sun.setflags(write=False)
        object.__setattr__(self, "sun_dir_body", sun)

    @property
    def phase_angle_rad(self) -> float:
        """The angle at the body's origin between the Sun and the camera."""
        camera = self.T_cam_body.camera_position_m
        cosine = float(camera @ self.sun_dir_body / np.linalg.norm(camera))
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def may_show(self, radius_m: float) -> bool:
        """Return whether a sphere about the body's origin reaches into the cone about the field of view."""
        width, height = self.camera.width_px, self.camera.height_px
        corners = self.camera.unproject(np.array([[0.0, 0.0], [0.0, height], [width, 0.0], [width, height]]))
        axis = corners.sum(axis=0) / np.linalg.norm(corners.sum(axis=0))
        centre = self.T_cam_body.translation_m
        range_m = float(np.linalg.norm(centre))
        sphere_rad = np.arcsin(radius_m / range_m) if range_m > radius_m else np.pi
        off_rad = np.arccos(np.clip(axis @ centre / range_m, -1.0, 1.0))
        return bool(off_rad <= np.arccos((corners @ axis).min()) + sphere_rad)


@dataclass(frozen=True, slots=True, eq=False)
class LinesOfSight:
    """K lines in one frame: camera positions (K, 3), and unit vectors (K, 3) from the camera towards the point."""

    origins_m: FloatArray
    directions: FloatArray

    def projectors(self) -> FloatArray:
        """(K, 3, 3) matrices ``I - d d^T``, which project onto the plane across each line."""
        return np.asarray(np.eye(3) - self.directions[:, :, None] * self.directions[:, None, :])

    def distances(self, points_m: FloatArray) -> FloatArray:
        """(K,) distances, m, of each line from its point (K, 3)."""
        offsets = np.einsum("kij,kj->ki", self.projectors(), points_m - self.origins_m)
        return np.asarray(np.linalg.norm(offsets, axis=1))


def triangulation_equations(
    lines: LinesOfSight,
    point: IndexArray,
    prior: tuple[FloatArray, FloatArray],
    weights: Sequence[FloatArray] = (),
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations, (L, 3, 3) and (L, 3), of the points that lie nearest their lines of sight.

    Each point x minimises the sum of ``w |(I - d d^T) (x - c)|^2`` over its lines, which start at c along d, plus its
    prior: ``(sum w (I - d d^T) + A) x = sum w (I - d d^T) c + b``. With one line alone, or with parallel lines, the
    matrix is singular unless the prior holds the point along them. Where w is the information of a line, 1 / m^2, the
    inverse of the matrix is the covariance of the point, m^2.

    ``point`` (K,) is the row of the point of each line. ``prior`` are A (L, 3, 3) and b (L, 3), zeros where nothing is
    known beforehand. ``weights`` are factors (K,) of w, multiplied in their order; none for w = 1.
    """
    # An error along a line of sight costs nothing: d is in the null space of I - d d^T.
    information = lines.projectors()
    for weight in weights:
        information = information * weight[:, None, None]
    matrix, right = prior[0].copy(), prior[1].copy()
    # add.at, because a point has several lines: plain indexing would keep the last of them alone.
    np.add.at(matrix, point, information)
    np.add.at(right, point, np.einsum("kij,kj->ki", information, lines.origins_m))
    return matrix, right
