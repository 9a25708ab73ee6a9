"""The methods of the approach in real renderings of the embedded body, with the noise of a detector."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from boresight.estimators.approach.body import BodyView, LitBody
from boresight.estimators.approach.centroid import CENTROID
from boresight.estimators.approach.limb import LimbEstimator, LimbOptions
from boresight.estimators.approach.matching import ALIGNMENT, SilhouetteEstimator
from boresight.estimators.approach.sight import SightOptions, _by_pose
from boresight.estimators.registry import estimator_class
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.bodies.embedded import EMBEDDED, icosphere
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, look_at
from boresight.scenarios.observation import CameraSigma, Frame, Observation
from boresight.scenarios.spec.brdf import LambertSpec, LommelSeeligerSpec, McEwenSpec
from boresight.scenarios.spec.camera import DetectorSpec

CAMERA = Camera(160, 128, 1000.0, 1000.0, 80.0, 64.0)
BODY = EMBEDDED["contact-binary"]()
SIGHTS = ("centroid", "centroid-phase", "silhouette")
METHODS = (*SIGHTS, "limb")
TRIALS = 16


class Assets:
    """The onboard model is the truth."""

    camera = CAMERA

    def shape(self):
        return BODY

    def mesh_renderer(self, mesh, samples_per_pixel=1, *, other_law=False):
        law = LommelSeeligerSpec(kind="lommel-seeliger") if other_law else LambertSpec()
        return MitsubaRenderer(mesh, law, samples_per_pixel, variant=choose_variant())


RENDERER = MitsubaRenderer(BODY, LambertSpec(), 16, variant=choose_variant())
ESTIMATORS = {name: estimator_class(name).from_options({}, Assets()) for name in METHODS}


def observed(
    trial: int,
    size_px: float = 60.0,
    turn_deg: float = 0.2,
    middle_px=(0.0, 0.0),
    phase_deg=(20.0, 110.0),
    range_sigma: float = 0.01,
) -> tuple[Pose, Observation]:
    """A view from a random direction at a random phase angle, with errors of the prior; drawn once for all tests."""
    return drawn(RENDERER, BODY.radius_m, trial, size_px, turn_deg, middle_px, phase_deg, range_sigma)


@cache
def drawn(renderer, radius_m, trial, size_px, turn_deg, middle_px, phase_deg, range_sigma):
    rng = np.random.default_rng((11, trial))
    range_m = 2.0 * radius_m * CAMERA.fx_px / size_px
    direction = rng.normal(size=3)
    truth = look_at(range_m * direction / np.linalg.norm(direction), rng.uniform(0.0, 6.0))
    scale = range_m / CAMERA.fx_px
    truth = truth.perturbed(np.zeros(3), np.array([*(rng.uniform(-8.0, 8.0, 2) + middle_px), 0.0]) * scale)
    phase, around = np.radians(rng.uniform(*phase_deg)), rng.uniform(0.0, 6.28)
    sun = np.array([np.sin(phase) * np.cos(around), np.sin(phase) * np.sin(around), -np.cos(phase)])
    image = Detector(DetectorSpec()).expose(renderer.render(View(CAMERA, truth, truth.rotation.T @ sun)), rng)
    sigmas = np.array([np.radians(turn_deg)] * 3 + [4.0 * scale, 4.0 * scale, range_sigma * range_m])
    error = rng.normal(size=6) * sigmas
    prior = truth.perturbed(error[:3], error[3:])
    return truth, Observation(CAMERA, Frame(image, sun, prior, np.diag(sigmas**2)))


def estimate(name: str, observation: Observation):
    return ESTIMATORS[name].estimate(observation, rng=np.random.default_rng(0))


@pytest.fixture(scope="module", params=METHODS)
def solved(request):
    """The method's name, with truth and estimate of each trial."""
    seen = [observed(trial) for trial in range(TRIALS)]
    return request.param, [(truth, seen_by, estimate(request.param, seen_by)) for truth, seen_by in seen]


def test_the_line_of_sight_is_sub_pixel(solved):
    name, trials = solved
    errors = [
        np.linalg.norm(CAMERA.project(found.pose.translation_m) - CAMERA.project(truth.translation_m))
        for truth, _, found in trials
        if found.status == "ok"
    ]
    assert len(errors) >= TRIALS - 2
    # An ellipsoid for a contact binary of 60 px is wrong by a few hundredths of its size.
    assert np.median(errors) < {"centroid-phase": 3.0}.get(name, 0.5)


