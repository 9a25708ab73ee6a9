"""The estimator ``approach``: which method answers, by the size that the prior predicts and by what fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boresight.estimators.options import OptionsError
from boresight.estimators.registry import Base, bases_of, can_predict, estimator_class, with_bases
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.bodies.embedded import EMBEDDED
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, look_at
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.brdf import LambertSpec

CAMERA = Camera(120, 90, 1000.0, 1000.0, 60.0, 45.0)
BODY = EMBEDDED["contact-binary"]()
RENDERER = MitsubaRenderer(BODY, LambertSpec(), 4, variant=choose_variant())


class Assets:
    """The onboard model is the truth."""

    camera = CAMERA

    def shape(self):
        return BODY

    def mesh_renderer(self, mesh, samples_per_pixel=1, *, other_law=False):
        return MitsubaRenderer(mesh, LambertSpec(), samples_per_pixel, variant=choose_variant())


def seen(size_px: float, predicted_px: float | None = None, middle_px: float = 0.0) -> Observation:
    """A body whose sphere has a diameter in the image, at a phase angle of 50 deg; the prior may have another range."""
    range_m, sun = 2000.0 * BODY.radius_m / size_px, np.array([0.766, 0.0, -0.643])
    truth = look_at(range_m * np.array([0.6, 0.0, 0.8]), 0.4)
    truth = truth.perturbed(np.zeros(3), np.array([middle_px, 0.0, 0.0]) * range_m / 1000.0)
    image = RENDERER.render(View(CAMERA, truth, truth.rotation.T @ sun)) * 3000.0
    image += np.random.default_rng(3).normal(20.0, 2.0, image.shape).astype(np.float32)
    prior = Pose(truth.rotation, truth.translation_m * (1.0 if predicted_px is None else size_px / predicted_px))
    sigmas = np.array([1e-3] * 3 + [5e-3 * range_m] * 2 + [0.2 * range_m])
    return Observation(CAMERA, Frame(image, sun, prior, np.diag(sigmas**2)))


def answer(name: str, observation: Observation, **options: object):
    return estimator_class(name).from_options(options, Assets()).estimate(observation, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("predicted_px", "method"), [(31.9, "centroid"), (32.1, "limb"), (149.0, "limb"), (151.0, "prior")]
)
def test_the_size_by_the_prior_decides(predicted_px, method):
    """The body is 40 px in all images, which the method does not see; the image's diagonal is 150 px."""
    observation = seen(40.0, predicted_px)
    found = answer("approach", observation, near="prior")
    assert found.status == "ok" and found.diagnostics["method"] == method
    assert found.diagnostics["predicted_px"] == pytest.approx(predicted_px)
    assert (found.diagnostics["fallbacks"], found.diagnostics["failed_before"]) == (0, "")
    alone = answer(method, observation)
    np.testing.assert_array_equal(found.pose.translation_m, alone.pose.translation_m)
    np.testing.assert_array_equal(found.covariance, alone.covariance)


def test_the_hand_overs_and_methods_are_options():
    observation, sizes = seen(40.0), {"middle_px": 40.1}
    assert answer("approach", observation, **sizes).diagnostics["method"] == "centroid"
    assert answer("approach", observation, **sizes, far="centroid-phase").diagnostics["method"] == "centroid-phase"
    assert answer("approach", observation, middle="silhouette").diagnostics["method"] == "silhouette"
    chosen = {"middle_px": 30.0, "near_px": 39.9, "near": "prior"}
    assert answer("approach", observation, **chosen).diagnostics["method"] == "prior"


def test_the_next_coarser_one_answers_where_a_finer_one_fails():
    few = answer("approach", seen(40.0), middle_options={"points_min": 360})
    assert (few.status, few.diagnostics["method"], few.diagnostics["fallbacks"]) == ("ok", "centroid", 1)
    assert few.diagnostics["failed_before"].startswith("limb: fewer than points_min 360 points")
    near = answer("approach", seen(40.0), near_px=35.0)
    assert (near.diagnostics["method"], near.diagnostics["failed_before"]) == ("limb", "near names no estimator")


def test_the_reason_names_every_method_that_failed():
    found = answer("approach", seen(1500.0))
    assert (found.status, found.pose) == ("failed", None)
    near, limb, centroid = found.reason.split("; ")
    assert near == "near names no estimator"
    assert limb.startswith("limb: fewer than points_min 12 points")
    assert centroid == "centroid: the frame cuts the body"


def test_a_failure_of_the_far_one_alone_is_named():
    observation = seen(10.0)
    black = replace(observation, frame=replace(observation.frame, image=0.0 * observation.frame.image))
    assert (
        answer("approach", black).reason
        == "centroid: nothing is brighter than the background: the image is black, or the body fills it"
    )


@pytest.mark.parametrize(("size_px", "phase"), [(31.9, "far"), (32.1, "middle"), (49.9, "middle"), (50.1, "near")])
def test_the_prediction_is_that_of_the_method_that_is_tried_first(size_px, phase):
    """Without a near estimator the middle one is tried in its place; `centroid` has no predictor."""
    planned = seen(size_px)
    options = {one: {"bias_px": 0.1 * number} for number, one in enumerate(("far", "middle", "near"), 1)}
    of_limb = {f"{one}_options": own for one, own in options.items()}
    approach = estimator_class("approach").from_options(
        {"far": "limb", "middle": "limb", "near": "limb", "near_px": 50.0, **of_limb}, Assets()
    )
    alone = estimator_class("limb").from_options(options[phase], Assets()).predict(planned)
    np.testing.assert_array_equal(approach.predict(planned), alone)
    usual = estimator_class("approach").from_options({"near_px": 50.0}, Assets())
    limb = None if phase == "far" else estimator_class("limb").from_options({}, Assets()).predict(planned)
    np.testing.assert_equal(usual.predict(planned), limb)


@pytest.mark.parametrize(
    ("options", "able"),
    [
        ({}, True),
        ({"middle": "silhouette"}, False),
        ({"middle": "silhouette", "near": "landmark-ransac"}, True),
        ({"middle": "tuned", "middle_options": {"base": "limb"}}, False),
    ],
)
def test_it_predicts_if_one_of_its_methods_does(options, able):
    assert can_predict("approach", options) is able


def test_what_it_builds_on_is_known():
    """So digests, versions, sensors and lengths are those of these methods too."""
    assert with_bases("approach", {}) == ("approach", "centroid", "limb")
    assert with_bases("approach", {"near": None}) == ("approach", "centroid", "limb")
    options = {"middle": "silhouette", "near": "tuned", "near_options": {"base": "lmaps"}}
    assert with_bases("approach", options) == ("approach", "centroid", "silhouette", "tuned", "lmaps")
    assert bases_of("approach", options)[2] == Base("near", "tuned", "near_options", {"base": "lmaps"})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"near_px": 20.0}, "near_px: 20 is less than middle_px, 32"),
        ({"near_options": {"levels": []}}, "near_options: near names no estimator"),
        ({"middle": "limbo"}, "did you mean limb"),
    ],
)
def test_wrong_options_are_refused(options, said):
    with pytest.raises(BoresightError, match=said):
        answer("approach", seen(40.0), **options)


@pytest.mark.parametrize("phase", ["far", "middle", "near"])
def test_wrong_options_of_a_method_are_located(phase):
    with pytest.raises(OptionsError, match="no_such") as caught:
        answer("approach", seen(40.0), **{phase: "centroid", f"{phase}_options": {"no_such": 1}})
    assert caught.value.sections == (f"{phase}_options",)
