"""Focal length and radial distortion of a camera from the stars of many images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from boresight.estimators.stars.wahba import solve_wahba
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, RadialDistortion, cross_matrix, spherical_direction

_ROUNDS = 20


@dataclass(frozen=True, slots=True, eq=False)
class StarField:
    """Identified stars of an image: pixels (n, 2), unit vectors (n, 3) in inertial axes, deviations (n,) of a pixel."""

    uv_px: FloatArray
    directions: FloatArray
    sigma_px: FloatArray

    @classmethod
    def of(cls, stars: Mapping[str, FloatArray]) -> Self:
        """Take the columns of the table ``stars`` in `Estimate.details`, deviations by the noise of the image alone."""
        towards = spherical_direction(np.radians(stars["ra_deg"]), np.radians(stars["dec_deg"]))
        return cls(np.stack([stars["u_px"], stars["v_px"]], axis=1), towards, np.asarray(stars["noise_px"]))


@dataclass(frozen=True, slots=True, eq=False)
class StarCalibration:
    """A calibrated camera, with the covariance (2, 2) of [relative focal length, k1]."""

    camera: Camera
    covariance: FloatArray


def calibrate(camera: Camera, fields: Sequence[StarField]) -> StarCalibration:
    """Fit a common factor of the focal lengths, k1 of `RadialDistortion`, and an attitude for each image.

    Least squares of the ideal positions in pixels, by Gauss-Newton: the attitudes are eliminated from the normal
    equations image by image. The principal point stays, as the attitudes take it up. ``camera`` is the start; its k2
    is kept. Raise BoresightError if it has another lens, or the stars do not determine the numbers.
    """
    lens = camera.distortion or RadialDistortion(0.0, 0.0)
    if not isinstance(lens, RadialDistortion):
        raise BoresightError(f"calibration from stars: the lens {lens} is not a radial polynomial")
    for _ in range(_ROUNDS):
        reduced, right = np.zeros((2, 2)), np.zeros(2)
        for field in fields:
            normal, side = _eliminated(camera, lens, field)
            reduced, right = reduced + normal, right + side
        if len(fields) == 0 or np.linalg.cond(reduced) > 1e12:
            raise BoresightError("calibration from stars: they do not determine focal length and distortion")
        step = np.linalg.solve(reduced, right)
        lens = RadialDistortion(lens.k1 + float(step[1]), lens.k2)
        factor = 1.0 + float(step[0])
        camera = replace(camera, fx_px=camera.fx_px * factor, fy_px=camera.fy_px * factor, distortion=lens)
        if np.abs(step).max() < 1e-12:
            break
    return StarCalibration(camera, np.asarray(np.linalg.inv(reduced), dtype=np.float64))


def _eliminated(camera: Camera, lens: RadialDistortion, field: StarField) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations (2, 2), (2,) of the lens from an image, without its attitude."""
    exact = replace(camera, distortion=lens)
    rotation, _ = solve_wahba(exact.unproject(field.uv_px), field.directions, field.sigma_px * camera.pixel_angle_rad)
    towards = field.directions @ rotation.T
    pinhole, focal_px = camera.pinhole, np.array([camera.fx_px, camera.fy_px])
    slope = (field.uv_px - [camera.cx_px, camera.cy_px]) / focal_px
    squared = np.sum(slope**2, axis=1, keepdims=True)
    residual = exact.undistorted(field.uv_px) - pinhole.project(towards)
    # ideal = s (1 + k1 r^2 + k2 r^4) with s = (uv - c) / f: f times it changes with f through the powers of r alone,
    # f times the predicted x / z in proportion.
    by_focal = -focal_px * slope * (2.0 * lens.k1 * squared + 4.0 * lens.k2 * squared**2)
    by_focal -= pinhole.project(towards) - [camera.cx_px, camera.cy_px]
    by_k1 = focal_px * slope * squared
    # A turn w moves a direction d by w x d = -[d]x w.
    by_turn = np.einsum("nij,njk->nik", pinhole.jacobian(towards), cross_matrix(towards))
    columns = np.concatenate([np.stack([by_focal, by_k1], axis=2), by_turn], axis=2)
    weights = np.repeat(1.0 / field.sigma_px, 2)[:, None]
    design, values = columns.reshape(-1, 5) * weights, residual.ravel() * weights[:, 0]
    normal, right = design.T @ design, -design.T @ values
    coupling = np.linalg.solve(normal[2:, 2:], normal[2:]).T
    return (normal - coupling @ normal[2:])[:2, :2], (right - coupling @ right[2:])[:2]
