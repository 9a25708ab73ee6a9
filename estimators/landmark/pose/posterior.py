"""Estimate the maximum a posteriori pose from points in an image, robust against outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import exp1

from boresight.estimators.landmark.pose.problem import PoseProblem, minimal_jacobian
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.estimators.prior import floor_variances
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Pose

_MAX_STEPS = 50
_STEP_TOLERANCE = 1e-8
_NU = 4.0
# Mean of weight times square per component, for squares with a chi-square distribution of two degrees of freedom.
# E[(nu + 2) x / (nu + x)] / 2 with nu = 4 and the density exp(-x / 2) / 2: 3 (1 - 2 e^2 E1(2)).
_GAUSSIAN_MEAN = 3.0 * (1.0 - 2.0 * float(np.exp(2.0) * exp1(2.0)))
_UNKNOWN_POINTS = 3.0  # observations of two components that the six unknowns take up
_LEAST_SCALE2 = 1e-4


def pose_offset(mean: Pose, T_cam_body: Pose) -> FloatArray:
    """Small motion (6,), [rotation_rad, translation_m], from ``mean`` to a pose: the argument of ``Pose.perturbed``."""
    turn = Rotation.from_matrix(T_cam_body.rotation @ mean.rotation.T).as_rotvec()
    return np.concatenate([turn, T_cam_body.translation_m - mean.translation_m])


@dataclass(frozen=True, slots=True, eq=False)
class GaussianPose:
    """A pose with the covariance (6, 6) of its error, [rotation_rad, translation_m] in camera axes."""

    T_cam_body: Pose
    covariance: FloatArray

    def offset(self, T_cam_body: Pose) -> FloatArray:
        """Offset (6,) of a pose from this one, see `pose_offset`."""
        return pose_offset(self.T_cam_body, T_cam_body)


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """A Gaussian prior of the pose: its mean, and the inverse (6, 6) of the covariance of its `offset`."""

    mean: Pose
    information: FloatArray

    def offset(self, T_cam_body: Pose) -> FloatArray:
        """Offset (6,) of a pose from the mean, see `pose_offset`."""
        return pose_offset(self.mean, T_cam_body)

    def errors(self, poses: PoseStack) -> FloatArray:
        """Offsets (B, 6) of several poses from the mean."""
        turns = Rotation.from_matrix(poses.rotations @ self.mean.rotation.T).as_rotvec()
        return np.concatenate([turns, poses.translations_m - self.mean.translation_m], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """A maximum a posteriori pose.

    ``covariance`` (6, 6) is that of its error, [rotation_rad, translation_m] in camera axes, and ``bound`` (6, 6) the
    Cramer-Rao bound: the covariance of the best estimator for Gaussian noise. ``d2`` (N,) are squared residuals,
    weighted by the given covariances, and ``scale2`` is the estimated factor on those covariances. ``residual_px`` is
    the RMS residual of a coordinate, over all points.
    """

    T_cam_body: Pose
    covariance: FloatArray
    bound: FloatArray
    d2: FloatArray
    scale2: float
    residual_px: float

    @property
    def quality(self) -> dict[str, float]:
        """Measures of the fit, for diagnostics; ``chi2_dof`` is chi-square over degrees of freedom, before scaling."""
        chi2_dof = float(self.d2.sum()) / max(1, 2 * len(self.d2) - 6)
        return {"scale2": self.scale2, "residual_px": self.residual_px, "chi2_dof": chi2_dof}


def solve_map(problem: PoseProblem, prior: GaussianPose, start: Pose, shared: FloatArray) -> Posterior:
    """Maximise the posterior under a Gaussian prior and Student's t for the observations.

    Iteratively reweighted Gauss-Newton: with nu degrees of freedom, an observation whose weighted square is x has the
    weight (nu + 2) / (nu + x) (Lange, Little and Taylor 1989). The scale of the covariances is estimated with the pose,
    because errors of the shape add to the noise of the image. The covariance of the result is that of an M-estimator
    (Huber 1981, section 7.6), with the moments of weight and influence from the residuals.

    ``shared`` (N, N) is the share of the pixels that each two observations have in common, 1 on the diagonal: the
    correlation of their errors, see `window_overlap`. The total information is divided by the mean redundancy that
    follows.
    """
    redundancy = float(shared.sum()) / len(shared)
    independent = len(shared) / redundancy
    pose, known = start, np.linalg.inv(floor_variances(prior.covariance))
    for _ in range(_MAX_STEPS):
        residuals = problem.residuals_px(pose)
        d2 = np.einsum("ni,nij,nj->n", residuals, problem.information_px2, residuals)
        # Scale and pose are iterated together: the weights need the scale, the scale the residuals.
        scale2 = _scale2(d2, independent)
        jacobian = minimal_jacobian(problem, pose)
        # Redundant observations count once: correlated errors do not average out.
        share = _weights(d2 / scale2) / (scale2 * redundancy)
        weighted = replace(problem, information_px2=share[:, None, None] * problem.information_px2)
        matrix, vector = weighted.normal_equations(jacobian, residuals)
        # Normal equations of the posterior: the prior pulls back by its information times the offset from its mean.
        step = np.asarray(np.linalg.solve(matrix + known, vector - known @ prior.offset(pose)), dtype=np.float64)
        pose = pose.perturbed(step[:3], step[3:])
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    # Sandwich covariance of an M-estimator: gain scatter gain^T, plus the prior's part.
    full, _ = problem.normal_equations(jacobian, residuals)
    best = full / (scale2 * redundancy)
    influence, slope = _moments(d2 / scale2, independent)
    scatter = influence / (scale2 * redundancy**2) * _scores_covariance(problem.information_px2, jacobian, shared)
    gain = np.linalg.inv(slope * best + known)
    covariance, bound = gain @ (scatter + known) @ gain, np.linalg.inv(best + known)
    return Posterior(pose, covariance, bound, d2, scale2, float(np.sqrt((residuals**2).mean())))


def window_overlap(first_px: FloatArray, last_px: FloatArray) -> FloatArray:
    """Return the common area (N, N) of each two windows over the geometric mean of their areas.

    This is the correlation of two observations' errors if these come from white noise in the pixels of the windows. As
    the Gram matrix of the windows it is positive semidefinite. ``first_px`` and ``last_px`` (N, 2) are columns and rows
    of the windows' first corners and of their opposite corners.
    """
    # Windows are intervals along both axes: where the common one is empty, the clipped length is 0.
    low = np.maximum(first_px[:, None], first_px[None])
    high = np.minimum(last_px[:, None], last_px[None])
    common = np.clip(high - low, 0.0, None).prod(axis=2)
    root = np.sqrt(np.diag(common))
    share: FloatArray = common / np.outer(root, root)
    return share


def _weights(x: FloatArray) -> FloatArray:
    """Weights of Student's t for the squared residuals x over the scale."""
    return (_NU + 2.0) / (_NU + x)


