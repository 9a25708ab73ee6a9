"""Input of single-image estimators: image, camera and a priori knowledge, without the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose


@dataclass(frozen=True, slots=True)
class RangeReading:
    """Altimeter measurement along the boresight, and the standard deviation of its error, m."""

    range_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image with the a priori knowledge of the spacecraft.

    Parameters
    ----------
    image
        (H, W) float32, digital numbers or any linear measure of radiance.
    sun_dir_cam
        (3,) unit vector towards the Sun in camera axes, from star tracker and ephemeris; it does not depend on the
        error of the body's attitude.
    prior_T_cam_body
        The a priori pose, with errors.
    prior_covariance
        (6, 6) covariance of the prior's error [rotation_rad, translation_m] in camera axes.
    time_s
        Epoch of the exposure.
    altimeter
        Range to the surface along the boresight; None without an altimeter, or if the boresight misses the body.
    """

    image: NDArray[np.float32]
    sun_dir_cam: NDArray[np.float64]
    prior_T_cam_body: Pose
    prior_covariance: NDArray[np.float64]
    time_s: float = 0.0
    altimeter: RangeReading | None = None


@dataclass(frozen=True, slots=True)
class CameraSigma:
    """Standard deviations that the camera's calibration declares of its own errors; 0 where it is exact.

    ``focal`` is relative, ``principal_point_px`` of each coordinate.
    """

    focal: float = 0.0
    principal_point_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A camera, one frame taken with it, and how well the camera is calibrated."""

    camera: Camera
    frame: Frame
    camera_sigma: CameraSigma = CameraSigma()

    def calibration_covariance(self, T_cam_body: Pose) -> FloatArray:
        """(6, 6) covariance of a pose's error by that of the calibration, [rotation_rad, translation_m], camera axes.

        A body at the range z is seen where it is if its pose is wrong by z dc / f across the line of sight, for an
        error dc of the principal point, and by z df / f along it, for an error df of the focal length f, where the
        body is small next to its range. So an estimate from the image has these errors whatever the image holds. A
        method adds this covariance to that of its fit, which takes the camera as exact. Where the prior decides and
        not the image it states too much.
        """
        range_m = float(T_cam_body.translation_m[2])
        across_m = range_m * self.camera_sigma.principal_point_px / np.array([self.camera.fx_px, self.camera.fy_px])
        return np.diag([0.0, 0.0, 0.0, *across_m**2, (range_m * self.camera_sigma.focal) ** 2])
