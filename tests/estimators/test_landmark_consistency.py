"""The check of a solution by the brightness centroid of the rendered mesh, and the image correlation."""

import cv2
import numpy as np
import pytest

from boresight.estimators.landmark.alignment import (
    MeshView,
    centroid_residual_px,
    consistency_failure,
    image_correlation,
)
from boresight.estimators.landmark.signal import extract_signal
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.bodies import load_body
from boresight.scenarios.geometry import Camera, look_at
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.brdf import LambertSpec

CAMERA = Camera.from_fov(256, 256, np.radians(18.3))
SUN_CAM = np.array([0.5, 0.2, -0.84]) / np.linalg.norm([0.5, 0.2, -0.84])
POSE = look_at(np.array([1500.0, 900.0, 970.0]))


@pytest.fixture(scope="module")
def view():
    return MeshView(CAMERA, MitsubaRenderer(load_body(BodySpec(), ()).mesh, LambertSpec()), SUN_CAM)


def test_the_true_pose_leaves_nothing(view):
    observed = extract_signal(view.render(POSE), (0.0, 0.0)).image
    assert centroid_residual_px(observed, POSE, view) == 0.0


@pytest.mark.parametrize("shift_m", [(40.0, 0.0, 0.0), (-25.0, 60.0, 0.0), (0.0, 0.0, 200.0)])
def test_a_wrong_pose_leaves_the_distance_of_the_centroids(view, shift_m):
    """Against OpenCV's moments of the two renderings, signal for signal."""
    observed = extract_signal(view.render(POSE), (0.0, 0.0)).image
    wrong = POSE.perturbed(np.zeros(3), np.array(shift_m))
    centroids = []
    for image in (observed, extract_signal(view.render(wrong), (0.0, 0.0)).image):
        moments = cv2.moments(image)
        centroids.append(np.array([moments["m10"], moments["m01"]]) / moments["m00"])
    expected = np.linalg.norm(centroids[0] - centroids[1])
    assert centroid_residual_px(observed, wrong, view) == pytest.approx(expected, rel=1e-4, abs=1e-4)
    across_px = np.linalg.norm(shift_m[:2]) * CAMERA.fx_px / np.linalg.norm(POSE.translation_m)
    assert expected == pytest.approx(across_px, abs=0.1 * across_px + 2.0)


def test_a_mesh_out_of_view_has_no_centroid(view):
    observed = extract_signal(view.render(POSE), (0.0, 0.0)).image
    assert centroid_residual_px(observed, POSE.perturbed(np.zeros(3), np.array([3000.0, 0.0, 0.0])), view) is None


def test_the_likeness_is_greatest_at_the_true_pose(view):
    observed = extract_signal(view.render(POSE), (0.0, 0.0)).image
    assert image_correlation(observed, POSE, view) == pytest.approx(1.0)
    turned = POSE.perturbed(np.array([0.0, 0.0, 0.05]), np.zeros(3))
    shifted = (POSE.perturbed(np.zeros(3), np.array([x, 0.0, 0.0])) for x in (5, 50))
    nearer, farther = (image_correlation(observed, pose, view) for pose in shifted)
    assert 1.0 > nearer > farther > 0.0
    assert image_correlation(observed, turned, view) < 1.0
    assert image_correlation(observed, POSE.perturbed(np.zeros(3), np.array([3000.0, 0.0, 0.0])), view) == -1.0


@pytest.mark.parametrize(
    ("residual", "limit", "says"),
    [(3.0, None, ""), (None, None, ""), (3.0, 3.0, ""), (3.1, 3.0, "3.1 px from"), (None, 3.0, "out of view")],
)
def test_only_what_exceeds_a_limit_fails(residual, limit, says):
    reason = consistency_failure(residual, limit)
    assert says in reason
    assert bool(reason) is bool(says)
