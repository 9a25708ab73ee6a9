"""Scores of a pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.estimators.landmark.pose.posterior import pose_offset
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Pose, View

_QUATERNION, _TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")


def nees(error: FloatArray, covariance: FloatArray | None) -> float | None:
    """Return e^T P^-1 e, which has a chi-square distribution with as many degrees of freedom as e has components.

    The error (n,) is in any units, the covariance (n, n) in the same. The result is None where the covariance is
    missing or not positive definite, as where something is known perfectly.
    """
    if covariance is None:
        return None
    # Scaled first: square radians and square metres are ten orders of magnitude apart.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    try:
        factor = np.linalg.cholesky(covariance * np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return None
    white = np.linalg.solve(factor, scale * error)
    return float(white @ white)


def pose_error(estimated: Pose, true: Pose) -> dict[str, float]:
    """Score T_cam_body against the truth.

    ``position_error_m`` is the length of c_est - c_true, the camera's position in the body frame, m;
    ``position_error_{x,y,z}_m`` is R_true (c_est - c_true), the same in the true camera's axes. ``attitude_error_deg``
    is the angle of the rotation between the attitudes. This is the metric of Rowell et al. (2015), section 3.4.4: an
    attitude error moves the camera about the body.
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


def view_columns(view: View) -> dict[str, float]:
    """Describe a view: the distance of the camera from the body's origin, and the phase angle there."""
    range_m = float(np.linalg.norm(view.T_cam_body.translation_m))
    return {"range_m": range_m, "phase_deg": float(np.degrees(view.phase_angle_rad))}


def pose_columns(pose: Pose, prefix: str = "") -> dict[str, float]:
    """Write T_cam_body as columns: its unit quaternion and its translation."""
    parts = zip((*_QUATERNION, *_TRANSLATION), (*pose.quat_wxyz, *pose.translation_m), strict=True)
    return {f"{prefix}{name}": float(value) for name, value in parts}


def pose_of(columns: Mapping[Any, Any], prefix: str = "") -> Pose:
    """Read T_cam_body back from its columns."""
    quat_wxyz, translation_m = (
        np.array([columns[f"{prefix}{name}"] for name in names]) for names in (_QUATERNION, _TRANSLATION)
    )
    return Pose.from_quat_wxyz(quat_wxyz, translation_m)


def pose_errors(estimated: PoseStack, true: PoseStack) -> dict[str, FloatArray]:
    """Score B poses against their truths: ``pose_error`` side by side, (B,) under each of its keys."""
    in_body = estimated.camera_positions_m - true.camera_positions_m
    in_camera = np.einsum("bij,bj->bi", true.rotations, in_body)
    turn = Rotation.from_matrix(np.einsum("bij,bkj->bik", estimated.rotations, true.rotations))
    return {
        "position_error_m": np.linalg.norm(in_body, axis=1),
        "attitude_error_deg": np.degrees(turn.magnitude()),
        "position_error_x_m": in_camera[:, 0],
        "position_error_y_m": in_camera[:, 1],
        "position_error_z_m": in_camera[:, 2],
    }


def consistency(
    estimated: Pose, true: Pose, covariance: FloatArray | None, bound: FloatArray | None
) -> dict[str, float | None]:
    """Compare an estimate's covariance with its error, of poses T_cam_body.

    ``covariance`` and ``bound`` are (6, 6) [rotation_rad, translation_m] in camera axes: the estimator's covariance and
    the Cramer-Rao bound of its observations; None where it gives none. Of the result, ``nees`` is e^T P^-1 e with 6
    degrees of freedom, for e in est = true.perturbed(e); ``position_sigma_m`` and ``attitude_sigma_deg`` are the RMS
    errors of the camera in the body and of the attitude that the covariance foretells, and ``position_bound_m`` and
    ``attitude_bound_deg`` those of the bound.
    """
    position_sigma_m, attitude_sigma_deg = _foretold(covariance, estimated)
    position_bound_m, attitude_bound_deg = _foretold(bound, estimated)
    return {
        "nees": nees(pose_offset(true, estimated), covariance),
        "position_sigma_m": position_sigma_m,
        "attitude_sigma_deg": attitude_sigma_deg,
        "position_bound_m": position_bound_m,
        "attitude_bound_deg": attitude_bound_deg,
    }


def _foretold(covariance: FloatArray | None, pose: Pose) -> tuple[float | None, float | None]:
    """Return the RMS position error (m) and attitude error (deg) of a (6, 6) covariance about a pose.

    The camera stands at c = -R^T t in the body, so in camera axes its error is w x t - d for a pose that is wrong by
    the rotation w and the translation d.
    """
    if covariance is None:
        return None, None
    x, y, z = pose.translation_m
    cross_t = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    jacobian = np.hstack([-cross_t, -np.eye(3)])
    position_m2 = float(np.trace(jacobian @ covariance @ jacobian.T))
    attitude_rad2 = float(np.trace(covariance[:3, :3]))
    return float(np.sqrt(max(position_m2, 0.0))), float(np.degrees(np.sqrt(max(attitude_rad2, 0.0))))
