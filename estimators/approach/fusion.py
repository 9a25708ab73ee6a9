"""Fusion of a measured position with the prior's pose, whose attitude stays; covariances of what is measured."""

from __future__ import annotations

import numpy as np

from boresight.estimators.contract import Estimate
from boresight.estimators.prior import floor_variances
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.observation import Observation


def fuse(
    observation: Observation,
    measured: FloatArray,
    by_pose: FloatArray,
    covariance: FloatArray,
    common: FloatArray | None = None,
    considered: FloatArray | None = None,
) -> Estimate:
    """Update the prior's translation by a measurement, and return the pose with its covariance as an estimate.

    ``measured`` (k,) is z = H [w, d] + noise for the error [rotation_rad, translation_m] of the prior, H being
    ``by_pose`` (k, 6) and ``covariance`` (k, k) that of the noise, any units; ``common`` (k,)
    is one standard deviation of the part of the noise that all images share. The attitude is considered and not
    estimated (Schmidt 1966): with the gain K = P H^T (H P H^T + R)^-1, rows of the rotation set to 0, the covariance is
    (I - K H) P (I - K H)^T + K R K^T. So it holds what the attitude's error does to the position. Errors of the camera
    with a covariance C, ``considered`` (6, 6), that are measured as if the body had moved, add K H C (K H)^T.
    """
    frame = observation.frame
    prior, known = frame.prior_T_cam_body, floor_variances(frame.prior_covariance)
    innovation = by_pose @ known @ by_pose.T + covariance
    scale = np.sqrt(np.diag(innovation))
    gain = np.linalg.solve(innovation / np.outer(scale, scale), (by_pose @ known) / scale[:, None]).T / scale
    gain[:3] = 0.0
    step = gain @ measured
    left = np.eye(6) - gain @ by_pose
    pose = prior.perturbed(np.zeros(3), step[3:])
    stated = left @ frame.prior_covariance @ left.T + gain @ covariance @ gain.T
    if considered is not None:
        of_image = gain @ by_pose
        stated = stated + of_image @ considered @ of_image.T
    moved = None if common is None else gain @ common
    return Estimate("ok", pose=pose, covariance=np.asarray(0.5 * (stated + stated.T)), common=moved)


def grouped_covariance(scores: FloatArray, group: IndexArray, unknowns: int) -> FloatArray:
    """Covariance (k, k) of the sum of scores (n, k) whose errors are correlated within groups (n,), not between them.

    The sum over groups of S S^T, S being the sum of the scores of a group (Liang and Zeger 1986, Biometrika 73, 13):
    no correlation within a group and no variance has to be known. It is increased by G / (G - unknowns) for the
    ``unknowns`` that the scores are fitted with, G being the number of groups.
    """
    used, index = np.unique(group, return_inverse=True)
    sums = np.zeros((len(used), scores.shape[1]))
    np.add.at(sums, index, scores)
    return np.asarray(sums.T @ sums * (len(used) / max(len(used) - unknowns, 1)))
