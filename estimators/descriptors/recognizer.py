"""The estimators ``landmark-sift`` and ``landmark-orb``: recognition by descriptors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import chdtrc

from boresight.estimators.contract import Assets, Estimate, Stage, Stopwatch, typed_product
from boresight.estimators.descriptors.database import (
    DescribedFeatures,
    DescriptorDatabase,
    DescriptorOptions,
    DescriptorViewOptions,
    FeatureOptions,
    Kind,
    find_features,
    match_features,
)
from boresight.estimators.landmark.pose.posterior import GaussianPose, Posterior, solve_map, window_overlap
from boresight.estimators.landmark.pose.problem import MIN_LANDMARKS, PoseProblem, minimal_jacobian
from boresight.estimators.landmark.signal import observed_signal
from boresight.estimators.options import parse_options
from boresight.estimators.prior import calibration_in_posterior
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, pixel_to_opencv
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel

PRODUCT = "descriptors"
_CONFIDENCE = 0.999
_POSE_UNKNOWNS = 6
_UNINFORMATIVE = 1e6  # factor on a prior covariance that makes the prior negligible


class DescriptorNavigatorOptions(SpecModel):
    """Options of both estimators."""

    database: DescriptorViewOptions = DescriptorViewOptions()
    features: FeatureOptions | None = Field(None, description="In an observed image: as for the data base if left out")
    views: int = Field(8, ge=1, le=1000, description="Views of the data base that an image is matched with")
    ratio_max: float = Field(0.85, gt=0, le=1, description="Largest ratio of nearest to second nearest distance")
    prior_sigma: float = Field(4.0, gt=0, description="Largest distance of a match from its prediction, in sigmas")
    inlier_px: float = Field(3.0, gt=0, description="Largest reprojection error of an inlier of RANSAC")
    max_iterations: int = Field(5000, ge=10, le=1_000_000, description="Most iterations of RANSAC")
    pixel_sigma: float = Field(1.0, gt=0, description="Standard deviation of a feature's position, px, before scaling")
    patch_px: float = Field(12.0, gt=0, description="Side of the window that determines a feature")
    prior_probability: float = Field(
        1e-6, gt=0, lt=1, description="A solution less probable than this under the prior is refused"
    )


@dataclass(frozen=True, slots=True, eq=False)
class PointMatches:
    """Matched features: positions in the image (M, 2) and points on the body (M, 3)."""

    uv_px: FloatArray
    points_m: FloatArray

    def __len__(self) -> int:
        return len(self.uv_px)

    def subset(self, rows: NDArray[np.generic]) -> PointMatches:
        """Keep some rows."""
        return PointMatches(self.uv_px[rows], self.points_m[rows])

    def problem(self, camera: Camera, pixel_sigma: float) -> PoseProblem:
        """Return the pose problem of these matches, with the same noise for all."""
        information = np.tile(np.eye(2) / pixel_sigma**2, (len(self), 1, 1))
        return PoseProblem(self.points_m, self.uv_px, information, camera)


class DescriptorNavigator:
    """Matches features with those of rendered views, removes outliers by RANSAC and estimates the posterior pose."""

    name: ClassVar[str]
    version: ClassVar[int] = 7
    options_model: ClassVar[type[SpecModel]] = DescriptorNavigatorOptions
    kind: ClassVar[Kind]

    def __init__(self, database: DescriptorDatabase, options: DescriptorNavigatorOptions) -> None:
        self._database = database
        self._options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its data base."""
        parsed = parse_options(DescriptorNavigatorOptions, options, cls.name)
        asked = DescriptorOptions(kind=cls.kind, **parsed.database.model_dump())
        database = typed_product(assets, PRODUCT, asked, DescriptorDatabase, cls.name)
        if database.kind != cls.kind:
            raise BoresightError(f"{cls.name}: the product {PRODUCT!r} holds {database.kind} descriptors")
        return cls(database, parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose; ``rng`` seeds RANSAC."""
        clock = Stopwatch()
        found = self._solve(observation.frame, observation.camera, int(rng.integers(2**31)), clock)
        if isinstance(found, str):
            return Estimate("failed", found, timings_s=clock.seconds)
        consensus, posterior = found
        calibration = calibration_in_posterior(observation, posterior.T_cam_body, posterior.covariance)
        return Estimate(
            "ok",
            pose=posterior.T_cam_body,
            covariance=posterior.covariance + calibration,
            bound=posterior.bound,
            stages=(Stage("consensus", consensus), Stage("recognition", posterior.T_cam_body)),
            diagnostics={"n_landmarks": len(posterior.d2), **posterior.quality},
            timings_s=clock.seconds,
        )

    def _solve(self, frame: Frame, camera: Camera, seed: int, clock: Stopwatch) -> tuple[Pose, Posterior] | str:
        """Return the consensus pose and the posterior, or the reason why there is no pose."""
        options = self._options
        observed = observed_signal(frame, camera)
        if isinstance(observed, str):
            return observed
        with clock("feature_extraction"):
            features = find_features(frame.image, self.kind, options.features or options.database.features)
        with clock("matching"):
            matched = self._match(features, frame, camera)
        with clock("recognition"):
            consensus = find_consensus(matched, camera, options, seed)
            if isinstance(consensus, str):
                return consensus
            pose, inliers = consensus
            prior = GaussianPose(frame.prior_T_cam_body, frame.prior_covariance)
            problem = inliers.problem(camera, options.pixel_sigma)
            half_px = options.patch_px / 2.0
            # The errors of features whose windows overlap are correlated: they count as fewer.
            shared = window_overlap(inliers.uv_px - half_px, inliers.uv_px + half_px)
            probability = consistency_probability(problem, pose, prior, shared)
            if not probability >= options.prior_probability:  # NaN where the solution is far off
                return f"the solution contradicts the prior: probability {probability:.1g}"
            return pose, solve_map(problem, prior, pose, shared)

    def _match(self, features: DescribedFeatures, frame: Frame, camera: Camera) -> PointMatches:
        """Match with the nearest views; of several matches of a feature, keep the one of least distance."""
        options, prior = self._options, frame.prior_T_cam_body
        position = prior.camera_position_m
        sun_dir_body = prior.rotation.T @ frame.sun_dir_cam
        views = self._database.nearest(position / np.linalg.norm(position), sun_dir_body, options.views)
        rows: list[NDArray[np.int64]] = []
        points: list[FloatArray] = []
        distances: list[FloatArray] = []
        for view in views:
            row, known, distance = match_features(features.descriptors, view.descriptors, self.kind, options.ratio_max)
            rows.append(row)
            points.append(view.points_m[known])
            distances.append(distance)
        row, distance, point = np.concatenate(rows), np.concatenate(distances), np.concatenate(points)
        # Before the best of several is chosen, so that a false match of less distance cannot displace the right one.
        near = near_prediction(PointMatches(features.uv_px[row], point), camera, frame, options.prior_sigma)
        row, distance, point = row[near], distance[near], point[near]
        # Sorted by distance, the first of equal rows is the best match of that feature over all views.
        order = np.argsort(distance, kind="stable")
        _, first = np.unique(row[order], return_index=True)
        return PointMatches(features.uv_px[row[order[first]]], point[order[first]])


def consistency_probability(problem: PoseProblem, consensus: Pose, prior: GaussianPose, shared: FloatArray) -> float:
    """Return the probability, under the prior, of a solution at least as far off as that of the observations alone.

    The difference between solution and prior has the sum of their covariances.
    """
    # The observations alone must be tested: a solution drawn to the prior would always agree with it.
    alone = solve_map(problem, GaussianPose(prior.T_cam_body, _UNINFORMATIVE * prior.covariance), consensus, shared)
    offset = prior.offset(alone.T_cam_body)
    return float(chdtrc(_POSE_UNKNOWNS, offset @ np.linalg.solve(prior.covariance + alone.covariance, offset)))


def near_prediction(matched: PointMatches, camera: Camera, frame: Frame, sigmas: float) -> NDArray[np.bool_]:
    """Return which matches (M,) lie within some standard deviations of the positions that the prior predicts."""
    if len(matched) < MIN_LANDMARKS:
        return np.ones(len(matched), dtype=np.bool_)
    pose = frame.prior_T_cam_body
    problem = matched.problem(camera, 1.0)
    jacobian = minimal_jacobian(problem, pose)
    # Covariance of the predicted position, plus that of a feature: 1 px in both coordinates.
    covariance = jacobian @ frame.prior_covariance @ np.swapaxes(jacobian, 1, 2) + np.eye(2)
    residuals = problem.residuals_px(pose)
    d2 = np.einsum("ni,ni->n", residuals, np.linalg.solve(covariance, residuals[..., None])[..., 0])
    return np.asarray(d2 <= sigmas**2)


def find_consensus(
    matched: PointMatches, camera: Camera, options: DescriptorNavigatorOptions, seed: int
) -> tuple[Pose, PointMatches] | str:
    """Find the consensus pose and its inliers by OpenCV's USAC with MAGSAC++ (Barath et al. 2020), or the failure."""
    if len(matched) < MIN_LANDMARKS:
        return f"{len(matched)} features matched, {MIN_LANDMARKS} needed"
    parameters = cv2.UsacParams()
    parameters.threshold = options.inlier_px
    parameters.maxIterations = options.max_iterations
    parameters.confidence = _CONFIDENCE
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.randomGeneratorState = seed
    # One thread, so that the same seed gives the same result.
    parameters.isParallel = False
    matrix = camera.matrix
    # OpenCV counts the first pixel's centre as 0, this project as 0.5.
    matrix[:2, 2] = pixel_to_opencv(matrix[:2, 2])
    found, _, rotation, translation, inliers = cv2.solvePnPRansac(
        matched.points_m, pixel_to_opencv(matched.uv_px), matrix, None, params=parameters
    )
    count = 0 if inliers is None else len(inliers)
    if not found or count < MIN_LANDMARKS:
        return f"{count} of {len(matched)} matched features agree, {MIN_LANDMARKS} needed"
    pose = Pose(cv2.Rodrigues(rotation)[0], np.ravel(translation))
    kept = matched.subset(np.ravel(inliers))
    if not (pose.transform(kept.points_m)[:, 2] > 0.0).all():
        return "the features that agree lie behind the camera"
    return pose, kept


class SiftNavigator(DescriptorNavigator):
    """Matches SIFT features with those of rendered images, and estimates the posterior pose.

    The features of the image are matched with those of the nearest views of the data base, if they lie near their
    predicted positions. RANSAC removes outliers, and the pose is the maximum a posteriori with the prior. A solution
    that contradicts the prior is a failure.

    Use it when
    -----------
    A baseline by standard features is wanted, the onboard shape is nearly as detailed as the true one, and the data
    base may be large (20 MB for the 500 images of ``compare-mismatched``).

    It fails when
    -------------
    Fewer than four features match or agree, or the solution contradicts the prior. Small relief that differs from the
    truth leaves few right matches: of 500 images of ``compare-mismatched`` it failed, or was worse than the prior, in
    0.800 % with exact knowledge and in 45.2 % with that of a mission (mean NEES 9.5 and 11.6, 6 expected).

    Cost
    ----
    0.15 s an image of ``quickstart``.

    Source
    ------
    Features: Lowe (2004); RANSAC: MAGSAC++ of Barath et al. (2020); both by OpenCV. Rowell et al. (2015), section 5.2,
    leave the comparison with other landmarks open. The posterior is ours.
    """

    name: ClassVar[str] = "landmark-sift"
    kind: ClassVar[Kind] = "sift"


class OrbNavigator(DescriptorNavigator):
    """Matches ORB features with those of rendered images, and estimates the posterior pose.

    The features of the image are matched with those of the nearest views of the data base, if they lie near their
    predicted positions. RANSAC removes outliers, and the pose is the maximum a posteriori with the prior. A solution
    that contradicts the prior is a failure.

    Use it when
    -----------
    A baseline by standard features is wanted, the onboard shape is nearly as detailed as the true one, and the data
    base may be large (7.9 MB for the 500 images of ``compare-mismatched``).

    It fails when
    -------------
    Fewer than four features match or agree, or the solution contradicts the prior. Small relief that differs from the
    truth leaves few right matches: of 500 images of ``compare-mismatched`` it failed, or was worse than the prior, in
    6.20 % with exact knowledge and in 28.6 % with that of a mission (mean NEES 9.3 and 12.6, 6 expected).

    Cost
    ----
    0.06 s an image of ``quickstart``.

    Source
    ------
    Features: Rublee et al. (2011); RANSAC: MAGSAC++ of Barath et al. (2020); both by OpenCV. Rowell et al. (2015),
    section 5.2, leave the comparison with other landmarks open. The posterior is ours.
    """

    name: ClassVar[str] = "landmark-orb"
    kind: ClassVar[Kind] = "orb"
