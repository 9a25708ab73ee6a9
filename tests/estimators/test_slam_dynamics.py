"""Smoothing with dynamics: propagation and adjustment against scipy, and the truth without noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy_equations import bearing_residuals, distance_residuals
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import chi2
from slam_orbits import GM, LIGHT, Drive, make_orbit_sequence
from slam_sequences import ORBIT_M, Recipe, position_errors_m

from boresight.estimators.slam.adjustment.problem import State
from boresight.estimators.slam.adjustment.solver import StoppingRule
from boresight.estimators.slam.force_model import ForceModel, propagate, propagate_with_derivatives
from boresight.estimators.slam.smoothing import dynamic_smoother
from boresight.estimators.slam.smoothing.dynamic_smoother import DynamicSmoother, DynamicWindow
from boresight.estimators.slam.smoothing.dynamics import (
    DynamicAdjustment,
    DynamicOrdering,
    DynamicSolution,
    DynamicState,
    arc_information,
    covariance_of,
    dynamic_equations,
    marginalise_dynamic,
    minimise_dynamic,
)
from boresight.scenarios.observation import Forces, TrackSequence

FORCES = Forces(3.3, 0.3, LIGHT, 0.2, 1e-7, np.zeros(3), 1e-6 * np.eye(3))
FIELD = ForceModel.of(FORCES, ORBIT_M)
STARTS = np.array([[700.0, -200.0, 300.0, 100.0, 650.0, -300.0], [790.0, 5.0, -8.0, -20.0, 10.0, 800.0]])
DURATIONS = np.array([0.035, 0.09])


def test_motion_is_that_of_scipy_in_si_units() -> None:
    """Also over a quarter of a revolution at once."""
    ratio, factor = 1.07, 0.8
    for start, duration in zip(STARTS, [0.035, 1.5], strict=True):

        def rate(_: float, y: np.ndarray) -> np.ndarray:
            return np.concatenate([y[3:], -ratio * 3.3 * y[:3] / np.linalg.norm(y[:3]) ** 3 + factor * LIGHT])

        si = np.concatenate([start[:3], start[3:] / FIELD.time_s])
        true = solve_ivp(rate, (0.0, duration * FIELD.time_s), si, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
        true[3:] *= FIELD.time_s
        parameters = ORBIT_M * np.array([ratio, factor])
        found = propagate(FIELD, start[None], parameters, np.array([duration]))[0]
        np.testing.assert_allclose(found, true, atol=2e-7)


def test_derivatives_of_the_motion_are_those_of_central_differences() -> None:
    parameters = ORBIT_M * np.array([1.07, 0.8])
    _, found = propagate_with_derivatives(FIELD, STARTS, parameters, DURATIONS)
    for axis in range(8):
        step = np.zeros(8)
        step[axis] = 1e-2
        ahead = propagate(FIELD, STARTS + step[:6], parameters + step[6:], DURATIONS)
        behind = propagate(FIELD, STARTS - step[:6], parameters - step[6:], DURATIONS)
        np.testing.assert_allclose(found[:, :, axis], (ahead - behind) / 2e-2, atol=1e-9)


def test_covariance_of_an_arc_is_that_of_drawn_pushes() -> None:
    """Displacement of an arc's end by a constant acceleration, in units in which that is 1 m per T^2."""
    duration = np.array([0.035])
    covariance = np.linalg.inv(arc_information(duration, 1.0, ORBIT_M))[0]
    pushes = np.random.default_rng(3).standard_normal((4000, 3))
    ends = [
        propagate(replace(FIELD, radiation_m=push), STARTS[:1], np.full(2, ORBIT_M), duration)[0] for push in pushes
    ]
    drawn = np.cov(np.array(ends).T)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(drawn / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=0.08)


