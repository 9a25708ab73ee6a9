"""How far pixels lie off in squared standard deviations, and what measurements tell of each landmark.

As in `levenberg`, each function has a compiled kernel, whose reference is the arithmetic in numpy here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.flat import flat, floats
from estimators.slam.gating import mahalanobis_squares
from estimators.slam.kernels import compiled_deviations
from estimators.slam.residuals import bearing_jacobians, bearing_residuals, distance_jacobians
from estimators.slam.state import Adjustment, State
from scenarios.geometry import Camera
from scenarios.tracks import TrackFrame

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def sighting_squares(problem: Adjustment, state: State) -> FloatArray:
    """(k,) squared residuals of the sightings at a state; NaN where a landmark is behind its camera."""
    kernels = compiled_deviations(problem.camera)
    if kernels is None:
        return np.asarray(np.sum(bearing_residuals(problem, state) ** 2, axis=1), dtype=np.float64)
    at = floats(state.positions_m), floats(state.points_m)
    return np.asarray(kernels.sighting_squares(flat(problem), *at), dtype=np.float64)


def landmark_information(problem: Adjustment, state: State) -> FloatArray:
    """(L, 3, 3) what sightings and distances tell of each landmark where the views are known, 1/m^2."""
    problem = replace(problem, frozen=None, prior=None)
    kernels = compiled_deviations(problem.camera)
    if kernels is not None:
        at = floats(state.positions_m), floats(state.points_m)
        return np.asarray(kernels.landmark_information(flat(problem), *at), dtype=np.float64)
    told = np.zeros((len(state.points_m), 3, 3))
    for point, rows in (
        (problem.sightings.point, bearing_jacobians(problem, state)),
        (problem.distances.point, distance_jacobians(problem, state)),
    ):
        np.add.at(told, point, np.swapaxes(rows, 1, 2) @ rows)
    return told


def pixel_squares(
    camera: Camera, frame: TrackFrame, rows: IndexArray, lines_m: FloatArray, own_m2: FloatArray
) -> FloatArray:
    """(n,) squared Mahalanobis distances of the pixels of some rows of a frame; NaN behind the camera.

    Parameters
    ----------
    lines_m, own_m2
        (n, 3) from the camera to the landmarks, body frame, and (n, 3, 3) covariances of these.
    """
    kernels = compiled_deviations(camera)
    if kernels is not None:
        pinhole = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
        seen = floats(frame.R_cam_body), floats(lines_m), floats(frame.uv_px[rows])
        return np.asarray(kernels.pixel_squares(pinhole, *seen, float(frame.sigma_px), floats(own_m2)), np.float64)
    in_camera = lines_m @ frame.R_cam_body.T
    by_line = camera.jacobian(in_camera) @ frame.R_cam_body
    spread = by_line @ own_m2 @ np.swapaxes(by_line, 1, 2) + frame.sigma_px**2 * np.eye(2)
    off = frame.uv_px[rows] - camera.project(in_camera)
    return mahalanobis_squares(off, np.asarray(spread, dtype=np.float64))
