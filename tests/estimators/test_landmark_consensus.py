"""Recognition by consensus on drawn landmarks and corners, whose truth and noise are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.differentiate import hessian
from scipy.optimize import approx_fprime
from scipy.special import logsumexp
from scipy.stats import chi2, multivariate_t

from boresight.estimators.landmark.alignment import Alignment
from boresight.estimators.landmark.pose.posterior import PosePrior
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.estimators.landmark.robust.estimator import (
    ConsensusOptions,
    _positive_definite,
    _prior_after_alignment,
)
from boresight.estimators.landmark.robust.search import (
    Mixture,
    MixtureOptions,
    SearchOptions,
    best_hypotheses,
    corner_map,
    refine_hypotheses,
    retained_information,
    rotation_grid,
    sampled_hypotheses,
)
from boresight.estimators.options import parse_options
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, look_at
from boresight.scenarios.observation import Frame

CAMERA = Camera.from_fov(512, 512, np.radians(18.3))
TRUE = look_at(np.array([1500.0, 900.0, 970.0]), 0.4)
PRIOR_SIGMAS = np.array([0.012, 0.012, 0.012, 4.0, 4.0, 3.0])
ROBUST = MixtureOptions(detection_probability=0.02, covariance_scale=1.0, corner_sigma_px=0.3)
SEEN = MixtureOptions(detection_probability=0.4, covariance_scale=1.0, corner_sigma_px=0.3)


def scene(seed: int, detected: float = 0.4, clutter: int = 120, options: MixtureOptions = SEEN, landmarks: int = 150):
    """Landmarks on the near half of a sphere; a corner for some of them, and clutter over the disc."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(400 * landmarks // 150, 3))
    points *= 180.0 / np.linalg.norm(points, axis=1, keepdims=True)
    points = points[points @ TRUE.camera_position_m > 0.15 * 180.0 * 2000.0][:landmarks]
    covariances = np.repeat(0.25 * np.eye(3)[None], len(points), axis=0)
    uv = CAMERA.project(TRUE.transform(points))
    sigma_px = np.hypot(0.5 * CAMERA.fx_px / 2000.0, 0.3)
    own = uv[rng.random(len(uv)) < detected]
    own = own + rng.normal(0.0, sigma_px, own.shape)
    angle, radius = rng.uniform(0, 2 * np.pi, clutter), 142.0 * np.sqrt(rng.random(clutter))
    noise = 256.0 + np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    error = rng.normal(0.0, PRIOR_SIGMAS)
    prior = PosePrior(TRUE.perturbed(error[:3], error[3:]), np.diag(PRIOR_SIGMAS**-2))
    corners = np.vstack([own, noise])
    return Mixture(points, covariances, corners, np.pi * 142.0**2, CAMERA, prior, options), corners, prior


def solve(mixture: Mixture, corners: np.ndarray, prior: PosePrior):
    search = SearchOptions()
    hypotheses = best_hypotheses(mixture, prior.mean, PRIOR_SIGMAS[0], corners, CAMERA, search)
    return refine_hypotheses(mixture, hypotheses, SEEN.corner_sigma_px, search)


def one(pose) -> PoseStack:
    return PoseStack(pose.rotation[None], pose.translation_m[None])


def moved(pose, steps) -> PoseStack:
    count = len(steps)
    many = PoseStack(np.repeat(pose.rotation[None], count, 0), np.repeat(pose.translation_m[None], count, 0))
    return many.perturbed(steps)


def test_the_gradient_is_that_of_the_posterior():
    """Against scipy's finite differences; covariances hardly change with the pose, so they are taken as constant."""
    mixture, _, prior = scene(1)
    units = np.array([1e-4, 1e-4, 1e-4, 0.2, 0.2, 0.2])

    def posterior(x):
        return mixture.evaluate(one(prior.mean).perturbed((units * x)[None]), 0.8).log_posterior[0]

    expected = approx_fprime(np.zeros(6), posterior, 1e-3) / units
    found = mixture.evaluate(one(prior.mean), 0.8).gradient[0]
    np.testing.assert_allclose(found * units, expected * units, atol=0.02 * np.abs(expected * units).max())


