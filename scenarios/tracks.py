"""What an estimator sees of a sequence: tracks of points in images whose attitude is known, and predicted motion."""

from __future__ import annotations

from dataclasses import dataclass

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
        (3,) predicted displacement of the camera since the frame before, body axes; zero for the first frame.
    motion_covariance_m2
        (3, 3) covariance of its error.
    ranges
        Distances measured at this frame.
    """

    time_s: float
    R_cam_body: FloatArray
    tracks: IndexArray
    uv_px: FloatArray
    sigma_px: float
    motion_m: FloatArray
    motion_covariance_m2: FloatArray
    ranges: tuple[TrackRange, ...] = ()


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
    """

    camera: Camera
    frames: tuple[TrackFrame, ...]
    position_m: FloatArray
    position_covariance_m2: FloatArray
