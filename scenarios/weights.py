"""Weights of trials by the law that their pose errors should have had: importance sampling."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm, uniform

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, draw_pose_error, generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.distribution import Law, Normal, Uniform
from boresight.scenarios.spec.vectors import Correlated3, Correlated6, Law3, Mixture3, Normal3, Uniform3
from boresight.scenarios.spec.world import AttitudeErrorSpec, PoseErrorSpec


def pose_error_weights(wanted: PoseErrorSpec, drawn: PoseErrorSpec, seed: int, trials: FloatArray) -> FloatArray:
    """Return p / q (n,) at the pose errors of ``trials`` (n,): p is their density by one law, q that by which they are.

    The errors are drawn again from the seed. The mean of x p / q over trials drawn by q is that of x over trials drawn
    by p, if q is not 0 where p is above. Raise BoresightError if a law has no density, such as ``choice``, or the two
    do not have the same keys of the position.
    """
    joint = drawn.pose_cam_deg_m, wanted.pose_cam_deg_m
    keys = ["pose_cam_deg_m" if law else one.position[0] for law, one in zip(joint, (drawn, wanted), strict=True)]
    if keys[0] != keys[1]:
        raise BoresightError(f"pose_error: trials are drawn by {keys[0]}, and weighted by {keys[1]}: give the same key")
    errors = [draw_pose_error(drawn, generator(seed, Stream.POSE_ERROR, int(trial))) for trial in trials]
    position, turn_deg = np.array([one for one, _ in errors]), np.degrees([turn for _, turn in errors])
    logs = []
    for spec, together in ((wanted, wanted.pose_cam_deg_m), (drawn, drawn.pose_cam_deg_m)):
        if together is not None:
            logs.append(log_density(together, np.hstack([turn_deg, position])))
        else:
            logs.append(log_density(spec.position[1], position) + _log_density_of_turn(spec.attitude, turn_deg))
    return np.asarray(np.exp(logs[0] - logs[1]), dtype=np.float64)


def log_density(law: Law | Law3, values: FloatArray) -> FloatArray:
    """Return the logarithm of the density (n,) of a law at values (n,), or vectors (n, k).

    Raise BoresightError for a law without a density, and for Student's t.
    """
    match law:
        case Uniform(uniform=(low, high)) if low < high:
            found = uniform.logpdf(values, low, high - low)
        case Normal(within=None) if law.support[0] < law.support[1]:
            mean = law.median
            found = norm.logpdf(values, mean, np.sqrt(law.second_moment - mean**2))
        case Uniform3() if all(low < high for low, high in law.uniform):
            low, high = np.array(law.uniform).T
            found = uniform.logpdf(values, low, high - low).sum(axis=1)
        case Normal3() | Correlated3() | Correlated6() if law.student_t is None and _varies(law.covariance_matrix):
            # In standard deviations, as components may differ in unit.
            sigmas = np.sqrt(np.diag(law.covariance_matrix))
            apart = (values - (law.mean or 0.0)) / sigmas
            found = multivariate_normal.logpdf(apart, cov=law.covariance_matrix / np.outer(sigmas, sigmas))
            found = np.asarray(found) - np.log(sigmas).sum()
        case Mixture3():
            parts = [log_density(one.law, values) for one in law.mixture]
            found = logsumexp(parts, axis=0, b=law.shares[:, None])
        case _:
            raise BoresightError(
                f"pose_error: {law.model_dump(mode='json', exclude_none=True)} has no density to weight trials by: give"
                " normal, covariance, uniform or a mixture, each of which varies in all its components"
            )
    return np.asarray(found, dtype=np.float64)


def _varies(covariance: FloatArray) -> bool:
    """Tell whether a covariance (k, k) has a density."""
    sigmas = np.sqrt(np.diag(covariance))
    return bool(sigmas.all()) and np.linalg.matrix_rank(covariance / np.outer(sigmas, sigmas)) == len(sigmas)


def _log_density_of_turn(spec: AttitudeErrorSpec, turn_deg: FloatArray) -> FloatArray:
    """Return the logarithm of the density (n,), 1/deg^3, of a law of the attitude at rotation vectors (n, 3)."""
    if spec.rotation_vector_deg is not None:
        return log_density(spec.rotation_vector_deg, turn_deg)
    if spec.angle_deg is None:
        raise BoresightError("pose_error.attitude: give either angle_deg or rotation_vector_deg")
    # By -a about an axis is by a about the opposite one.
    angle_deg = np.linalg.norm(turn_deg, axis=1)
    either = np.logaddexp(log_density(spec.angle_deg, angle_deg), log_density(spec.angle_deg, -angle_deg))
    return np.asarray(either - np.log(4.0 * np.pi * angle_deg**2), dtype=np.float64)
