"""The estimator ``landmark-ransac``: the pose by consensus of all corners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import Assets, Estimate, ImageRenderer, Stage, Stopwatch
from boresight.estimators.landmark.alignment import (
    Alignment,
    AlignmentOptions,
    MeshView,
    align_translation,
    centroid_residual_px,
    consistency_failure,
)
from boresight.estimators.landmark.corners import CornerOptions, detect_corners
from boresight.estimators.landmark.database import DatabaseOptions, LandmarkDatabase
from boresight.estimators.landmark.matching import matched_table
from boresight.estimators.landmark.planned import planned_problem
from boresight.estimators.landmark.pose.posterior import PosePrior
from boresight.estimators.landmark.pose.problem import minimal_jacobian
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.estimators.landmark.projection import visible_landmarks
from boresight.estimators.landmark.recognizer import POINT_PAIRS, landmark_database
from boresight.estimators.landmark.robust.search import (
    Mixture,
    MixtureEvaluation,
    MixtureOptions,
    SearchOptions,
    best_hypotheses,
    landmark_odds_px2,
    refine_hypotheses,
    retained_information,
    sampled_hypotheses,
)
from boresight.estimators.landmark.signal import observed_signal
from boresight.estimators.options import parse_options
from boresight.estimators.prior import calibration_in_posterior, floor_variances
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel

_MATCHED_D2 = 11.83  # 3-sigma quantile (99.73 %) of chi-square with two degrees of freedom
_FEWEST = 4


class RayDatabaseOptions(DatabaseOptions):
    """Options of a landmark data base, with landmarks where their rays meet."""

    position: Literal["mean", "rays"] = Field("rays", description=DatabaseOptions.model_fields["position"].description)


class ConsensusOptions(SpecModel):
    """Options of ``landmark-ransac``."""

    database: RayDatabaseOptions = RayDatabaseOptions()
    corners: CornerOptions = Field(
        CornerOptions(count=250, min_relative_strength=1e-5), description="Corners of the observed image"
    )
    alignment: Literal["centroid", "image"] = Field("image", description="Method of the first alignment")
    alignment_loop: AlignmentOptions = AlignmentOptions()
    alignment_sigma_px: float = Field(3.6, gt=0, description="Standard deviation of that alignment, each axis")
    mixture: MixtureOptions = MixtureOptions()
    search: SearchOptions = SearchOptions()
    log_evidence_min: float | None = Field(
        1.0, description="Least log evidence for landmarks among the corners, over clutter alone; null: none"
    )
    consistency_max_px: float | None = Field(
        None,
        gt=0,
        description="Largest distance of the brightness centroids of image and rendered solution",
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """A pose with the landmarks, corners and evaluated mixture that it was estimated from."""

    alignment: Alignment
    pose: Pose
    evaluation: MixtureEvaluation
    log_evidence: float
    visible: NDArray[np.intp]
    corners_px: FloatArray
    centroid_residual_px: float | None = None

    def matched(self) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the landmarks (M,) with a corner within their 3-sigma region (two degrees of freedom), and corners."""
        # Among the candidates of a landmark the one at the least weighted distance.
        rows, likely = np.arange(len(self.visible)), self.evaluation.squares[0].argmin(axis=1)
        near = self.evaluation.squares[0, rows, likely] < _MATCHED_D2
        corner = self.evaluation.candidates[0, rows, likely][near]
        return self.visible[near], self.corners_px[corner]


