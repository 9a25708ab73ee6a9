"""The single-image experiment: degrade the pose of one image, let each estimator refine it, score."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import TrialImage, World, check_views, open_world
from boresight.campaign.kinds.single_image.score import check
from boresight.campaign.pool.guard import Call
from boresight.campaign.products import BuiltAssets, BuiltProduct, MissingProduct
from boresight.campaign.products.databases import with_database_craters
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.image_trials import ImageSink, PerDatabase, image_sink
from boresight.campaign.trial.kind import Record, Records, Witness, WorkerContext, add_records
from boresight.campaign.trial.methods import Unbuilt, check_options, require_built, try_build, unbuilt_products
from boresight.campaign.trial.pose_score import consistency, pose_columns, pose_error
from boresight.campaign.trial.work import Work
from boresight.estimators.contract import Estimate, Estimator, Table
from boresight.estimators.registry import estimator_class
from boresight.reports.schema.common import FRESH_IMAGE, STORED_IMAGE
from boresight.scenarios.draw import estimator_generator
from boresight.scenarios.geometry import Pose, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Observation
from boresight.scenarios.onboard import onboard_camera
from boresight.scenarios.spec.campaign import EstimatorSpec

T = TypeVar("T", bound=np.generic)

Method = Estimator | Unbuilt
"""An estimator, or why there is none in a scenario."""


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedImage:
    """A trial of one estimator as a witness is shown it; ``estimate`` is None where the estimator raised."""

    trial_image: TrialImage
    observation: Observation
    estimate: Estimate | None

    @property
    def image(self) -> NDArray[np.float32]:
        """The image, as the camera took it."""
        return self.trial_image.image

    @property
    def truth(self) -> View:
        """The true view; of real images that of the reference pose."""
        return self.trial_image.view


@dataclass(frozen=True, eq=False)
class SingleImage:
    """Trials of one scenario with a set of labelled estimators.

    Parameters
    ----------
    world
        The scenario in this process.
    estimators
        Label to estimator; every one sees the same observation. Of one that cannot be built, why.
    seed
        Seed of the campaign.
    keep_image
        Called with the trial and its image, to keep it; or None.
    witness
        Shown the `EstimatedImage` of every trial and estimator; or None.
    database
        Number of the data base that the estimators have.
    with_database
        Labels of those that have one.
    """

    world: World
    estimators: Mapping[str, Method]
    seed: int
    keep_image: ImageSink | None = None
    witness: Witness | None = None
    database: int = 0
    with_database: frozenset[str] = frozenset()

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of an estimator."""
        return estimator_class(name).version

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without images."""
        check_views(scenario)

    @classmethod
    def methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, Method]:
        """Refuse wrong options; estimators are built later, with their assets."""
        check_options(campaign, scenario)
        return {}

    @classmethod
    def prepare(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets
    ) -> list[BuiltProduct | MissingProduct]:
        """Let every estimator ask for its products."""
        products: list[BuiltProduct | MissingProduct] = []
        for number, entry in product(range(campaign.spec.databases), campaign.spec.estimators):
            asked = assets.for_database(number)
            method = _method(entry, scenario, asked)
            products += asked.products_of(entry.label)
            products += unbuilt_products(scenario, {entry.label: method})
        return products

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext
    ) -> PerDatabase[SingleImage]:
        """Open the world and build the estimators, with each of their data bases."""
        return PerDatabase(
            tuple(cls._with_database(campaign, scenario, context, i) for i in range(campaign.spec.databases))
        )

    @classmethod
    def _with_database(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, database: int
    ) -> SingleImage:
        assets = BuiltAssets(scenario, context.run / "products", None, campaign.variant, None, campaign.draft, database)
        assets_by_label = {entry.label: assets.for_database(database) for entry in campaign.spec.estimators}
        estimators = {
            entry.label: _method(entry, scenario, assets_by_label[entry.label]) for entry in campaign.spec.estimators
        }
        having = frozenset(label for label, asked in assets_by_label.items() if asked.depends_on_database)
        sink = image_sink(context.run / "images" / scenario.spec.name) if context.keep_images else None
        world = open_world(with_database_craters(scenario, database), campaign.variant)
        return cls(world, estimators, campaign.seed, sink, None, database, having)

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one estimator, shown to a witness."""
        return replace(self, estimators={label: self.estimators[label]}, witness=witness)

    def flush(self) -> None:
        """Keep what was rendered."""
        self.world.source.flush()

    def trial(self, trial: int) -> Records:
        """Run one trial: the records that it adds to each stored table."""
        started = time.perf_counter()
        trial_image = self.world.source.trial_image(self.seed, trial)
        image_seconds = time.perf_counter() - started
        if self.keep_image is not None:
            self.keep_image(trial, trial_image.image)
        observation = observe(self.world, trial_image, self.seed, trial)
        records: Records = {}
        for label, estimator in self.estimators.items():
            key: Record = {"trial": trial, "scenario": self.world.scenario.spec.name, "estimator": label}
            call = Call(self.world.scenario.spec.name, trial, label)
            found = self._judged(call, estimator, observation, trial_image)
            found["rows"][0]["database"] = self.database if label in self.with_database else None
            add_records(records, found, key)
            stage = STORED_IMAGE if trial_image.from_store else FRESH_IMAGE
            add_records(records, {"timings": [{"stage": stage, "seconds": image_seconds}]}, key)
        return records

    def _judged(self, call: Call, estimator: Method, observation: Observation, trial_image: TrialImage) -> Records:
        """Let an estimator work and score what it returns: records without their key, whatever goes wrong."""
        rng = estimator_generator(self.seed, call.trial)
        row = _circumstances(observation, trial_image)

        def work() -> Estimate:
            return require_built(estimator).estimate(own_copy(observation), rng=rng)

        def show(found: Estimate | None) -> None:
            if self.witness is not None:
                self.witness(EstimatedImage(trial_image, observation, found))

        return Work(call, "estimator", row).run(work, check, lambda found: self._scored(found, row, trial_image), show)

    def _scored(self, estimate: Estimate, circumstances: Record, trial_image: TrialImage) -> Records:
        true = trial_image.view.T_cam_body
        final = estimate.pose if estimate.status == "ok" else None
        row = {**circumstances}
        if final is not None:
            row |= {**pose_error(final, true), **pose_columns(final)}
            row |= consistency(final, true, estimate.covariance, estimate.bound)
        row |= {
            "status": estimate.status,
            "reason": estimate.reason,
            "n_landmarks": int(estimate.diagnostics.get("n_landmarks", 0)),
        }
        numbers = {name: float(value) for name, value in estimate.diagnostics.items() if not isinstance(value, str)}
        return {
            "stages": [{"stage": str(s.name), **pose_error(s.T_cam_body, true)} for s in estimate.stages],
            "references": _references(final, trial_image),
            "landmarks": self._landmarks(estimate.details.get("landmarks"), trial_image),
            "diagnostics": [{"name": str(name), "value": value} for name, value in numbers.items()],
            "timings": [{"stage": str(name), "seconds": float(value)} for name, value in estimate.timings_s.items()],
            "rows": [row],
        }

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


