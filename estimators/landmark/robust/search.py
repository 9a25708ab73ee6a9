"""Search the prior for the pose of greatest posterior probability, from a grid or from random minimal sets.

A pose is evaluated by the likelihood of all corners of the image, a mixture of landmarks and clutter. With landmarks i
projected to u_i with covariance S_i, and corners x_c of density b in the body's image,

    log L = sum_i log(1 + p / ((1 - p) b) sum_c N(x_c; u_i, S_i)),

over that of no landmark detected: with probability p one of the corners is the landmark's, all others are clutter. It
has the form of MLESAC (P. Torr and A. Zisserman, Computer Vision and Image Understanding 78, 2000), summed over
assignments instead of maximised. Expectation maximisation with a Gaussian prior finds the pose of greatest posterior
probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from scipy.special import spence

from boresight.estimators.landmark.matching import inverse_and_determinant
from boresight.estimators.landmark.pose.posterior import PosePrior
from boresight.estimators.landmark.pose.problem import image_jacobian, point_by_rotation
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.spec.base import SpecModel

IndexArray = NDArray[np.intp]

_SET = 3
_MATCHING_SIGMA = 6.0


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

    ``log_posterior`` (H,) is log likelihood and log prior, over those of the prior's mean with no landmark detected,
    and ``gradient`` (H, 6) its derivative by [rotation_rad, translation_m]. ``hessian`` (H, 6, 6) is the information of
    the complete data: Gauss-Newton's, weighted by the probabilities that a candidate is the landmark's corner, with
    that of the prior. ``candidates`` (H, N, K) are rows of the corners, the nearest first; the number of corners stands
    for no candidate. ``squares`` (H, N, K) are their weighted squared distances, infinite for no candidate, ``offsets``
    (H, N, K, 2) from the landmarks, px, and ``responsibilities`` (H, N, K) the probabilities that they are theirs.
    ``weighted`` (H, N, 2, 6) is information times derivative of a landmark's place.
    """

    log_posterior: FloatArray
    hessian: FloatArray
    gradient: FloatArray
    candidates: IndexArray
    squares: FloatArray
    offsets: FloatArray
    responsibilities: FloatArray
    weighted: FloatArray

    @property
    def observed_information(self) -> FloatArray:
        """Negative second derivative (H, 6, 6) of the log posterior: information of the complete data less the missing.

        What is missing is which candidate is the corner, if any is: T. Louis (Journal of the Royal Statistical Society
        B 44, 1982). Covariances and derivatives of the projection are taken as constant. At a pose that is no maximum
        it may be indefinite.
        """
        offsets, share, weighted = self.offsets, self.responsibilities, self.weighted
        # Covariance of the offset, given the corners, between its candidates and the 0 of a landmark not detected.
        spread = np.einsum("hnk,hnki,hnkj->hnij", share, offsets, offsets, optimize=True)
        pull = np.einsum("hnk,hnki->hni", share, offsets)
        spread -= pull[..., :, None] * pull[..., None, :]
        missing = np.einsum("hnip,hnij,hnjq->hpq", weighted, spread, weighted, optimize=True)
        observed: FloatArray = self.hessian - missing
        return observed


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
        self.odds_px2 = landmark_odds_px2(options, len(corners_px) / area_px2)
        # Log probability that no landmark is detected.
        self._log_none = len(points_m) * float(np.log1p(-p))

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
        by_body = by_point @ poses.rotations[:, None]
        covariance = by_body @ self._covariances_m2 @ np.swapaxes(by_body, 2, 3) + corner_sigma_px**2 * np.eye(2)
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
            offsets,
            responsibilities,
            weighted,
        )

    def log_evidence(self, evaluation: MixtureEvaluation) -> FloatArray:
        """Return the log (H,) of the probability of the corners over that of as many corners of clutter alone.

        The posterior is integrated over the pose, by Laplace's approximation at a maximum, where the observed
        information is positive definite. Of more landmarks or a wider prior chance makes a higher maximum, and no
        larger integral.
        """
        observed = np.linalg.slogdet(evaluation.observed_information)[1]
        prior = np.linalg.slogdet(self._prior.information)[1]
        return np.asarray(evaluation.log_posterior + self._log_none + 0.5 * (prior - observed))

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


