"""Whether two workers do twice as much as one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from multiprocessing import get_context

from benchmarks.ratio import Absent, Ratio
from benchmarks.scene import SpeedScene, speed_scene
from benchmarks.settings import Settings
from boresight.campaign.machine import cores
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant, limit_threads

WORK = "images, one render thread a worker, two workers"
AIM = 1.8
_FACETS, _VIEWS, _TURNS = 190_000, 4, 10


def scaling_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Let one worker, and then two, render the same images; the time of an image of one over that of two.

    Clock time, for what is asked is what the user waits: on a machine with other guests it tells of those too.
    """
    if cores() < 2:
        yield Absent(WORK, "this process may use one core only")
        return
    one, two = float("inf"), float("inf")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        _seconds(pool, 2)
        for _ in range(settings.rounds):
            one, two = min(one, _seconds(pool, 1)), min(two, _seconds(pool, 2))
    images = _VIEWS * _TURNS
    yield Ratio(WORK, "one worker", "wall", two / (2 * images), one / images, AIM, "the same images")


def _seconds(pool: ProcessPoolExecutor, workers: int) -> float:
    """Seconds until so many workers, both of which run, have rendered all images each."""
    began = time.perf_counter()
    for done in [pool.submit(_render_all) for _ in range(workers)]:
        done.result()
    return time.perf_counter() - began


def _render_all() -> None:
    scene, renderer = _opened()
    for _ in range(_TURNS):
        for view in scene.views:
            renderer.render(view)


@lru_cache(maxsize=1)
def _opened() -> tuple[SpeedScene, MitsubaRenderer]:
    limit_threads(1)
    scene = speed_scene(_FACETS, _VIEWS)
    return scene, scene.renderer(choose_variant())