def mean_nees(trials) -> float:
    """Return the mean NEES / 6 of the solved ones of (truth, observation, estimate)."""
    squares = []
    for truth, seen_by, found in trials:
        if found.status == "ok":
            prior = seen_by.frame.prior_T_cam_body
            turn = (prior.rotation @ truth.rotation.T - truth.rotation @ prior.rotation.T) / 2.0
            error = [turn[2, 1], turn[0, 2], turn[1, 0], *(found.pose.translation_m - truth.translation_m)]
            squares.append(error @ np.linalg.solve(found.covariance, error) / 6.0)
            np.testing.assert_array_equal(found.pose.rotation, prior.rotation)
    return float(np.mean(squares))


def test_the_covariance_is_that_of_the_errors(solved):
    # For exact covariances 99 % of such means are within 0.65 and 1.4; the bias of a limb is stated with a margin.
    assert 0.35 < mean_nees(solved[1]) < 1.6


def test_the_limb_of_a_crescent():
    """The strip of light is narrower or wider than that of a ball, by which points were up to 0.4 px off."""
    seen = [observed(trial, size_px=50.0, phase_deg=(110.0, 140.0)) for trial in range(TRIALS)]
    solved = [(truth, one, estimate("limb", one)) for truth, one in seen]
    assert sum(found.status == "ok" for _, _, found in solved) >= TRIALS - 2
    assert mean_nees(solved) < 1.2


@pytest.mark.parametrize("name", ["centroid", *(pytest.param(one, marks=pytest.mark.long) for one in SIGHTS[1:])])
def test_the_covariance_of_a_crescent_thinner_than_a_pixel(name):
    """Three pixels of body: where in its pixel the crescent is, the image does not tell."""
    seen = [observed(trial, size_px=3.5, phase_deg=(110.0, 140.0)) for trial in range(TRIALS)]
    assert mean_nees([(truth, seen_by, estimate(name, seen_by)) for truth, seen_by in seen]) < 1.6


@pytest.mark.parametrize(("name", "least"), [("centroid", 0.6), ("silhouette", 0.15)])
def test_small_bodies_share_the_sampling_error_with_their_rendering(name, least):
    """Were it independent of the image's, the silhouette's variance across the line of sight would be 16 errors'."""
    squares = []
    for trial in range(TRIALS):
        truth, seen_by = observed(trial, 10.0, phase_deg=(0.0, 60.0))
        found = estimate(name, seen_by)
        across = np.linalg.svd(truth.translation_m[None])[2][1:]
        error = across @ (found.pose.translation_m - truth.translation_m)
        squares.append(error @ np.linalg.solve(across @ found.covariance[3:, 3:] @ across.T, error) / 2.0)
    assert least < np.mean(squares) < 1.6


def test_the_silhouette_takes_what_errors_of_the_pose_leave_as_large_in_every_direction():
    """Errors of the pose that the derivatives do not explain widen the covariance in every direction."""
    truth, seen = observed(0, size_px=100.0, range_sigma=0.05)
    parts = Assets().mesh_renderer(BODY), BODY, BODY.radius_m, SightOptions()
    narrow, wide = (
        SilhouetteEstimator(*parts, replace(ALIGNMENT, any_direction=one)).estimate(seen, rng=np.random.default_rng(0))
        for one in (False, True)
    )
    across = CAMERA.jacobian(truth.translation_m)
    more_px2 = across @ (wide.covariance - narrow.covariance)[3:, 3:] @ across.T
    assert np.linalg.eigvalsh(more_px2).min() > 1e-4


def test_the_attitude_of_a_sphere_does_not_move_its_centroid():
    """A crescent of 200 px; a sample a pixel makes its edges ragged."""
    ball, sun = icosphere(6, 100.0), np.array([np.sin(2.4), 0.0, -np.cos(2.4)])
    view = BodyView(
        Assets().mesh_renderer(ball),
        ball.radius_m,
        ball.area_vectors_m2,
        replace(CAMERA, width_px=400, height_px=400),
        sun,
        0.5,
    )
    pose = look_at(np.array([0.0, -1000.0, 0.0]))
    patch = view.render(pose)
    body = LitBody(patch, patch.image > 0.02, 0.01, 0.0, False)
    derivative, left_px2 = _by_pose(view, pose, body, CENTROID, np.diag([np.radians(0.1)] * 3 + [1.0] * 3) ** 2)
    assert np.abs(derivative[:, :3]).max() * np.radians(0.1) < 0.01
    assert np.sqrt(np.diag(left_px2)).max() < 0.02