def _method(entry: EstimatorSpec, scenario: LoadedScenario, assets: BuiltAssets) -> Method:
    given = assets.for_estimator()
    return try_build(entry, scenario.spec.name, lambda: estimator_class(entry.name).from_options(entry.options, given))


def _circumstances(observation: Observation, trial_image: TrialImage) -> Record:
    """Describe a trial as far as no estimator can change it."""
    true = trial_image.view.T_cam_body
    x, y, z = true.camera_position_m
    prior = pose_error(observation.frame.prior_T_cam_body, true)
    return {
        **{f"prior_{name}": value for name, value in prior.items()},
        "image": trial_image.image_name,
        "range_m": float(np.linalg.norm(true.translation_m)),
        "latitude_deg": float(np.degrees(np.arctan2(z, np.hypot(x, y)))),
        "phase_deg": float(np.degrees(trial_image.view.phase_angle_rad)),
        "time_s": trial_image.time_s,
        **pose_columns(true, "true_"),
    }


def _columns(table: Table, *names: str) -> NDArray[np.float64]:
    return np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])


def _references(final: Pose | None, trial_image: TrialImage) -> list[Record]:
    if final is None:
        return []
    return [{"reference": name, **pose_error(final, view.T_cam_body)} for name, view in trial_image.further.items()]
