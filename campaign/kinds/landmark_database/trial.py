"""The landmark-database experiment: data bases of independent sets of images (section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Self

from boresight.campaign.draft import drafted
from boresight.campaign.imaging.image_store import store_switched
from boresight.campaign.imaging.world import believed, check_views
from boresight.campaign.products import BuiltAssets, BuiltProduct, landmark_database
from boresight.campaign.products.landmark_database import landmark_candidates
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import Record, Records, Witness, WorkerContext
from boresight.campaign.trial.methods import located
from boresight.estimators.contract import NoProductError
from boresight.estimators.landmark.build import METHOD_VERSION, DatabaseOptions, LandmarkDatabaseBuild, build_database
from boresight.estimators.options import parse_options
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario


@dataclass(frozen=True, eq=False)
class DatabaseTrials:
    """Trials of one scenario with labelled ways to make a data base; trial t takes the images of seed + t.

    Parameters
    ----------
    scenario
        As the spacecraft believes it to be.
    makers
        Label to options.
    variant
        The Mitsuba variant.
    """

    scenario: LoadedScenario
    makers: Mapping[str, DatabaseOptions]
    variant: str

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of the method."""
        if name != landmark_database.KIND:
            raise BoresightError(
                f"estimators: {name!r} has no part in landmark-database: the only method is {landmark_database.KIND}"
            )
        return METHOD_VERSION

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without views."""
        check_views(scenario)

    @classmethod
    def methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, DatabaseOptions]:
        """Return the options of each way to make a data base; refuse wrong ones."""
        del scenario
        found = {}
        for entry in campaign.spec.estimators:
            with located(campaign, entry.label):
                found[entry.label] = drafted(parse_options(DatabaseOptions, entry.options, entry.name), campaign.draft)
        return found

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets) -> list[BuiltProduct]:
        """Build the data bases of trial 0, which stay with the run."""
        products: list[BuiltProduct] = []
        for label, options in cls.methods(campaign, scenario).items():
            asked = assets.for_database()
            # One that does not come out is a failed trial, not the end of the run.
            with suppress(NoProductError):
                asked.product(landmark_database.KIND, at_trial(options, campaign.seed, 0).model_dump(mode="json"))
            products += asked.products_of(label)
        return products

    @classmethod
    def open(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext) -> DatabaseTrials:
        """Take the options; the world is opened with the first image."""
        del context
        makers = {
            label: at_trial(options, campaign.seed, 0) for label, options in cls.methods(campaign, scenario).items()
        }
        return cls(believed(scenario), makers, campaign.variant)

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one way to make a data base; there is nothing to show of them."""
        del witness
        return replace(self, makers={label: self.makers[label]})

    def run(self, trials: range) -> Records:
        """Run trials: records in the order of trials and makers."""
        records: Records = {"rows": [], "diagnostics": []}
        for trial in trials:
            for label, options in self.makers.items():
                key: Record = {"trial": trial, "scenario": self.scenario.spec.name, "estimator": label}
                row, numbers = self._made(at_trial(options, 0, trial))
                records["rows"].append({**key, **row})
                records["diagnostics"] += [{**key, "name": name, "value": value} for name, value in numbers.items()]
        return records

    def _made(self, options: DatabaseOptions) -> tuple[Record, dict[str, float]]:
        # Images of a hundred data bases would drive all others out of the store, and their candidates are kept.
        with store_switched(False):
            candidates = landmark_candidates(self.scenario, options, None, self.variant)
        row: Record = {**_nothing(), "status": "ok", "reason": ""}
        try:
            return row, counts(build_database(candidates.by_image, options), options)
        except NoProductError as error:
            return {**row, "status": "failed", "reason": str(error)}, {}


def at_trial(options: DatabaseOptions, seed: int, trial: int) -> DatabaseOptions:
    """Return the options of a trial: those of the next seed for the next trial."""
    return options.model_copy(update={"seed": options.seed + seed + trial})


def counts(built: LandmarkDatabaseBuild, options: DatabaseOptions) -> dict[str, float]:
    """Count what a data base was made of, and what it is."""
    clusters, database = built.clusters, built.database
    return {
        "candidates": float(len(built.points_m)),
        "candidates_an_image": len(built.points_m) / options.images,
        "seed_clusters": float(len(clusters.grown)),
        "kept_clusters": float(len(clusters.kept)),
        "merged_clusters": float(len(clusters.refined)),
        "landmarks": float(len(database)),
        "facets": float(len(database.facets)),
    }


def _nothing() -> Record:
    """Return the columns of a row that a data base has no number for."""
    return {"n_landmarks": 0, "image": ""}