@pytest.fixture(scope="module")
def small() -> tuple[DynamicAdjustment, DynamicState, TrackSequence]:
    """Four views, the position of the first known, at a disturbed state."""
    rng = np.random.default_rng(5)
    sequence, truth = make_orbit_sequence(rng, Recipe(frames=4, landmarks=8))
    assert sequence.forces is not None
    window = DynamicWindow(sequence, sequence.forces)
    window.begin(sequence)
    window.slam_map.frames = dict(enumerate(sequence.frames))
    window.views = [0, 1, 2, 3]
    window.slam_map.positions_m = dict(enumerate(truth.positions_m))
    window.slam_map.points_m = dict(truth.points_m)
    window.velocities_m = dict(enumerate(truth.states[:, 3:] * window.field.time_s))
    tracks = [track for track in window.tracks() if sum(track in f.tracks for f in sequence.frames) >= 2]
    problem = window.problem(tracks, first_estimates=True)
    true = window.state(tracks)
    moved = 1.0 * rng.standard_normal((4, 3)) * problem.vision.free_views[:, None]
    places = State(true.vision.positions_m + moved, true.vision.points_m + rng.standard_normal((len(tracks), 3)))
    velocities = true.velocities_m + rng.standard_normal((4, 3))
    return problem, DynamicState(places, velocities, true.parameters_m + np.array([20.0, -30.0])), sequence


def unpacked(problem: DynamicAdjustment, state: DynamicState, x: np.ndarray) -> DynamicState:
    points = len(state.vision.points_m)
    parts = np.split(x, np.cumsum([9, 12, 2]))
    positions = np.concatenate([state.vision.positions_m[:1], parts[0].reshape(3, 3)])
    return DynamicState(State(positions, parts[3].reshape(points, 3)), parts[1].reshape(4, 3), parts[2])


def packed(state: DynamicState) -> np.ndarray:
    places = state.vision
    return np.concatenate(
        [places.positions_m[1:].ravel(), state.velocities_m.ravel(), state.parameters_m, places.points_m.ravel()]
    )


def all_residuals(problem: DynamicAdjustment, state: DynamicState, sequence: TrackSequence) -> np.ndarray:
    """Independent residuals in SI units: propagation by DOP853, and the prior from the sequence."""
    forces = sequence.forces
    assert forces is not None
    field = problem.field
    ratio, factor = state.parameters_m / field.length_m
    at = np.einsum("vji,vj->vi", [f.R_body_inertial for f in sequence.frames], state.vision.positions_m)
    velocities = state.velocities_m / field.time_s
    rows = [bearing_residuals(problem.vision, state.vision).ravel(), distance_residuals(problem.vision, state.vision)]
    for k in range(3):

        def rate(_: float, y: np.ndarray) -> np.ndarray:
            pull = -ratio * forces.gm_m3_s2 * y[:3] / np.linalg.norm(y[:3]) ** 3
            return np.concatenate([y[3:], pull + factor * forces.radiation_m_s2])

        dt = sequence.frames[k + 1].time_s - sequence.frames[k].time_s
        y0 = np.concatenate([at[k], velocities[k]])
        end = solve_ivp(rate, (0.0, dt), y0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        residual = np.concatenate([at[k + 1] - end[:3], (velocities[k + 1] - end[3:]) * field.time_s])
        rows.append(np.linalg.cholesky(problem.arcs.information[k]).T @ residual)
    sigma = np.sqrt(forces.velocity_covariance_m2_s2[0, 0])
    rows.append((velocities[0] - forces.velocity_m_s) / sigma)
    light = np.linalg.norm(forces.radiation_m_s2) / forces.radiation_sigma_m_s2
    rows.append([(ratio - 1.0) * forces.gm_m3_s2 / forces.gm_sigma_m3_s2, (factor - 1.0) * light])
    return np.concatenate(rows)


def test_minimum_and_covariance_are_those_of_scipy(
    small: tuple[DynamicAdjustment, DynamicState, TrackSequence],
) -> None:
    problem, state, sequence = small
    solution = minimise_dynamic(problem, state, StoppingRule(1e-7))
    foreign = least_squares(
        lambda x: all_residuals(problem, unpacked(problem, state, x), sequence),
        packed(state), xtol=1e-14, ftol=1e-14, gtol=1e-12, x_scale="jac",
    )  # fmt: skip
    assert solution.cost == pytest.approx(foreign.cost, rel=1e-6)
    sigma = np.sqrt(np.diag(np.linalg.inv(foreign.jac.T @ foreign.jac)))
    assert np.all(np.abs(packed(solution.state) - foreign.x) < 1e-3 * sigma)
    rows = DynamicOrdering.of(problem)
    wanted = np.concatenate([rows.position[3], rows.velocity[1], rows.parameters])
    places = np.concatenate([[6, 7, 8], [12, 13, 14], [21, 22]])
    covariance = np.linalg.inv(foreign.jac.T @ foreign.jac)[np.ix_(places, places)]
    found = covariance_of(problem, solution.state, wanted, rows)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-3)


