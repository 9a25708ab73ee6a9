"""The estimator ``landmark-harris``: section 3 of Rowell et al. (2015) from image to pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import Assets, Estimate, ImageRenderer, Stage, Stopwatch, Table, typed_product
from boresight.estimators.landmark.alignment import (
    Alignment,
    AlignmentOptions,
    MeshView,
    align_translation,
    centroid_pair,
    centroid_residual_px,
    consistency_failure,
    correlation_pair,
    image_correlation,
)
from boresight.estimators.landmark.corners import CornerOptions, Corners, detect_corners
from boresight.estimators.landmark.database import DatabaseOptions, LandmarkDatabase
from boresight.estimators.landmark.matching import Matches, inverse_2x2, match_landmarks, matched_table
from boresight.estimators.landmark.planned import planned_problem
from boresight.estimators.landmark.pose.problem import (
    MIN_LANDMARKS,
    MarquardtOptions,
    PoseFit,
    PoseProblem,
    pose_covariance,
    refine_pose,
    solve_epnp,
)
from boresight.estimators.landmark.projection import Projection, project_landmarks, visible_landmarks
from boresight.estimators.landmark.signal import observed_signal
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel, rule

PRODUCT = "landmark-database"
POINT_PAIRS = {"centroid": centroid_pair, "image": correlation_pair}


class PoseOptions(SpecModel):
    """Options of matching and solving."""

    method: Literal["both", "closed-form", "non-linear"] = Field(
        "both", description="EPnP and then Levenberg-Marquardt, or one of them alone"
    )
    marquardt: MarquardtOptions = MarquardtOptions()
    match_d2_max: float = Field(36.0, gt=0, description="Largest weighted squared distance of a match")
    max_rounds: int = Field(30, ge=1, le=1000, description="Rounds of matching and solving")


@dataclass(frozen=True, slots=True, eq=False)
class MatchingRound:
    """One round of matching and solving.

    ``projection`` has all landmarks, projected at the pose before the round, and ``visible`` (N,) those visible from
    there. ``closed_form`` is the pose by EPnP, None if not wanted or not found; ``fit`` is the pose after the round,
    None if there were too few matches or no solution.
    """

    projection: Projection
    visible: NDArray[np.bool_]
    matches: Matches
    closed_form: Pose | None = None
    fit: PoseFit | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolution:
    """All rounds and the fit of the last; ``failure`` is the reason if there is none."""

    rounds: tuple[MatchingRound, ...]
    stable: bool = False
    failure: str = ""
    fit: PoseFit | None = field(default=None)


def solve_matches(problem: PoseProblem, start: Pose, options: PoseOptions) -> tuple[Pose | None, PoseFit | None]:
    """Solve once; return the closed-form pose, if wanted, and the fit.

    If EPnP finds no pose with the landmarks in front of the camera, the refinement begins at ``start``.
    """
    closed_form = None if options.method == "non-linear" else solve_epnp(problem)
    if options.method == "closed-form":
        if closed_form is None:
            return None, None
        fit = PoseFit(closed_form, float(problem.chi2(closed_form)), pose_covariance(problem, closed_form), 0)
    else:
        fit = refine_pose(problem, closed_form or start, options.marquardt)
    usable = np.isfinite(fit.chi2) and np.isfinite(fit.covariance).all()
    return closed_form, fit if usable else None


def solve_pose(
    database: LandmarkDatabase, camera: Camera, start: Pose, corners_px: FloatArray, options: PoseOptions
) -> PoseSolution:
    """Recognise landmarks among corners (M, 2), px, and solve for the pose; they are first predicted from ``start``."""
    mesh = database.mesh()
    pose = start
    rounds: list[MatchingRound] = []
    for _ in range(options.max_rounds):
        projection = project_landmarks(database, camera, pose)
        visible = visible_landmarks(mesh, camera, pose)
        matches = match_landmarks(
            projection.uv_px, projection.covariances_px2, visible, corners_px, options.match_d2_max
        )
        # The same matches give the same pose but for the weights, so that the set is stable.
        if rounds and rounds[-1].fit is not None and matches.same_pairs(rounds[-1].matches):
            return PoseSolution(tuple(rounds), True, "", rounds[-1].fit)
        rounds.append(MatchingRound(projection, visible, matches))
        if len(matches) < MIN_LANDMARKS:
            return PoseSolution(tuple(rounds), False, f"{len(matches)} landmarks recognised, {MIN_LANDMARKS} needed")
        problem = PoseProblem(
            database.means_m[matches.landmark],
            corners_px[matches.corner],
            # Weights from the pose before the round: constant during the fit, so that chi-square is a plain sum of
            # squares.
            inverse_2x2(projection.covariances_px2[matches.landmark]),
            camera,
        )
        closed_form, fit = solve_matches(problem, pose, options)
        rounds[-1] = MatchingRound(projection, visible, matches, closed_form, fit)
        if fit is None:
            return PoseSolution(tuple(rounds), False, f"{len(matches)} recognised landmarks fix no pose")
        pose = fit.T_cam_body
    return PoseSolution(tuple(rounds), False, "", rounds[-1].fit)


@dataclass(frozen=True, slots=True)
class MeshAligner:
    """The method that aligns the mesh with the image before landmarks are predicted, and the name of its stage.

    ``align`` maps (observed signal, frame, view of the mesh, clock) to the alignment.
    """

    stage: str
    align: Callable[[NDArray[np.float32], Frame, MeshView, Stopwatch], Alignment]


class RecognitionOptions(SpecModel):
    """Options of recognition, for any method of alignment."""

    database: DatabaseOptions = DatabaseOptions()
    corners: CornerOptions | None = None
    pose: PoseOptions = PoseOptions()
    consistency_max_px: float | None = Field(
        None,
        gt=0,
        description="Largest distance of the brightness centroids of image and rendered solution",
    )
    keep: Literal["always", "if-better"] = Field(
        "always",
        description="Whether the recognised pose is always the answer, as in the paper, or only if the onboard shape"
        " rendered at it correlates no worse with the image than at the aligned pose, which is the answer otherwise",
    )


class LandmarkOptions(RecognitionOptions):
    """Options of ``landmark-harris``."""

    alignment: Literal["centroid", "image", "none"] = Field(
        "centroid", description="What is aligned first: the brightness centroid, as in the paper, the image, or nothing"
    )
    alignment_loop: AlignmentOptions = AlignmentOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Recognition:
    """All intermediate results of recognition in one image.

    ``alignment`` has no iterations where alignment is off; ``corners`` and ``solution`` are None after a failure before
    that stage. ``timings_s`` is the wall time by stage, as in the paper's Table 1. ``failure`` is the reason why there
    is no pose; empty if there is one. ``centroid_residual_px`` is the distance of the brightness centroids of the image
    and of the mesh rendered at the solution, None if unknown. ``correlations`` are the image correlations of the
    onboard shape at the aligned and at the recognised pose, None with ``keep: always``.
    """

    prior: Pose
    alignment: Alignment
    corners: Corners | None
    solution: PoseSolution | None
    timings_s: Mapping[str, float]
    failure: str = ""
    centroid_residual_px: float | None = None
    correlations: tuple[float, float] | None = None

    @property
    def kept(self) -> bool:
        """Whether the recognised pose is the answer: with ``keep: if-better``, if it correlates at least as well."""
        return self.correlations is None or self.correlations[1] >= self.correlations[0]

    @property
    def fit(self) -> PoseFit | None:
        """The last fit; None if there is none or it is not kept."""
        return self.solution.fit if self.solution is not None and self.kept else None

    @property
    def T_cam_body(self) -> Pose:
        """The estimated pose: of the fit, or else of the alignment."""
        return self.alignment.T_cam_body if self.fit is None else self.fit.T_cam_body


def translation_aligner(options: LandmarkOptions) -> MeshAligner:
    """Return the alignment across the line of sight by centroids or by correlation of whole images."""

    def align(observed: NDArray[np.float32], frame: Frame, view: MeshView, clock: Stopwatch) -> Alignment:
        prior = frame.prior_T_cam_body
        if options.alignment == "none":
            return Alignment(prior, ())
        return align_translation(observed, prior, view, POINT_PAIRS[options.alignment], options.alignment_loop, clock)

    return MeshAligner("centroid" if options.alignment == "centroid" else "alignment", align)


def landmark_database(options: DatabaseOptions, assets: Assets, estimator: str) -> LandmarkDatabase:
    """Return the landmark data base of some options for the estimator of that name."""
    return typed_product(assets, PRODUCT, options, LandmarkDatabase, estimator)


class ShapeOptions(SpecModel):
    """Options of an estimator that renders a shape."""

    shape: Literal["onboard", "landmark-mesh"] = Field(
        "onboard", description="The full shape that the spacecraft carries, or the mesh of its landmark data base"
    )
    database: DatabaseOptions | None = Field(
        None, description="The data base of ``landmark-mesh``; it has no other use"
    )

    @rule
    def _database_has_a_use(self) -> None:
        if self.shape == "landmark-mesh" and self.database is None:
            raise ValueError("shape: landmark-mesh is the mesh of a data base: give database, {} for the default one")
        if self.shape == "onboard" and self.database is not None:
            raise ValueError("database has no use with shape: onboard: leave it out, or give shape: landmark-mesh")


def rendered_mesh(options: ShapeOptions, assets: Assets, estimator: str) -> TriangleMesh:
    """Return the mesh that the estimator of that name renders."""
    if options.database is None:
        return assets.shape()
    return landmark_database(options.database, assets, estimator).mesh()


def shape_renderer(options: RecognitionOptions, assets: Assets) -> ImageRenderer | None:
    """Return a renderer of the onboard shape with ``keep: if-better``; None otherwise."""
    return None if options.keep == "always" else assets.mesh_renderer(assets.shape())


class LandmarkRecognizer:
    """Recognises known landmarks by the proximity of Harris corners, after Rowell et al. (2015).

    The mesh of the landmarks is rendered and shifted onto the brightness centroid of the image. Landmarks are projected
    and matched with the nearest corners; EPnP and Levenberg-Marquardt solve for the pose. Matching and solving
    alternate until the matches no longer change. The covariance is that of the least-squares fit, without the prior.

    Use it when
    -----------
    The method of the paper is wanted, or the data base must be small, and the onboard model is close to the truth.

    It fails when
    -------------
    Fewer than four landmarks are matched, or the pose is fitted to wrong matches: the fit then looks good and is not.
    It needs an onboard model close to the truth. Of 500 images of ``compare-mismatched`` it gave no estimate, or one
    worse than the prior, in 18.6 % with exact knowledge and in 68.2 % with that of a mission. The covariance is far too
    small: mean NEES 398 with exact knowledge, 6 expected.

    Far from the body a good prior is better. Corners are off by a pixel, so that they alone fix the attitude relative
    to the body to 0.02 to 0.1 deg at best, and the position to the range times that. In 50 images of
    ``vesta-approach``, 15 lengths of the body away, the median error is 28 km, with a prior of 4.6 km and 0.03 deg.

    Cost
    ----
    0.10 s an image of ``quickstart``.

    Source
    ------
    Rowell et al. (2015): data base section 2, projection 3.1, centroid 3.2, corners 3.3, matching and pose 3.4.
    """

    name: ClassVar[str] = "landmark-harris"
    version: ClassVar[int] = 6
    options_model: ClassVar[type[SpecModel]] = LandmarkOptions

    def __init__(
        self,
        database: LandmarkDatabase,
        renderer: ImageRenderer,
        options: RecognitionOptions,
        aligner: MeshAligner,
        shape_view: ImageRenderer | None = None,
    ) -> None:
        self._shape_renderer = shape_view
        self._database = database
        self._renderer = renderer
        self._options = options
        self._aligner = aligner

    @property
    def database(self) -> LandmarkDatabase:
        """The data base whose landmarks are recognised."""
        return self._database

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its landmark data base."""
        parsed = parse_options(LandmarkOptions, options, cls.name)
        database = landmark_database(parsed.database, assets, cls.name)
        shape = shape_renderer(parsed, assets)
        return cls(database, assets.mesh_renderer(database.mesh()), parsed, translation_aligner(parsed), shape)

    def recognise(self, frame: Frame, camera: Camera) -> Recognition:
        """Recognise the landmarks of a frame and return all intermediate results.

        Raise BoresightError if the image does not have the camera's size.
        """
        prior, clock, options = frame.prior_T_cam_body, Stopwatch(), self._options
        view = MeshView(camera, self._renderer, frame.sun_dir_cam)
        observed = observed_signal(frame, camera, clock)
        if isinstance(observed, str):
            return Recognition(prior, Alignment(prior, ()), None, None, clock.seconds, observed)
        # Section 3.2: matching by proximity needs the error across the line of sight to be small.
        alignment = self._aligner.align(observed, frame, view, clock)
        if alignment.failure:
            return Recognition(prior, alignment, None, None, clock.seconds, alignment.failure)
        with clock("feature_extraction"):
            corners = detect_corners(frame.image, options.corners or options.database.corners)
        with clock("recognition"):
            solution = solve_pose(self._database, camera, alignment.T_cam_body, corners.uv_px, options.pose)
        if solution.fit is None:
            return Recognition(prior, alignment, corners, solution, clock.seconds, solution.failure)
        with clock("consistency"):
            # The outliers of the paper (section 4.2.1) are bodies rolled incorrectly onto wrong matches: the brightness
            # centroid does not depend on the matches.
            residual_px = centroid_residual_px(observed, solution.fit.T_cam_body, view)
            correlations = None
            if self._shape_renderer is not None:
                shape_view = replace(view, renderer=self._shape_renderer)
                before, after = alignment.T_cam_body, solution.fit.T_cam_body
                correlations = (
                    image_correlation(observed, before, shape_view),
                    image_correlation(observed, after, shape_view),
                )
        failure = solution.failure or consistency_failure(residual_px, options.consistency_max_px)
        return Recognition(prior, alignment, corners, solution, clock.seconds, failure, residual_px, correlations)

    def predict(self, planned: Observation) -> FloatArray | None:
        """Predict the covariance (6, 6) without wrong matches, see `Predictor` and `planned_problem`.

        The result is None also with the closed form alone: it is no least-squares fit.
        """
        problem = planned_problem(self._database, planned)
        if problem is None or self._options.pose.method == "closed-form":
            return None
        pose = planned.frame.prior_T_cam_body
        covariance = pose_covariance(problem, pose)
        return covariance + planned.calibration_covariance(pose) if np.isfinite(covariance).all() else None

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose; ``rng`` is not used."""
        del rng
        found = self.recognise(observation.frame, observation.camera)
        ok, fit = not found.failure, found.fit
        return Estimate(
            status="ok" if ok else "failed",
            reason=found.failure,
            pose=found.T_cam_body if ok else None,
            covariance=fit.covariance if ok and fit is not None else None,
            stages=self._stages(found),
            details=_details(found, self._database, observation.camera) if ok else {},
            diagnostics=_diagnostics(found),
            timings_s=found.timings_s,
        )

    def _stages(self, result: Recognition) -> tuple[Stage, ...]:
        """Return the poses after alignment, recognition and the choice between them, as far as they were reached."""
        stages = [Stage(self._aligner.stage, result.alignment.T_cam_body)] if result.alignment.steps else []
        if result.solution is not None and result.solution.fit is not None:
            stages.append(Stage("recognition", result.solution.fit.T_cam_body))
            if result.correlations is not None:
                stages.append(Stage("choice", result.T_cam_body))
        return tuple(stages)


def _diagnostics(result: Recognition) -> dict[str, float | int | str]:
    diagnostics: dict[str, float | int | str] = {"centroid_iterations": len(result.alignment.steps)}
    if result.corners is not None:
        diagnostics["n_corners"] = len(result.corners)
    if result.solution is not None:
        last = result.solution.rounds[-1]
        diagnostics["n_landmarks"] = len(last.matches) if result.kept else 0
        diagnostics["n_predicted"] = int(last.visible.sum())
        diagnostics["outlier_rounds"] = len(result.solution.rounds)
        diagnostics["stable"] = int(result.solution.stable)
        if result.solution.fit is not None:
            diagnostics["chi2"] = result.solution.fit.chi2
    if result.correlations is not None:
        diagnostics["kept"] = int(result.kept)
        diagnostics["likeness_before"], diagnostics["likeness"] = result.correlations
    if result.centroid_residual_px is not None:
        diagnostics["centroid_residual_px"] = result.centroid_residual_px
    return diagnostics


def _details(found: Recognition, database: LandmarkDatabase, camera: Camera) -> dict[str, Table]:
    """Return the table of recognised landmarks, see `matched_table`, if the recognised pose is kept."""
    if found.fit is None or found.solution is None or found.corners is None:
        return {}
    matches = found.solution.rounds[-1].matches
    uv_px = found.corners.uv_px[matches.corner]
    return {"landmarks": matched_table(matches.landmark, uv_px, database, camera, found.fit.T_cam_body)}
