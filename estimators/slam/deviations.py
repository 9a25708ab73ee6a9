"""How far pixels lie off in squared standard deviations, and what measurements tell of each landmark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled import deviations as kernels
from estimators.slam.compiled.flat import flat, floats
from estimators.slam.state import Adjustment, State
from scenarios.geometry import Camera
from scenarios.tracks import TrackFrame

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def sighting_squares(problem: Adjustment, state: State) -> FloatArray:
    """(k,) squared residuals of the sightings at a state; NaN where a landmark is behind its camera."""
    at = floats(state.positions_m), floats(state.points_m)
    return np.asarray(kernels.sighting_squares(flat(problem), *at), dtype=np.float64)


def landmark_information(problem: Adjustment, state: State) -> FloatArray:
    """(L, 3, 3) what sightings and distances tell of each landmark where the views are known, 1/m^2."""
    problem = replace(problem, frozen=None, prior=None)
    at = floats(state.positions_m), floats(state.points_m)
    return np.asarray(kernels.landmark_information(flat(problem), *at), dtype=np.float64)


def pixel_squares(
    camera: Camera, frame: TrackFrame, rows: IndexArray, lines_m: FloatArray, own_m2: FloatArray
) -> FloatArray:
    """(n,) squared Mahalanobis distances of the pixels of some rows of a frame; NaN behind the camera.

    Parameters
    ----------
    lines_m, own_m2
        (n, 3) from the camera to the landmarks, body frame, and (n, 3, 3) covariances of these.
    """
    pinhole = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    seen = floats(frame.R_cam_body), floats(lines_m), floats(frame.uv_px[rows])
    return np.asarray(kernels.pixel_squares(pinhole, *seen, float(frame.sigma_px), floats(own_m2)), np.float64)
