"""Methods without a peer on one core, beside the yardstick: of the approach, of craters, and those built on others."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.ratio import Absent, Ratio
from benchmarks.timing import YARDSTICK, Settings, in_turn, timed, yardstick
from boresight.campaign.imaging.image_store import store_switched
from boresight.campaign.products.covariance_tuning import build
from boresight.campaign.runs.benchmark import one_core
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.trial.kind import PerDatabase, WorkerContext
from boresight.estimators.approach.limb import LimbEstimator
from boresight.estimators.craters.contract import CraterDetections, CraterDetector
from boresight.estimators.tuned import Rehearsals
from boresight.renderers.mitsuba3 import choose_variant, limit_threads
from boresight.scenarios.draw import estimator_generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.observation import Observation

SEQUENCES, PREDICTION_AIM_MS = "delpech2015-smoke", 5.0
_SEED = 5
_SCENE = """\
body: {shape: itokawa-like}
brdf: {kind: lambert, albedo: 0.3}
pose_error: {position_cam_px: {normal: [10, 10, 30]}, attitude: {rotation_vector_deg: {normal: [0.1, 0.1, 0.1]}}}
"""
_LIMB = """\
camera: {width_px: 1024, height_px: 1024, fov_deg: 18.3}
viewpoint: {range_m: 5600}
lighting: {phase_deg: {uniform: [10, 90]}}
detector: {psf_sigma_px: 0.5, exposure_s: 0.1}
"""
_STARS = """\
camera: {width_px: 1024, height_px: 1024, fov_deg: 10}
viewpoint: {range_m: 20000}
lighting: {phase_deg: 40}
detector: {psf_sigma_px: 0.8, exposure_s: 1, white_e_per_s: 1.0e+8}
stars: {}
"""
METHODS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {"limb": (_SCENE + _LIMB, 15.0), "stars": (_SCENE + _STARS, 20.0)}
)
"""Scene of each method, and the processor time of an image that is aimed at, ms."""


CRATER_SCENE = """\
body: {shape: sphere}
craters: {seed: 5, count: 250, min_diameter_m: 16, max_diameter_m: 120, known_diameter_m: 30, edge_m: 4}
camera: {width_px: 1024, height_px: 1024, fov_deg: 12}
detector: {psf_sigma_px: 0.8}
viewpoint: {range_m: 2000, targets: [nadir]}
lighting: {phase_deg: {uniform: [30, 70]}, measure: angle}
pose_error: {position_cam_m: {normal: [10, 10, 10]}, attitude: {rotation_vector_deg: {normal: [0.02, 0.02, 0.02]}}}
"""
DETECTORS: Mapping[str, float] = MappingProxyType({"crater-learned": 1500.0, "crater-heat-map": 3000.0})
"""Processor time of an image that is aimed at for each detector, ms."""

REHEARSALS = 20
COMBINED_SCENE = (_SCENE + _LIMB).replace("1024", "256")
_CONSENSUS_AIM_MS, _TUNING_AIM_MS = 500.0, 1500.0


def method_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time estimates from images of 1024 x 1024, rendered beforehand, and predictions as `predict` makes them.

    Raises
    ------
    BoresightError
        If a method gives no estimate or no covariance: its time says nothing.
    """
    number = range(settings.views)
    with _alone() as folder:
        for name, (scene, aim_ms) in METHODS.items():
            trials = _opened(_stored(folder, scene, name), folder)
            estimates = _estimates(trials, name, number)
            yield _beside_yardstick(f"{name}, image of 1024 x 1024", estimates, aim_ms, 5 * settings.rounds)
            if name == "limb":
                predictions = [trials.predictors(trial)[name] for trial in number]
                work = f"{name}, prediction of an image"
                yield _beside_yardstick(work, predictions, PREDICTION_AIM_MS, 5 * settings.rounds)
        trials = _opened(SEQUENCES, folder)
        predictions = [trials.predictors(trial)["fixed-lag"] for trial in number]
        work = "fixed-lag, prediction of 361 frames"
        yield _beside_yardstick(work, predictions, PREDICTION_AIM_MS, 5 * settings.rounds)


