"""Adjustments solved by gtsam and by Ceres, from the same start to the same minimum, with the time of each part."""

from __future__ import annotations

import time
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimators.slam.gtsam_smoothers import Factors, load_gtsam
from estimators.slam.normal import cost
from estimators.slam.problem import Adjustment, State
from scenarios.errors import BoresightError

FloatArray = NDArray[np.float64]

# The loosest that brings both to the cost of the minimum within a part in a million.
_RELATIVE_DECREASE = 1e-8
_ITERATIONS = 100


@dataclass(frozen=True, slots=True, eq=False)
class PeerSolution:
    """Where a peer came to, our cost of it, and the processor time in which its problem was written down and solved."""

    state: State
    cost: float
    build_s: float
    solve_s: float


def solved_by_gtsam(problem: Adjustment, state: State) -> PeerSolution:
    """Minimise an adjustment without a prior by the Levenberg-Marquardt method of gtsam."""
    gtsam = load_gtsam()
    began = time.process_time()
    graph, values = graph_of(problem, state)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(_RELATIVE_DECREASE)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setMaxIterations(_ITERATIONS)
    built = time.process_time()
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    solved = time.process_time()
    factors = Factors(problem.camera)
    positions = [found.atPose3(factors.view(i)).translation() for i in range(len(state.positions_m))]
    points = [found.atPoint3(factors.point(j)) for j in range(len(state.points_m))]
    end = State(np.array(positions), np.array(points).reshape(-1, 3))
    return PeerSolution(end, cost(problem, end), built - began, solved - built)


def load_ceres() -> tuple[Any, Any, Any]:
    """Import pyceres, pycolmap and the cost functions in C++ that pycolmap has for it.

    Raises
    ------
    BoresightError
        If one is not installed.
    """
    try:
        return import_module("pyceres"), import_module("pycolmap"), import_module("pycolmap.cost_functions")
    except ImportError as error:
        raise BoresightError(
            f"pyceres: cannot be imported ({error}); install it: pip install 'boresight[peers]'"
        ) from None


def solved_by_ceres(problem: Adjustment, state: State) -> PeerSolution:
    """Minimise an adjustment of sightings, and distances from fixed views, by Ceres with a dense Schur complement.

    The cost functions are C++ but for the distances, of which a window has one.
    """
    ceres, colmap, functions = load_ceres()
    camera, seen, ranged = problem.camera, problem.pixels, problem.distances
    began = time.process_time()
    turns = Rotation.from_matrix(problem.R_cam_body)
    poses = [np.concatenate([q, t]) for q, t in zip(turns.as_quat(), -turns.apply(state.positions_m), strict=True)]
    points = [point.copy() for point in state.points_m]
    lens = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    covariances = {sigma: np.eye(2) * sigma**2 for sigma in set(seen.sigma_px.tolist())}
    graph, model = ceres.Problem(), colmap.CameraModelId.PINHOLE
    for i, j, uv, sigma in zip(
        seen.view.tolist(), seen.point.tolist(), seen.uv_px, seen.sigma_px.tolist(), strict=True
    ):
        term = functions.ReprojErrorCost(model, covariances[sigma], uv)
        graph.add_residual_block(term, None, [points[j], poses[i], lens])
    for i, j, length, sigma in zip(
        ranged.view.tolist(), ranged.point.tolist(), ranged.range_m.tolist(), ranged.sigma_m.tolist(), strict=True
    ):
        graph.add_residual_block(_distance(ceres, state.positions_m[i], length, sigma), None, [points[j]])
    graph.set_parameter_block_constant(lens)
    for i, pose in enumerate(poses):
        if problem.free_views[i]:
            graph.set_manifold(pose, ceres.SubsetManifold(7, [0, 1, 2, 3]))
        else:
            graph.set_parameter_block_constant(pose)
    options, summary = ceres.SolverOptions(), ceres.SolverSummary()
    options.linear_solver_type = ceres.LinearSolverType.DENSE_SCHUR
    options.num_threads = 1
    options.function_tolerance = _RELATIVE_DECREASE
    options.max_num_iterations = _ITERATIONS
    options.logging_type = ceres.LoggingType.SILENT
    built = time.process_time()
    ceres.solve(options, graph, summary)
    solved = time.process_time()
    end = State(-turns.apply(np.array([pose[4:] for pose in poses]), inverse=True), np.array(points).reshape(-1, 3))
    return PeerSolution(end, cost(problem, end), built - began, solved - built)


def _distance(ceres: Any, position_m: FloatArray, range_m: float, sigma_m: float) -> Any:
    """Return the cost function of a distance from a fixed position."""

    class Distance(ceres.CostFunction):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(1)
            self.set_parameter_block_sizes([3])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            line = parameters[0] - position_m
            length = float(np.linalg.norm(line))
            residuals[0] = (length - range_m) / sigma_m
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = line / (length * sigma_m)
            return True

    return Distance()


def graph_of(problem: Adjustment, state: State) -> tuple[Any, Any]:
    """Return the factor graph of an adjustment without a prior, and ``state`` as its values."""
    factors = Factors(problem.camera)
    graph, values = factors.gtsam.NonlinearFactorGraph(), factors.gtsam.Values()
    for i, (R, position) in enumerate(zip(problem.R_cam_body, state.positions_m, strict=True)):
        graph.add(factors.attitude(i, R))
        values.insert(factors.view(i), factors.pose(R, position))
        if not problem.free_views[i]:
            graph.add(factors.place(i, position, np.zeros((3, 3))))
    for j, point in enumerate(state.points_m):
        values.insert(factors.point(j), point)
    seen, ranged, moved = problem.pixels, problem.distances, problem.motions
    for i, j, uv, sigma in zip(
        seen.view.tolist(), seen.point.tolist(), seen.uv_px, seen.sigma_px.tolist(), strict=True
    ):
        graph.add(factors.pixel(i, j, uv, sigma))
    for i, j, length, sigma in zip(*(part.tolist() for part in _columns(ranged)), strict=True):
        graph.add(factors.distance(i, j, length, sigma))
    for k in range(len(moved.start)):
        ends = int(moved.start[k]), int(moved.end[k])
        covariance = np.linalg.inv(moved.information[k])
        graph.add(factors.motion(ends, problem.R_cam_body[list(ends)], moved.displacement_m[k], covariance))
    return graph, values


def _columns(ranged: Any) -> tuple[Any, ...]:
    return ranged.view, ranged.point, ranged.range_m, ranged.sigma_m
