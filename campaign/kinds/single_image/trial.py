"""The single-image experiment: degrade the pose of one image, let each estimator refine it, score."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.world import TrialImage, World, check_views, open_world
from boresight.campaign.kinds.single_image.check import check
from boresight.campaign.products import BuiltAssets, BuiltProduct, MissingProduct
from boresight.campaign.products.databases import with_database_craters
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.images import ImageDraw, draw_image
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, WorkerContext
from boresight.campaign.trial.methods import Unbuilt, check_options, try_build, unbuilt_products
from boresight.campaign.trial.pose_score import consistency, pose_columns, pose_error
from boresight.campaign.trial.runner import TrialRunner
from boresight.estimators.contract import Estimate, Estimator, Table
from boresight.estimators.options import model_of
from boresight.estimators.registry import estimator_class
from boresight.scenarios.draw import estimator_generator
from boresight.scenarios.geometry import View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Observation
from boresight.scenarios.onboard import onboard_camera
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import EstimatorSpec

EstimatedImage = InspectedTrial[View, Observation, Estimate]
"""A trial of one estimator, for inspection; the true view of a real image is that of the reference pose."""


@dataclass(frozen=True, eq=False)
class SingleImage(TrialRunner[Estimator, ImageDraw, Estimate]):
    """Trials of estimators that refine the pose of one image; every one sees the same observation.

    ``folder`` keeps the images of all trials; None to keep none.
    """

    name = "single-image"
    version = 2
    block_trials = 10
    databases = True

    world: World
    folder: Path | None = None

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of an estimator."""
        return estimator_class(name).version

    @classmethod
    def options_model(cls, name: str) -> type[SpecModel] | None:
        return model_of(estimator_class(name))

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without images."""
        check_views(scenario)

    @classmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> Mapping[str, object]:
        """Refuse wrong options; estimators need assets, and `open` builds them."""
        check_options(campaign, scenario, cls.entries(campaign, scenario))
        return {}

    @classmethod
    def prepare(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets
    ) -> list[BuiltProduct | MissingProduct]:
        """Let every estimator ask for its products."""
        products: list[BuiltProduct | MissingProduct] = []
        for number, entry in product(range(campaign.spec.databases), cls.entries(campaign, scenario)):
            asked = assets.for_database(number)
            method = _method(entry, scenario, asked)
            products += asked.products_of(entry.label)
            products += unbuilt_products(scenario, {entry.label: method})
        return products

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Open the world and build the estimators."""
        assets = BuiltAssets(scenario, context.run / "products", None, campaign.variant, None, campaign.draft, number)
        asked = {label: assets.for_database(number) for label in campaign.labels}
        return cls(
            scenario=scenario.spec.name,
            methods={
                entry.label: _method(entry, scenario, asked[entry.label]) for entry in cls.entries(campaign, scenario)
            },
            seed=campaign.seed,
            world=open_world(with_database_craters(scenario, number), campaign.variant),
            folder=context.image_folder(scenario.spec.name),
            database={label: number for label, one in asked.items() if one.depends_on_database},
        )

    def flush(self) -> None:
        self.world.source.flush()

    def draw(self, trial: int) -> ImageDraw:
        """Render or read an image, and degrade what is known of it."""
        return draw_image(self.world, self.seed, trial, self.folder)

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
            row |= consistency(final, true, answer.covariance, answer.bound)
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