def _free(n: float) -> float:
    """Factor n / (n - p/2) for the observations that the six unknowns take up, of n independent ones."""
    return n / max(1.0, n - _UNKNOWN_POINTS)


def _scale2(d2: FloatArray, independent: float) -> float:
    """Robust scale of the weighted squares (N,); for Gaussian residuals it is their variance."""
    # The median as a start withstands outliers; the floor keeps the weights finite for perfect data.
    scale2 = max(float(np.median(d2)) / 2.0, _LEAST_SCALE2)
    for _ in range(_MAX_STEPS):
        mean = float((_weights(d2 / scale2) * d2).mean()) / 2.0
        previous, scale2 = scale2, max(_free(independent) * mean / _GAUSSIAN_MEAN, _LEAST_SCALE2)
        if abs(scale2 - previous) < 1e-9 * scale2:
            break
    return scale2


def _moments(x: FloatArray, independent: float) -> tuple[float, float]:
    """E[psi^2] and E[psi'] per component, of the influence function psi, over the weighted squares (N,)."""
    weights = _weights(x)
    influence = _free(independent) * float((weights**2 * x).mean()) / 2.0
    # psi(r) = w(x) r with x = |r|^2 has the mean derivative w + w' x per component, w' = -(nu + 2) / (nu + x)^2.
    slope = float((weights - (_NU + 2.0) * x / (_NU + x) ** 2).mean())
    return influence, slope


def _scores_covariance(information: FloatArray, jacobian: FloatArray, shared: FloatArray) -> FloatArray:
    """Covariance (P, P) of J^T S^-1/2 e for errors e of unit variance with the correlation ``shared``."""
    values, vectors = np.linalg.eigh(information)
    # Symmetric square root of the information: it whitens both components of a residual.
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    white = root @ jacobian
    covariance: FloatArray = np.einsum("nip,niq->pq", white, np.einsum("nm,miq->niq", shared, white))
    return covariance
