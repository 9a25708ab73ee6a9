"""The compiled kernels against their reference in numpy, and against dense linear algebra."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy_adjustment
import pytest
from numpy_equations import VariableOrdering, bearing_residuals, cost, normal_equations
from scipy.spatial.distance import mahalanobis
from slam_sequences import Recipe, make_sequence

from boresight.estimators.slam.adjustment import slam_map, solver
from boresight.estimators.slam.adjustment.compiled import descent, equations, tracks
from boresight.estimators.slam.adjustment.compiled import envelope as packed
from boresight.estimators.slam.adjustment.compiled import problem as flat_problem
from boresight.estimators.slam.adjustment.problem import Adjustment, Distances, Motions, QuadraticPrior, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import (
    AdjustmentSolution,
    StoppingRule,
    minimise,
    reduced_rank_deficiency,
    view_covariance,
)
from boresight.estimators.slam.association.gating import pixel_squares
from boresight.estimators.slam.association.outliers import residual_squares
from boresight.estimators.slam.association.prediction import line_information
from boresight.estimators.slam.keyframes.bundle import BundleSlam
from boresight.estimators.slam.smoothing.smoother import BatchAdjustment, FixedLagSmoother
from boresight.scenarios.geometry.camera import LinesOfSight, triangulation_equations

RULE = StoppingRule(1e-6)
REFERENCED = (
    "minimise",
    "reduced_rank_deficiency",
    "view_covariance",
    "marginalise_view",
    "place_view",
)


def window(seed: int) -> tuple[Adjustment, State]:
    """Five views and their landmarks with every kind of measurement, at a disturbed state."""
    rng = np.random.default_rng([31, seed])
    sequence, truth = make_sequence(rng, Recipe(frames=5, landmarks=6 + 2 * seed, range_all=True))
    slam_map = SlamMap(sequence.camera)
    slam_map.frames = dict(enumerate(sequence.frames))
    slam_map.positions_m = dict(enumerate(truth.positions_m))
    slam_map.points_m = dict(truth.points_m)
    views = list(range(5))
    tracks = sorted(track for track, by in slam_map.seen_by(views).items() if len(by) >= 2)
    true = slam_map.state(views, tracks)
    state = State(
        true.positions_m + rng.normal(size=true.positions_m.shape), true.points_m + rng.normal(size=(len(tracks), 3))
    )
    problem = Adjustment(
        camera=sequence.camera,
        R_cam_body=slam_map.attitudes(views),
        pixels=slam_map.pixels(views, tracks),
        free_views=np.ones(5, dtype=bool),
        free_points=np.ones(len(tracks), dtype=bool),
        distances=slam_map.distances(views, tracks),
        motions=slam_map.motions(views),
    )
    variables = np.array([0, 2]), rng.permutation(len(tracks))[:3]
    origin = np.concatenate([true.positions_m[variables[0]], true.points_m[variables[1]]])
    root = rng.normal(size=(15, 20))
    prior = QuadraticPrior(*variables, origin, root @ root.T, rng.normal(size=15))
    frozen = State(np.full((5, 3), np.nan), np.full((len(tracks), 3), np.nan))
    frozen.positions_m[0] = true.positions_m[0]
    frozen.points_m[variables[1]] = origin[2:]
    kept = np.arange(len(tracks)) % 4 == 0
    choices = [
        {"free_views": np.array([False, True, True, True, True]), "motions": Motions()},
        {"prior": prior},
        {"prior": prior, "frozen": frozen},
        {"prior": prior, "distances": Distances(), "kept_points": kept},
        {"free_views": np.array([False, True, True, False, True]), "free_points": ~kept},
        {"free_views": np.zeros(5, dtype=bool)},
    ]
    return replace(problem, **choices[seed % len(choices)]), state


@pytest.fixture
def in_numpy(monkeypatch: pytest.MonkeyPatch):
    """Call a function with the kernels replaced by their numpy reference in all modules."""

    def call(function, *arguments):
        with monkeypatch.context() as patch:
            for name in REFERENCED:
                compiled = getattr(solver, name)
                for module in [m for key, m in sys.modules.items() if key.startswith("boresight.estimators.slam")]:
                    if getattr(module, name, None) is compiled:
                        patch.setattr(module, name, getattr(numpy_adjustment, name))
            return function(*arguments)

    return call


@pytest.mark.parametrize("seed", range(12))
def test_equations_are_those_of_numpy(seed: int) -> None:
    problem, state = window(seed)
    at = state.positions_m, state.points_m
    ordering = flat_problem.make_ordering(problem.flat)
    value, system = equations.linearise(problem.flat, ordering, *at)
    assert value == pytest.approx(cost(problem, state), rel=1e-12)
    done, matrix, right, inverse = descent.reduced(system, ordering, 0.3)
    assert done
    expected, expected_right, expected_inverse = normal_equations(problem, state, VariableOrdering.of(problem)).reduced(
        0.3
    )
    lanes = ordering.landmark[: ordering.eliminated]
    by_landmark = np.swapaxes(inverse.reshape(-1, 6, flat_problem.LANES), 1, 2)[lanes >= 0]
    for found, wanted in [
        (packed.dense(matrix, ordering.shape), expected),
        (right, expected_right),
        (by_landmark[np.argsort(lanes[lanes >= 0])], expected_inverse.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]),
    ]:
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max(initial=1.0))


@pytest.mark.parametrize("seed", range(6))
def test_deviations_are_those_of_numpy_and_scipy(seed: int) -> None:
    """Also for a landmark behind its camera; pixels against derivatives by differences."""
    problem, state = window(seed)
    squares = residual_squares(problem, state)
    np.testing.assert_allclose(squares, np.sum(bearing_residuals(problem, state) ** 2, axis=1), rtol=1e-11)
    told = line_information(problem, state, np.arange(len(state.points_m))).sum(axis=1)
    np.testing.assert_allclose(
        told, numpy_adjustment.landmark_information(problem, state), rtol=0, atol=1e-12 * told.max()
    )
    sequence, _ = make_sequence(np.random.default_rng([31, seed]), Recipe(frames=2, landmarks=12))
    camera, frame, rows = sequence.camera, sequence.frames[0], np.arange(4)
    rng = np.random.default_rng(seed)
    lines = camera.unproject(frame.uv_px[rows] + rng.normal(size=(4, 2))) @ frame.R_cam_body * 600.0
    root = rng.normal(size=(4, 3, 5))
    arguments = camera, frame, rows, lines, root @ np.swapaxes(root, 1, 2), np.full(4, 1.7)
    found = pixel_squares(*arguments)
    shifts = 1e-3 * np.vstack([np.eye(3), -np.eye(3)])
    for square, uv_px, line, own in zip(found, frame.uv_px, lines, arguments[-2], strict=False):
        ends = camera.project((line + shifts) @ frame.R_cam_body.T)
        rise = (ends[:3] - ends[3:]).T / 2e-3
        inverse = np.linalg.inv(rise @ own @ rise.T + 1.7 * np.eye(2))
        expected = mahalanobis(uv_px, camera.project(frame.R_cam_body @ line), inverse)
        assert square == pytest.approx(expected**2, rel=1e-6)
    lines[1] *= -1.0
    np.testing.assert_array_equal(np.isnan(pixel_squares(*arguments)), [False, True, False, False])


@pytest.mark.parametrize("seed", range(12))
def test_minimum_is_that_of_numpy(seed: int) -> None:
    problem, state = window(seed)
    solution, expected = minimise(problem, state, RULE), numpy_adjustment.minimise(problem, state, RULE)
    assert (solution.iterations, solution.converged) == (expected.iterations, expected.converged)
    assert solution.converged
    assert solution.cost == pytest.approx(expected.cost, rel=1e-12)
    np.testing.assert_allclose(solution.state.positions_m, expected.state.positions_m, rtol=1e-12, atol=1e-9)
    # At equal costs, points with small parallax differ by more than the rounding of their coordinates.
    np.testing.assert_allclose(solution.state.points_m, expected.state.points_m, rtol=1e-12, atol=1e-8)
    at = expected.state
    assert reduced_rank_deficiency(problem, at) == numpy_adjustment.reduced_rank_deficiency(problem, at) == 0
    if problem.free_views[4]:
        covariance = numpy_adjustment.view_covariance(problem, at, 4)
        np.testing.assert_allclose(view_covariance(problem, at, 4), covariance, rtol=1e-9, atol=1e-12)


def test_points_are_triangulated_as_by_the_shared_equations() -> None:
    """A point with an implausible depth, or on parallel lines, is at the given depth on its last line."""
    rng = np.random.default_rng(8)
    begin, true = np.array([0, 2, 5, 7, 9]), 100.0 * rng.normal(size=(4, 3))
    rows = np.repeat(range(4), np.diff(begin))
    rays = rng.normal(size=(9, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays[8] = rays[7]
    # Lines that miss their points by about 0.1 m, at depths of 40 to 60 m.
    origins = true[rows] - rng.uniform(40.0, 60.0, (9, 1)) * rays + 0.1 * rng.normal(size=(9, 3))
    nothing = np.zeros((4, 3, 3)), np.zeros((4, 3))
    matrix, right = triangulation_equations(LinesOfSight(origins, rays), rows, nothing)
    depths = np.array([40.0, 50.0, 1.0, 50.0])
    found = tracks.triangulate(origins, rays, begin, depths)
    np.testing.assert_allclose(found[:2], np.linalg.solve(matrix[:2], right[:2, :, None])[:, :, 0], rtol=1e-12)
    last = begin[1:] - 1
    np.testing.assert_allclose(found[2:], (origins[last] + depths[:, None] * rays[last])[2:], rtol=1e-15)


def test_landmark_behind_its_camera_costs_infinity_as_with_numpy() -> None:
    problem, state = window(0)
    points = state.points_m.copy()
    points[0] += 2.0 * (state.positions_m[0] - points[0])
    behind = replace(state, points_m=points)
    found, expected = minimise(problem, behind, RULE), numpy_adjustment.minimise(problem, behind, RULE)
    assert (found.cost, found.iterations, found.converged) == (np.inf, 0, False)
    assert (expected.cost, expected.iterations, expected.converged) == (np.inf, 0, False)


@pytest.mark.parametrize("fixed", [0, 1])
def test_missing_rank_is_that_of_numpy(fixed: int) -> None:
    problem, state = window(0)
    views = np.arange(5) >= fixed
    adrift = replace(problem, free_views=views, distances=Distances(), motions=Motions())
    at = minimise(adrift, state, RULE).state
    assert reduced_rank_deficiency(adrift, at) == numpy_adjustment.reduced_rank_deficiency(adrift, at) == 4 - 3 * fixed


def test_envelope_solves_what_lapack_solves() -> None:
    """A band with a bulge, whose factor must not leave the envelope."""
    rng = np.random.default_rng(3)
    reach = np.array([1, 2, 6, 4, 5, 6, 7, 7])
    shape = packed.make_envelope(reach.copy())
    values = np.zeros(shape.begin[-1])
    wanted = np.zeros((24, 24))
    for i, last in enumerate(reach):
        for j in range(i, last + 1):
            block = rng.normal(size=(3, 3)) + (40.0 * np.eye(3) if i == j else 0.0)
            block = 0.5 * (block + block.T) if i == j else block
            for row, column in np.ndindex(3, 3):
                packed.add_entry(values, shape, i, row, j, column, block[row, column])
            wanted[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] += block
            if j > i:
                wanted[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] += block.T
    np.testing.assert_array_equal(packed.dense(values, shape), wanted)
    right = rng.normal(size=24)
    solution = right.copy()
    assert packed.factorise(values, shape)
    packed.solve(values, shape, solution)
    np.testing.assert_allclose(solution, np.linalg.solve(wanted, right), rtol=1e-12)
    np.testing.assert_allclose(np.triu(packed.dense(values, shape)), np.linalg.cholesky(wanted).T, atol=1e-12)


@pytest.mark.parametrize("estimator", [BundleSlam, FixedLagSmoother, BatchAdjustment])
def test_sequence_is_followed_as_with_numpy(estimator: type[BundleSlam], in_numpy) -> None:
    sequence, _ = make_sequence(np.random.default_rng(12), Recipe(frames=25, landmarks=12))
    found = estimator.from_options({}).follow(sequence)
    expected = in_numpy(estimator.from_options({}).follow, sequence)
    assert found.diagnostics == expected.diagnostics
    for one, other in zip(found.frames, expected.frames, strict=True):
        np.testing.assert_allclose(one.position_m, other.position_m, atol=1e-7)
        np.testing.assert_array_equal(one.tracks, other.tracks)


def test_first_estimates_are_adjusted_to_where_their_gradient_is_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost may rise by a little on the way, as they are not its derivatives: that is no reason to stop before."""
    left, ours = [], slam_map.minimise

    def watched(problem: Adjustment, state: State, rule: StoppingRule) -> AdjustmentSolution:
        solution = ours(problem, state, rule)
        if problem.frozen is not None:
            kept, eliminated = numpy_adjustment.undamped_step(problem, solution.state)
            left.append(max(np.abs(kept).max(), np.abs(eliminated).max(initial=0.0)) / rule.step_m)
        return solution

    monkeypatch.setattr(slam_map, "minimise", watched)
    sequence, _ = make_sequence(np.random.default_rng(12), Recipe(frames=40))
    FixedLagSmoother.from_options({"lag": 5}).follow(sequence)
    assert len(left) > 20
    assert max(left) < 1.0


@pytest.mark.long
def test_machine_code_is_kept_where_the_user_wants_it(tmp_path: Path) -> None:
    """The envelope's kernels in a separate process: none is cached in the source folder."""
    code = (
        "import numpy as np; from boresight.estimators.slam.adjustment.compiled.envelope import make_envelope;"
        "print(make_envelope(np.array([2, 1, 2])).reach.tolist())"
    )
    for home in ({"BORESIGHT_CACHE": str(tmp_path)}, {"BORESIGHT_CACHE": os.devnull}):
        clean = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
        done = subprocess.run(
            [sys.executable, "-c", code], env={**clean, **home}, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == "[2, 2, 2]"
    assert list(tmp_path.glob("kernels/*/envelope.make_envelope-*.nbi"))