def test_prior_of_the_departed_stands_for_them(
    small: tuple[DynamicAdjustment, DynamicState, TrackSequence],
) -> None:
    """With the oldest view and some landmarks marginalised, matrix and gradient of the rest are as before."""
    problem, state, _ = small
    state = minimise_dynamic(problem, state, StoppingRule(1e-7)).state
    seen = problem.vision.pixels
    lost = np.zeros(len(problem.vision.free_points), dtype=bool)
    lost[seen.point[seen.view == 0][:2]] = True
    prior = marginalise_dynamic(problem, state, 0, lost)
    stays = (seen.view != 0) & ~lost[seen.point]
    kept = np.zeros(len(lost), dtype=bool)
    kept[prior.points] = True
    measured = problem.vision.distances
    assert set(measured.view.tolist()) == {0}
    rest = replace(
        problem,
        vision=replace(
            problem.vision,
            pixels=type(seen)(seen.view[stays], seen.point[stays], seen.uv_px[stays], seen.sigma_px[stays]),
            distances=type(measured)(),
            free_views=np.array([False, True, True, True]),
            free_points=~lost,
            kept_points=kept,
        ),
        arcs=replace(problem.arcs, **{
            name: getattr(problem.arcs, name)[1:] for name in ("start", "end", "duration", "information")
        }),
        free_velocities=np.array([False, True, True, True]),
        prior=prior,
    )  # fmt: skip
    whole_rows, rest_rows = DynamicOrdering.of(problem), DynamicOrdering.of(rest)
    for rows_of in (lambda rows: rows.position[3], lambda rows: rows.velocity[1], lambda rows: rows.parameters):
        whole = covariance_of(problem, state, rows_of(whole_rows), whole_rows)
        np.testing.assert_allclose(covariance_of(rest, state, rows_of(rest_rows), rest_rows), whole, rtol=1e-5)
    _, right, _ = dynamic_equations(rest, state, rest_rows).reduced()
    _, before, _ = dynamic_equations(problem, state, whole_rows).reduced()
    largest = np.abs(dynamic_equations(problem, state, whole_rows).reduced()[0]).max()
    assert np.abs(right).max() <= np.abs(before).max() + 1e-9 * largest


def test_noise_free_sequence_returns_the_truth_and_the_parameters() -> None:
    """The prior velocity, gravity parameter and radiation pressure have errors."""
    drive = Drive(noise_m_s2=0.0, gm_sigma=1.0, radiation_sigma=1.0)
    sequence, truth = make_orbit_sequence(np.random.default_rng(1), Recipe(frames=60, noise_px=0.0), drive)
    forces = replace(sequence.forces, gm_m3_s2=1.05 * GM, radiation_m_s2=0.9 * LIGHT)
    estimate = DynamicSmoother.from_options({"tolerance": 1e-10}).follow(replace(sequence, forces=forces))
    assert estimate.status == "ok", estimate.reason
    assert position_errors_m(estimate, truth).max() < 1e-3
    assert estimate.diagnostics["gm_m3_s2"] == pytest.approx(GM, rel=1e-6)
    assert estimate.diagnostics["radiation_m_s2"] == pytest.approx(np.linalg.norm(LIGHT), rel=1e-5)


