"""Scores that several kinds of trial share: errors of a pose, and matches of detected craters with the true ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.campaign.trial.checks import check_array, check_type
from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.landmark.pose.posterior import pose_offset
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.craters.truth import LEAST_DIAMETER_PX, CraterTruth
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses, Pose, View
from boresight.scenarios.geometry.pose import plane_axes
from boresight.scenarios.load import LoadedScenario

_QUATERNION, _TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")

CENTRE_RADII, CENTRE_PX = 0.3, 1.5
"""A match's centre lies within the larger of these."""

LOG_RADIUS = 0.36
"""A match's radius differs by less than this in its logarithm."""

_MOST_PX = 1e6
_MOST_UNLISTED = 0.5  # share of the craters of detectable size

NONE = -1


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
    estimated: Pose,
    true: Pose,
    covariance: FloatArray | None,
    bound: FloatArray | None,
    true_covariance: FloatArray | None = None,
) -> dict[str, float | None]:
    """Compare an estimate's covariance with its error, of poses T_cam_body.

    ``covariance`` and ``bound`` are (6, 6) [rotation_rad, translation_m] in camera axes: the estimator's covariance and
    the Cramer-Rao bound of its observations; None where it gives none. ``true_covariance`` (6, 6) is that of ``true``,
    if that is a reference that errs itself. Of the result, ``nees`` is e^T P^-1 e with 6 degrees of freedom, for e in
    est = true.perturbed(e) and P the sum of the covariances of both; ``sight_nees`` the same with 2 degrees of freedom,
    of e across the direction to the body's origin; ``position_sigma_m`` and ``attitude_sigma_deg``
    are the RMS errors of the camera in the body and of the attitude that the estimator's covariance predicts, and
    ``position_bound_m`` and ``attitude_bound_deg`` those of the bound.
    """
    position_sigma_m, attitude_sigma_deg = _foretold(covariance, estimated)
    position_bound_m, attitude_bound_deg = _foretold(bound, estimated)
    total = covariance if covariance is None or true_covariance is None else covariance + true_covariance
    offset = pose_offset(true, estimated)
    sight = true.translation_m / np.linalg.norm(true.translation_m)
    across = np.concatenate(plane_axes(sight[None]))
    return {
        "nees": nees(offset, total),
        "sight_nees": nees(across @ offset[3:], None if total is None else across @ total[3:, 3:] @ across.T),
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


MEASURES = ("position_m", "attitude_deg", "sight_urad", "range_m")
"""Predicted errors: of the camera in the body and of the attitude, as scored; of the direction to the body's origin in
camera axes, and of its distance."""


def predicted_errors(covariance: FloatArray, pose: Pose) -> dict[str, float]:
    """RMS errors by `MEASURES` of a covariance (6, 6), [rotation_rad, translation_m] in camera axes, at T_cam_body."""
    position_m, attitude_deg = _foretold(covariance, pose)
    range_m = float(np.linalg.norm(pose.translation_m))
    sight = pose.translation_m / range_m
    along_m2, whole_m2 = float(sight @ covariance[3:, 3:] @ sight), float(np.trace(covariance[3:, 3:]))
    across_m = np.sqrt(max(whole_m2 - along_m2, 0.0))
    values = position_m, attitude_deg, 1e6 * across_m / range_m, np.sqrt(max(along_m2, 0.0))
    return dict(zip(MEASURES, map(float, values), strict=True))


def measured_errors(row: Mapping[Any, Any]) -> dict[str, float]:
    """Errors by `MEASURES` of a row of a finished run; those that its kind of trial has."""
    found = {
        name: row.get(column)
        for name, column in zip(MEASURES, ("position_error_m", "attitude_error_deg"), strict=False)
    }
    if np.isfinite([row.get("true_tx_m", np.nan), row.get("tx_m", np.nan)]).all():
        estimated, true = pose_of(row).translation_m, pose_of(row, "true_").translation_m
        range_m = float(np.linalg.norm(true))
        along_m = float((estimated - true) @ true) / range_m
        across_m = np.sqrt(max(float(np.sum((estimated - true) ** 2)) - along_m**2, 0.0))
        found |= {"sight_urad": 1e6 * across_m / range_m, "range_m": along_m}
    return {name: float(value) for name, value in found.items() if value is not None and np.isfinite(value)}


def check_listed(scenario: LoadedScenario) -> None:
    """Refuse a truth that leaves most detectable craters out: when found, they would count as false alarms.

    Raise BoresightError if more than half of the craters that are large enough at the range of the views are not
    listed.
    """
    craters, m_per_px = scenario.spec.craters, scenario.spec.m_per_px
    if craters is None or m_per_px is None:
        return
    least_m = LEAST_DIAMETER_PX * m_per_px
    unlisted = craters.unlisted_share(least_m)
    if unlisted > _MOST_UNLISTED:
        raise BoresightError(
            f"{scenario.path}: craters.known_diameter_m: {craters.listed_from_m:g} m is"
            f" {craters.listed_from_m / m_per_px:.3g} px at the range of the views, and {100.0 * unlisted:.0f} % of the"
            f" craters of {LEAST_DIAMETER_PX:g} px or more would not be listed in the truth: leave the key out, or give"
            f" at most {least_m:.3g}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class DetectionMatches:
    """Classification of each of m detections.

    ``crater`` (m,) is the row of the true crater that it stands for, -1 for a false alarm. ``duplicate`` (m,) marks
    false alarms that fit a crater which a more confident detection stands for.
    """

    crater: IndexArray
    duplicate: BoolArray


def match_detections(found: Ellipses, true: Ellipses) -> DetectionMatches:
    """Match detections, the most confident first, with all craters of an image, one to one.

    A detection takes the nearest crater that is left of those that it fits: the centres within max(0.3 r, 1.5 px), r
    the crater's radius, and the logarithm of the ratio of the radii within 0.36 of 0. As the more confident choose
    first, what a detection is does not depend on where a threshold is put below it.
    """
    crater = np.full(len(found), NONE, dtype=np.int64)
    duplicate = np.zeros(len(found), dtype=bool)
    if len(true) == 0:
        return DetectionMatches(crater, duplicate)
    apart = np.linalg.norm(found.centre_px[:, None] - true.centre_px, axis=2)
    limit = np.maximum(CENTRE_RADII * true.radius_px, CENTRE_PX)
    ratio = np.abs(np.log(found.radius_px[:, None] / true.radius_px))
    cost = np.where((apart <= limit) & (ratio < LOG_RADIUS), (apart / limit) ** 2 + (ratio / LOG_RADIUS) ** 2, np.inf)
    for row in range(len(found)):
        nearest = int(np.argmin(cost[row]))
        if np.isfinite(cost[row, nearest]):
            crater[row] = nearest
            # Those that come later fit it as well, but only as duplicates.
            duplicate[row + 1 :] |= np.isfinite(cost[row + 1 :, nearest])
            cost[row + 1 :, nearest] = np.inf
    return DetectionMatches(crater, duplicate & (crater == NONE))


def identified(found: Ellipses, truth: CraterTruth) -> IndexArray:
    """Return the numbers (m,) of the true craters that detections stand for; ``NO_CRATER`` for a false alarm."""
    # The last of the numbers is that of no crater, which is row -1 as well.
    numbers = np.append(truth.crater, NO_CRATER).astype(np.int64)
    return np.asarray(numbers[match_detections(found, truth.ellipses).crater])


def ellipse_errors(found: Ellipses, true: Ellipses) -> dict[str, FloatArray]:
    """Errors (k,), px, of k ellipses against k true ones: centre, its coordinates, and the two semi-axes."""
    offset = found.centre_px - true.centre_px
    axes = found.semi_axes_px - true.semi_axes_px
    return {
        "centre_error_px": np.linalg.norm(offset, axis=1),
        "centre_error_u_px": offset[:, 0],
        "centre_error_v_px": offset[:, 1],
        "major_error_px": axes[:, 0],
        "minor_error_px": axes[:, 1],
    }


def check_detections(found: CraterDetections) -> None:
    """Refuse detections that do not keep the contract.

    Raise `ValueError` if it is none, lengths differ, a number is not finite or of an impossible size, axes are not
    positive with the longer first, or the confidence ascends.
    """
    check_type(found, CraterDetections)
    check_type(found.ellipses, Ellipses)
    ellipses, confidence = found.ellipses, np.asarray(found.confidence)
    n = len(ellipses)
    check_array("the centres of detections", ellipses.centre_px, (n, 2), _MOST_PX)
    check_array("the axes of detections", ellipses.semi_axes_px, (n, 2), _MOST_PX)
    check_array("the angles of detections", ellipses.angle_rad, (n,))
    check_array("the confidence of detections", confidence, (n,))
    if np.any(ellipses.semi_axes_px[:, 1] <= 0.0) or np.any(np.diff(ellipses.semi_axes_px, axis=1) > 0.0):
        raise ValueError("semi-axes of detections must be positive, the longer one first")
    if np.any(np.diff(confidence) > 0.0):
        raise ValueError("detections must come in the order of their confidence, the most confident first")
