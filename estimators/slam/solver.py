"""Levenberg-Marquardt on an adjustment, equation (4), with the Schur complement and a check of the rank.

The work is done by compiled kernels (`estimators.slam.compiled`); their reference in numpy is in the tests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError

from estimators.slam.compiled import descent
from estimators.slam.compiled import equations as kernels
from estimators.slam.compiled.problem import flat, floats
from estimators.slam.problem import Adjustment, State
from scenarios.geometry import Camera
from scenarios.tracks import TrackFrame

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

RANK_TOLERANCE = 1e-11


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


@dataclass(frozen=True, slots=True)
class AdjustmentSolution:
    """The state at the minimum, what it costs, and whether the solver got there."""

    state: State
    cost: float
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True)
class StoppingRule:
    """When to stop: no variable moves by more than ``step_m``, or after ``iterations`` steps were taken."""

    step_m: float
    iterations: int = 50


def minimise(problem: Adjustment, state: State, rule: StoppingRule) -> AdjustmentSolution:
    """Minimise ``cost`` from ``state``; damping starts at 1e-6 of the mean diagonal."""
    start = floats(state.positions_m), floats(state.points_m)
    positions, points, value, iterations, converged = descent.minimise(
        flat(problem), *start, rule.step_m, rule.iterations
    )
    return AdjustmentSolution(State(positions, points), value, iterations, converged)


def reduced_rank_deficiency(problem: Adjustment, state: State) -> int:
    """Count the directions of the kept variables that nothing determines: a free scale counts as one.

    Levenberg-Marquardt comes to a stop on an undetermined scale as well, wherever that happens to be.
    """
    known, values, _, found = descent.reduced_at(flat(problem), floats(state.positions_m), floats(state.points_m))
    if not known:  # a landmark is not determined
        return len(descent.dense(values, found.shape))
    matrix = descent.dense(values, found.shape)
    if not len(matrix):
        return 0
    eigenvalues = np.linalg.eigvalsh(matrix)
    return int(np.count_nonzero(eigenvalues < RANK_TOLERANCE * eigenvalues[-1]))


def view_covariance(problem: Adjustment, state: State, view: int) -> FloatArray:
    """(3, 3) covariance of a free view's position, all other variables taken for unknown, m^2.

    Raises
    ------
    scipy.linalg.LinAlgError
        If the reduced matrix is not positive definite.
    """
    known, matrix, _, ordering = descent.reduced_at(flat(problem), floats(state.positions_m), floats(state.points_m))
    if not known or not descent.factorise(matrix, ordering.shape):
        raise LinAlgError("the reduced matrix is not positive definite")
    return np.asarray(descent.block_of_inverse(matrix, ordering.shape, ordering.view_slot[view]), dtype=np.float64)


def reduced_system(problem: Adjustment, state: State) -> tuple[FloatArray, FloatArray, IndexArray, IndexArray]:
    """Reduced matrix (3n, 3n) and right side (3n,) at a state, and the slots of views (V,) and kept landmarks (L,).

    Raises
    ------
    numpy.linalg.LinAlgError
        If a landmark that is eliminated is not determined.
    """
    at = floats(state.positions_m), floats(state.points_m)
    known, values, right, found = descent.reduced_at(flat(problem), *at)
    if not known:
        raise LinAlgError("a landmark is not determined")
    return descent.dense(values, found.shape), right, found.view_slot, found.point_slot