def test_the_covariance_holds_what_a_wrong_range_does_to_the_greatest_correlation(monkeypatch):
    """The rendering of a ball that is 5 % too large or small clings to the lit limb, or to the middle."""
    ball, law = icosphere(6, 100.0), LommelSeeligerSpec(kind="lommel-seeliger")

    def renderer(self, mesh, samples_per_pixel=1):
        return MitsubaRenderer(mesh, law, samples_per_pixel, variant=choose_variant())

    monkeypatch.setattr(Assets, "mesh_renderer", renderer)
    monkeypatch.setattr(Assets, "shape", lambda self: ball)
    monkeypatch.setitem(globals(), "BODY", ball)
    monkeypatch.setitem(globals(), "RENDERER", renderer(None, ball, 16))
    method = estimator_class("silhouette").from_options({}, Assets())
    seen = [
        observed(trial, size_px=110.0, turn_deg=0.0, phase_deg=(20.0, 60.0), range_sigma=0.05)
        for trial in range(TRIALS)
    ]
    squares = []
    for truth, one in seen:
        found = method.estimate(one, rng=np.random.default_rng(0))
        if found.status == "ok":
            error = found.pose.translation_m - truth.translation_m
            squares.append(error @ np.linalg.solve(found.covariance[3:, 3:], error) / 3.0)
    assert len(squares) >= TRIALS - 2
    # With the slope at the prior in place of the regression it is above 2.
    assert np.mean(squares) < 1.3


def test_the_limb_gives_the_range():
    errors = []
    for trial in range(8):
        truth, seen = observed(trial, size_px=100.0)
        found = estimate("limb", seen)
        errors.append(found.pose.translation_m[2] / truth.translation_m[2] - 1.0)
    assert np.sqrt(np.mean(np.square(errors))) < 0.005  # half of the prior's


@pytest.mark.parametrize("size_px", [12.0, 100.0])
def test_the_centroid_fits_the_law_of_reflectance(monkeypatch, size_px):
    """The surface has McEwen's law with a share of 0.63 of Lommel and Seeliger's; Lambert's is believed in."""
    law = McEwenSpec(kind="mcewen", L1_per_deg=0.0, L2_per_deg2=0.0, L3_per_deg3=-0.37 / 30.0**3)
    monkeypatch.setitem(globals(), "RENDERER", MitsubaRenderer(BODY, law, 16, variant=choose_variant()))
    methods = [
        estimator_class("centroid").from_options({"reflectance": how}, Assets()) for how in ("fitted", "onboard")
    ]
    errors_px, shares = [], []
    for trial in range(8):
        truth, seen = observed(trial, size_px=size_px, phase_deg=(30.0, 30.0))
        found = [method.estimate(seen, rng=np.random.default_rng(0)) for method in methods]
        apart_px = [CAMERA.project(one.pose.translation_m) - CAMERA.project(truth.translation_m) for one in found]
        errors_px.append(np.linalg.norm(apart_px, axis=1))
        shares.append(found[0].diagnostics["other_law"])
    fitted_px, onboard_px = np.median(errors_px, axis=0)
    assert 2.0 * fitted_px < onboard_px
    assert 0.5 < np.median(shares) < 0.8


@pytest.mark.parametrize("name", SIGHTS)
@pytest.mark.parametrize("trial", [1, 2])
def test_three_pixels_are_enough(name, trial):
    truth, seen = observed(trial, size_px=3.0)
    found = estimate(name, seen)
    assert found.status == "ok"
    error = CAMERA.project(found.pose.translation_m) - CAMERA.project(truth.translation_m)
    assert np.linalg.norm(error) < 0.3


@pytest.mark.parametrize("name", METHODS)
def test_the_attitude_s_error_is_in_the_covariance(name):
    """With an error of the attitude the position is known less well, and is correlated with it."""
    _, seen = observed(3)
    loose, tight = seen.frame, replace(seen.frame, prior_covariance=seen.frame.prior_covariance.copy())
    tight.prior_covariance[:3, :3] = 0.0
    stated = [estimate(name, replace(seen, frame=frame)).covariance for frame in (loose, tight)]
    np.testing.assert_array_equal(stated[0][:3, :3], loose.prior_covariance[:3, :3])
    assert np.trace(stated[0][3:5, 3:5]) > np.trace(stated[1][3:5, 3:5])
    assert np.abs(stated[0][:3, 3:]).max() > 0.0


