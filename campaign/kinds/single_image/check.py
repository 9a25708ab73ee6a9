"""Validation of an estimate before it is scored: an invalid one would distort the statistics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from boresight.campaign.trial.checks import (
    MOST,
    check_array,
    check_covariance,
    check_indices,
    check_name,
    check_names,
    check_numbers,
    check_seconds,
    check_semidefinite,
    check_several,
    check_status,
    check_type,
)
from boresight.estimators.contract import Estimate, Stage, Table
from boresight.scenarios.geometry import Pose

LANDMARK_NUMBERS = (
    *("u_px", "v_px", "x_m", "y_m", "z_m"),
    *("sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2"),
)
"""Columns of the details ``landmarks`` beside ``landmark``: corner, mean and covariance."""

_RIGID = 1e-6
_MOST_PX = 1e6
_PARAMETERS = 6


def check(estimate: Estimate) -> None:
    """Refuse an estimate that does not keep the contract.

    Raises
    ------
    ValueError
        If it is none, the status or the reason is none, it is ok without a pose, or a number is not finite or of an
        impossible size.
    """
    check_type(estimate, Estimate)
    check_status(estimate.status, estimate.reason)
    check_several("stages", estimate.stages)
    for stage in estimate.stages:
        check_type(stage, Stage)
        check_name("a stage", stage.name)
        _check_pose(stage.T_cam_body, f"the pose after {stage.name}")
    check_numbers(estimate.diagnostics, "diagnostics", texts=True)
    if isinstance(estimate.diagnostics.get("n_landmarks"), str):
        raise ValueError("diagnostics: n_landmarks is a text")  # noqa: TRY004  every invalid result is a ValueError
    check_seconds(estimate.timings_s, "timings_s")
    _check_details(estimate.details)
    _check_solution(estimate)


def _check_solution(estimate: Estimate) -> None:
    """Refuse a pose and covariances that are none, also of an estimate that failed, and an ok one without a pose."""
    if estimate.pose is not None:
        _check_pose(estimate.pose, "the pose")
    elif estimate.status == "ok":
        raise ValueError("an ok estimate has no pose")
    for what, matrix in (("covariance", estimate.covariance), ("bound", estimate.bound)):
        if matrix is not None:
            check_covariance(f"a {what}", matrix, _PARAMETERS)


def _check_pose(pose: Pose, which: str) -> None:
    check_type(pose, Pose)
    check_type(pose.rotation, np.ndarray)
    check_type(pose.translation_m, np.ndarray)
    if (pose.to_frame, pose.from_frame) != ("cam", "body"):
        raise ValueError(f"{which} is T_{pose.to_frame}_{pose.from_frame}, not T_cam_body")
    residual = np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max()
    possible = np.abs(pose.translation_m).max() <= MOST
    if not (possible and residual < _RIGID and np.linalg.det(pose.rotation) > 0):
        raise ValueError(f"{which} is not rigid: rotation off by {residual:.1e}, translation {pose.translation_m}")


def _check_details(details: Mapping[str, Table]) -> None:
    """Refuse tables that are not arrays by name, and recognised landmarks that cannot be scored."""
    check_names("details", details)
    for name, table in details.items():
        check_names(f"details: {name}", table)
        for column, values in table.items():
            if not isinstance(values, np.ndarray) or values.dtype.kind not in "biufU":
                raise ValueError(f"details: {name}: {column} is no array of numbers or texts")
    if "landmarks" in details:
        _check_landmarks(details["landmarks"])


def _check_landmarks(table: Table) -> None:
    """Refuse recognised landmarks that cannot be scored: columns, their lengths, and covariances."""
    n = len(table["landmark"]) if "landmark" in table else -1
    missing = [name for name in ("landmark", *LANDMARK_NUMBERS) if name not in table]
    if missing and n != 0:
        raise ValueError(f"details: landmarks: columns are missing: {', '.join(missing)}")
    if n == 0:
        return
    check_indices("details: landmarks: landmark", table["landmark"], (n,))
    for name in LANDMARK_NUMBERS:
        most = _MOST_PX if name.endswith("_px") else MOST**2
        check_array(f"details: landmarks: {name}", table[name], (n,), most)
    xx, xy, xz, yy, yz, zz = (np.asarray(table[name], dtype=np.float64) for name in LANDMARK_NUMBERS[5:])
    covariances = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    check_semidefinite("details: landmarks: a covariance", covariances)
    try:
        np.linalg.inv(covariances)
    except np.linalg.LinAlgError:
        raise ValueError("details: landmarks: a covariance is singular") from None
