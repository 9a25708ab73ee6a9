"""Stacks of pose problems against the solver of one, scipy, and other stacks of the same problems."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from boresight.estimators.landmark.pose.problem import MarquardtOptions, refine_pose
from boresight.estimators.landmark.pose.stack import PoseStack, ProblemStack, refine_poses
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, look_at

CAMERA = Camera.from_fov(512, 512, np.radians(18.3))
VARIANTS = [
    MarquardtOptions(parameters=parameters, schedule=schedule, damping=damping, max_iterations=iterations)
    for parameters in ("quaternion", "quaternion-as-printed", "minimal")
    for schedule, damping, iterations in (("adaptive", 1e-3, 100), ("fixed", 1e-3, 100), ("fixed", 1.0, 7))
]


def stack(size, n=10, seed=0, near_m=0.0):
    """Landmarks in a box ``near_m`` before the origin, drawn from their covariances; starts 50 m and 2 deg off."""
    rng = np.random.default_rng(seed)
    truths = [look_at(2000.0 * d / np.linalg.norm(d), rng.uniform(-3.0, 3.0)) for d in rng.normal(size=(size, 3))]
    in_view = rng.uniform(-1.0, 1.0, (size, n, 3)) * (120.0, 120.0, 60.0) - (0.0, 0.0, near_m)
    points = np.stack([part @ truth.rotation for part, truth in zip(in_view, truths, strict=True)])
    factor = rng.normal(size=(size, n, 2, 2))
    covariances = factor @ np.swapaxes(factor, -1, -2) + 0.3 * np.eye(2)
    noise = np.einsum("bnij,bnj->bni", np.linalg.cholesky(covariances), rng.normal(size=(size, n, 2)))
    uv = CAMERA.project(PoseStack.of(truths).transform(points)) + noise
    starts = [t.perturbed(np.radians(rng.normal(0.0, 2.0, 3)), rng.normal(0.0, 50.0, 3)) for t in truths]
    return ProblemStack(points, uv, np.linalg.inv(covariances), CAMERA), PoseStack.of(starts), starts


def label(options):
    return f"{options.parameters}-{options.schedule}-{options.damping:g}"


@pytest.mark.parametrize("options", VARIANTS, ids=label)
def test_a_stack_does_step_by_step_what_one_does(options):
    problems, starts, poses = stack(40)
    fits = refine_poses(problems, starts, options)
    iterations = []
    for row, start in enumerate(poses):
        one = refine_pose(problems.problem(row), start, options)
        assert fits.chi2[row] == pytest.approx(one.chi2, rel=1e-9)
        iterations.append(one.iterations)
        np.testing.assert_allclose(fits.poses.rotations[row], one.T_cam_body.rotation, atol=3e-7)
        np.testing.assert_allclose(fits.poses.translations_m[row], one.T_cam_body.translation_m, atol=2e-3)
    # At the bottom rounding decides whether a step is a success, so that single counts may differ.
    assert np.mean(fits.iterations == iterations) > 0.8


@pytest.mark.parametrize("parameters", ["quaternion", "minimal"])
def test_a_stack_agrees_with_scipy(parameters):
    problems, starts, poses = stack(15, seed=3)
    fits = refine_poses(problems, starts, MarquardtOptions(parameters=parameters, tolerance=1e-14))
    for row, start in enumerate(poses):
        weights = np.linalg.cholesky(problems.information_px2[row])
        points, uv = problems.points_body_m[row], problems.uv_px[row]

        def residuals(x, start=start, weights=weights, points=points, uv=uv):
            seen = Rotation.from_rotvec(x[:3]).apply(points @ start.rotation.T) + start.translation_m + 1000.0 * x[3:]
            return np.einsum("nji,nj->ni", weights, uv - (seen[:, :2] / seen[:, 2:] * CAMERA.fx_px + 256.0)).ravel()

        found = least_squares(residuals, np.zeros(6), method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        expected = start.perturbed(found.x[:3], 1000.0 * found.x[3:])
        assert fits.chi2[row] == pytest.approx(2.0 * found.cost, rel=1e-8)
        np.testing.assert_allclose(fits.poses.rotations[row], expected.rotation, atol=1e-6)
        np.testing.assert_allclose(fits.poses.translations_m[row], expected.translation_m, atol=4e-3)


@pytest.mark.parametrize("options", VARIANTS, ids=label)
def test_bits_do_not_depend_on_the_company(options):
    problems, starts, _ = stack(30, seed=5)
    whole = refine_poses(problems, starts, options)
    for rows in (np.arange(1), np.arange(7, 30), np.array([29, 3, 3, 11])):
        part = refine_poses(problems.rows(rows), starts.rows(rows), options)
        np.testing.assert_array_equal(part.poses.rotations, whole.poses.rotations[rows])
        np.testing.assert_array_equal(part.poses.translations_m, whole.poses.translations_m[rows])
        np.testing.assert_array_equal(part.chi2, whole.chi2[rows])
        np.testing.assert_array_equal(part.iterations, whole.iterations[rows])


def test_renormalising_alone_costs_steps_and_no_accuracy():
    """As printed, a part of each step is undone: the convergence is linear, the minimum the same."""
    problems, starts, _ = stack(100, seed=8)
    kept, printed = (
        refine_poses(problems, starts, MarquardtOptions(parameters=name))
        for name in ("quaternion", "quaternion-as-printed")
    )
    assert np.median(printed.iterations) > 2.0 * np.median(kept.iterations)
    np.testing.assert_allclose(np.median(printed.chi2), np.median(kept.chi2), rtol=1e-5)


def test_a_fixed_lambda_creeps_where_adaptive_damping_arrives():
    """For landmarks on the near side alone, rotation and translation are nearly the same: a long and narrow valley."""
    problems, starts, _ = stack(100, seed=9, near_m=120.0)
    fixed = MarquardtOptions(parameters="minimal", schedule="fixed", damping=1.0, max_iterations=20)
    creeping = refine_poses(problems, starts, fixed)
    arrived = refine_poses(problems, starts, MarquardtOptions(parameters="minimal", max_iterations=20))
    assert (creeping.chi2 > 2.0 * arrived.chi2).mean() > 0.25
    assert (arrived.chi2 < 40.0).all()


def test_a_start_with_the_body_behind_the_camera_is_left_as_it_is():
    problems, starts, _ = stack(3)
    turned = PoseStack(starts.rotations, starts.translations_m * np.array([[1.0], [-1.0], [1.0]]))
    fits = refine_poses(problems, turned, MarquardtOptions())
    assert fits.chi2[1] == float("inf")
    assert fits.iterations[1] == 0
    np.testing.assert_array_equal(fits.poses.translations_m[1], turned.translations_m[1])
    assert np.isfinite(fits.chi2[[0, 2]]).all()


def test_the_input_stays_as_it_was():
    problems, starts, _ = stack(4)
    before = starts.rotations.copy(), starts.translations_m.copy()
    refine_poses(problems, starts, MarquardtOptions())
    np.testing.assert_array_equal(starts.rotations, before[0])
    np.testing.assert_array_equal(starts.translations_m, before[1])


def test_shapes_that_disagree_are_refused():
    problems, _, _ = stack(2)
    with pytest.raises(BoresightError, match="agreeing shapes"):
        ProblemStack(problems.points_body_m, problems.uv_px[:, :5], problems.information_px2, CAMERA)


def test_camera_positions_are_those_of_the_poses():
    _, starts, poses = stack(6)
    np.testing.assert_allclose(starts.camera_positions_m, [p.camera_position_m for p in poses], rtol=1e-12)


def test_a_problem_without_a_solution_leaves_the_others_alone():
    """Weights of zero make a normal matrix of zeros, which is singular whatever the damping."""
    problems, starts, _ = stack(5)
    information = problems.information_px2.copy()
    information[2] = 0.0
    spoilt = ProblemStack(problems.points_body_m, problems.uv_px, information, CAMERA)
    for name in ("quaternion", "minimal"):
        options = MarquardtOptions(parameters=name)
        fits, alone = refine_poses(spoilt, starts, options), refine_poses(problems, starts, options)
        np.testing.assert_allclose(fits.poses.rotations[2], starts.rotations[2], atol=1e-12)
        others = [0, 1, 3, 4]
        np.testing.assert_array_equal(fits.poses.rotations[others], alone.poses.rotations[others])
        np.testing.assert_array_equal(fits.chi2[others], alone.chi2[others])


def test_a_fixed_step_behind_the_camera_ends_one_problem_as_it_ends_it_alone():
    """From 7 km a linear step to 2 km overshoots: with the same lambda nothing else could be tried."""
    problems, _, poses = stack(20, seed=1)
    options = MarquardtOptions(parameters="minimal", schedule="fixed", damping=1e-3, max_iterations=20)
    far = [pose.perturbed(np.zeros(3), np.array([0.0, 0.0, 5000.0])) for pose in poses]
    fits = refine_poses(problems, PoseStack.of(far), options)
    alone = [refine_pose(problems.problem(row), pose, options) for row, pose in enumerate(far)]
    ended = [row for row, one in enumerate(alone) if one.iterations == 1]
    assert len(ended) > 3
    np.testing.assert_array_equal(fits.iterations[ended], 1)