@pytest.mark.parametrize("name", SIGHTS)
def test_a_wrong_camera_shifts_the_body(name):
    """The range is the prior's: an error of the focal length is across the line of sight, and none of the range's."""
    truth, seen = observed(5, middle_px=(-40.0, 25.0))
    sigma = np.sqrt(np.diag(seen.frame.prior_covariance))
    frame = replace(seen.frame, prior_covariance=np.diag([*sigma[:3], *(100.0 * sigma[3:5]), 1e-3 * sigma[5]]) ** 2)
    exact, focal, middle = (
        estimate(name, replace(seen, frame=frame, camera_sigma=CameraSigma(*wrong))).covariance[3:, 3:]
        for wrong in ((0.0, 0.0), (0.01, 0.0), (0.0, 1.0))
    )
    per_px = truth.translation_m[2] / CAMERA.fx_px
    wrong_m = 0.01 * per_px * (CAMERA.project(truth.translation_m) - [CAMERA.cx_px, CAMERA.cy_px])
    np.testing.assert_allclose((focal - exact)[:2, :2], np.outer(wrong_m, wrong_m), rtol=0.1)
    np.testing.assert_allclose((middle - exact)[:2, :2], per_px**2 * np.eye(2), rtol=0.05, atol=0.02 * per_px**2)
    assert (focal - exact)[2, 2] < 0.05 * np.trace(focal - exact)


def test_a_ball_that_is_larger_than_known_moves_the_limb_along_its_common_error():
    """All points of a ball of 60 px are 0.2 px farther out: as by the bias, of which half is common, 0.07 px."""
    truth = look_at(np.array([0.0, -2000.0 * BODY.radius_m / 60.0, 0.0]))
    sun = np.array([0.8, 0.0, -0.6])
    shapes = [icosphere(5, BODY.radius_m * (1.0 - off_px / 30.0)) for off_px in (0.0, 0.2)]
    renderer = MitsubaRenderer(shapes[0], LambertSpec(), 36, variant=choose_variant())
    image = Detector(DetectorSpec()).expose(
        renderer.render(View(CAMERA, truth, truth.rotation.T @ sun)), np.random.default_rng(0)
    )
    seen = Observation(CAMERA, Frame(image, sun, truth, np.diag([1e-12] * 3 + [1e12] * 3)))
    right, small = (
        LimbEstimator(shape, LimbOptions(bias_px=0.1)).estimate(seen, rng=np.random.default_rng(0)) for shape in shapes
    )
    moved = (small.pose.translation_m - right.pose.translation_m) * np.sqrt(0.5) * 0.1 / 0.2
    sigma = np.sqrt(np.diag(right.covariance)[3:])
    np.testing.assert_allclose(moved / sigma, right.common[3:] / sigma, atol=0.05)
    assert np.linalg.norm(right.common[3:] / sigma) > 0.5
    left = right.covariance[3:, 3:] - np.outer(right.common[3:], right.common[3:])
    assert np.linalg.eigvalsh(left / np.outer(sigma, sigma)).min() > 0.0


@pytest.mark.parametrize(("axis", "wrong"), [(3, CameraSigma(0.0, 1.0)), (5, CameraSigma(0.01, 0.0))])
@pytest.mark.parametrize("range_sigma", [1e-5, 0.01, 1.0])
def test_the_calibration_is_in_the_covariance_of_the_limb_as_far_as_it_decides(axis, wrong, range_sigma):
    """The range is known to a share of ``range_sigma`` beforehand; a pixel is across it, a focal length along it."""
    _, seen = observed(3)
    range_m = seen.frame.prior_T_cam_body.translation_m[2]
    prior = np.diag([*np.diag(seen.frame.prior_covariance)[:5], (range_sigma * range_m) ** 2])
    given = replace(seen, frame=replace(seen.frame, prior_covariance=prior))
    exact, stated = (estimate("limb", replace(given, camera_sigma=sigma)) for sigma in (CameraSigma(), wrong))
    np.testing.assert_array_equal(stated.pose.translation_m, exact.pose.translation_m)
    whole_m = range_m * (wrong.focal if axis == 5 else wrong.principal_point_px / CAMERA.fx_px)
    share = 1.0 - exact.covariance[axis, axis] / prior[axis, axis]
    added_m2 = (stated.covariance - exact.covariance)[axis, axis]
    assert added_m2 == pytest.approx((share * whole_m) ** 2, rel=0.05, abs=1e-6)
    np.testing.assert_array_equal(stated.covariance[:3, :3], prior[:3, :3])