def landmark_odds_px2(options: MixtureOptions, density_px2: float) -> float:
    """Return p / ((1 - p) b), px^2: times the density of an offset, the odds that a corner is the landmark's."""
    p = options.detection_probability
    return p / (1.0 - p) / density_px2


def retained_information(odds: FloatArray) -> FloatArray:
    """Return the expected share of a corner's information that is left as it may be its landmark's or clutter.

    ``odds`` k are those of a corner at the landmark's place. With offsets d from N(0, S), u = exp(-d^T S^-1 d / 2) is
    uniform, a corner is the landmark's with probability r = k u / (1 + k u), and the observed information is S^-1 times
    r + r (1 - r) ln u along either axis, on average. Its mean is 1 + Li2(-k) / k. Evenly spread clutter has no
    curvature on average; what it takes from the corner's is neglected, about the detection probability of it.
    """
    share: FloatArray = 1.0 + spence(1.0 + odds) / odds
    return share


class SearchOptions(SpecModel):
    """Options of the hypotheses and of the refinement of the best.

    Hypotheses are rotations about the body's origin over the whole prior, each with shifts across the line of sight, or
    the poses of random minimal sets of landmarks and corners, as in RANSAC.
    """

    hypotheses: Literal["prior", "minimal-sets"] = Field("prior", description="Source of the hypotheses")
    draws: int = Field(20_000, ge=1, le=1_000_000, description="Minimal sets drawn")
    reach_sigma: float = Field(3.45, gt=0, le=10, description="Radius of the ball of rotations, in the prior's sigmas")
    step_px: float = Field(1.7, gt=0, le=20, description="Step of the rotations, as motion of the surface in pixels")
    max_turns: int = Field(4000, ge=1, le=100_000, description="Most rotations; the step grows until there are no more")
    shift_px: int = Field(2, ge=0, le=20, description="Shifts up to this many pixels along rows and columns")
    blur_px: float = Field(1.8, gt=0, le=20, description="Blur of the corner map on which hypotheses are scored")
    refined: int = Field(25, ge=1, le=1000, description="Best hypotheses that are refined")
    anneal_px: tuple[Annotated[float, Field(gt=0, le=20)], ...] = Field(
        (1.5, 0.8), min_length=1, description="Corner errors of the successive stages of refinement"
    )
    iterations: int = Field(4, ge=1, le=100, description="Iterations at each of them")
    finalists: int = Field(4, ge=1, le=100, description="Hypotheses iterated to convergence")
    max_iterations: int = Field(30, ge=1, le=1000, description="Most iterations to convergence")


def best_hypotheses(
    mixture: Mixture, start: Pose, turn_sigma_rad: float, corners_px: FloatArray, camera: Camera, options: SearchOptions
) -> PoseStack:
    """Score rotations and shifts of ``start`` on a blurred map of the corners, and return the best.

    The score of a hypothesis is the log likelihood of `Mixture`, with the isotropic covariance of the map's blur and
    landmarks rounded to pixels, plus the log prior of its rotation, with the standard deviation ``turn_sigma_rad``
    about each axis.
    """
    # A rotation w moves the surface by w times its radius, in pixels by that over the size of a pixel on the body.
    size_m = float(np.median(np.linalg.norm(mixture.points_m, axis=1)))
    pixel_m = float(np.linalg.norm(start.translation_m)) * camera.pixel_angle_rad
    turns = rotation_grid(options.reach_sigma * turn_sigma_rad, options.step_px * pixel_m / size_m, options.max_turns)
    # About the origin of the body: `Pose.perturbed` leaves the translation as it is, which the alignment has measured.
    rotations = Rotation.from_rotvec(turns).as_matrix() @ start.rotation
    poses = PoseStack(rotations, np.repeat(start.translation_m[None], len(turns), axis=0))
    shifts = np.arange(-options.shift_px, options.shift_px + 1)
    du, dv = (grid.ravel() for grid in np.meshgrid(shifts, shifts))
    # Log prior of the rotation alone: the shifts lie within the error of the alignment.
    prior = -0.5 * np.square(turns).sum(axis=1) / turn_sigma_rad**2
    scores = map_scores(mixture, poses, corners_px, camera, options.blur_px, du, dv) + prior[:, None]
    best = np.argsort(-scores.ravel(), kind="stable")[: options.refined]
    # Flat indices of (rotation, shift).
    turn, shift = np.divmod(best, len(du))
    # The image of the origin moves by du pixels where the body moves by du pixels' size along x, at its distance.
    across_m = np.stack([du[shift], dv[shift], np.zeros(len(best))], axis=1) * pixel_m
    return PoseStack(rotations[turn], start.translation_m + across_m)


