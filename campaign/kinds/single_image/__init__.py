"""Kind of trial: the pose of one image is degraded, each estimator refines it, and the result is scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.observe import plan
from boresight.campaign.imaging.world import TrialImage, World, check_views, open_world
from boresight.campaign.products import BuiltAssets, Prepared
from boresight.campaign.products.databases import with_database_craters
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.checks import (
    MOST,
    check_array,
    check_covariance,
    check_indices,
    check_name,
    check_names,
    check_numbers,
    check_seconds,
    check_semidefinite,
    check_several,
    check_status,
    check_type,
)
from boresight.campaign.trial.images import ImageDraw, draw_image
from boresight.campaign.trial.kind import InspectedTrial, Prediction, Record, Records, WorkerContext
from boresight.campaign.trial.runner import TrialRunner, Unbuilt, check_options, try_build, unbuilt_products
from boresight.campaign.trial.score import consistency, pose_columns, pose_error, predicted_errors
from boresight.estimators.contract import Estimate, Estimator, Predictor, Stage, Table
from boresight.estimators.options import model_of
from boresight.estimators.registry import can_predict, estimator_class
from boresight.scenarios.draw import estimator_generator
from boresight.scenarios.geometry import Pose, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Observation
from boresight.scenarios.onboard import onboard_camera
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import EstimatorSpec

LANDMARK_NUMBERS = (
    *("u_px", "v_px", "x_m", "y_m", "z_m"),
    *("sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2"),
)
"""Columns of the details ``landmarks`` beside ``landmark``: corner, mean and covariance."""

Drawn = TypeVar("Drawn")
Answer = TypeVar("Answer")

_RIGID = 1e-6
_MOST_PX = 1e6
_PARAMETERS = 6

EstimatedImage = InspectedTrial[View, Observation, Estimate]
"""A trial of one estimator, for inspection; the true view of a real image is that of the reference pose."""


def check(estimate: Estimate) -> None:
    """Refuse an estimate that does not keep the contract.

    Raise `ValueError` if it is none, the status or the reason is none, it is ok without a pose, or a number is not
    finite or of an impossible size.
    """
    check_type(estimate, Estimate)
    check_status(estimate.status, estimate.reason)
    check_several("stages", estimate.stages)
    for stage in estimate.stages:
        check_type(stage, Stage)
        check_name("a stage", stage.name)
        _check_pose(stage.T_cam_body, f"the pose after {stage.name}")
    check_numbers(estimate.diagnostics, "diagnostics", texts=True)
    if isinstance(estimate.diagnostics.get("n_landmarks"), str):
        raise ValueError("diagnostics: n_landmarks is a text")  # noqa: TRY004  every invalid result is a ValueError
    check_seconds(estimate.timings_s, "timings_s")
    _check_details(estimate.details)
    _check_solution(estimate)


def _check_solution(estimate: Estimate) -> None:
    """Refuse a pose and covariances that are none, also of an estimate that failed, and an ok one without a pose."""
    if estimate.pose is not None:
        _check_pose(estimate.pose, "the pose")
    elif estimate.status == "ok":
        raise ValueError("an ok estimate has no pose")
    for what, matrix in (("covariance", estimate.covariance), ("bound", estimate.bound)):
        if matrix is not None:
            check_covariance(f"a {what}", matrix, _PARAMETERS)
    if estimate.common is not None:
        check_array("the common error", estimate.common, (_PARAMETERS,))


def _check_pose(pose: Pose, which: str) -> None:
    check_type(pose, Pose)
    check_type(pose.rotation, np.ndarray)
    check_type(pose.translation_m, np.ndarray)
    if (pose.to_frame, pose.from_frame) != ("cam", "body"):
        raise ValueError(f"{which} is T_{pose.to_frame}_{pose.from_frame}, not T_cam_body")
    residual = np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max()
    possible = np.abs(pose.translation_m).max() <= MOST
    if not (possible and residual < _RIGID and np.linalg.det(pose.rotation) > 0):
        raise ValueError(f"{which} is not rigid: rotation off by {residual:.1e}, translation {pose.translation_m}")


def _check_details(details: Mapping[str, Table]) -> None:
    """Refuse tables that are not arrays by name, and recognised landmarks that cannot be scored."""
    check_names("details", details)
    for name, table in details.items():
        check_names(f"details: {name}", table)
        for column, values in table.items():
            if not isinstance(values, np.ndarray) or values.dtype.kind not in "biufU":
                raise ValueError(f"details: {name}: {column} is no array of numbers or texts")
    if "landmarks" in details:
        _check_landmarks(details["landmarks"])


def _check_landmarks(table: Table) -> None:
    """Refuse recognised landmarks that cannot be scored: columns, their lengths, and covariances."""
    n = len(table["landmark"]) if "landmark" in table else -1
    missing = [name for name in ("landmark", *LANDMARK_NUMBERS) if name not in table]
    if missing and n != 0:
        raise ValueError(f"details: landmarks: columns are missing: {', '.join(missing)}")
    if n == 0:
        return
    check_indices("details: landmarks: landmark", table["landmark"], (n,))
    for name in LANDMARK_NUMBERS:
        most = _MOST_PX if name.endswith("_px") else MOST**2
        check_array(f"details: landmarks: {name}", table[name], (n,), most)
    xx, xy, xz, yy, yz, zz = (np.asarray(table[name], dtype=np.float64) for name in LANDMARK_NUMBERS[5:])
    covariances = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    check_semidefinite("details: landmarks: a covariance", covariances)
    try:
        np.linalg.inv(covariances)
    except np.linalg.LinAlgError:
        raise ValueError("details: landmarks: a covariance is singular") from None


class ImageMethods(TrialRunner[Estimator, Drawn, Answer]):
    """Trials of estimators of single images, with the products that these ask for."""

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of an estimator."""
        return estimator_class(name).version

    @classmethod
    def options_model(cls, name: str) -> type[SpecModel] | None:
        return model_of(estimator_class(name))

    @classmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> Mapping[str, object]:
        """Refuse wrong options; estimators need assets, and `open` builds them."""
        check_options(campaign, scenario, cls.entries(campaign, scenario))
        return {}

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets) -> list[Prepared]:
        """Let every estimator ask for its products, and for the shape."""
        products: list[Prepared] = []
        for number, entry in product(range(campaign.spec.databases), cls.entries(campaign, scenario)):
            asked = assets.for_database(number)
            method = _method(entry, scenario, asked)
            products += asked.products_of(entry.label)
            products += asked.shape_of(entry.label) if number == 0 else []
            products += unbuilt_products(scenario, {entry.label: method})
        return products

    @classmethod
    def opened(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int, **world: Any
    ) -> Self:
        """Make the trials of a scenario in a world, with all estimators, built with the data bases of a number."""
        assets = BuiltAssets(scenario, context.run / "products", None, campaign.variant, None, campaign.draft, number)
        asked = {label: assets.for_database(number) for label in campaign.labels}
        return cls(
            scenario=scenario.spec.name,
            methods={
                entry.label: _method(entry, scenario, asked[entry.label]) for entry in cls.entries(campaign, scenario)
            },
            seed=campaign.seed,
            database={label: number for label, one in asked.items() if one.depends_on_database},
            **world,
        )


