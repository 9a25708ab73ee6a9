"""The crater-detection experiment: detectors of craters on rendered images, against the craters that are there."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import TrialImage, World, open_world
from boresight.campaign.pool.guard import Call
from boresight.campaign.products import BuiltAssets, BuiltProduct
from boresight.campaign.products.databases import with_database_craters
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.crater_score import NONE, check_detections, check_listed, ellipse_errors, match_detections
from boresight.campaign.trial.image_trials import ImageSink, PerDatabase, image_sink
from boresight.campaign.trial.kind import Record, Records, Witness, WorkerContext, add_records
from boresight.campaign.trial.methods import Unbuilt, methods, require_built
from boresight.campaign.trial.work import GaveUpError, Work
from boresight.estimators.craters.contract import CraterDetections, CraterDetector
from boresight.estimators.craters.registry import crater_detector_class
from boresight.renderers.mitsuba3 import TiledRenderer
from boresight.reports.schema.common import FRESH_IMAGE, STORED_IMAGE
from boresight.scenarios.craters import CraterTruth, build_surfaces, crater_truth
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Frame, Observation


@dataclass(frozen=True, slots=True, eq=False)
class DetectedImage:
    """A trial of one detector as a witness is shown it; ``estimate`` is None where the detector raised or gave up."""

    trial_image: TrialImage
    observation: Observation
    truth: CraterTruth
    estimate: CraterDetections | None

    @property
    def image(self) -> NDArray[np.float32]:
        """The image, as the camera took it."""
        return self.trial_image.image


@dataclass(frozen=True, eq=False)
class CraterDetection:
    """Trials of one scenario with labelled detectors; a trial is an image, and all see the same.

    Parameters
    ----------
    world
        The scenario in this process, with craters.
    detectors
        Label to detector; of one that cannot be built, why.
    seed
        Seed of the campaign.
    keep_image
        Called with the trial and its image, to keep it; or None.
    witness
        Shown the `DetectedImage` of every trial; or None.
    database
        Number of the world of craters; None where there is one.
    """

    world: World
    detectors: Mapping[str, CraterDetector | Unbuilt]
    seed: int
    keep_image: ImageSink | None = None
    witness: Witness | None = None
    database: int | None = None

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of a detector."""
        return crater_detector_class(name).version

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
    def methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, CraterDetector | Unbuilt]:
        """Build the detectors; refuse wrong options."""
        return methods(campaign, scenario, lambda entry: crater_detector_class(entry.name).from_options(entry.options))

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets) -> list[BuiltProduct]:
        """Build the surfaces, which workers then only read."""
        worlds = (with_database_craters(scenario, number).spec for number in range(campaign.spec.databases))
        populations = [spec.craters for spec in worlds if spec.craters is not None]
        build_surfaces(scenario.spec.body, populations, scenario.search_dirs, assets.jobs or 1, assets.report)
        return []

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext
    ) -> PerDatabase[CraterDetection]:
        """Open the worlds and build the detectors."""
        sink = image_sink(context.run / "images" / scenario.spec.name) if context.keep_images else None
        detectors, several = cls.methods(campaign, scenario), campaign.spec.databases > 1
        worlds = [
            open_world(with_database_craters(scenario, i), campaign.variant) for i in range(campaign.spec.databases)
        ]
        return PerDatabase(
            tuple(
                cls(world, detectors, campaign.seed, sink, database=i if several else None)
                for i, world in enumerate(worlds)
            )
        )

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one detector, shown to a witness."""
        return replace(self, detectors={label: self.detectors[label]}, witness=witness)

    def flush(self) -> None:
        """Keep what was rendered."""
        self.world.source.flush()

    def trial(self, trial: int) -> Records:
        """Run one trial: the records that it adds to each stored table."""
        started = time.perf_counter()
        trial_image = self.world.source.trial_image(self.seed, trial)
        observation = observe(self.world, trial_image, self.seed, trial)
        frame, camera = observation.frame, observation.camera
        image_seconds = time.perf_counter() - started
        if self.keep_image is not None:
            self.keep_image(trial, trial_image.image)
        truth = self.truth(trial_image)
        image_key: Record = {"trial": trial, "scenario": self.world.scenario.spec.name}
        records: Records = {
            "crater_images": [{**image_key, **_image_facts(trial_image, truth)}],
            "craters": [{**image_key, **row} for row in _truth_rows(truth)],
        }
        stage = STORED_IMAGE if trial_image.from_store else FRESH_IMAGE

        def show(found: tuple[CraterDetections, float] | None) -> None:
            if self.witness is not None:
                self.witness(DetectedImage(trial_image, observation, truth, None if found is None else found[0]))

        for label, detector in self.detectors.items():
            call = Call(self.world.scenario.spec.name, trial, label)
            judged = Work(call, "detector", _circumstances(trial_image)).run(
                partial(_detected, detector, frame, camera), _check, partial(_judged, truth=truth), show
            )
            judged.setdefault("timings", []).append({"stage": stage, "seconds": image_seconds})
            judged["rows"][0] = {**_circumstances(trial_image), **judged["rows"][0], "database": self.database}
            add_records(records, judged, {**image_key, "estimator": label})
        return records

    def truth(self, trial_image: TrialImage) -> CraterTruth:
        """Find what is true of an image."""
        ground, renderer = self.world.ground, self.world.renderer
        if ground is None or not isinstance(renderer, TiledRenderer):
            raise BoresightError(f"{self.world.scenario.path}: craters: missing, so there is no crater to detect")
        return crater_truth(ground.rims, trial_image.view, renderer)


def _detected(detector: CraterDetector | Unbuilt, frame: Frame, camera: Camera) -> tuple[CraterDetections, float]:
    """Let a detector work; return what it finds and the seconds that it took."""
    finder = require_built(detector)
    started = time.perf_counter()
    try:
        found = finder.detect(own_copy(frame), own_copy(camera))
    except BoresightError as error:
        raise GaveUpError(str(error)) from error
    return found, time.perf_counter() - started


def _check(answer: tuple[CraterDetections, float]) -> None:
    check_detections(answer[0])
    if answer[0].rejected is not None:
        check_detections(answer[0].rejected)


def _judged(answer: tuple[CraterDetections, float], truth: CraterTruth) -> Records:
    """Score what was found: records without their key."""
    found, seconds = answer
    return {
        "rows": [{"status": "ok", "reason": "", "n_landmarks": len(found.ellipses)}],
        "detections": _scored(found, truth),
        "timings": [{"stage": "detect", "seconds": seconds}],
    }


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


def _circumstances(trial_image: TrialImage) -> Record:
    """Fill the columns of a row that no detector can change, or that detection has no number for."""
    return {
        "image": trial_image.image_name,
        "range_m": float(np.linalg.norm(trial_image.view.T_cam_body.translation_m)),
        "phase_deg": float(np.degrees(trial_image.view.phase_angle_rad)),
    }
