"""Kind of trial: pose solvers on landmarks drawn from their own covariances (figure 5 of Rowell et al. 2015)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.products import BuiltAssets, BuiltProduct
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import Prediction, Record, Records, Trials, WorkerContext, check_only_method
from boresight.campaign.trial.runner import located
from boresight.campaign.trial.score import pose_errors, predicted_errors, view_columns
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.matching import inverse_2x2
from boresight.estimators.landmark.pose.problem import MarquardtOptions, pose_covariance
from boresight.estimators.landmark.pose.stack import (
    NAME,
    VERSION,
    PoseSolverOptions,
    PoseStack,
    ProblemStack,
    closed_forms,
    refine_poses,
    solve_stack,
)
from boresight.estimators.landmark.projection import faces_camera, image_covariances, is_occluded
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, degrade, draw_view, drawn_together, generator, state_of_trial
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import EstimatorSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

_MINIMUM = MarquardtOptions(parameters="minimal", tolerance=1e-12)

LANDMARKS = 10
_TESTED_AT_ONCE = 16


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkDraw:
    """One trial: the true view, the disturbed pose, and where landmarks are observed.

    ``chosen`` (10,) are indices of landmarks, fewer where fewer can be seen; ``uv_px`` (10, 2) are their positions.
    """

    view: View
    prior: Pose
    chosen: NDArray[np.intp]
    uv_px: FloatArray


def draw_landmarks(spec: ScenarioSpec, database: LandmarkDatabase, seed: int, trial: int) -> LandmarkDraw:
    """Draw a view, ten of the landmarks that are visible from it, and a position of each in the image.

    The paper draws ten landmarks of those projected into the image; a camera sees none behind the body, so they are
    drawn from the visible ones.
    """
    camera, spec = spec.camera.camera(), drawn_together(spec, seed, trial)
    state = state_of_trial(spec.viewpoint, seed, trial)
    view = draw_view(spec, camera, generator(seed, Stream.TRUTH, trial), state)
    truth = view.T_cam_body
    rng = generator(seed, Stream.LANDMARKS, trial)
    chosen = first_visible(database.mesh(), camera, truth, rng.permutation(len(database)))
    points_cam_m = truth.transform(database.means_m[chosen])
    covariances = image_covariances(database.covariances_m2[chosen], points_cam_m, camera, truth)
    error = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(LANDMARKS, 2))[: len(chosen)])
    states = None if spec.viewpoint is None else spec.viewpoint.states
    velocity_m_s = None if states is None else states.velocity(state)
    prior = degrade(truth, spec.pose_error, camera, generator(seed, Stream.POSE_ERROR, trial), velocity_m_s)
    return LandmarkDraw(view, prior, chosen, camera.project(points_cam_m) + error)


def first_visible(
    mesh: TriangleMesh, camera: Camera, T_cam_body: Pose, order: NDArray[np.integer], count: int = LANDMARKS
) -> NDArray[np.intp]:
    """Return the first ``count`` vertices, in the given order, that the camera sees; all where they are fewer."""
    position = T_cam_body.camera_position_m
    near_side = camera.contains(camera.project(T_cam_body.transform(mesh.vertices_m))) & faces_camera(mesh, position)
    candidates = np.asarray(order[near_side[order]], dtype=np.intp)
    seen = np.empty(0, dtype=np.intp)
    for start in range(0, len(candidates), _TESTED_AT_ONCE):
        tested = candidates[start : start + _TESTED_AT_ONCE]
        seen = np.concatenate([seen, tested[~is_occluded(mesh, position, tested)]])
        if len(seen) >= count:
            break
    return seen[:count]


def problem_stack(draws: Sequence[LandmarkDraw], database: LandmarkDatabase, camera: Camera) -> ProblemStack:
    """Set the pose problems of trials side by side, weighted with the covariances seen from the disturbed poses."""
    chosen = np.stack([draw.chosen for draw in draws])
    points = database.means_m[chosen]
    covariances = [
        image_covariances(database.covariances_m2[draw.chosen], draw.prior.transform(seen), camera, draw.prior)
        for draw, seen in zip(draws, points, strict=True)
    ]
    information = inverse_2x2(np.concatenate(covariances)).reshape(*chosen.shape, 2, 2)
    return ProblemStack(points, np.stack([draw.uv_px for draw in draws]), information, camera)


@dataclass(frozen=True, eq=False)
class PoseConvergence(Trials):
    """Trials of pose solvers; every one gets the same observations, and a block of trials is solved at once.

    Of ``spec``, camera, viewpoint and pose errors count; nothing is rendered.
    """

    name = "pose-convergence"
    version = 1
    block_trials = 1000
    # Nothing is rendered: a process grows by less than 1 MB in 1000 trials, and takes half as long as a block to start.
    process_trials = 100_000

    methods: Mapping[str, PoseSolverOptions]
    spec: ScenarioSpec
    landmarks: LandmarkDatabase

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of the solvers."""
        check_only_method(cls.name, NAME, name)
        return VERSION

    @classmethod
    def options_model(cls, name: str) -> type[SpecModel]:
        return PoseSolverOptions

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without a viewpoint."""
        if scenario.spec.viewpoint is None:
            raise BoresightError(f"{scenario.path}: viewpoint: missing, but the experiment {NAME} needs it")
        if scenario.spec.viewpoint.altitude_m is not None:
            raise BoresightError(f"{scenario.path}: viewpoint.altitude_m has no part in {NAME}: give range_m")
        if scenario.spec.onboard.pose_error is not None:
            raise BoresightError(f"{scenario.path}: onboard.pose_error has no part in {NAME}: leave it out")

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        told = ("sun_error_deg", "pole_error_deg", "rotation_error_deg", "camera_sigma", "pose_error", "declared")
        return (
            *("detector", "lighting.brightness", "second_body", "stars", "sensors", "viewpoint.keep_clear_px"),
            *(f"onboard.{key}" for key in told),
        )

    @classmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, PoseSolverOptions]:
        """Return the options of each solver; refuse wrong ones, and solvers of different data bases."""
        found = {}
        for entry in cls.entries(campaign, scenario):
            with located(campaign, entry.label):
                found[entry.label] = parse_options(PoseSolverOptions, entry.options, entry.name)
        first, *others = (options.database for options in found.values())
        if any(other != first for other in others):
            raise BoresightError(f"estimators: the options database of {', '.join(found)} differ: give all the same")
        return found

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets) -> list[BuiltProduct]:
        """Build the data base, which all solvers share."""
        _database(cls.build_methods(campaign, scenario), assets)
        return assets.products_of(NAME)

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Read the data base."""
        place = context.run / "products"
        assets = BuiltAssets(scenario, place, None, campaign.variant, None, campaign.draft, number)
        landmarks = _database(cls.build_methods(campaign, scenario), assets)
        return cls.made(campaign, scenario, number, spec=scenario.spec, landmarks=landmarks)

    def trial(self, trial: int) -> Records:
        return self.run(range(trial, trial + 1))

    def run(self, trials: range) -> Records:
        """Run trials: records in the order of trials and solvers."""
        draws = [draw_landmarks(self.spec, self.landmarks, self.seed, trial) for trial in trials]
        full = [i for i, draw in enumerate(draws) if len(draw.chosen) == LANDMARKS]
        scored = self._scored([draws[i] for i in full]) if full else {}
        row_of = {i: row for row, i in enumerate(full)}
        true = PoseStack.of([draw.view.T_cam_body for draw in draws])
        priors = pose_errors(PoseStack.of([draw.prior for draw in draws]), true)
        records: Records = {"rows": [], "diagnostics": []}
        for i, (trial, draw) in enumerate(zip(trials, draws, strict=True)):
            circumstances: Record = {
                **{f"prior_{name}": float(values[i]) for name, values in priors.items()},
                "n_landmarks": len(draw.chosen),
                "image": "",
                **view_columns(draw.view),
            }
            reason = f"{len(draw.chosen)} landmarks are visible, {LANDMARKS} needed"
            unseen: Record = {"status": "failed", "reason": reason}
            for label in self.methods:
                key: Record = {"trial": trial, "scenario": self.scenario, "estimator": label}
                row, numbers = scored[label][row_of[i]] if i in row_of else (unseen, {})
                records["rows"].append({**key, **circumstances, **row})
                records["diagnostics"] += [{**key, "name": name, "value": value} for name, value in numbers.items()]
        return records

    @classmethod
    def predicts(cls, entry: EstimatorSpec) -> bool:
        """Whether a solver minimises: the covariance of the closed form is not that of a least-squares fit."""
        return entry.options.get("method") != "closed-form"

    def predictors(self, trial: int) -> Mapping[str, Prediction]:
        """Draw a view with its landmarks; none if they are too few."""
        draw = draw_landmarks(self.spec, self.landmarks, self.seed, trial)
        if len(draw.chosen) < LANDMARKS:
            return {}
        truth, camera = draw.view.T_cam_body, self.spec.camera.camera()

        def predict() -> Mapping[str, float] | None:
            planned = problem_stack([replace(draw, prior=truth)], self.landmarks, camera)
            covariance = pose_covariance(planned.problem(0), truth)
            return predicted_errors(covariance, truth) if np.isfinite(covariance).all() else None

        return dict.fromkeys((label for label, one in self.methods.items() if one.method != "closed-form"), predict)

    def _scored(self, draws: Sequence[LandmarkDraw]) -> dict[str, list[tuple[Record, dict[str, float]]]]:
        """Solve and score: for each label, one row and its diagnostics for each draw.

        ``chi2_excess`` is how far the solution lies above the minimum next to the truth, which only the experiment
        can look for; a solver that is stuck shows there.
        """
        problems = problem_stack(draws, self.landmarks, self.spec.camera.camera())
        truths, closed = PoseStack.of([draw.view.T_cam_body for draw in draws]), closed_forms(problems)
        priors = PoseStack.of([draw.prior for draw in draws])
        lowest = refine_poses(problems, truths, _MINIMUM).chi2
        scored = {}
        for label, options in self.methods.items():
            fits = solve_stack(problems, priors, closed, options)
            columns = pose_errors(fits.poses, truths)
            numbers = {"iterations": fits.iterations.astype(np.float64), "chi2_excess": fits.chi2 - lowest}
            scored[label] = list(_solved(fits.chi2, columns, numbers))
        return scored


def _database(solvers: Mapping[str, PoseSolverOptions], assets: BuiltAssets) -> LandmarkDatabase:
    """Return the one data base of all solvers, so that they are compared on the same trials."""
    database = assets.product("landmark-database", next(iter(solvers.values())).database.model_dump(mode="json"))
    if not isinstance(database, LandmarkDatabase):
        raise BoresightError(f"{NAME}: the product is a {type(database).__name__}, not a landmark data base")
    return database


def _solved(
    chi2: FloatArray, columns: Mapping[str, FloatArray], numbers: Mapping[str, FloatArray]
) -> Iterator[tuple[Record, dict[str, float]]]:
    for i, value in enumerate(chi2):
        if np.isfinite(value):
            errors = {name: float(errors[i]) for name, errors in columns.items()}
            yield {**errors, "status": "ok", "reason": ""}, {name: float(found[i]) for name, found in numbers.items()}
        else:
            yield {"status": "failed", "reason": "no pose in front of the camera"}, {}


KIND = PoseConvergence