def rotation_grid(radius_rad: float, step_rad: float, most: int) -> FloatArray:
    """Return rotation vectors (H, 3) on a cubic grid in a ball; the step grows until there are at most ``most``."""
    while True:
        count = int(np.floor(radius_rad / step_rad))
        axis = step_rad * np.arange(-count, count + 1)
        grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        ball: FloatArray = grid[np.linalg.norm(grid, axis=1) <= radius_rad]
        if len(ball) <= most:
            return ball
        step_rad *= 1.1


def map_scores(
    mixture: Mixture,
    poses: PoseStack,
    corners_px: FloatArray,
    camera: Camera,
    blur_px: float,
    du: NDArray[np.int_],
    dv: NDArray[np.int_],
) -> FloatArray:
    """Log likelihoods (H, S) of H poses with S shifts by whole pixels, on a blurred map of the corners."""
    log_density = np.log1p(mixture.odds_px2 * corner_map(corners_px, camera, blur_px))
    return _scores(log_density, mixture.project(poses), du, dv)


def corner_map(corners_px: FloatArray, camera: Camera, blur_px: float) -> NDArray[np.float32]:
    """Blurred density of corners in the image, (H, W) px^-2."""
    # Normalised to corners per square pixel: the Gaussian kernel sums to 1.
    counts = np.zeros((camera.height_px, camera.width_px), dtype=np.float32)
    column, row = np.clip(np.floor(corners_px), 0, [camera.width_px - 1, camera.height_px - 1]).astype(int).T
    np.add.at(counts, (row, column), 1.0)
    return np.asarray(cv2.GaussianBlur(counts, (0, 0), blur_px), dtype=np.float32)


def _scores(
    log_density: NDArray[np.float32], uv_px: FloatArray, du: NDArray[np.int_], dv: NDArray[np.int_]
) -> FloatArray:
    """Sum the map over the landmarks for each shift, (H, S); landmarks outside the image add nothing."""
    # Flat indices into a map padded by the largest shift: a shift is then a constant offset.
    reach = int(np.abs(np.concatenate([du, dv])).max())
    padded = np.pad(log_density, reach + 1)
    height, width = log_density.shape
    column = np.clip(np.floor(uv_px[..., 0]), -1, width).astype(np.intp) + reach + 1
    row = np.clip(np.floor(uv_px[..., 1]), -1, height).astype(np.intp) + reach + 1
    flat = row * padded.shape[1] + column
    steps = dv * padded.shape[1] + du
    # The border of the padded map is 0: landmarks outside the image add log 1.
    edge = padded.ravel()
    return np.stack(
        [edge[np.clip(flat + step, 0, edge.size - 1)].sum(axis=1) for step in steps], axis=1, dtype=np.float64
    )


