"""Input of estimators, without the truth: one image with its camera and a priori knowledge, or tracks of a sequence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, Pose


@dataclass(frozen=True, slots=True)
class RangeReading:
    """Altimeter measurement along the boresight, and the standard deviation of its error, m."""

    range_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class SkyKnowledge:
    """Attitudes among the stars that are known on board when an image with stars is exposed.

    ``R_body_inertial`` (3, 3) is the body's attitude by the onboard model of its rotation. ``R_cam_inertial`` (3, 3) is
    the camera's by a star tracker, with ``sigma_rad`` (3,), standard deviations of its error about the camera's axes;
    both None without one.
    """

    R_body_inertial: FloatArray
    R_cam_inertial: FloatArray | None = None
    sigma_rad: FloatArray | None = None


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
    sky
        Attitudes among the stars; None if the image has no stars.
    """

    image: NDArray[np.float32]
    sun_dir_cam: NDArray[np.float64]
    prior_T_cam_body: Pose
    prior_covariance: NDArray[np.float64]
    time_s: float = 0.0
    altimeter: RangeReading | None = None
    sky: SkyKnowledge | None = None


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
        body is small next to its range. So an estimate from the image alone has these errors whatever the image holds;
        one with a prior has a share of them, see `boresight.estimators.prior.calibration_in_posterior`.
        """
        range_m = float(T_cam_body.translation_m[2])
        across_m = range_m * self.camera_sigma.principal_point_px / np.array([self.camera.fx_px, self.camera.fy_px])
        return np.diag([0.0, 0.0, 0.0, *across_m**2, (range_m * self.camera_sigma.focal) ** 2])


@dataclass(frozen=True, slots=True)
class TrackRange:
    """A measured distance from the camera to the point of a track, and the standard deviation of its error, m."""

    track: int
    range_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """A priori force model, inertial axes: equation (6) of Delpech et al. (2015).

    ``radiation_m_s2`` (3,) is the acceleration by solar radiation pressure, with the standard deviation of the error of
    its size. ``noise_m_s2`` is the standard deviation of each coordinate of the unmodelled acceleration, constant
    between two frames and independent from one interval to the next. ``velocity_m_s`` (3,) is at the first frame,
    relative to the body's centre, with the covariance (3, 3) of its error.
    """

    gm_m3_s2: float
    gm_sigma_m3_s2: float
    radiation_m_s2: FloatArray
    radiation_sigma_m_s2: float
    noise_m_s2: float
    velocity_m_s: FloatArray
    velocity_covariance_m2_s2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TrackFrame:
    """Measurements of one image of a sequence, made by the vision front end.

    Parameters
    ----------
    time_s
        Epoch of the exposure; strictly increasing along a sequence.
    R_cam_body
        (3, 3) measured rotation ``x_cam = R_cam_body (x_body - c_body)``.
    tracks
        (n,) distinct numbers of the tracks that are observed. The number of a lost track is never used again.
    uv_px
        (n, 2) measured pixels.
    sigma_px
        Standard deviation of the error of a coordinate.
    motion_m
        (3,) predicted displacement of the camera since the previous frame: position in this frame's body axes minus
        position in the previous frame's body axes, so that it includes the body's rotation; zero for the first frame.
    motion_covariance_m2
        (3, 3) covariance of its error.
    ranges
        Ranges measured at this frame.
    again
        (k, 2) loop closures: pairs (track of this frame, older lost track) that the front end identifies as the same
        landmark, for example after a revolution. Some may be wrong.
    R_body_inertial
        (3, 3) rotation ``x_body = R_body_inertial x_inertial`` by the onboard spin model; both frames have their origin
        at the centre of mass.
    attitude_sigma_rad
        Standard deviation of the error of `R_cam_body` about each camera axis: star-tracker noise, independent from
        frame to frame, camera misalignment, constant, and the error of `R_body_inertial`, which grows with time.
    attitude_bias_sigma_rad
        The part of it that is correlated from frame to frame: misalignment and body rotation.
    walk_px
        Standard deviation of a coordinate's random step since the previous frame, of each track: its errors add up
        along the track, beside the independent error of `sigma_px`. Zero: none is known of.
    contraction, drift_px
        Standard deviations of a share c and of the coordinates of d, px, which are constant and common to all tracks:
        since the previous frame the error of a track at the pixel p has grown by ``d - c (p - p0)``, p0 being the
        principal point. Zero: none is known of.
    """

    time_s: float
    R_cam_body: FloatArray
    tracks: IndexArray
    uv_px: FloatArray
    sigma_px: float
    motion_m: FloatArray
    motion_covariance_m2: FloatArray
    ranges: tuple[TrackRange, ...] = ()
    again: IndexArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    R_body_inertial: FloatArray = field(default_factory=lambda: np.eye(3))
    attitude_sigma_rad: float = 0.0
    attitude_bias_sigma_rad: float = 0.0
    walk_px: float = 0.0
    contraction: float = 0.0
    drift_px: float = 0.0

    @property
    def attitude_noise_rad(self) -> float:
        """Standard deviation of the part of the error of `R_cam_body` that is independent from frame to frame."""
        return math.sqrt(max(self.attitude_sigma_rad**2 - self.attitude_bias_sigma_rad**2, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Landmark positions in the next image as predicted by an estimator, tracks ascending.

    ``covariance_px2`` (2 n, 2 n) is joint and without measurement noise; landmarks are correlated by the common error
    of the camera's position.
    """

    tracks: IndexArray
    uv_px: FloatArray
    covariance_px2: FloatArray


LandmarkPredictor = Callable[[TrackFrame], Prediction | None]


class VisionFrontEnd(Protocol):
    """A vision front end that searches landmarks at the positions predicted by an estimator."""

    def frames(self, predict: LandmarkPredictor) -> Iterator[TrackFrame]:
        """Yield the frames in the order of time.

        Before each frame is made, ``predict`` is called with that frame without its tracks. Another call yields the
        frames that were made before again.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TrackSequence:
    """Frames in the order of time, and a priori knowledge of the first camera position and the forces.

    Parameters
    ----------
    camera
        The camera of all frames.
    frames
        In the order of time.
    position_m, position_covariance_m2
        (3,) and (3, 3): the first camera position in the body frame and the covariance of its error; all zero where
        it is known perfectly.
    forces
        A priori force model; None if there is none.
    front_end
        Produces the frames during the estimation (guided matching); those of ``frames`` have no tracks then. None if
        all tracks are computed beforehand.
    """

    camera: Camera
    frames: tuple[TrackFrame, ...]
    position_m: FloatArray
    position_covariance_m2: FloatArray
    forces: Forces | None = None
    front_end: VisionFrontEnd | None = None
