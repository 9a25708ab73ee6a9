"""Where truth and estimate meet: the errors of a pose."""

from __future__ import annotations

import numpy as np

from scenarios.geometry import Pose


def pose_error(estimated: Pose, true: Pose) -> dict[str, float]:
    """Score T_cam_body against the truth.

    Returns
    -------
    dict
        ``position_error_m``: length of c_est - c_true, the camera's position in the body frame, m;
        ``position_error_{x,y,z}_m``: R_true (c_est - c_true), the same in the true camera's axes;
        ``attitude_error_deg``: angle of the rotation between the attitudes. This is the metric of
        Rowell et al. (2015), section 3.4.4: an attitude error moves the camera about the body.
    """
    in_body = estimated.camera_position_m - true.camera_position_m
    in_camera = true.rotate(in_body)
    return {
        "position_error_m": float(np.linalg.norm(in_body)),
        "attitude_error_deg": float(np.degrees(estimated.angle_to(true))),
        "position_error_x_m": float(in_camera[0]),
        "position_error_y_m": float(in_camera[1]),
        "position_error_z_m": float(in_camera[2]),
    }


def no_pose_error() -> dict[str, float | None]:
    """Return the same keys without a value, for an estimate that failed."""
    keys = ("position_error_m", "attitude_error_deg", "position_error_x_m", "position_error_y_m", "position_error_z_m")
    return dict.fromkeys(keys)
