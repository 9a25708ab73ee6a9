"""Components of pose errors against hand-made poses: each in the true camera's own axis."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.campaign.trial.score import pose_error, pose_errors
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.scenarios.geometry import Pose

# x of the camera along y of the body, y along z, and the boresight along x: no two axes share a name.
R_CAM_BODY = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
TRUE = Pose(R_CAM_BODY, np.array([10.0, 20.0, 2000.0]))


def moved(offset_body_m):
    """Return the true camera moved in the body frame, and turned by 90 deg about its boresight."""
    position = TRUE.camera_position_m + np.asarray(offset_body_m)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ R_CAM_BODY
    return Pose(turned, -turned @ position)


@pytest.mark.parametrize(
    ("offset_body_m", "in_camera_m"),
    [((0.0, 3.0, 0.0), (3.0, 0.0, 0.0)), ((0.0, 0.0, 4.0), (0.0, 4.0, 0.0)), ((5.0, 0.0, 0.0), (0.0, 0.0, 5.0))],
)
def test_an_error_along_a_body_axis_is_along_the_camera_axis_that_points_there(offset_body_m, in_camera_m):
    """Neither in body axes, nor in those of the estimated camera, which is turned."""
    found = pose_error(moved(offset_body_m), TRUE)
    assert [found[f"position_error_{axis}_m"] for axis in "xyz"] == pytest.approx(in_camera_m, abs=1e-9)
    assert found["position_error_m"] == pytest.approx(np.linalg.norm(offset_body_m))
    assert found["attitude_error_deg"] == pytest.approx(90.0)


def test_many_poses_are_scored_as_one_by_one():
    offsets = np.random.default_rng(1).normal(size=(5, 3))
    estimated = [moved(offset) for offset in offsets]
    stacks = [
        PoseStack(np.stack([p.rotation for p in poses]), np.stack([p.translation_m for p in poses]))
        for poses in (estimated, [TRUE] * 5)
    ]
    found = pose_errors(*stacks)
    for i, one in enumerate(estimated):
        for name, value in pose_error(one, TRUE).items():
            assert found[name][i] == pytest.approx(value)