@dataclass(frozen=True, eq=False)
class SingleImage(ImageMethods[ImageDraw, Estimate]):
    """Trials of estimators that refine the pose of one image; every one sees the same observation.

    ``folder`` keeps the images of all trials; None to keep none.
    """

    name = "single-image"
    version = 3
    block_trials = 10
    databases = True

    world: World
    folder: Path | None = None

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without images."""
        check_views(scenario)

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Open the world and build the estimators."""
        return cls.opened(
            campaign,
            scenario,
            context,
            number,
            world=open_world(with_database_craters(scenario, number), campaign.variant),
            folder=context.image_folder(scenario.spec.name),
        )

    def flush(self) -> None:
        self.world.source.flush()

    def draw(self, trial: int) -> ImageDraw:
        """Render or read an image, and degrade what is known of it."""
        return draw_image(self.world, self.seed, trial, self.folder)

    @classmethod
    def predicts(cls, entry: EstimatorSpec) -> bool:
        return can_predict(entry.name, entry.options)

    def predictors(self, trial: int) -> Mapping[str, Prediction]:
        """Plan the observation of a trial, without an image."""
        planned = plan(self.world, self.seed, trial)

        def predict(method: Predictor) -> Mapping[str, float] | None:
            covariance = method.predict(planned)
            if covariance is None:
                return None
            check_covariance("a predicted covariance", covariance, _PARAMETERS)
            return predicted_errors(covariance, planned.frame.prior_T_cam_body)

        return {label: partial(predict, one) for label, one in self.methods.items() if isinstance(one, Predictor)}

    def row(self, drawn: ImageDraw) -> Record:
        trial_image, true = drawn.trial_image, drawn.trial_image.view.T_cam_body
        x, y, z = true.camera_position_m
        prior = pose_error(drawn.observation.frame.prior_T_cam_body, true)
        return {
            **{f"prior_{name}": value for name, value in prior.items()},
            "image": trial_image.image_name,
            "range_m": float(np.linalg.norm(true.translation_m)),
            "latitude_deg": float(np.degrees(np.arctan2(z, np.hypot(x, y)))),
            "phase_deg": float(np.degrees(trial_image.view.phase_angle_rad)),
            "time_s": trial_image.time_s,
            **pose_columns(true, "true_"),
        }

    def ask(self, method: Estimator, drawn: ImageDraw) -> Estimate:
        """Let an estimator refine the pose."""
        return method.estimate(own_copy(drawn.observation), rng=estimator_generator(self.seed, drawn.trial))

    def check(self, answer: Estimate, drawn: ImageDraw) -> None:
        check(answer)

    def score(self, answer: Estimate, drawn: ImageDraw) -> Records:
        """Score pose, stages and recognised landmarks."""
        true = drawn.trial_image.view.T_cam_body
        final = answer.pose if answer.status == "ok" else None
        row: Record = {}
        references: list[Record] = []
        if final is not None:
            row |= {**pose_error(final, true), **pose_columns(final)}
            row |= consistency(final, true, answer.covariance, answer.bound, drawn.trial_image.covariance)
            views = drawn.trial_image.further
            references = [{"reference": name, **pose_error(final, one.T_cam_body)} for name, one in views.items()]
        row |= {
            "status": answer.status,
            "reason": answer.reason,
            "n_landmarks": int(answer.diagnostics.get("n_landmarks", 0)),
        }
        numbers = {name: float(value) for name, value in answer.diagnostics.items() if not isinstance(value, str)}
        return {
            "stages": [{"stage": str(s.name), **pose_error(s.T_cam_body, true)} for s in answer.stages],
            "references": references,
            "landmarks": self._landmarks(answer.details.get("landmarks"), drawn.trial_image),
            "diagnostics": [{"name": str(name), "value": value} for name, value in numbers.items()],
            "timings": [{"stage": str(name), "seconds": float(value)} for name, value in answer.timings_s.items()],
            "rows": [row],
        }

    def of_all(self, drawn: ImageDraw) -> Records:
        return drawn.timings

    def shown(self, answer: Estimate | None, drawn: ImageDraw) -> EstimatedImage:
        image = drawn.trial_image
        return InspectedTrial(image.view, drawn.observation, answer, image.image, image.image_name)

    def _landmarks(self, table: Table | None, trial_image: TrialImage) -> list[Record]:
        """Score recognised landmarks: the corner's true surface point against the landmark's distribution.

        Rowell et al. (2015), section 4.2.2. Corners whose line of sight misses the body have no error: None.
        """
        if table is None or len(table["landmark"]) == 0:
            return []
        uv = _columns(table, "u_px", "v_px")
        on_detector = onboard_camera(self.world.scenario.spec).distorted(uv)
        seen = self.world.renderer.surface(trial_image.view, on_detector).points_body_m
        offset = seen - _columns(table, "x_m", "y_m", "z_m")
        names = ("sxx", "sxy", "sxz", "sxy", "syy", "syz", "sxz", "syz", "szz")
        covariance = _columns(table, *(f"{name}_m2" for name in names)).reshape(-1, 3, 3)
        weighted = np.linalg.solve(covariance, offset[..., None])[..., 0]
        errors = np.linalg.norm(offset, axis=1)
        squares = np.einsum("ni,ni->n", offset, weighted)
        return [
            {
                "landmark": int(landmark),
                "u_px": float(u),
                "v_px": float(v),
                "error_m": float(error) if np.isfinite(error) else None,
                "chi_square": float(square) if np.isfinite(square) else None,
            }
            for landmark, (u, v), error, square in zip(table["landmark"], uv, errors, squares, strict=True)
        ]


def _method(entry: EstimatorSpec, scenario: LoadedScenario, assets: BuiltAssets) -> Estimator | Unbuilt:
    given = assets.for_estimator()
    return try_build(entry, scenario.spec.name, lambda: estimator_class(entry.name).from_options(entry.options, given))


def _columns(table: Table, *names: str) -> NDArray[np.float64]:
    return np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])


KIND = SingleImage
