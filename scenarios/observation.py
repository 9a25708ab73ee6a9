"""What an estimator may see. Truth never enters here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Camera, Pose


@dataclass(frozen=True, slots=True)
class RangeReading:
    """What an altimeter measured along the boresight, and the standard deviation of its error, m."""

    range_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image with what the spacecraft knows about it.

    Parameters
    ----------
    image
        (H, W) float32, digital numbers or any linear measure of radiance.
    sun_dir_cam
        (3,) unit vector towards the Sun in camera axes: known from the star tracker and the ephemeris,
        whatever the error of the body's attitude.
    prior_T_cam_body
        The degraded pose that the recogniser starts from.
    prior_covariance
        (6, 6) covariance of the prior's error [rotation_rad, translation_m] in camera axes.
    time_s
        Epoch of the exposure.
    altimeter
        The distance to the surface along the boresight; None without an altimeter, or where it met nothing.
    """

    image: NDArray[np.float32]
    sun_dir_cam: NDArray[np.float64]
    prior_T_cam_body: Pose
    prior_covariance: NDArray[np.float64]
    time_s: float = 0.0
    altimeter: RangeReading | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A camera, and the frame that it took."""

    camera: Camera
    frame: Frame
