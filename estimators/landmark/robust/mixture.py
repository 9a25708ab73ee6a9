"""Evaluate the likelihood of all corners of an image at a pose: a mixture of landmarks and clutter.

With landmarks i projected to u_i with covariance S_i, and corners x_c of density b in the body's image,

    log L = sum_i log(1 + p / ((1 - p) b) sum_c N(x_c; u_i, S_i)),

up to a constant: with probability p one of the corners is the landmark's, all others are clutter. It has the form of
MLESAC (P. Torr and A. Zisserman, Computer Vision and Image Understanding 78, 2000), summed over assignments instead of
maximised. Expectation maximisation with a Gaussian prior finds the pose of greatest posterior probability.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import KDTree

from boresight.estimators.landmark.matching import inverse_and_determinant
from boresight.estimators.landmark.pose.posterior import PosePrior
from boresight.estimators.landmark.pose.problem import point_by_rotation
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.base import SpecModel

IndexArray = NDArray[np.intp]


class MixtureOptions(SpecModel):
    """Options of the mixture: the distribution of corners about a projected landmark."""

    detection_probability: float = Field(
        0.02, gt=0, lt=1, description="Prior probability that a landmark's corner was detected; small values are robust"
    )
    covariance_scale: float = Field(2.5, gt=0, description="Factor on the landmarks' covariances as stored")
    corner_sigma_px: float = Field(0.3, gt=0, le=10, description="Error of a corner's position in the image")
    max_candidates: int = Field(6, ge=1, le=64, description="Nearest corners that may be a landmark's")


@dataclass(frozen=True, slots=True, eq=False)
class MixtureEvaluation:
    """The mixture evaluated at H poses.

    ``log_posterior`` (H,) is log likelihood and log prior, up to a constant, ``gradient`` (H, 6) its derivative by
    [rotation_rad, translation_m], and ``hessian`` (H, 6, 6) the Gauss-Newton information, weighted by the probabilities
    that a candidate is the landmark's corner, with that of the prior. ``candidates`` (H, N, K) are rows of the corners,
    the nearest first; the number of corners stands for no candidate. ``squares`` (H, N, K) are their weighted squared
    distances; infinite for no candidate.
    """

    log_posterior: FloatArray
    hessian: FloatArray
    gradient: FloatArray
    candidates: IndexArray
    squares: FloatArray


class Mixture:
    """The posterior of the pose, from visible landmarks, the corners of an image and a prior.

    ``points_m`` (N, 3) and ``covariances_m2`` (N, 3, 3) are landmarks in the body frame, and ``corners_px`` (C, 2) the
    corners, spread over an area of ``area_px2`` of the image. The information of the prior must be regular.
    """

    def __init__(
        self,
        points_m: FloatArray,
        covariances_m2: FloatArray,
        corners_px: FloatArray,
        area_px2: float,
        camera: Camera,
        prior: PosePrior,
        options: MixtureOptions,
    ) -> None:
        self.points_m = points_m
        self._covariances_m2 = options.covariance_scale * covariances_m2
        # The row after the last stands for no corner, as the tree numbers a missing neighbour.
        self._corners_px = np.vstack([corners_px, [np.inf, np.inf]])
        self._tree = KDTree(corners_px)
        self._camera = camera
        self._prior = prior
        self._k = min(options.max_candidates, len(corners_px))
        p = options.detection_probability
        # p / ((1 - p) b), with the density b of clutter in the hull of the corners.
        self.odds_px2 = p / (1.0 - p) * area_px2 / len(corners_px)

    def project(self, poses: PoseStack) -> FloatArray:
        """Project the landmarks at each pose, (H, N, 2)."""
        return self._camera.project(self._in_camera(poses))

    def _in_camera(self, poses: PoseStack) -> FloatArray:
        turned = np.einsum("hij,nj->hni", poses.rotations, self.points_m)
        seen: FloatArray = turned + poses.translations_m[:, None]
        return seen

    def evaluate(self, poses: PoseStack, corner_sigma_px: float) -> MixtureEvaluation:
        """Evaluate the posterior and its Gauss-Newton approximation at each pose."""
        points = self._in_camera(poses)
        uv = self._camera.project(points)
        by_point = self._camera.jacobian(points)
        covariance = self._image_covariances(poses, by_point, corner_sigma_px)
        information, determinant = inverse_and_determinant(covariance)
        # Corners beyond five standard deviations of the median landmark have no weight: the tree takes one radius for
        # all.
        reach_px = 5.0 * float(np.sqrt(np.median(covariance[..., 0, 0] + covariance[..., 1, 1])))
        _, near = self._tree.query(uv, k=self._k, distance_upper_bound=reach_px)
        near = near.reshape(*uv.shape[:2], self._k)
        # 0 instead of infinity, so that products with zero weights are no NaN.
        offsets = np.where(near[..., None] < self._tree.n, self._corners_px[near] - uv[:, :, None], 0.0)
        square = np.einsum("hnki,hnij,hnkj->hnk", offsets, information, offsets, optimize=True)
        square = np.where(near < self._tree.n, square, np.inf)
        density = np.exp(-0.5 * square) / (2.0 * np.pi * np.sqrt(determinant))[..., None]
        # Expectation: the probability that each candidate is the landmark's corner.
        ratio = self.odds_px2 * density
        # The 1 stands for clutter alone: the landmark's corner was not detected.
        total = 1.0 + ratio.sum(axis=2)
        responsibilities = ratio / total[..., None]
        weight = responsibilities.sum(axis=2)
        # Each landmark is pulled to the mean of its candidates, weighted by their responsibilities.
        pull = np.einsum("hnk,hnki->hni", responsibilities, offsets)
        by_rotation = by_point @ point_by_rotation(points - poses.translations_m[:, None])
        jacobian = np.concatenate([by_rotation, by_point], axis=-1)
        # A landmark without a likely corner has the weight 0 and drops out of the normal equations.
        weighted = information @ jacobian
        # Maximum a posteriori: the prior adds its information, and a pull back to its mean.
        errors = self._prior.errors(poses)
        prior_pull = errors @ self._prior.information
        return MixtureEvaluation(
            np.log(total).sum(axis=1) - 0.5 * np.einsum("hp,hp->h", errors, prior_pull),
            np.einsum("hn,hnip,hniq->hpq", weight, jacobian, weighted, optimize=True) + self._prior.information,
            np.einsum("hnip,hni->hp", weighted, pull, optimize=True) - prior_pull,
            near,
            square,
        )

    def maximise(
        self, poses: PoseStack, corner_sigma_px: float, iterations: int, tolerance_px: float = 0.0
    ) -> PoseStack:
        """Iterate expectation and maximisation, until no landmark moves by ``tolerance_px`` or more."""
        for _ in range(iterations):
            here = self.evaluate(poses, corner_sigma_px)
            # One Gauss-Newton step for the weighted squares of the last expectation (generalised EM): the prior keeps
            # the matrix regular, however few landmarks have candidates.
            moved: FloatArray = np.linalg.solve(here.hessian, here.gradient[..., None])[..., 0].astype(np.float64)
            before = self.project(poses)
            poses = poses.perturbed(moved)
            if np.abs(self.project(poses) - before).max() < tolerance_px:
                break
        return poses

    def _image_covariances(self, poses: PoseStack, by_point: FloatArray, corner_sigma_px: float) -> FloatArray:
        by_body = by_point @ poses.rotations[:, None]
        projected: FloatArray = by_body @ self._covariances_m2 @ np.swapaxes(by_body, 2, 3)
        return projected + corner_sigma_px**2 * np.eye(2)
