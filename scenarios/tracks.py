"""What an estimator sees of a sequence: tracks of points in images whose attitude is known, and predicted motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Camera

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TrackRange:
    """A measured distance from the camera to the point of a track, and the standard deviation of its error, m."""

    track: int
    range_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """What the spacecraft knows of its motion about the body, in inertial axes: equation (6) of Delpech et al. (2015).

    Parameters
    ----------
    gm_m3_s2, gm_sigma_m3_s2
        Gravity parameter of the body, and the standard deviation of its error.
    radiation_m_s2, radiation_sigma_m_s2
        (3,) acceleration by solar radiation pressure, and the standard deviation of the error of its size.
    noise_m_s2
        Standard deviation of each coordinate of what is not modelled, constant between two frames and independent from
        one interval to the next.
    velocity_m_s, velocity_covariance_m2_s2
        (3,) and (3, 3): velocity at the first frame relative to the body's centre, and the covariance of its error.
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
    """One image of a sequence, after the vision layer.

    Parameters
    ----------
    time_s
        Epoch of the exposure; strictly increasing along a sequence.
    R_cam_body
        (3, 3) rotation ``x_cam = R_cam_body (x_body - c_body)`` as the spacecraft knows it.
    tracks
        (n,) numbers of the tracks that are seen, each once. A track that is lost never returns under its number.
    uv_px
        (n, 2) where they are seen.
    sigma_px
        Standard deviation of the error of a coordinate.
    motion_m
        (3,) predicted displacement of the camera since the frame before, as this frame's body axes see it against the
        last frame's, so that it holds how the body turned as well; zero for the first frame.
    motion_covariance_m2
        (3, 3) covariance of its error.
    ranges
        Distances measured at this frame.
    again
        (k, 2) pairs (track of this frame, older track that was lost): landmarks that the vision layer takes for one and
        the same, as where a revolution ends. It may be wrong.
    R_body_inertial
        (3, 3) rotation ``x_body = R_body_inertial x_inertial`` as the spacecraft knows it; both have their origin at
        the centre of mass.
    attitude_sigma_rad
        Standard deviation of the error of `R_cam_body` about each camera axis: that of the star tracker, independent
        from frame to frame, that of the camera's attitude on it, always the same, and that of `R_body_inertial`, which
        grows with time.
    attitude_bias_sigma_rad
        The part of it that is not independent from frame to frame: the latter two.
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

    @property
    def attitude_noise_rad(self) -> float:
        """Standard deviation of what is independent from frame to frame of the error of `R_cam_body`."""
        return math.sqrt(max(self.attitude_sigma_rad**2 - self.attitude_bias_sigma_rad**2, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where an estimator expects its landmarks in the next image.

    Parameters
    ----------
    tracks, uv_px
        (n,), ascending, and (n, 2).
    covariance_px2
        (2 n, 2 n) joint covariance of those pixels, without the noise of a sighting: landmarks share the error of the
        camera's position.
    """

    tracks: IndexArray
    uv_px: FloatArray
    covariance_px2: FloatArray


LandmarkPredictor = Callable[[TrackFrame], Prediction | None]


class VisionFrontEnd(Protocol):
    """A vision layer that looks where an estimator expects its landmarks."""

    def frames(self, predict: LandmarkPredictor) -> Iterator[TrackFrame]:
        """Yield the frames in the order of time.

        Before each one ``predict`` is asked where tracks will be, with a frame that has no tracks yet.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TrackSequence:
    """Frames in the order of time, and what is known of the first camera position.

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
        What is known of the forces on the camera; None where nothing is.
    front_end
        Makes the frames while an estimator follows them; those of ``frames`` have no tracks then. None where all are
        there beforehand.
    """

    camera: Camera
    frames: tuple[TrackFrame, ...]
    position_m: FloatArray
    position_covariance_m2: FloatArray
    forces: Forces | None = None
    front_end: VisionFrontEnd | None = None