@pytest.mark.parametrize("name", ["centroid", "silhouette"])
def test_a_star_beside_the_body_is_no_part_of_it(name):
    """Thirty pixels of body, and a star at twenty-three of its middle with some of its light."""
    truth, seen = observed(1, size_px=30.0)
    u, v = (int(value) for value in CAMERA.project(truth.translation_m))
    image = seen.frame.image.copy()
    image[v - 1 : v + 2, u + 22 : u + 25] += 2000.0
    moved = estimate(name, replace(seen, frame=replace(seen.frame, image=image))).pose
    away = CAMERA.project(moved.translation_m) - CAMERA.project(estimate(name, seen).pose.translation_m)
    assert np.linalg.norm(away) < 0.05


@pytest.mark.parametrize("trial", [1, 2])
def test_dust_around_a_comet_is_not_its_limb(trial):
    """A tenth as bright as the surface, brightest towards the Sun; a limb outside the true one is a shorter range."""
    truth, seen = observed(trial, size_px=60.0)
    image, sun = seen.frame.image, seen.frame.sun_dir_cam[:2]
    rows, columns = np.mgrid[:128, :160] + 0.5
    u, v = CAMERA.project(truth.translation_m) + 15.0 * sun / np.linalg.norm(sun)
    glow = 0.1 * np.percentile(image, 99.0) * np.exp(-np.hypot(columns - u, rows - v) / 60.0)
    dusty = np.maximum(image, 0.0) + glow.astype(np.float32)
    dark, bright = (estimate("limb", replace(seen, frame=replace(seen.frame, image=each))) for each in (image, dusty))
    assert bright.status == "ok"
    moved = CAMERA.project(bright.pose.translation_m) - CAMERA.project(dark.pose.translation_m)
    assert np.linalg.norm(moved) < 0.03
    assert bright.pose.translation_m[2] / dark.pose.translation_m[2] == pytest.approx(1.0, abs=1.5e-3)


@pytest.mark.parametrize("name", SIGHTS)
def test_a_rendering_that_does_not_meet_the_body_is_a_failure(name):
    """One round only, from a prior that is off by two and a half times the body's size."""
    method = estimator_class(name).from_options({"alignment_loop": {"max_iterations": 1}}, Assets())
    _, seen = observed(1, size_px=30.0)
    prior = seen.frame.prior_T_cam_body
    moved = prior.perturbed(np.zeros(3), np.array([75.0, 0.0, 0.0]) * prior.translation_m[2] / CAMERA.fx_px)
    frame = replace(seen.frame, prior_T_cam_body=moved)
    found = method.estimate(replace(seen, frame=frame), rng=np.random.default_rng(0))
    assert (found.status, found.pose) == ("failed", None)
    assert "does not meet the body in max_iterations 1" in found.reason or "out of view" in found.reason


NOISE = np.random.default_rng(8).normal(10.0, 1.0, (128, 160)).round().astype(np.float32)
HOT = NOISE + 500.0 * (np.random.default_rng(9).uniform(size=(128, 160)) < 1e-3)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize(
    ("image", "reason"),
    [(0.0 * NOISE, "black"), (NOISE, "black"), (HOT.astype(np.float32), "shows no body")],
    ids=["black", "noise", "hot-pixels"],
)
def test_an_image_without_the_body_is_a_failure(name, image, reason):
    _, seen = observed(1)
    found = estimate(name, replace(seen, frame=replace(seen.frame, image=image)))
    assert (found.status, found.pose) == ("failed", None)
    assert reason in found.reason
    with pytest.raises(BoresightError, match="the image has shape"):
        estimate(name, replace(seen, frame=replace(seen.frame, image=image[:100])))


