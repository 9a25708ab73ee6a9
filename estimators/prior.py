"""The control estimator, which returns the prior pose, and the treatment of priors with zero variances."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
from scipy.linalg import eigh

from boresight.estimators.contract import Assets, Estimate
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Pose
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.base import SpecModel

# 1e-9 rad and 1e-6 m: far below what an image resolves, far above the rounding of a pose in double precision.
_LEAST_SIGMAS = np.array([1e-9] * 3 + [1e-6] * 3)
_LEAST_SHARE = 1e-9
_ROUNDING = 1e-6


def floor_variances(covariance: FloatArray) -> FloatArray:
    """Floor zero variances so that a prior's covariance (6, 6) of [rotation_rad, translation_m] is invertible.

    The variance of a component to which the scenario gives no error is 0. It becomes that of 1e-9 rad or 1e-6 m, which
    keeps the component fixed in practice. A combination of components without an error gets a share of 1e-9 of their
    variances. A covariance without either is returned unchanged.
    """
    variances = np.diag(covariance)
    if not (variances >= _LEAST_SIGMAS**2).all():
        covariance = covariance + np.diag(np.where(variances < _LEAST_SIGMAS**2, _LEAST_SIGMAS**2, 0.0))
    variances = np.diag(covariance)
    # Of the correlations, as radians and metres differ by orders of magnitude.
    scale = np.sqrt(variances)
    lowest = float(np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0])
    if lowest < _LEAST_SHARE:
        covariance = covariance + (_LEAST_SHARE + abs(lowest)) * np.diag(variances)
    return covariance


def shares_of_prior(covariance: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return variances (k,) and axes (k, k), as columns, in which ``prior`` is 1 and ``covariance`` diagonal.

    The variances ascend. Raise `numpy.linalg.LinAlgError` if ``prior`` is not positive definite.
    """
    shares, axes = eigh(covariance, prior)
    return np.asarray(shares), np.asarray(axes)


def calibration_in_posterior(observation: Observation, T_cam_body: Pose, covariance: FloatArray) -> FloatArray:
    """(6, 6) covariance of the error that the calibration makes in a maximum a posteriori pose.

    An estimate with the covariance P, the camera taken as exact, has the share K = I - P P_0^-1 of an error of the
    image, P_0 being the prior's covariance. If the calibration moves the body by errors of the covariance C, see
    `Observation.calibration_covariance`, that is K C K^T: nothing where the prior decides and not the image. Where P is
    enlarged by residuals, K is a little larger than the share. Where P exceeds P_0 in some direction the estimate does
    not use the prior, and has C whole. ``covariance`` (6, 6) is P, [rotation_rad, translation_m] in camera axes. The
    pose itself is not changed: errors of the camera are considered (Schmidt 1966).
    """
    of_camera = observation.calibration_covariance(T_cam_body)
    if not of_camera.any():
        return of_camera
    prior = floor_variances(observation.frame.prior_covariance)
    shares, axes = shares_of_prior(covariance, prior)
    if shares[-1] > 1.0 + _ROUNDING:
        return of_camera
    # V^T P_0 V = I and V^T P V = S, so that K = P_0 V (I - S) V^T.
    of_image = prior @ axes @ ((1.0 - shares)[:, None] * axes.T)
    return np.asarray(of_image @ of_camera @ of_image.T, dtype=np.float64)


def free_directions(covariance: FloatArray) -> int:
    """Count the directions in which a covariance (6, 6) leaves an error."""
    free = np.diag(covariance) > 0.0
    sigmas = np.sqrt(np.diag(covariance)[free])
    return int((np.linalg.eigvalsh(covariance[np.ix_(free, free)] / np.outer(sigmas, sigmas)) > 1e-9).sum())


class PriorOptions(SpecModel):
    """``prior`` has no options."""


class PriorEstimator:
    """The control: returns the prior pose and covariance unchanged, without using the image.

    Use it when
    -----------
    In every campaign, as the control: an estimator is useful only where its errors are below those of ``prior``.

    It fails when
    -------------
    It does not fail.

    Cost
    ----
    None.

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "prior"
    version: ClassVar[int] = 1
    fuses_prior: ClassVar[bool] = True
    options_model: ClassVar[type[SpecModel]] = PriorOptions

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build; any option is refused."""
        del assets
        parse_options(PriorOptions, options, cls.name)
        return cls()

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Return the prior."""
        del rng
        frame = observation.frame
        return Estimate("ok", pose=frame.prior_T_cam_body, covariance=frame.prior_covariance)
