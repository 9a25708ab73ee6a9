"""Methods of the approach and predicted covariances on one core, beside the yardstick, as no peer does their work."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.ratio import Absent, Ratio
from benchmarks.timing import YARDSTICK, Settings, in_turn, timed, yardstick
from boresight.campaign.imaging.image_store import store_switched
from boresight.campaign.runs.benchmark import one_core
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.trial.kind import PerDatabase, WorkerContext
from boresight.renderers.mitsuba3 import choose_variant, limit_threads
from boresight.scenarios.draw import estimator_generator
from boresight.scenarios.errors import BoresightError

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


def method_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time estimates from images of 1024 x 1024, rendered beforehand, and predictions as `predict` makes them.

    Raises
    ------
    BoresightError
        If a method gives no estimate or no covariance: its time says nothing.
    """
    limit_threads(1)
    with (
        tempfile.TemporaryDirectory(prefix="boresight-bench-") as place,
        one_core(),
        threadpool_limits(limits=1),
        store_switched(on=False),
    ):
        folder, number = Path(place), range(settings.views)
        for name, (scene, aim_ms) in METHODS.items():
            (folder / "scene.yaml").write_text(scene, encoding="utf-8")
            campaign = f"scenarios: [scene.yaml]\nestimators: [{name}]\ntrials: 1\nseed: {_SEED}\n"
            (folder / "campaign.yaml").write_text(campaign, encoding="utf-8")
            trials = _opened(str(folder / "campaign.yaml"), folder)
            estimate, rng = trials.methods[name].estimate, estimator_generator(_SEED, 0)  # which neither method uses
            estimates = [partial(estimate, trials.draw(trial).observation, rng=rng) for trial in number]
            yield _beside_yardstick(f"{name}, image of 1024 x 1024", estimates, aim_ms, settings.rounds)
            if name == "limb":
                predictions = [trials.predictors(trial)[name] for trial in number]
                work = f"{name}, prediction of an image"
                yield _beside_yardstick(work, predictions, PREDICTION_AIM_MS, settings.rounds)
        trials = _opened(SEQUENCES, folder)
        predictions = [trials.predictors(trial)["fixed-lag"] for trial in number]
        work = "fixed-lag, prediction of 361 frames"
        yield _beside_yardstick(work, predictions, PREDICTION_AIM_MS, settings.rounds)


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
    pairs = [in_turn(5 * rounds, timed(trial), yardstick) for trial in trials]
    ours_s, fixed_s = (float(np.mean([seconds.cpu for seconds in one])) for one in zip(*pairs, strict=True))
    note = f"all of {len(trials)} trials succeed; aim {aim_ms:g} ms on one core"
    return Ratio(work, YARDSTICK, "cpu", ours_s, fixed_s, agreement=note)