class ConsensusRecognizer:
    """Searches the whole prior for the maximum a posteriori pose, with all corners as candidates of each landmark.

    The image is aligned first. Rotations within the prior are then scored on a map of the corners, and the best ones
    are refined on a mixture: a landmark's corner is one of the nearest corners, or was not detected. Data base and
    corners are those of ``landmark-harris``, but for the places of the landmarks. A corner's ray ends at the first
    surface that it meets, so that the mean of its ends lies above the place that the corners have in common. Landmarks
    lie where the rays meet (``database.position``). The covariance is the inverse of the observed information, which
    lacks what is not known of the assignment. ``bound`` is that of corners whose landmarks are known.

    Use it when
    -----------
    The data base is that of ``landmark-harris``, and fewer failures or a usable covariance are wanted. Far from the
    body too, as the prior is part of the estimate: in 50 images of ``vesta-approach`` the median error is 2.8 km (mean
    NEES 5.2, 6 expected; ``database: {images: 200, min_observations: 10}``), that of the prior 4.9 km.

    It fails when
    -------------
    Fewer than four landmarks or corners are in view, no hypothesis has matches, or the pose found is no maximum. It
    fails too if the log evidence for landmarks among the corners, over clutter alone, is below ``log_evidence_min``:
    such a pose would be chance, and its covariance wrong. So it needs an onboard model close to the truth: of
    500 images of ``compare-mismatched``, with a shape that was made from four times the distance, it answers in one at
    most, and with exact knowledge in 294 of 300 (mean NEES 5.2). With ``log_evidence_min: 0`` it answers in 171 of 180
    images of three built-in bodies of which all relief above 3 pixels is known (mean NEES 7.0 to 8.0; with exact
    knowledge 4.7 to 6.1 of 179).

    Cost
    ----
    0.26 s an image of ``quickstart``.

    Source
    ------
    Rowell et al. (2015), section 6, propose to consider every corner within the matching radius; the method is ours.
    Observed information: T. Louis, Journal of the Royal Statistical Society B 44 (1982). Minimal sets: USAC, Raguram et
    al. (2013). Log evidence from 1 is positive: Kass and Raftery, Journal of the American Statistical Association 90
    (1995).
    """

    name: ClassVar[str] = "landmark-ransac"
    version: ClassVar[int] = 11
    options_model: ClassVar[type[SpecModel]] = ConsensusOptions

    def __init__(self, database: LandmarkDatabase, renderer: ImageRenderer, options: ConsensusOptions) -> None:
        self._database = database
        self._mesh = database.mesh()
        self._renderer = renderer
        self._options = options

    @property
    def database(self) -> LandmarkDatabase:
        """The data base whose landmarks are recognised."""
        return self._database

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its landmark data base."""
        parsed = parse_options(ConsensusOptions, options, cls.name)
        database = landmark_database(parsed.database, assets, cls.name)
        return cls(database, assets.mesh_renderer(database.mesh()), parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose; only hypotheses from minimal sets use ``rng``."""
        clock = Stopwatch()
        solution = self._solve(observation.frame, observation.camera, clock, rng)
        if isinstance(solution, str):
            return Estimate("failed", solution, timings_s=clock.seconds)
        landmark, uv_px = solution.matched()
        diagnostics = _diagnostics(solution, len(landmark))
        least, evidence = self._options.log_evidence_min, solution.log_evidence
        if least is not None and evidence < least:
            reason = f"the log evidence for landmarks is {evidence:.3g}: less than log_evidence_min {least:g}"
            return Estimate("failed", reason, diagnostics=diagnostics, timings_s=clock.seconds)
        covariance = np.linalg.inv(solution.evaluation.observed_information[0])
        return Estimate(
            "ok",
            pose=solution.pose,
            covariance=covariance + calibration_in_posterior(observation, solution.pose, covariance),
            # As if it were known which corner is whose: no candidate takes information away.
            bound=np.linalg.inv(solution.evaluation.hessian[0]),
            stages=(Stage("alignment", solution.alignment.T_cam_body), Stage("recognition", solution.pose)),
            details={"landmarks": matched_table(landmark, uv_px, self._database, observation.camera, solution.pose)},
            diagnostics=diagnostics,
            timings_s=clock.seconds,
        )

    def predict(self, planned: Observation) -> FloatArray | None:
        """Predict the covariance (6, 6) by landmarks, alignment and prior, see `Predictor` and `planned_problem`.

        Of a landmark's corner it has the information that is left among clutter, see `retained_information`, with as
        many corners as the options have, within the hull of the landmarks.
        """
        options, pose = self._options.mixture, planned.frame.prior_T_cam_body
        count = self._options.corners.count

        def retained(uv_px: FloatArray, covariances_px2: FloatArray) -> FloatArray:
            odds_px2 = landmark_odds_px2(options, count / _hull_px2(uv_px, count))
            return retained_information(odds_px2 / (2.0 * np.pi * np.sqrt(np.linalg.det(covariances_px2))))

        factors = (options.covariance_scale, options.corner_sigma_px)
        problem = planned_problem(self._database, planned, *factors, retained)
        if problem is None:
            return None
        seen, _ = problem.normal_equations(minimal_jacobian(problem, pose), problem.residuals_px(pose))
        aligned = _alignment_information(float(np.linalg.norm(pose.translation_m)), planned.camera, self._options)
        fitted = np.linalg.inv(seen + aligned + np.linalg.inv(floor_variances(planned.frame.prior_covariance)))
        return np.asarray(fitted + calibration_in_posterior(planned, pose, fitted))

    def _solve(self, frame: Frame, camera: Camera, clock: Stopwatch, rng: np.random.Generator) -> _Solution | str:
        """Solve for the pose, or return the reason why there is none."""
        options, prior = self._options, frame.prior_T_cam_body
        observed = observed_signal(frame, camera, clock)
        if isinstance(observed, str):
            return observed
        view = MeshView(camera, self._renderer, frame.sun_dir_cam)
        measure = POINT_PAIRS[options.alignment]
        alignment = align_translation(observed, prior, view, measure, options.alignment_loop, clock)
        if alignment.failure:
            return alignment.failure
        with clock("feature_extraction"):
            corners_px = detect_corners(frame.image, options.corners).uv_px
        with clock("recognition"):
            solution = self._recognise(frame, camera, alignment, corners_px, rng)
        if isinstance(solution, str):
            return solution
        with clock("consistency"):
            residual_px = centroid_residual_px(observed, solution.pose, view)
        failure = consistency_failure(residual_px, options.consistency_max_px)
        return failure or replace(solution, centroid_residual_px=residual_px)

    def _recognise(
        self, frame: Frame, camera: Camera, alignment: Alignment, corners_px: FloatArray, rng: np.random.Generator
    ) -> _Solution | str:
        options, start = self._options, alignment.T_cam_body
        visible = np.flatnonzero(visible_landmarks(self._mesh, camera, start))
        if min(len(visible), len(corners_px)) < _FEWEST:
            return f"{len(visible)} landmarks in view and {len(corners_px)} corners, {_FEWEST} of each needed"
        sigma_px = options.mixture.corner_sigma_px
        # The grid is a ball: the largest of the three sigmas covers the prior in all directions.
        turn_sigma_rad = float(np.sqrt(np.diag(floor_variances(frame.prior_covariance))[:3].max()))
        prior = _prior_after_alignment(frame, alignment, camera, options)
        first = self._mixture(visible, corners_px, camera, prior)
        if options.search.hypotheses == "prior":
            hypotheses = best_hypotheses(first, start, turn_sigma_rad, corners_px, camera, options.search)
        else:
            hypotheses = sampled_hypotheses(first, prior, start, corners_px, camera, options.search, rng)
        if not len(hypotheses):
            return "no three landmarks have a corner within their matching radius"
        pose = refine_hypotheses(first, hypotheses, sigma_px, options.search)
        # A rotation of some degrees brings other landmarks into view.
        visible = np.flatnonzero(visible_landmarks(self._mesh, camera, pose))
        last = self._mixture(visible, corners_px, camera, prior)
        poses = last.maximise(PoseStack.of([pose]), sigma_px, options.search.max_iterations, 1e-3)
        evaluation = last.evaluate(poses, sigma_px)
        if not _positive_definite(evaluation.observed_information[0]):
            return "the pose found is no maximum of the posterior: the observed information is not positive definite"
        evidence = float(last.log_evidence(evaluation)[0])
        return _Solution(alignment, poses.pose(0), evaluation, evidence, visible, corners_px)

    def _mixture(self, visible: NDArray[np.intp], corners_px: FloatArray, camera: Camera, prior: PosePrior) -> Mixture:
        means, covariances = self._database.means_m[visible], self._database.covariances_m2[visible]
        # Clutter lies on the body, not in the sky: its density is that in the convex hull of the corners.
        area_px2 = _hull_px2(corners_px, len(corners_px))
        return Mixture(means, covariances, corners_px, area_px2, camera, prior, self._options.mixture)


