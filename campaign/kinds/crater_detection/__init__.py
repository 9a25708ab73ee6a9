"""Kind of trial: craters detected in rendered images, and compared with the true ones."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.world import TrialImage, World, open_world
from boresight.campaign.products import BuiltAssets, BuiltProduct
from boresight.campaign.products.databases import with_database_craters
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.images import ImageDraw, draw_image
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, WorkerContext
from boresight.campaign.trial.runner import GaveUpError, MethodRunner
from boresight.campaign.trial.score import (
    NONE,
    check_detections,
    check_listed,
    ellipse_errors,
    match_detections,
    view_columns,
)
from boresight.estimators.craters.contract import CraterDetections, CraterDetector
from boresight.estimators.registry import crater_detector_class
from boresight.renderers.mitsuba3 import TiledRenderer
from boresight.scenarios.craters import CraterTruth, build_surfaces, crater_truth
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.scenario import ScenarioSpec

DetectedImage = InspectedTrial[CraterTruth, Observation, CraterDetections]
"""A trial of one detector, for inspection."""


@dataclass(frozen=True, slots=True, eq=False)
class DetectionDraw:
    """The image of a trial, with the craters that it truly shows."""

    image: ImageDraw
    truth: CraterTruth


@dataclass(frozen=True, slots=True, eq=False)
class TimedDetections:
    """Craters that a detector found, and the seconds that it took."""

    found: CraterDetections
    seconds: float


@dataclass(frozen=True, eq=False)
class CraterDetection(MethodRunner[CraterDetector, DetectionDraw, TimedDetections]):
    """Trials of crater detectors; a trial is an image, and all see the same.

    ``world`` has craters. ``folder`` keeps the images of all trials; None to keep none.
    """

    name = "crater-detection"
    version = 3
    block_trials = 10
    databases = True
    called = "detector"

    world: World
    folder: Path | None = None

    @classmethod
    def method_class(cls, name: str) -> type[CraterDetector]:
        return crater_detector_class(name)

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without craters, or one that does not list most of those that a detector finds."""
        if scenario.spec.craters is None or scenario.spec.viewpoint is None:
            raise BoresightError(
                f"{scenario.path}: craters and viewpoint are needed by the experiment crater-detection: add the"
                " sections"
            )
        check_listed(scenario)

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        models = ("brdf", "body", "facets", "relief", "height_error", "albedo", "camera_sigma", "declared")
        return tuple(f"onboard.{key}" for key in models)

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets) -> list[BuiltProduct]:
        """Build the surfaces, which workers then only read."""
        worlds = (with_database_craters(scenario, number).spec for number in range(campaign.spec.databases))
        populations = [spec.craters for spec in worlds if spec.craters is not None]
        build_surfaces(scenario.spec.body, populations, scenario.search_dirs, assets.jobs or 1, assets.report)
        return []

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Open the world and build the detectors."""
        world = open_world(with_database_craters(scenario, number), campaign.variant)
        return cls.made(campaign, scenario, number, world=world, folder=context.image_folder(scenario.spec.name))

    def flush(self) -> None:
        self.world.source.flush()

    def draw(self, trial: int) -> DetectionDraw:
        """Render an image, and find what is true of it."""
        image = draw_image(self.world, self.seed, trial, self.folder)
        ground, renderer = self.world.ground, self.world.renderer
        if ground is None or not isinstance(renderer, TiledRenderer):
            raise BoresightError(f"{self.world.scenario.path}: craters: missing, so there is no crater to detect")
        return DetectionDraw(image, crater_truth(ground.rims, image.trial_image.view, renderer))

    def row(self, drawn: DetectionDraw) -> Record:
        trial_image = drawn.image.trial_image
        return {"image": trial_image.image_name, **view_columns(trial_image.view)}

    def ask(self, method: CraterDetector, drawn: DetectionDraw) -> TimedDetections:
        """Let a detector look for craters."""
        observation, started = drawn.image.observation, time.perf_counter()
        try:
            found = method.detect(own_copy(observation.frame), own_copy(observation.camera))
        except BoresightError as error:
            raise GaveUpError(str(error)) from error
        return TimedDetections(found, time.perf_counter() - started)

    def check(self, answer: TimedDetections, drawn: DetectionDraw) -> None:
        check_detections(answer.found)
        if answer.found.rejected is not None:
            check_detections(answer.found.rejected)

    def score(self, answer: TimedDetections, drawn: DetectionDraw) -> Records:
        """Match detections with the craters of the image."""
        return {
            "rows": [{"status": "ok", "reason": "", "n_landmarks": len(answer.found.ellipses)}],
            "detections": _scored(answer.found, drawn.truth),
            "timings": [{"stage": "detect", "seconds": answer.seconds}],
        }

    def of_draw(self, drawn: DetectionDraw) -> Records:
        return {
            "crater_images": [_image_facts(drawn.image.trial_image, drawn.truth)],
            "craters": _truth_rows(drawn.truth),
        }

    def of_all(self, drawn: DetectionDraw) -> Records:
        return drawn.image.timings

    def shown(self, answer: TimedDetections | None, drawn: DetectionDraw) -> DetectedImage:
        image, found = drawn.image, None if answer is None else answer.found
        return InspectedTrial(drawn.truth, image.observation, found, image.trial_image.image)


def _scored(found: CraterDetections, truth: CraterTruth) -> list[Record]:
    """Score detections against all craters of an image, and those that the detector rejected after them."""
    rejected = CraterDetections.none() if found.rejected is None else found.rejected
    every = Ellipses.joined([found.ellipses, rejected.ellipses])
    matches = match_detections(every, truth.ellipses)
    hit = np.flatnonzero(matches.crater != NONE)
    rows = matches.crater[hit]
    errors = ellipse_errors(every[hit], truth.ellipses[rows])
    records: list[Record] = [
        {
            "rank": rank,
            "confidence": float(confidence),
            "kept": rank < len(found.confidence),
            **_ellipse(every, rank),
            "crater": NONE,
            "duplicate": bool(matches.duplicate[rank]),
            "detectable": False,
            "clean": False,
        }
        for rank, confidence in enumerate([*found.confidence, *rejected.confidence])
    ]
    for k, (rank, row) in enumerate(zip(hit, rows, strict=True)):
        records[rank] |= {name: float(values[k]) for name, values in errors.items()}
        records[rank] |= {
            "crater": int(truth.crater[row]),
            "detectable": bool(truth.detectable[row]),
            "clean": bool(truth.clean[row]),
        }
    return records


def _ellipse(ellipses: Ellipses, row: int) -> Record:
    return {
        "u_px": float(ellipses.centre_px[row, 0]),
        "v_px": float(ellipses.centre_px[row, 1]),
        "major_px": float(ellipses.semi_axes_px[row, 0]),
        "minor_px": float(ellipses.semi_axes_px[row, 1]),
        "angle_deg": float(np.degrees(ellipses.angle_rad[row])),
    }


def _truth_rows(truth: CraterTruth) -> list[Record]:
    detectable, clean = truth.detectable, truth.clean
    names = ("diameter_m", "degradation", "visible", "in_frame", "lit", "cut", "emission_deg", "incidence_deg")
    return [
        {
            "crater": int(truth.crater[row]),
            **_ellipse(truth.ellipses, row),
            "deviation": float(truth.deviation[row]),
            **{name: float(getattr(truth, name)[row]) for name in names},
            "depth_ratio": float(truth.depth_m[row] / truth.diameter_m[row]),
            "detectable": bool(detectable[row]),
            "clean": bool(clean[row]),
        }
        for row in range(len(truth))
    ]


def _image_facts(trial_image: TrialImage, truth: CraterTruth) -> Record:
    """Describe an image and how many craters it shows."""
    lit = trial_image.image > trial_image.image.min() + 0.05 * float(np.ptp(trial_image.image))
    return {
        "phase_deg": float(np.degrees(trial_image.view.phase_angle_rad)),
        "lit_share": float(lit.mean()),
        "n_craters": len(truth),
        "n_detectable": int(truth.detectable.sum()),
        "n_clean": int(truth.clean.sum()),
    }


KIND = CraterDetection