def test_the_frame_cuts_the_body():
    """The limb is still good, where it is in the image; what needs the whole body says why it fails."""
    truth, seen = observed(0, middle_px=(60.0, 0.0))
    for name in SIGHTS:
        assert estimate(name, seen).reason == "the frame cuts the body"
    found = estimate("limb", seen)
    error = CAMERA.project(found.pose.translation_m) - CAMERA.project(truth.translation_m)
    assert found.status == "ok" and np.linalg.norm(error) < 1.0


@pytest.mark.parametrize("size_px", [3.0, 1500.0])
def test_too_little_limb_is_a_failure(size_px):
    assert "fewer than points_min 12 points of the lit limb" in estimate("limb", observed(1, size_px)[1]).reason


def test_a_star_is_not_taken_for_a_small_body():
    """It is larger than the body, and fifty pixels from where the prior has the body."""
    truth, seen = observed(1, size_px=3.0)
    u, v = (int(value) for value in CAMERA.project(truth.translation_m))
    image = seen.frame.image.copy()
    image[v - 2 : v + 3, (u + 70) % 150 : (u + 70) % 150 + 5] = 4000.0
    found = estimate("centroid", replace(seen, frame=replace(seen.frame, image=image)))
    assert np.linalg.norm(CAMERA.project(found.pose.translation_m) - CAMERA.project(truth.translation_m)) < 0.3


@pytest.mark.parametrize("name", METHODS)
def test_the_other_of_two_bodies_is_never_the_answer(name):
    """It has four times the body's area, and is nearer to where the prior has the body; then it is alone."""
    other = np.hypot(*(np.mgrid[: CAMERA.height_px, : CAMERA.width_px] + 0.5 - np.array([64.0, 80.0])[:, None, None]))
    ok = 0
    for trial in range(6):
        truth, seen = observed(trial, size_px=30.0, middle_px=(48.0, 0.0), phase_deg=(20.0, 80.0))
        covariance = seen.frame.prior_covariance.copy()
        covariance[3:5, 3:5] *= 25.0
        for image in (seen.frame.image, np.full_like(seen.frame.image, np.median(seen.frame.image))):
            frame = replace(seen.frame, image=np.where(other < 24.0, 2000.0, image).astype(np.float32))
            found = estimate(name, replace(seen, frame=replace(frame, prior_covariance=covariance)))
            if image is not seen.frame.image:
                assert "it is another one" in found.reason
            elif found.status == "ok":
                error = CAMERA.project(found.pose.translation_m) - CAMERA.project(truth.translation_m)
                assert np.linalg.norm(error) < 3.0, trial
                ok += 1
    assert ok >= 5


def test_the_limb_of_a_body_larger_than_the_frame():
    """A part of the limb is fitted from the prior: the horizon of an ellipsoid through it was up to 6 px away."""
    for trial in range(TRIALS):
        truth, seen = observed(trial, 260.0)
        found = estimate("limb", seen)
        error = CAMERA.project(found.pose.translation_m) - CAMERA.project(truth.translation_m)
        along = CAMERA.jacobian(truth.translation_m)
        square = error @ np.linalg.solve(along @ found.covariance[3:, 3:] @ along.T, error) / 2.0
        # The largest error is that of 14 points.
        assert found.status == "ok" and np.linalg.norm(error) < 1.2 and square < 2.5, trial


@pytest.mark.parametrize("turn_rad", [np.pi / 2.0, np.pi])
def test_the_limb_of_another_shape_is_a_failure(turn_rad):
    """No place brings its outline onto the limb, and a wrong one with a small covariance would be worse than none."""
    reasons = []
    for trial in range(TRIALS):
        _, seen = observed(trial, 260.0)
        turned = seen.frame.prior_T_cam_body.perturbed(np.array([0.0, 0.0, turn_rad]), np.zeros(3))
        found = estimate("limb", replace(seen, frame=replace(seen.frame, prior_T_cam_body=turned)))
        reasons.append(found.reason if found.status == "failed" else "solved")
    assert reasons.count("solved") <= 1
    if turn_rad > 2.0:
        assert any("it is that of another shape" in reason for reason in reasons)


def test_a_misfit_of_the_limb_is_a_failure():
    """With the right shape it is far below the default."""
    _, seen = observed(0, 260.0)
    assert estimate("limb", seen).diagnostics["residual_px"] < 0.3
    strict = LimbEstimator(BODY, LimbOptions(misfit_px=0.02)).estimate(seen, rng=np.random.default_rng(0))
    assert strict.status == "failed" and strict.reason.endswith("more than misfit_px")
