"""The likelihood of all corners of an image, given a pose: a mixture of landmarks and clutter.

For a landmark i that is seen at u_i with covariance S_i, corners x_c of density b in the body's image,

    log L = sum_i log(1 + p / ((1 - p) b) sum_c N(x_c; u_i, S_i)),

up to a constant: with probability p one of the corners is the landmark's, all others are clutter. It has the form of
MLESAC (P. Torr and A. Zisserman, Computer Vision and Image Understanding 78, 2000) with the assignment summed over
instead of chosen. Its maximum over the pose is found by expectation and maximisation, with a Gaussian prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from estimators.landmark.matching import inverse_and_determinant
from estimators.landmark.robust.options import MixtureOptions
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """H poses side by side: ``rotations`` (H, 3, 3) and ``translations_m`` (H, 3) of T_cam_body."""

    rotations: FloatArray
    translations_m: FloatArray

    def __len__(self) -> int:
        return len(self.rotations)

    def take(self, which: IndexArray) -> Poses:
        """Return some of them."""
        return Poses(self.rotations[which], self.translations_m[which])

    def pose(self, index: int) -> Pose:
        """Return one of them."""
        return Pose(self.rotations[index], self.translations_m[index])

    def perturbed(self, steps: FloatArray) -> Poses:
        """Turn and shift each by a step [rotation_rad, translation_m] in camera axes, (H, 6)."""
        turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        return Poses(turns @ self.rotations, self.translations_m + steps[:, 3:])


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """A Gaussian over poses: ``mean``, and the (6, 6) inverse covariance of [rotation_rad, translation_m]."""

    mean: Pose
    information: FloatArray

    def errors(self, poses: Poses) -> FloatArray:
        """Differences from the mean, (H, 6)."""
        turns = Rotation.from_matrix(poses.rotations @ self.mean.rotation.T).as_rotvec()
        return np.concatenate([turns, poses.translations_m - self.mean.translation_m], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class MixtureEvaluation:
    """What the mixture says at H poses.

    Parameters
    ----------
    log_posterior
        (H,) log likelihood and log prior, up to a constant.
    hessian
        (H, 6, 6) information of the corners by their responsibilities, and of the prior.
    gradient
        (H, 6).
    responsibilities
        (H, N, K) probability that a candidate corner is the landmark's.
    candidates
        (H, N, K) rows of the corners, the nearest first; their number where there is none near.
    squares
        (H, N, K) weighted squared distances of the candidates; infinite where there is none.
    """

    log_posterior: FloatArray
    hessian: FloatArray
    gradient: FloatArray
    responsibilities: FloatArray
    candidates: IndexArray
    squares: FloatArray


class Mixture:
    """Landmarks that can be seen, corners of an image, a prior."""

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
        self._corners_px = np.vstack([corners_px, [np.inf, np.inf]])
        self._tree = KDTree(corners_px)
        self._camera = camera
        self._prior = prior
        self._k = min(options.max_candidates, len(corners_px))
        p = options.detection_probability
        self.odds_px2 = p / (1.0 - p) * area_px2 / len(corners_px)

    def project(self, poses: Poses) -> FloatArray:
        """Landmarks in the image, (H, N, 2)."""
        return self._camera.project(self._in_camera(poses))

    def _in_camera(self, poses: Poses) -> FloatArray:
        turned = np.einsum("hij,nj->hni", poses.rotations, self.points_m)
        seen: FloatArray = turned + poses.translations_m[:, None]
        return seen

    def step(self, poses: Poses, corner_sigma_px: float) -> MixtureEvaluation:
        """Evaluate the posterior and its Gauss-Newton approximation at each pose."""
        points = self._in_camera(poses)
        uv = self._camera.project(points)
        by_point = self._camera.jacobian(points)
        covariance = self._image_covariances(poses, by_point, corner_sigma_px)
        information, determinant = inverse_and_determinant(covariance)
        reach_px = 5.0 * float(np.sqrt(np.median(covariance[..., 0, 0] + covariance[..., 1, 1])))
        _, near = self._tree.query(uv, k=self._k, distance_upper_bound=reach_px)
        near = near.reshape(*uv.shape[:2], self._k)
        offsets = np.where(near[..., None] < self._tree.n, self._corners_px[near] - uv[:, :, None], 0.0)
        square = np.einsum("hnki,hnij,hnkj->hnk", offsets, information, offsets, optimize=True)
        square = np.where(near < self._tree.n, square, np.inf)
        density = np.exp(-0.5 * square) / (2.0 * np.pi * np.sqrt(determinant))[..., None]
        ratio = self.odds_px2 * density
        total = 1.0 + ratio.sum(axis=2)
        responsibilities = ratio / total[..., None]
        weight = responsibilities.sum(axis=2)
        pull = np.einsum("hnk,hnki->hni", responsibilities, offsets)
        jacobian = _pose_jacobian(by_point, points - poses.translations_m[:, None])
        weighted = information @ jacobian
        errors = self._prior.errors(poses)
        prior_pull = errors @ self._prior.information
        return MixtureEvaluation(
            np.log(total).sum(axis=1) - 0.5 * np.einsum("hp,hp->h", errors, prior_pull),
            np.einsum("hn,hnip,hniq->hpq", weight, jacobian, weighted, optimize=True) + self._prior.information,
            np.einsum("hnip,hni->hp", weighted, pull, optimize=True) - prior_pull,
            responsibilities,
            near,
            square,
        )

    def climb(self, poses: Poses, corner_sigma_px: float, iterations: int, tolerance_px: float = 0.0) -> Poses:
        """Take steps of expectation and maximisation, until none moves a landmark by ``tolerance_px``."""
        for _ in range(iterations):
            step = self.step(poses, corner_sigma_px)
            moved: FloatArray = np.linalg.solve(step.hessian, step.gradient[..., None])[..., 0].astype(np.float64)
            before = self.project(poses)
            poses = poses.perturbed(moved)
            if np.abs(self.project(poses) - before).max() < tolerance_px:
                break
        return poses

    def _image_covariances(self, poses: Poses, by_point: FloatArray, corner_sigma_px: float) -> FloatArray:
        by_body = by_point @ poses.rotations[:, None]
        projected: FloatArray = by_body @ self._covariances_m2 @ np.swapaxes(by_body, 2, 3)
        return projected + corner_sigma_px**2 * np.eye(2)


def _pose_jacobian(by_point: FloatArray, arms_m: FloatArray) -> FloatArray:
    """Differentiate pixels by [rotation_rad, translation_m], (..., 2, 6); ``arms_m`` are the turned points."""
    x, y, z = np.moveaxis(arms_m, -1, 0)
    zero = np.zeros_like(x)
    turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(*x.shape, 3, 3)
    return np.concatenate([by_point @ turn, by_point], axis=-1)
