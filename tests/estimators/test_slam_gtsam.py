"""Smoothers of gtsam as sequence estimators, and as an independent check of our own adjustment."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.ceres import ceres
from benchmarks.peers import PeerSolution, graph_of, solved_by_gtsam
from needs_ceres import skip_without_ceres
from slam_sequences import Recipe, make_sequence
from test_slam_kernels import window

from boresight.estimators.registry import sequence_estimator_class
from boresight.estimators.slam.adjustment.problem import Adjustment, Distances, State
from boresight.estimators.slam.adjustment.solver import StoppingRule, minimise, view_covariance
from boresight.estimators.slam.smoothing.gtsam_smoothers import Factors, GtsamFixedLag, GtsamIsam2
from boresight.estimators.slam.smoothing.smoother import BatchAdjustment, FixedLagSmoother
from boresight.scenarios.errors import BoresightError


@pytest.mark.parametrize("name", ["gtsam-fixed-lag", "gtsam-isam2"])
def test_missing_package_is_named_with_its_remedy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(BoresightError, match=r'gtsam: cannot be imported .* pip install -e "\.\[gtsam\]"'):
        sequence_estimator_class(name).from_options({})


@pytest.fixture(scope="module")
def gtsam():
    return pytest.importorskip("gtsam", reason="gtsam is not installed")


@pytest.mark.parametrize("seed", [0, 5, 6, 12])
def test_minimum_is_that_of_gtsam(seed: int, gtsam) -> None:
    problem, state = window(seed)
    problem = replace(problem, free_views=np.arange(5) > 0, free_points=np.ones(len(state.points_m), dtype=bool))
    ours = minimise(problem, state, StoppingRule(1e-8))
    start = state.positions_m.copy()
    graph, values = graph_of(problem, state)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    solver = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    found = solver.optimize()
    assert ours.cost == pytest.approx(graph.error(found), rel=1e-6)
    factors = Factors(problem.camera)
    places = np.array([found.atPose3(factors.view(i)).translation() for i in range(5)])
    np.testing.assert_allclose(ours.state.positions_m, places, atol=1e-3)
    np.testing.assert_array_equal(start, state.positions_m)
    local = gtsam.Marginals(graph, found).marginalCovariance(factors.view(4))[3:, 3:]
    R_body_cam = problem.R_cam_body[4].T
    covariance = view_covariance(problem, ours.state, 4)
    np.testing.assert_allclose(covariance, R_body_cam @ local @ R_body_cam.T, rtol=1e-3, atol=1e-6)


def window_of_pixels_and_gauge(seed: int) -> tuple[Adjustment, State]:
    problem, state = window(seed)
    first = Distances(*(part[problem.distances.view == 0] for part in _columns(problem.distances)))
    free = np.arange(5) > 0, np.ones(len(state.points_m), dtype=bool)
    return Adjustment(problem.camera, problem.R_cam_body, problem.pixels, *free, distances=first), state


@pytest.mark.parametrize("seed", [0, 5, 6])
def test_adjustment_solved_by_gtsam_ends_at_our_minimum(seed: int, gtsam) -> None:
    del gtsam
    check_minimum(*window_of_pixels_and_gauge(seed), solved_by_gtsam(*window_of_pixels_and_gauge(seed), 1e-8))


def test_adjustments_solved_by_ceres_end_at_our_minima() -> None:
    """Ceres fixes attitudes exactly, and has its own projection and derivatives."""
    skip_without_ceres()
    cases = [window_of_pixels_and_gauge(seed) for seed in (0, 5, 6)]
    with ceres(cases) as program:
        for number, case in enumerate(cases):
            check_minimum(*case, program.solve(number, repetitions=2, tolerance=1e-8))


def check_minimum(problem: Adjustment, state: State, found: PeerSolution) -> None:
    ours = minimise(problem, state, StoppingRule(1e-8))
    assert found.cost == pytest.approx(ours.cost, rel=1e-6)
    np.testing.assert_allclose(found.state.positions_m, ours.state.positions_m, atol=1e-2)
    assert found.solve_s > 0.0


def _columns(distances: Distances) -> tuple[np.ndarray, ...]:
    return distances.view, distances.point, distances.range_m, distances.sigma_m


def test_incremental_smoothers_come_to_what_ours_come_to(gtsam) -> None:
    del gtsam
    sequence, _ = make_sequence(np.random.default_rng(4), Recipe(frames=20, landmarks=20))
    pairs = [
        (GtsamIsam2.from_options({"rounds": 5, "relinearize_m": 1e-3}), BatchAdjustment.from_options({})),
        (
            GtsamFixedLag.from_options({"rounds": 5, "relinearize_m": 1e-3}),
            FixedLagSmoother.from_options({"associations": "all"}),
        ),
    ]
    for theirs, ours in pairs:
        one, other = theirs.follow(sequence), ours.follow(sequence)
        assert one.status == other.status == "ok"
        for found, wanted in zip(one.frames[2:], other.frames[2:], strict=True):
            assert wanted.covariance_m2 is not None
            assert found.covariance_m2 is not None
            gap = found.position_m - wanted.position_m
            assert np.sqrt(gap @ np.linalg.solve(wanted.covariance_m2, gap)) < 0.2
            np.testing.assert_allclose(np.trace(found.covariance_m2), np.trace(wanted.covariance_m2), rtol=0.1)


@pytest.mark.parametrize("estimator", [GtsamFixedLag, GtsamIsam2])
def test_lost_tracks_end_with_a_reason(estimator: type[GtsamIsam2], gtsam) -> None:
    del gtsam
    sequence, _ = make_sequence(np.random.default_rng(8), Recipe(frames=8))
    frames = [*sequence.frames[:5], *(replace(f, tracks=f.tracks + 10000) for f in sequence.frames[5:])]
    estimate = estimator.from_options({}).follow(replace(sequence, frames=tuple(frames)))
    assert estimate.status == "failed"
    assert "tracks are lost: 0 landmarks" in estimate.reason
    assert len(estimate.frames) == 5


@pytest.mark.parametrize("estimator", [GtsamIsam2, GtsamFixedLag])
def test_track_that_appears_with_a_range_is_mapped(estimator: type[GtsamIsam2], gtsam) -> None:
    sequence, truth = make_sequence(np.random.default_rng(4), Recipe(frames=8, landmarks=10, range_all=True))
    assert set(sequence.frames[5].tracks.tolist()) - set(sequence.frames[4].tracks.tolist())
    found = estimator.from_options({}).follow(sequence)
    assert found.status == "ok"
    positions = np.array([frame.position_m for frame in found.frames])
    np.testing.assert_allclose(positions, truth.positions_m, atol=0.5)


def test_factors_have_our_axes(gtsam) -> None:
    """A pose projects as our camera does; the error of a motion is that of its covariance in body axes."""
    sequence, truth = make_sequence(np.random.default_rng(4), Recipe(frames=2, landmarks=10, noise_px=0.0))
    factors, (first, second) = Factors(sequence.camera), sequence.frames
    camera = sequence.camera
    calibration = gtsam.Cal3_S2(camera.fx_px, camera.fy_px, 0.0, camera.cx_px, camera.cy_px)
    pose = factors.pose(second.R_cam_body, truth.positions_m[1])
    for track, uv_px in zip(second.tracks.tolist(), second.uv_px, strict=True):
        seen = gtsam.PinholeCameraCal3_S2(pose, calibration).project(truth.points_m[track])
        np.testing.assert_allclose(seen, uv_px, atol=1e-6)
    covariance, off = np.diag([1.0, 4.0, 25.0]), np.array([0.3, -0.8, 2.0])
    values, attitudes = gtsam.Values(), np.stack([first.R_cam_body, second.R_cam_body])
    values.insert(factors.view(0), factors.pose(first.R_cam_body, truth.positions_m[0]))
    values.insert(factors.view(1), factors.pose(second.R_cam_body, truth.positions_m[1] + off))
    factor = factors.motion((0, 1), attitudes, truth.positions_m[1] - truth.positions_m[0], covariance)
    assert factor.error(values) == pytest.approx(0.5 * off @ np.linalg.solve(covariance, off))


def test_covariance_is_in_body_axes(gtsam) -> None:
    """At the first frame it is that of the given position: a bearing and a range of one landmark add nothing."""
    del gtsam
    sequence, _ = make_sequence(np.random.default_rng(4), Recipe(frames=1, landmarks=10))
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 2.0], [0.0, 2.0, 16.0]])
    found = GtsamIsam2.from_options({}).follow(replace(sequence, position_covariance_m2=covariance))
    assert found.status == "ok", found.reason
    np.testing.assert_allclose(found.frames[0].covariance_m2, covariance, rtol=1e-4, atol=1e-6)