def _prior_after_alignment(frame: Frame, aligned: Alignment, camera: Camera, options: ConsensusOptions) -> PosePrior:
    """Update the prior with the aligned translation across the line of sight.

    The aligned translation is a measurement of x and y with the standard deviation ``alignment_sigma_px``; along the
    boresight and in attitude there is only the prior.
    """
    prior_information = np.linalg.inv(floor_variances(frame.prior_covariance))
    shifted_m = aligned.T_cam_body.translation_m
    # The distance of the body, or of its ground where that is near.
    measured = _alignment_information(aligned.depth_share * float(np.linalg.norm(shifted_m)), camera, options)
    information = prior_information + measured
    offset = np.concatenate([np.zeros(3), shifted_m - frame.prior_T_cam_body.translation_m])
    # Product of two Gaussians: (P^-1 + H) mean = H z, from the mean of the prior.
    shift = np.linalg.solve(information, measured @ offset)
    mean = frame.prior_T_cam_body.perturbed(shift[:3], shift[3:])
    return PosePrior(mean, information)


def _alignment_information(depth_m: float, camera: Camera, options: ConsensusOptions) -> FloatArray:
    """Information (6, 6) of the aligned translation across the line of sight, of what is ``depth_m`` away."""
    sigma_m = options.alignment_sigma_px * camera.pixel_angle_rad * depth_m
    return np.diag([0.0, 0.0, 0.0, sigma_m**-2, sigma_m**-2, 0.0])


def _hull_px2(uv_px: FloatArray, least_px2: float) -> float:
    """Area of the convex hull of points (N, 2), at least ``least_px2``."""
    return max(float(cv2.contourArea(cv2.convexHull(uv_px.astype(np.float32)))), float(least_px2))


def _positive_definite(matrix: FloatArray) -> bool:
    """Tell it by Cholesky's decomposition, which the different units of a pose do not disturb."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def _diagnostics(solution: _Solution, n_landmarks: int) -> dict[str, float | int | str]:
    residual_px = solution.centroid_residual_px
    return {
        "n_landmarks": n_landmarks,
        "n_predicted": len(solution.visible),
        "n_corners": len(solution.corners_px),
        "log_posterior": float(solution.evaluation.log_posterior[0]),
        "log_evidence": solution.log_evidence,
        **({} if residual_px is None else {"centroid_residual_px": residual_px}),
    }
