"""Hypotheses from random minimal sets, as in RANSAC: three landmarks, each with a corner within its matching radius.

M. Fischler and R. Bolles (Communications of the ACM 24, 1981), in the frame of R. Raguram et al. (USAC, IEEE
Transactions on Pattern Analysis and Machine Intelligence 35, 2013): guided sampling, here by the prior; scoring by a
likelihood (MLESAC); local optimisation of the best.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.landmark.pose.derivatives import image_jacobian, point_by_rotation
from estimators.landmark.robust.mixture import Mixture, PosePrior, Poses
from estimators.landmark.robust.options import SearchOptions
from estimators.landmark.robust.search import map_scores
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

_SET = 3
_MATCHING_SIGMA = 6.0


def sampled_hypotheses(
    mixture: Mixture,
    prior: PosePrior,
    start: Pose,
    corners_px: FloatArray,
    camera: Camera,
    options: SearchOptions,
    rng: np.random.Generator,
) -> Poses:
    """Draw minimal sets, solve each for its pose under the prior, and return the best; none where nothing matches.

    A landmark's corner is drawn from all within 6 sigma of its prediction, by their likelihood under the prior. The
    pose of a set is the linear maximum a posteriori about ``start``; its score is that of `search.best_hypotheses`.
    """
    points_cam_m = start.transform(mixture.points_m)
    jacobian = image_jacobian(camera, points_cam_m, point_by_rotation(start.rotate(mixture.points_m)))
    predicted_px = camera.project(points_cam_m)
    sigma_px = options.anneal_px[0]
    likelihood = _likelihoods(corners_px - predicted_px[:, None], jacobian, prior, sigma_px)
    landmark, corner = _draw(likelihood, options.draws, rng)
    if not len(landmark):
        return Poses(np.zeros((0, 3, 3)), np.zeros((0, 3)))
    residuals = corners_px[corner] - predicted_px[landmark]
    by_pose = jacobian[landmark]
    normal = np.einsum("hkip,hkiq->hpq", by_pose, by_pose) / sigma_px**2 + prior.information
    here = prior.errors(Poses(start.rotation[None], start.translation_m[None]))[0]
    vector = np.einsum("hkip,hki->hp", by_pose, residuals) / sigma_px**2 - prior.information @ here
    steps = np.linalg.solve(normal, vector[..., None])[..., 0]
    copies = np.repeat(start.rotation[None], len(steps), 0), np.repeat(start.translation_m[None], len(steps), 0)
    poses = Poses(*copies).perturbed(steps)
    none = np.zeros(1, dtype=np.int_)
    errors = prior.errors(poses)
    scores = map_scores(mixture, poses, corners_px, camera, options.blur_px, none, none)[:, 0]
    scores -= 0.5 * np.einsum("hp,pq,hq->h", errors, prior.information, errors)
    return poses.take(np.argsort(-scores, kind="stable")[: options.refined])


def _likelihoods(offsets_px: FloatArray, jacobian: FloatArray, prior: PosePrior, sigma_px: float) -> FloatArray:
    """Likelihood (N, C) of each corner as a landmark's, under the prior; 0 outside of the matching radius."""
    spread = jacobian @ np.linalg.inv(prior.information) @ np.swapaxes(jacobian, 1, 2) + sigma_px**2 * np.eye(2)
    d2 = np.einsum("nci,nij,ncj->nc", offsets_px, np.linalg.inv(spread), offsets_px)
    return np.where(d2 <= _MATCHING_SIGMA**2, np.exp(-0.5 * d2), 0.0)


def _draw(likelihood: FloatArray, draws: int, rng: np.random.Generator) -> tuple[IndexArray, IndexArray]:
    """Draw sets of landmarks that differ and a corner for each, (H, 3) both, H <= ``draws``."""
    total = np.cumsum(likelihood, axis=1)
    matched = np.flatnonzero(total[:, -1] > 0.0)
    if len(matched) < _SET:
        return np.zeros((0, _SET), dtype=np.intp), np.zeros((0, _SET), dtype=np.intp)
    landmark = matched[rng.integers(0, len(matched), (draws, _SET))]
    ordered = np.sort(landmark, axis=1)
    landmark = landmark[(np.diff(ordered, axis=1) > 0).all(axis=1)]
    share = rng.random(landmark.shape) * total[landmark, -1]
    corner = np.stack([(total[landmark[:, k]] <= share[:, k, None]).sum(axis=1) for k in range(_SET)], axis=1)
    return landmark, np.minimum(corner, likelihood.shape[1] - 1)
