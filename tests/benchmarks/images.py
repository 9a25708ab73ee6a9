"""Images of a body of 3.1 million facets beside Blender Cycles."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.blender import Cycles, cycles
from benchmarks.ratio import CLOCKS, Absent, Ratio
from benchmarks.scene import SAMPLES, SpeedScene, agreement, speed_scene
from benchmarks.settings import Settings
from benchmarks.timing import Seconds, in_turn, timed
from boresight.campaign.machine import cores
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant, limit_threads
from boresight.scenarios.errors import BoresightError

WORK = "image of 3.1 M facets, 512 x 512, 4 samples, shadows"
AIM = 5.0
LEAST_CORRELATION = 0.99
_AGREEMENT_SAMPLES = 64


def image_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Render the same windows by both in turn, with as many threads as there are cores.

    Both are given the body beforehand, so neither time holds the making of a tree; Cycles keeps it as the Sun stands
    still. Whether both draw the same is asked at many samples, for they place theirs differently in a pixel.

    Raises
    ------
    BoresightError
        If the images do not agree.
    """
    threads = cores()
    limit_threads(threads)
    scene = speed_scene(settings.facets, settings.views)
    variant = choose_variant()
    try:
        # Cycles keeps, with the body, the samples that it began with: who is timed must never have been asked for many.
        with cycles(settings.blender, scene, threads) as blender:
            many = blender.image(0, _AGREEMENT_SAMPLES)
        alike = _correlation(scene.renderer(variant, _AGREEMENT_SAMPLES).render(scene.views[0]), many)
        with cycles(settings.blender, scene, threads) as blender:
            _check_samples(blender.image(0, SAMPLES), many)
            pairs = _times(scene, scene.renderer(variant), blender, settings.rounds)
    except BoresightError as error:
        yield Absent(WORK, str(error))
        return
    note = f"{blender.version}; correlation {alike:.4f} at {_AGREEMENT_SAMPLES} samples; {threads} threads each"
    for clock in CLOCKS:
        ours, theirs = (np.array([getattr(seconds, clock) for seconds in one]) for one in zip(*pairs, strict=True))
        spread = f"{(theirs / ours).min():.3g} to {(theirs / ours).max():.3g} in {len(pairs)} views"
        yield Ratio(WORK, "Blender Cycles", clock, float(ours.mean()), float(theirs.mean()), AIM, f"{note}; {spread}")


def _check_samples(few: NDArray[np.float32], many: NDArray[np.float32]) -> None:
    if np.array_equal(few, many):
        raise BoresightError(f"Blender: {SAMPLES} samples a pixel are the same image as {_AGREEMENT_SAMPLES}")


def _correlation(ours: NDArray[np.float32], theirs: NDArray[np.float32]) -> float:
    alike = agreement(ours, theirs)
    if alike < LEAST_CORRELATION:
        raise BoresightError(f"the images correlate by {alike:.4f} only, so that their times say nothing")
    return alike


def _times(scene: SpeedScene, renderer: MitsubaRenderer, blender: Cycles, rounds: int) -> list[tuple[Seconds, Seconds]]:
    """Return our seconds and Blender's for each view."""
    pairs = []
    for number, view in enumerate(scene.views):
        works = timed(partial(renderer.render, view)), partial(blender.render, number, SAMPLES)
        ours, theirs = in_turn(rounds, *works)
        pairs.append((ours, theirs))
    return pairs