def sampled_hypotheses(
    mixture: Mixture,
    prior: PosePrior,
    start: Pose,
    corners_px: FloatArray,
    camera: Camera,
    options: SearchOptions,
    rng: np.random.Generator,
) -> PoseStack:
    """Draw minimal sets, solve each for its pose under the prior, and return the best; none where nothing matches.

    A set is three landmarks, each with a corner within 6 sigma of its prediction, drawn by its likelihood under the
    prior. Its pose is the linear maximum a posteriori about ``start``; its score is that of `best_hypotheses`. RANSAC:
    M. Fischler and R. Bolles (Communications of the ACM 24, 1981), with the guided sampling and local optimisation of
    R. Raguram et al. (USAC, IEEE Transactions on Pattern Analysis and Machine Intelligence 35, 2013).
    """
    points_cam_m = start.transform(mixture.points_m)
    jacobian = image_jacobian(camera, points_cam_m, point_by_rotation(start.rotate(mixture.points_m)))
    predicted_px = camera.project(points_cam_m)
    sigma_px = options.anneal_px[0]
    likelihood = _likelihoods(corners_px - predicted_px[:, None], jacobian, prior, sigma_px)
    landmark, corner = _draw(likelihood, options.draws, rng)
    if not len(landmark):
        return PoseStack(np.zeros((0, 3, 3)), np.zeros((0, 3)))
    residuals = corners_px[corner] - predicted_px[landmark]
    by_pose = jacobian[landmark]
    # Three landmarks give six equations for six unknowns; the prior bounds the pose where they are nearly collinear.
    normal = np.einsum("hkip,hkiq->hpq", by_pose, by_pose) / sigma_px**2 + prior.information
    here = prior.errors(PoseStack.of([start]))[0]
    vector = np.einsum("hkip,hki->hp", by_pose, residuals) / sigma_px**2 - prior.information @ here
    steps = np.linalg.solve(normal, vector[..., None])[..., 0]
    copies = np.repeat(start.rotation[None], len(steps), 0), np.repeat(start.translation_m[None], len(steps), 0)
    poses = PoseStack(*copies).perturbed(steps)
    none = np.zeros(1, dtype=np.int_)
    errors = prior.errors(poses)
    scores = map_scores(mixture, poses, corners_px, camera, options.blur_px, none, none)[:, 0]
    scores -= 0.5 * np.einsum("hp,pq,hq->h", errors, prior.information, errors)
    return poses.rows(np.argsort(-scores, kind="stable")[: options.refined])


def _likelihoods(offsets_px: FloatArray, jacobian: FloatArray, prior: PosePrior, sigma_px: float) -> FloatArray:
    """Likelihood (N, C) of each corner for each landmark, under the prior; 0 outside the matching radius."""
    # Covariance of the predicted place: P of the pose through the Jacobian, plus the error of the corner.
    spread = jacobian @ np.linalg.inv(prior.information) @ np.swapaxes(jacobian, 1, 2) + sigma_px**2 * np.eye(2)
    d2 = np.einsum("nci,nij,ncj->nc", offsets_px, np.linalg.inv(spread), offsets_px)
    return np.where(d2 <= _MATCHING_SIGMA**2, np.exp(-0.5 * d2), 0.0)


def _draw(likelihood: FloatArray, draws: int, rng: np.random.Generator) -> tuple[IndexArray, IndexArray]:
    """Draw sets of three different landmarks and a corner for each, (H, 3) both, H <= ``draws``."""
    total = np.cumsum(likelihood, axis=1)
    matched = np.flatnonzero(total[:, -1] > 0.0)
    if len(matched) < _SET:
        return np.zeros((0, _SET), dtype=np.intp), np.zeros((0, _SET), dtype=np.intp)
    landmark = matched[rng.integers(0, len(matched), (draws, _SET))]
    ordered = np.sort(landmark, axis=1)
    # Sets with a landmark twice are left out, so that fewer than ``draws`` may remain.
    landmark = landmark[(np.diff(ordered, axis=1) > 0).all(axis=1)]
    # Inverse transform sampling of the corner: the first whose cumulative likelihood exceeds the random share.
    share = rng.random(landmark.shape) * total[landmark, -1]
    corner = np.stack([(total[landmark[:, k]] <= share[:, k, None]).sum(axis=1) for k in range(_SET)], axis=1)
    return landmark, np.minimum(corner, likelihood.shape[1] - 1)


def refine_hypotheses(mixture: Mixture, hypotheses: PoseStack, corner_sigma_px: float, options: SearchOptions) -> Pose:
    """Maximise from each hypothesis with decreasing corner error, and return the pose of greatest posterior.

    ``corner_sigma_px`` is the error in the last stage, in which only the ``options.finalists`` best are iterated until
    no landmark moves by 0.001 px.
    """
    poses = hypotheses
    # From coarse to fine: a wide error first smooths the many local maxima of the likelihood.
    for sigma_px in options.anneal_px:
        poses = mixture.maximise(poses, sigma_px, options.iterations)
    order = np.argsort(-mixture.evaluate(poses, options.anneal_px[-1]).log_posterior, kind="stable")
    last = mixture.maximise(poses.rows(order[: options.finalists]), corner_sigma_px, options.max_iterations, 1e-3)
    return last.pose(int(np.argmax(mixture.evaluate(last, corner_sigma_px).log_posterior)))
