"""Centroiding as an estimator, on balls whose images are drawn by formula."""

import numpy as np
import pytest
from pydantic import ValidationError
from test_landmark_centroid import CAMERA, RADIUS_M, Ball, disc

from boresight.estimators.approach.centroid import CENTROID, CentroidEstimator, CentroidOptions
from boresight.estimators.dense.photometric import PhotometricOptions
from boresight.scenarios.bodies.embedded import icosphere
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose
from boresight.scenarios.observation import Frame, Observation

TRUTH = Pose(np.eye(3), np.array([15.0, -20.0, 1500.0]))


def observed(shift_m=(0.0, 0.0, 0.0), image=None):
    """A ball at the truth, and a prior that is wrong by a shift."""
    seen = CAMERA.project(TRUTH.translation_m)
    ball = disc(*seen, CAMERA.fx_px * RADIUS_M / TRUTH.translation_m[2])
    prior = TRUTH.perturbed(np.zeros(3), np.array(shift_m))
    frame = Frame(
        image=100.0 * ball if image is None else image,
        sun_dir_cam=np.array([0.0, 0.0, -1.0]),
        prior_T_cam_body=prior,
        prior_covariance=np.diag([0.0] * 3 + [50.0**2] * 2 + [1.0]),
        time_s=0.0,
    )
    return Observation(CAMERA, frame)


def estimate(observation, **options):
    wanted = CentroidOptions(blur_px=0.0, **options)
    aligner = CentroidEstimator(Ball(), icosphere(3, RADIUS_M), RADIUS_M, wanted, CENTROID)
    return aligner.estimate(observation, rng=np.random.default_rng(0))


@pytest.mark.parametrize("shift_m", [(30.0, 0.0, 0.0), (-25.0, 40.0, 3.0)])
def test_offsets_are_observed_minus_rendered_at_the_prior(shift_m):
    found = estimate(observed(shift_m), alignment_loop={"tolerance_px": 0.05})
    numbers = found.diagnostics
    expected = CAMERA.project(TRUTH.translation_m) - CAMERA.project(TRUTH.translation_m + np.array(shift_m))
    assert (numbers["centroid_du_px"], numbers["centroid_dv_px"]) == pytest.approx(tuple(expected), abs=0.05)
    assert numbers["centroid_offset_px"] == pytest.approx(np.linalg.norm(expected), abs=0.05)
    assert found.status == "ok"
    across = found.pose.translation_m - TRUTH.translation_m
    np.testing.assert_allclose(across[:2], 0.0, atol=0.3)
    np.testing.assert_array_equal(found.pose.rotation, TRUTH.rotation)
    assert [stage.name for stage in found.stages] == ["centroid"]


def test_without_an_error_nothing_moves():
    found = estimate(observed())
    assert found.diagnostics["centroid_offset_px"] < 1e-3
    assert found.diagnostics["centroid_iterations"] == 1


def test_the_extent_is_that_of_the_disc():
    """A ball's disc is as long as it is wide: both measures give its diameter, to the pixels that it cuts."""
    diameter = 2.0 * CAMERA.fx_px * RADIUS_M / TRUTH.translation_m[2]
    numbers = estimate(observed()).diagnostics
    assert numbers["extent_px"] == pytest.approx(diameter, abs=2.0)
    assert numbers["diameter_px"] == pytest.approx(diameter, abs=1.5)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.zeros((200, 256), np.float32), "the image is black"),
        (np.full((200, 256), np.nan, np.float32), "NaN or infinite pixels"),
    ],
)
def test_a_hopeless_image_is_a_failure_with_a_reason(image, reason):
    found = estimate(observed(image=image))
    assert found.status == "failed"
    assert reason in found.reason
    assert found.pose is None


def test_the_body_is_found_where_the_prior_is_out_of_view():
    found = estimate(observed((900.0, 0.0, 0.0)))
    np.testing.assert_allclose(found.pose.translation_m[:2], TRUTH.translation_m[:2], atol=1.0)


def test_a_prior_behind_the_camera_is_a_failure_with_a_reason():
    assert "it is another one" in estimate(observed((0.0, 0.0, -3000.0))).reason  # its side there is dark


def test_an_image_of_another_size_is_refused():
    with pytest.raises(BoresightError, match="the image has shape"):
        estimate(observed(image=np.ones((100, 256), np.float32)))


@pytest.mark.parametrize(
    ("options", "what"), [({"database": {}}, "has no use"), ({"shape": "landmark-mesh"}, "give database")]
)
@pytest.mark.parametrize("model", [CentroidOptions, PhotometricOptions])
def test_a_data_base_is_that_of_the_landmark_mesh(model, options, what):
    with pytest.raises(ValidationError, match=what):
        model(**options)
