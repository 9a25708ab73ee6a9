"""Choose the threshold on the confidence of each detector of craters, on images of a world that no campaign shows.

Run as ``python -m training.thresholds``: it prints what stands as the default of ``confidence_min`` in the
detectors' options. The body is that of ``eros-like-msi``, but its craters, its roughness and all views are drawn from
other seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import World, open_world
from boresight.campaign.trial.score import NONE, match_detections
from boresight.estimators.craters.contract import CraterDetector
from boresight.estimators.registry import crater_detector_class
from boresight.renderers.mitsuba3 import TiledRenderer, choose_variant
from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.craters import crater_truth
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.load import load_scenario

SCENARIO, SEED = "eros-like-msi", 77
FALSE_SHARE = 0.04
"""So many false alarms are let through here, that it may be less than 5 % in another world."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """All detections (n,) in some images, and the number of detectable craters there."""

    confidence: FloatArray
    false: BoolArray
    detectable: BoolArray
    n_detectable: int


def lowest_threshold(confidence: FloatArray, false: BoolArray, most: float) -> float:
    """Find the lowest of the confidences (n,) above which at most a share ``most`` of the detections is false.

    Raises
    ------
    BoresightError
        If there is none.
    """
    order = np.argsort(-confidence, kind="stable")
    share = np.cumsum(false[order]) / np.arange(1, len(order) + 1)
    # Of equal confidences all or none are above a threshold.
    last = np.append(np.diff(confidence[order]) < 0.0, [True] * (len(order) > 0))
    allowed = np.flatnonzero((share <= most) & last)
    if not len(allowed):
        raise BoresightError(f"no threshold lets at most {100 * most:g} % false alarms through: take more images")
    return float(confidence[order[allowed[-1]]])


def judge(detector: CraterDetector, world: World, images: int) -> Judged:
    """Let a detector work on images of a cratered world, and say which detections are false."""
    if world.ground is None or not isinstance(world.renderer, TiledRenderer):
        raise BoresightError(f"{world.scenario.path}: craters: missing, so there is no crater to detect")
    confidence, false, detectable, there = [np.zeros(0)], [np.zeros(0, bool)], [np.zeros(0, bool)], 0
    for trial in range(images):
        sight = world.source.trial_image(SEED, trial)
        observation = observe(world, sight, SEED, trial)
        truth = crater_truth(world.ground.rims, sight.view, world.renderer)
        there += int(truth.detectable.sum())
        try:
            found = detector.detect(observation.frame, observation.camera)
        except BoresightError:  # too little lit ground: nothing is found there
            continue
        every = [found] if found.rejected is None else [found, found.rejected]
        crater = match_detections(Ellipses.joined([one.ellipses for one in every]), truth.ellipses).crater
        confidence += [one.confidence for one in every]
        false.append(crater == NONE)
        detectable.append((crater != NONE) & np.append(truth.detectable, False)[crater])
    world.source.flush()
    return Judged(np.concatenate(confidence), np.concatenate(false), np.concatenate(detectable), there)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the threshold of each detector and what it does on these images."""
    parser = argparse.ArgumentParser(prog="python -m training.thresholds", description=__doc__)
    parser.add_argument("--images", type=int, default=30)
    parser.add_argument("--detectors", nargs="+", default=["crater-classic", "crater-learned"])
    told = parser.parse_args(arguments)
    world = open_world(load_scenario(SCENARIO, [f"craters.seed={SEED}"]), choose_variant().name)
    for name in told.detectors:
        judged = judge(crater_detector_class(name).from_options({}), world, told.images)
        threshold = lowest_threshold(judged.confidence, judged.false, FALSE_SHARE)
        kept = judged.confidence >= threshold
        found = judged.detectable[kept].sum() / max(judged.n_detectable, 1)
        sys.stdout.write(
            f"{name}: confidence_min {threshold:.6f}: {100 * judged.false[kept].mean():.1f} % of {kept.sum()} false,"
            f" {100 * found:.1f} % of {judged.n_detectable} detectable craters found in {told.images} images\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
