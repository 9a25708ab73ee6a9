"""What an estimate must be before it is scored: rubbish would poison the statistics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimators.contract import Estimate
from scenarios.geometry import Pose
from scenarios.observation import Observation

_RIGID = 1e-6


def check(estimate: Estimate, observation: Observation) -> None:
    """Refuse an estimate that does not keep the contract.

    Raises
    ------
    ValueError
        If the status or the reason is none, poses or covariances are not those of the frames, or a number is not
        finite.
    """
    if estimate.status not in {"ok", "failed"}:
        raise ValueError(f"status is {estimate.status!r}, not ok or failed")
    if not isinstance(estimate.reason, str) or (estimate.status == "failed" and not estimate.reason):
        raise ValueError(f"a {estimate.status} estimate gives as its reason {estimate.reason!r}")
    for stage in estimate.stages:
        _check_pose(stage.T_cam_body, f"after {stage.name}")
    _check_numbers(estimate.diagnostics, "diagnostics")
    _check_numbers(estimate.timings_s, "timings_s")
    if estimate.status == "ok":
        _check_solution(estimate, len(observation.frames))


def _check_solution(estimate: Estimate, frames: int) -> None:
    if len(estimate.poses) != frames:
        raise ValueError(f"{len(estimate.poses)} poses for {frames} frames")
    for index, pose in enumerate(estimate.poses):
        _check_pose(pose, f"of frame {index}")
    for what, matrices in (("covariance", estimate.covariances), ("bound", estimate.bounds)):
        if matrices and len(matrices) != frames:
            raise ValueError(f"{len(matrices)} {what}s for {frames} frames")
        for matrix in matrices:
            if np.shape(matrix) != (6, 6) or not np.isfinite(matrix).all():
                raise ValueError(f"a {what} of shape {np.shape(matrix)} is not (6, 6) of finite numbers")


def _check_pose(pose: Pose, which: str) -> None:
    residual = np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max()
    if not (np.isfinite(pose.translation_m).all() and residual < _RIGID and np.linalg.det(pose.rotation) > 0):
        raise ValueError(
            f"the pose {which} is not rigid: rotation off by {residual:.1e}, translation {pose.translation_m}"
        )


def _check_numbers(numbers: Mapping[str, float | int | str], what: str) -> None:
    for name, value in numbers.items():
        if not isinstance(value, str) and not np.isfinite(value):
            raise ValueError(f"{what}: {name} is {value}")
