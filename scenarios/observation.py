"""Input of single-image estimators: image, camera and a priori knowledge, without the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A camera and one frame taken with it."""

    camera: Camera
    frame: Frame