def test_errors_are_what_the_covariance_says() -> None:
    """Squared normalised errors of 10 trials: chi-square; the bounds are left by chance once in 10000."""
    position, parameters = 0.0, np.zeros(2)
    true = np.array([GM, np.linalg.norm(LIGHT)])
    trials = 10
    for trial in range(trials):
        sequence, truth = make_orbit_sequence(np.random.default_rng([3, trial]), Recipe(frames=15))
        estimate = DynamicSmoother.from_options({"lag": 6}).follow(sequence)
        last = estimate.frames[-1]
        error = last.position_m - truth.positions_m[-1]
        assert last.covariance_m2 is not None
        position += error @ np.linalg.solve(last.covariance_m2, error)
        found = estimate.diagnostics
        told = np.array([found["gm_m3_s2"], found["radiation_m_s2"]])
        parameters += ((told - true) / [found["gm_sigma_m3_s2"], found["radiation_sigma_m_s2"]]) ** 2
    for total, freedom in ((position, 3 * trials), *((square, trials) for square in parameters)):
        low, high = chi2.ppf([5e-5, 1.0 - 5e-5], freedom)
        assert low < total < high


@pytest.mark.parametrize("trials", [60, pytest.param(400, marks=pytest.mark.long)])
def test_what_two_frames_tell_of_the_light_is_what_was_known(trials: int) -> None:
    """The error of the known value does not change its standard deviation, so that squared errors average one."""
    squares = []
    for trial in range(trials):
        drive = Drive(radiation_sigma=0.3)
        sequence, _ = make_orbit_sequence(np.random.default_rng([8, trial]), Recipe(frames=2, landmarks=8.0), drive)
        found = DynamicSmoother.from_options({}).follow(sequence).diagnostics
        squares.append(((found["radiation_m_s2"] - np.linalg.norm(LIGHT)) / found["radiation_sigma_m_s2"]) ** 2)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], trials)
    assert low < sum(squares) < high


def test_long_lag_is_the_batch_and_a_short_one_near_it() -> None:
    sequence, _ = make_orbit_sequence(np.random.default_rng(4), Recipe(frames=14))
    batch = DynamicSmoother.from_options({"lag": 14}).follow(sequence).frames[-1]
    short = DynamicSmoother.from_options({"lag": 4}).follow(sequence).frames[-1]
    assert batch.covariance_m2 is not None
    assert short.covariance_m2 is not None
    away = short.position_m - batch.position_m
    assert 0.0 < away @ np.linalg.solve(batch.covariance_m2, away) < 0.1
    np.testing.assert_allclose(np.trace(short.covariance_m2), np.trace(batch.covariance_m2), rtol=0.05)


def test_error_of_the_first_position_is_found_out() -> None:
    """Gravity determines the centre of mass: half a revolution leaves a tenth of the uncertainty, and it is right."""
    sequence, truth = make_orbit_sequence(np.random.default_rng(9), Recipe(frames=91), Drive(noise_m_s2=1e-9))
    shift = np.array([12.0, -16.0, 0.0])
    unsure = replace(sequence, position_m=sequence.position_m + shift, position_covariance_m2=400.0 * np.eye(3))
    estimate = DynamicSmoother.from_options({}).follow(unsure)
    assert position_errors_m(estimate, truth)[0] == pytest.approx(20.0)
    last = estimate.frames[-1]
    assert last.covariance_m2 is not None
    assert np.trace(last.covariance_m2) < 0.01 * np.trace(unsure.position_covariance_m2)
    error = last.position_m - truth.positions_m[-1]
    assert error @ np.linalg.solve(last.covariance_m2, error) < chi2.ppf(1.0 - 1e-4, 3)