@pytest.mark.parametrize("seed", range(3))
def test_the_observed_information_is_the_second_derivative_of_the_posterior(seed):
    """Against scipy's differences of its values at the maximum; the complete data would have far more."""
    mixture, corners, prior = scene(seed, options=ROBUST)
    pose = solve(mixture, corners, prior)
    found = mixture.evaluate(one(pose), SEEN.corner_sigma_px)
    # Units in which the information of the complete data is 1.
    units = np.linalg.inv(np.linalg.cholesky(found.hessian[0])).T

    def posterior(x):
        steps = (units @ x.reshape(6, -1)).T
        return mixture.evaluate(moved(pose, steps), SEEN.corner_sigma_px).log_posterior.reshape(x.shape[1:])

    expected = -hessian(posterior, np.zeros(6), initial_step=0.2, order=4, maxiter=3).ddf
    np.testing.assert_allclose(units.T @ found.observed_information[0] @ units, expected, atol=0.05)
    assert np.linalg.eigvalsh(expected).min() < 0.8


@pytest.mark.parametrize(("away_px", "definite"), [(0.4, True), (0.6, False)])
def test_between_two_corners_there_is_no_maximum(away_px, definite):
    """With a corner on either side of each landmark the curvature along the row changes sign: at 0.5 px, its sigma."""
    points = scene(1)[0].points_m
    uv, sure = CAMERA.project(TRUE.transform(points)), np.repeat(1e-6 * np.eye(3)[None], len(points), axis=0)
    shift_px = np.array([away_px, 0.0])
    corners = np.concatenate([uv + shift_px, uv - shift_px])
    weak = PosePrior(TRUE, 1e-3 * np.diag(PRIOR_SIGMAS**-2))
    found = Mixture(points, sure, corners, np.pi * 142.0**2, CAMERA, weak, SEEN).evaluate(one(TRUE), 0.5)
    assert _positive_definite(found.hessian[0])
    assert _positive_definite(found.observed_information[0]) == definite


@pytest.mark.parametrize("seed", range(3))
def test_the_evidence_is_the_integral_of_the_posterior(seed):
    """Against importance sampling from Student's t about the maximum; over clutter alone, which detects no landmark."""
    mixture, corners, prior = scene(seed)
    pose = solve(mixture, corners, prior)
    found = mixture.evaluate(one(pose), SEEN.corner_sigma_px)
    near = multivariate_t(np.zeros(6), 1.5 * np.linalg.inv(found.observed_information[0]), df=5, seed=seed)
    steps = near.rvs(1000)
    values = mixture.evaluate(moved(pose, steps), SEEN.corner_sigma_px).log_posterior - near.logpdf(steps)
    prior_peak = 0.5 * np.linalg.slogdet(prior.information)[1] - 3.0 * np.log(2.0 * np.pi)
    expected = logsumexp(values) - np.log(1000) + prior_peak + len(mixture.points_m) * np.log(0.6)
    assert mixture.log_evidence(found)[0] == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize(("landmarks", "clutter"), [(150, 120), (600, 1500)])
def test_chance_is_no_evidence_however_many_landmarks_are_in_view(landmarks, clutter):
    """Of clutter alone the greatest posterior rises with their number, from 7 to 16 here; of true corners it is 31."""
    evidence = []
    for detected in (0.0, 0.2):
        mixture, corners, prior = scene(5, detected, clutter, ROBUST, landmarks)
        found = mixture.evaluate(one(solve(mixture, corners, prior)), SEEN.corner_sigma_px)
        evidence.append(mixture.log_evidence(found)[0])
    assert evidence[0] < 0.0 < evidence[1]


@pytest.mark.parametrize("p", [0.005, 0.02, 0.1])
def test_the_information_that_clutter_leaves_is_the_mean_curvature_of_drawn_corners(p):
    """By central differences of log(1 + k sum exp(-d^2 / 2)), with Poisson clutter of 0.05 in the unit square."""
    rng, n, density, step = np.random.default_rng(3), 40_000, 0.05, 0.05
    odds = p / (1.0 - p) / density / (2.0 * np.pi)
    clutter = rng.uniform(-5.0, 5.0, (n, 25, 2))
    clutter[np.arange(25) >= rng.poisson(100.0 * density, (n, 1))] = np.inf
    corners = np.concatenate([rng.normal(size=(n, 1, 2)), clutter], axis=1)

    def log_likelihood(x):
        squares = np.square(corners - [x, 0.0]).sum(axis=2)
        return np.log1p(odds * np.exp(-0.5 * squares).sum(axis=1))

    curvature = (2.0 * log_likelihood(0.0) - log_likelihood(step) - log_likelihood(-step)) / step**2
    mean, error = curvature.mean(), curvature.std() / np.sqrt(n)
    # Clutter nearby takes away another part of about p.
    assert retained_information(np.array(odds)) == pytest.approx(mean, abs=3.0 * error + p * mean)


