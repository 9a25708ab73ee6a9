"""Adjustments solved by gtsam, from the same start to the same minimum, with the time of each part."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy_equations import cost

from boresight.estimators.slam.adjustment.problem import Adjustment, State
from boresight.estimators.slam.smoothing.gtsam_smoothers import Factors, load_gtsam

# The loosest power of ten that ends the windows of the benchmark within a part in a million of their minimum.
RELATIVE_DECREASE = 1e-3
_ITERATIONS = 100


@dataclass(frozen=True, slots=True, eq=False)
class PeerSolution:
    """Where a peer came to, our cost of it, and the processor time in which its problem was written down and solved."""

    state: State
    cost: float
    build_s: float
    solve_s: float


def solved_by_gtsam(problem: Adjustment, state: State, tolerance: float = RELATIVE_DECREASE) -> PeerSolution:
    """Minimise an adjustment without a prior by the Levenberg-Marquardt method of gtsam, to a relative decrease."""
    gtsam = load_gtsam()
    began = time.process_time()
    graph, values = graph_of(problem, state)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(tolerance)
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