def test_innovation_is_one_and_wrong_forces_are_declared() -> None:
    """The mean of 3 trials of 19 frames is a chi-square over its freedom: 1 to within four standard deviations."""
    told = []
    for trial in range(3):
        sequence, _ = make_orbit_sequence(np.random.default_rng([8, trial]), Recipe(frames=20))
        told.append(DynamicSmoother.from_options({"lag": 6}).follow(sequence).diagnostics["innovation"])
    freedom = 3 * 19 * 15  # two coordinates of 15 landmarks a frame, of which a tenth are new: 30 - 1.5 x 3 and more
    assert np.mean(told) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / freedom))
    assert sequence.forces is not None
    wrong = replace(sequence.forces, gm_m3_s2=2.0 * GM, gm_sigma_m3_s2=0.01, noise_m_s2=1e-9)
    estimate = DynamicSmoother.from_options({}).follow(replace(sequence, forces=wrong))
    assert estimate.status == "failed"
    assert "the smoother diverges" in estimate.reason


def test_what_is_certain_stays_as_it_is() -> None:
    """Parameters without variance are fixed, which makes the covariance of the path smaller."""
    certain = Drive(gm_sigma=0.0, radiation_sigma=0.0, velocity_sigma_m_s=0.0)
    sequence, truth = make_orbit_sequence(np.random.default_rng(6), Recipe(frames=16), certain)
    assert sequence.forces is not None
    sure = DynamicSmoother.from_options({"lag": 5}).follow(sequence)
    assert (sure.diagnostics["gm_m3_s2"], sure.diagnostics["gm_sigma_m3_s2"]) == (pytest.approx(GM, rel=1e-15), 0.0)
    assert sure.diagnostics["radiation_m_s2"] == pytest.approx(np.linalg.norm(LIGHT), rel=1e-15)
    assert position_errors_m(sure, truth)[-1] < 2.0
    looser = replace(sequence.forces, gm_sigma_m3_s2=0.1 * GM, velocity_covariance_m2_s2=1e-6 * np.eye(3))
    unsure = DynamicSmoother.from_options({"lag": 5}).follow(replace(sequence, forces=looser)).frames[-1]
    last = sure.frames[-1]
    assert last.covariance_m2 is not None
    assert unsure.covariance_m2 is not None
    assert np.all(np.linalg.eigvalsh(unsure.covariance_m2 - last.covariance_m2) > -1e-9)


def test_first_estimates_change_little_where_the_parameters_are_well_known() -> None:
    sequence, _ = make_orbit_sequence(np.random.default_rng(6), Recipe(frames=20))
    kept, moved = (
        DynamicSmoother.from_options({"lag": 4, "first_estimates": first}).follow(sequence).frames[-1]
        for first in (True, False)
    )
    assert kept.covariance_m2 is not None
    apart = kept.position_m - moved.position_m
    assert 0.0 < apart @ np.linalg.solve(kept.covariance_m2, apart) < 0.1


def test_first_estimates_are_adjusted_to_where_their_gradient_is_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost may rise by a little on the way, as they are not its derivatives: that is no reason to stop before."""
    left, ours = [], dynamic_smoother.minimise_dynamic

    def watched(problem: DynamicAdjustment, state: DynamicState, rule: StoppingRule) -> DynamicSolution:
        solution = ours(problem, state, rule)
        if not np.isnan(problem.frozen_parameters_m).all():
            system = dynamic_equations(problem, solution.state, DynamicOrdering.of(problem))
            matrix, right, inverse = system.reduced(0.0)
            _, step = system.stepped(solution.state, np.linalg.solve(matrix, right), inverse)
            left.append(step / rule.step_m)
        return solution

    monkeypatch.setattr(dynamic_smoother, "minimise_dynamic", watched)
    sequence, _ = make_orbit_sequence(np.random.default_rng(1), Recipe(frames=40))
    DynamicSmoother.from_options({}).follow(sequence)
    assert len(left) > 20
    assert max(left) < 1.0


def test_without_forces_it_ends_with_a_reason() -> None:
    sequence, _ = make_orbit_sequence(np.random.default_rng(9), Recipe(frames=3))
    estimate = DynamicSmoother.from_options({}).follow(replace(sequence, forces=None))
    assert (estimate.status, len(estimate.frames)) == ("failed", 0)
    assert "the sequence tells no forces" in estimate.reason