def test_covariances_are_scaled_as_if_they_were_larger():
    mixture, corners, prior = scene(1)
    given = (corners, np.pi * 142.0**2, CAMERA, prior)
    covariances = np.random.default_rng(1).uniform(0.1, 0.4, len(mixture.points_m))[:, None, None] * np.eye(3)
    scaled = Mixture(mixture.points_m, covariances, *given, SEEN.model_copy(update={"covariance_scale": 2.5}))
    larger = Mixture(mixture.points_m, 2.5 * covariances, *given, SEEN)
    found, expected = (one_.evaluate(one(prior.mean), 0.3) for one_ in (scaled, larger))
    np.testing.assert_allclose(found.log_posterior, expected.log_posterior)
    np.testing.assert_allclose(found.hessian, expected.hessian)


def test_corners_that_mean_nothing_leave_the_prior():
    """The best hypotheses do not turn; minimal sets are drawn to a prior that is sure, wherever they begin."""
    mixture, corners, prior = scene(1)
    mixture.odds_px2 = 1e-12
    best = best_hypotheses(mixture, prior.mean, PRIOR_SIGMAS[0], corners, CAMERA, SearchOptions())
    np.testing.assert_allclose(best.rotations, np.broadcast_to(prior.mean.rotation, best.rotations.shape))
    sure = PosePrior(prior.mean, 1e6 * prior.information)
    start = prior.mean.perturbed(np.zeros(3), np.array([1.0, -1.0, 2.0]))
    search = SearchOptions(hypotheses="minimal-sets", draws=500)
    sets = sampled_hypotheses(mixture, sure, start, corners, CAMERA, search, np.random.default_rng(1))
    assert len(sets) > 0
    np.testing.assert_allclose(sure.errors(sets), 0.0, atol=0.05)


def test_an_alignment_is_known_across_the_line_of_sight_alone():
    """Means of two numbers of which one is three times as uncertain: nine tenths of the way to the other."""
    camera = Camera.from_fov(512, 512, np.radians(18.3))
    sigma_m = 3.6 * camera.pixel_angle_rad * float(np.linalg.norm(TRUE.translation_m))
    covariance = np.diag([0.01, 0.01, 0.01, 3.0 * sigma_m, 3.0 * sigma_m, 40.0]) ** 2
    frame = Frame(np.zeros((512, 512), dtype=np.float32), np.array([0.0, 0.0, -1.0]), TRUE, covariance)
    shifted = Alignment(TRUE.perturbed(np.zeros(3), np.array([10.0, -20.0, 3.0])), ())
    found = _prior_after_alignment(frame, shifted, camera, ConsensusOptions())
    np.testing.assert_allclose(found.mean.translation_m - TRUE.translation_m, [9.0, -18.0, 0.0], atol=0.02)
    sigmas = np.sqrt(np.diag(np.linalg.inv(found.information)))
    np.testing.assert_allclose(sigmas, [0.01, 0.01, 0.01, *np.sqrt([0.9, 0.9]) * sigma_m, 40.0], rtol=0.01)
    # A tenth of the range from the ground the same pixels are a tenth of the metres, beside which the prior is nothing.
    near = _prior_after_alignment(frame, replace(shifted, depth_share=0.1), camera, ConsensusOptions())
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(near.information)))[3:5], 0.1 * sigma_m, rtol=0.01)


def test_each_climb_raises_the_posterior():
    mixture, _, prior = scene(2)
    poses = one(prior.mean)
    posteriors = []
    for _ in range(6):
        posteriors.append(mixture.evaluate(poses, 1.0).log_posterior[0])
        poses = mixture.maximise(poses, 1.0, 1)
    assert (np.diff(posteriors) > -1e-4).all(), "but for the covariances, which are taken as constant"


def test_poses_side_by_side_are_those_one_by_one():
    mixture, _, prior = scene(3)
    steps = np.random.default_rng(0).normal(0, 1, (5, 6)) * PRIOR_SIGMAS
    many = PoseStack(np.repeat(prior.mean.rotation[None], 5, 0), np.repeat(prior.mean.translation_m[None], 5, 0))
    many = many.perturbed(steps)
    together = mixture.evaluate(many, 0.5)
    for index in range(5):
        alone = mixture.evaluate(many.rows(np.array([index])), 0.5)
        assert alone.log_posterior[0] == pytest.approx(together.log_posterior[index])
        np.testing.assert_allclose(alone.hessian[0], together.hessian[index], rtol=1e-9)


