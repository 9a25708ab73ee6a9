"""Kind of trial: data bases of landmarks from independent sets of images (section 4.1)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Self

from boresight.campaign.imaging.image_store import store_switched
from boresight.campaign.imaging.world import believed, check_views
from boresight.campaign.products import BuiltAssets, BuiltProduct, landmark_database
from boresight.campaign.products.landmark_database import landmark_candidates
from boresight.campaign.resolved import ResolvedCampaign, drafted
from boresight.campaign.trial.kind import Record, Records, WorkerContext, check_only_method
from boresight.campaign.trial.runner import GaveUpError, TrialRunner, located, require_built
from boresight.campaign.trial.unused import LENS, OF_OBSERVATIONS
from boresight.estimators.contract import NoProductError
from boresight.estimators.landmark.database import (
    METHOD_VERSION,
    DatabaseOptions,
    LandmarkDatabaseBuild,
    build_database,
)
from boresight.estimators.options import parse_options
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.scenario import ScenarioSpec


@dataclass(frozen=True, slots=True, eq=False)
class DatabaseDraw:
    """Number of a trial and of its images, and the data base of one way to make it, or why there is none."""

    trial: int
    images: int = 0
    built: LandmarkDatabaseBuild | NoProductError | None = None


@dataclass(frozen=True, eq=False)
class DatabaseTrials(TrialRunner[DatabaseOptions, DatabaseDraw, LandmarkDatabaseBuild]):
    """Trials of ways to make a data base; trial t takes the images of seed + t.

    The world of the ``believed`` scenario is opened with the first image.
    """

    name = "landmark-database"
    version = 1
    block_trials = 1

    believed: LoadedScenario
    variant: str

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of the method."""
        check_only_method(cls.name, landmark_database.KIND, name)
        return METHOD_VERSION

    @classmethod
    def options_model(cls, name: str) -> type[SpecModel]:
        return DatabaseOptions

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without views."""
        check_views(scenario)

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        aimed = spec.viewpoint is not None and bool(spec.viewpoint.targets)
        views = ("roll_deg", "off_pointing_deg", "latitude_deg", "keep_clear_px")
        told = ("pose_error", "camera_sigma", "declared", "distortion_error")
        wrong = ("sun_error_deg", "pole_error_deg", "rotation_error_deg")
        return (
            *("detector", "lighting.phase_deg", "lighting.brightness", *(() if aimed else ("lighting.measure",))),
            *("correlated", "second_body", "stars", *OF_OBSERVATIONS, *LENS),
            *(f"viewpoint.{key}" for key in views),
            *(f"onboard.{key}" for key in (*told, *wrong)),
        )

    @classmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, DatabaseOptions]:
        """Return the options of each way to make a data base; refuse wrong ones."""
        found = {}
        for entry in cls.entries(campaign, scenario):
            with located(campaign, entry.label):
                found[entry.label] = drafted(parse_options(DatabaseOptions, entry.options, entry.name), campaign.draft)
        return found

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets) -> list[BuiltProduct]:
        """Build the data bases of trial 0, which stay with the run."""
        products: list[BuiltProduct] = []
        for label, options in cls.build_methods(campaign, scenario).items():
            asked = assets.for_database()
            # One that does not come out is a failed trial, not the end of the run.
            with suppress(NoProductError):
                asked.product(landmark_database.KIND, at_trial(options, campaign.seed, 0).model_dump(mode="json"))
            products += asked.products_of(label)
        return products

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Take the options."""
        return cls.made(campaign, scenario, number, believed=believed(scenario), variant=campaign.variant)

    def draw(self, trial: int) -> DatabaseDraw:
        """Return the number of a trial: images depend on the options."""
        return DatabaseDraw(trial)

    def given(self, drawn: DatabaseDraw, label: str) -> DatabaseDraw:
        """Make the data base of a trial: a fault in that is ours, and not a method's."""
        options = at_trial(require_built(self.methods[label]), self.seed, drawn.trial)
        # Images of a hundred data bases would drive all others out of the store, and their candidates are kept.
        with store_switched(False):
            candidates = landmark_candidates(self.believed, options, None, self.variant)
        try:
            built = build_database(candidates.by_image, candidates.cameras_m, options)
            return replace(drawn, images=options.images, built=built)
        except NoProductError as error:
            return replace(drawn, built=error)

    def row(self, drawn: DatabaseDraw) -> Record:
        return {"n_landmarks": 0}

    def ask(self, method: DatabaseOptions, drawn: DatabaseDraw) -> LandmarkDatabaseBuild:
        """Return the data base."""
        if not isinstance(drawn.built, LandmarkDatabaseBuild):
            raise GaveUpError(str(drawn.built))
        return drawn.built

    def score(self, answer: LandmarkDatabaseBuild, drawn: DatabaseDraw) -> Records:
        """Count what the data base was made of, and what it is."""
        clusters, database = answer.clusters, answer.database
        numbers = {
            "candidates": len(answer.points_m),
            "candidates_an_image": len(answer.points_m) / drawn.images,
            "seed_clusters": len(clusters.grown),
            "kept_clusters": len(clusters.kept),
            "merged_clusters": len(clusters.refined),
            "landmarks": len(database),
            "facets": len(database.facets),
        }
        return {
            "rows": [{"status": "ok", "reason": ""}],
            "diagnostics": [{"name": name, "value": float(value)} for name, value in numbers.items()],
        }


def at_trial(options: DatabaseOptions, seed: int, trial: int) -> DatabaseOptions:
    """Return the options of a trial: those of the next seed for the next trial."""
    return options.model_copy(update={"seed": options.seed + seed + trial})


KIND = DatabaseTrials