def crater_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time detectors of craters on images of 1024 x 1024, rendered beforehand.

    Raises
    ------
    BoresightError
        If a detector finds no crater: its time says nothing.
    """
    with _alone() as folder:
        campaign = _stored(folder, CRATER_SCENE, ", ".join(DETECTORS), "experiment: crater-detection\n")
        trials = _opened(campaign, folder)
        seen = [trials.draw(trial).image.observation for trial in range(settings.views)]
        for name, aim_ms in DETECTORS.items():
            detections = [partial(_detected, trials.methods[name], one) for one in seen]
            yield _beside_yardstick(f"{name}, image of 1024 x 1024", detections, aim_ms, settings.rounds)


def combined_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time `consensus` of two methods on an image, and the rehearsals from which `tuned` has its factor.

    Raises
    ------
    BoresightError
        If both methods do not agree, or too few rehearsals are solved: the time says nothing.
    """
    with _alone() as folder:
        campaign = _stored(folder, COMBINED_SCENE, "consensus: {base: limb, second: photometric}")
        estimates = _estimates(_opened(campaign, folder), "consensus", range(settings.views))
        work = "consensus of limb and photometric, image of 256 x 256"
        yield _beside_yardstick(work, estimates, _CONSENSUS_AIM_MS, settings.rounds)
        scenario = load_scenario(str(folder / "scene.yaml"))
        asked = Rehearsals(base="limb", options={}, version=LimbEstimator.version, trials=REHEARSALS, bodies=1)
        tuning = partial(build, scenario, asked, folder, 1, choose_variant().name)
        work = f"tuned, {REHEARSALS} rehearsals of limb, images of 256 x 256"
        yield _beside_yardstick(work, [tuning], _TUNING_AIM_MS, settings.rounds)


@contextmanager
def _alone() -> Iterator[Path]:
    """Yield an empty folder; within, this process has one core and keeps no images."""
    limit_threads(1)
    with (
        tempfile.TemporaryDirectory(prefix="boresight-bench-") as place,
        one_core(),
        threadpool_limits(limits=1),
        store_switched(on=False),
    ):
        yield Path(place)


def _stored(folder: Path, scene: str, methods: str, more: str = "") -> str:
    """Write a scene and a campaign with methods, and return the campaign's path."""
    (folder / "scene.yaml").write_text(scene, encoding="utf-8")
    campaign = f"scenarios: [scene.yaml]\nestimators: [{methods}]\ntrials: 1\nseed: {_SEED}\n{more}"
    (folder / "campaign.yaml").write_text(campaign, encoding="utf-8")
    return str(folder / "campaign.yaml")


def _estimates(trials: Any, name: str, number: Sequence[int]) -> list[Callable[[], Any]]:
    """Return an estimate of each trial, whose image is rendered; no method here draws random numbers."""
    estimate, rng = trials.methods[name].estimate, estimator_generator(_SEED, 0)
    return [partial(estimate, trials.draw(trial).observation, rng=rng) for trial in number]


def _detected(detector: CraterDetector, observation: Observation) -> CraterDetections:
    found = detector.detect(observation.frame, observation.camera)
    if not len(found.ellipses):
        raise BoresightError(f"{detector.name}: it finds no crater, so that its time says nothing")
    return found


def _opened(campaign: str, folder: Path) -> Any:
    """Return the trials of a campaign's first scenario, with its methods."""
    resolved = resolve(campaign, (), variant=choose_variant().name)
    return PerDatabase.open(resolved, resolved.scenarios[0], WorkerContext(folder, 1, keep_images=False)).of(0)


def _beside_yardstick(work: str, trials: Sequence[Callable[[], Any]], aim_ms: float, rounds: int) -> Ratio:
    """Return the mean over trials of the least times of a work and of the yardstick in turn with it.

    An aim in milliseconds is of no processor: the note has it, and the ratio has none.
    """
    for number, answer in enumerate(trial() for trial in trials):
        if answer is None or getattr(answer, "status", "ok") != "ok":
            why = getattr(answer, "reason", "no covariance")
            raise BoresightError(f"{work}: trial {number} failed ({why}), so that its time says nothing")
    pairs = [in_turn(rounds, timed(trial), yardstick) for trial in trials]
    ours_s, fixed_s = (float(np.mean([seconds.cpu for seconds in one])) for one in zip(*pairs, strict=True))
    note = f"all of {len(trials)} trials succeed; aim {aim_ms:g} ms on one core"
    return Ratio(work, YARDSTICK, "cpu", ours_s, fixed_s, agreement=note)