def test_the_pose_is_found_and_its_covariance_is_true():
    """The mean of e^T P^-1 e over drawn scenes lies in its 99 % band: no scene fails, and P has the right size."""
    squares = []
    for seed in range(14):
        mixture, corners, prior = scene(seed)
        pose = solve(mixture, corners, prior)
        error = PosePrior(TRUE, np.eye(6)).errors(one(pose))[0]
        squares.append(error @ mixture.evaluate(one(pose), SEEN.corner_sigma_px).observed_information[0] @ error)
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_the_same_input_gives_the_same_bits():
    first, second = (solve(*scene(7)) for _ in range(2))
    assert first.rotation.tobytes() == second.rotation.tobytes()
    assert first.translation_m.tobytes() == second.translation_m.tobytes()


def test_turns_fill_the_ball_and_keep_to_their_number():
    turns = rotation_grid(0.04, 0.007, 4000)
    assert np.linalg.norm(turns, axis=1).max() <= 0.04
    assert len(turns) == pytest.approx(4.0 / 3.0 * np.pi * (0.04 / 0.007) ** 3, rel=0.1)
    assert len(rotation_grid(0.04, 0.0007, 500)) <= 500


def test_the_corner_map_counts_every_corner():
    corners = np.array([[100.2, 50.7], [100.4, 50.1], [300.0, 400.0]])
    density = corner_map(corners, CAMERA, 1.5)
    assert density.sum() == pytest.approx(3.0, rel=1e-4)
    assert np.unravel_index(density.argmax(), density.shape) == (50, 100)


def sampled(mixture: Mixture, corners: np.ndarray, prior: PosePrior, seed: int = 5):
    search = SearchOptions(hypotheses="minimal-sets", draws=4000)
    rng = np.random.default_rng(seed)
    return sampled_hypotheses(mixture, prior, prior.mean, corners, CAMERA, search, rng), search


def test_minimal_sets_lead_to_the_pose_that_the_whole_prior_does():
    """Two searches without common hypotheses find the same optimum."""
    for seed in range(3):
        mixture, corners, prior = scene(seed)
        hypotheses, search = sampled(mixture, corners, prior)
        found = refine_hypotheses(mixture, hypotheses, SEEN.corner_sigma_px, search)
        expected = solve(mixture, corners, prior)
        difference = PosePrior(expected, np.eye(6)).errors(one(found))[0]
        assert (np.abs(difference) < 0.02 * PRIOR_SIGMAS).all()


def test_minimal_sets_are_those_of_their_seed():
    given = scene(3)
    first, again, other = (sampled(*given, seed=seed)[0].translations_m for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_minimal_set_of_true_corners_gives_the_true_pose():
    """Without noise and clutter every set is correct, so every hypothesis is the pose, up to the linearisation."""
    mixture, _, prior = scene(4)
    near = PosePrior(TRUE.perturbed(np.full(3, 1e-4), np.full(3, 0.05)), prior.information)
    points = mixture.points_m[::12]
    corners = CAMERA.project(TRUE.transform(points))
    sure = np.repeat(1e-6 * np.eye(3)[None], len(points), axis=0)
    exact = Mixture(points, sure, corners, 6e4, CAMERA, near, SEEN)
    search = SearchOptions(hypotheses="minimal-sets", draws=400, anneal_px=(0.001,))
    poses = sampled_hypotheses(exact, near, near.mean, corners, CAMERA, search, np.random.default_rng(0))
    errors = PosePrior(TRUE, np.eye(6)).errors(poses)
    assert np.median(np.abs(errors[:, :3])) < 1e-6, "but for sets that nearly lie on a line"
    assert np.median(np.abs(errors[:, 3:5])) < 1e-3


def test_without_a_match_there_is_no_hypothesis():
    mixture, _, prior = scene(1)
    hypotheses, _ = sampled(mixture, np.array([[3.0, 3.0], [5.0, 3.0]]), prior)
    assert len(hypotheses) == 0


@pytest.mark.parametrize("anneal_px", [(), (1.5, 0.0), (-1.0,)])
def test_the_refinement_goes_through_corner_errors_above_zero(anneal_px):
    with pytest.raises(BoresightError, match=r"estimator landmark-ransac: search\.anneal_px"):
        parse_options(ConsensusOptions, {"search": {"anneal_px": anneal_px}}, "landmark-ransac")
