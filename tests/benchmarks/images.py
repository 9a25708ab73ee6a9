"""Images beside Blender Cycles and beside Mitsuba as it comes, and whether two workers do twice as much as one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blender import cycles
from benchmarks.ratio import CLOCKS, Absent, Ratio
from benchmarks.scene import ALBEDO, FOV_RAD, SAMPLES, SIZE_PX, SUN_DIR_BODY, SpeedScene, agreement, speed_scene
from benchmarks.timing import Settings, in_turn, timed
from boresight.campaign.machine import cores
from boresight.renderers.mitsuba3 import MitsubaRenderer, Variant, choose_variant, limit_threads
from boresight.renderers.mitsuba3.scene import build_shape
from boresight.renderers.mitsuba3.variant import load_mitsuba
from boresight.scenarios.errors import BoresightError

IMAGE_WORK = "image of 3.1 M facets, 512 x 512, 4 samples, shadows"
PLAIN_WORK = "image of 0.2 M facets, 512 x 512, 4 samples, shadows"
SCALING_WORK = "images, one render thread a worker, two workers"
IMAGE_AIM, SCALING_AIM = 5.0, 1.8
LEAST_CORRELATION = 0.99
LEAST_CORRELATION_PLAIN = 0.97  # at four samples, which Mitsuba draws at random
_AGREEMENT_SAMPLES = 64
_FACETS, _VIEWS, _TURNS = 190_000, 4, 10


def image_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Render the same windows by both in turn, with as many threads as there are cores.

    Both are given the body beforehand, so neither time holds the making of a tree; Cycles keeps it as the Sun stands
    still. Whether both draw the same is asked at many samples, for they place theirs differently in a pixel.
    """
    threads = cores()
    limit_threads(threads)
    scene = speed_scene(settings.facets, settings.views)
    variant = choose_variant()
    try:
        # Cycles keeps, with the body, the samples that it began with: who is timed must never have been asked for many.
        with cycles(settings.blender, scene, threads) as blender:
            many = blender.image(0, _AGREEMENT_SAMPLES)
        alike = agreement(scene.renderer(variant, _AGREEMENT_SAMPLES).render(scene.views[0]), many)
        if alike < LEAST_CORRELATION:
            yield Absent(IMAGE_WORK, f"the images correlate by {alike:.4f} only, so that their times say nothing")
            return
        renderer = scene.renderer(variant)
        with cycles(settings.blender, scene, threads) as blender:
            if np.array_equal(blender.image(0, SAMPLES), many):
                why = f"Blender: {SAMPLES} samples a pixel are the same image as {_AGREEMENT_SAMPLES}"
                yield Absent(IMAGE_WORK, why)
                return
            pairs = [
                in_turn(
                    settings.rounds, timed(partial(renderer.render, view)), partial(blender.render, number, SAMPLES)
                )
                for number, view in enumerate(scene.views)
            ]
    except BoresightError as error:
        yield Absent(IMAGE_WORK, str(error))
        return
    note = f"{blender.version}; correlation {alike:.4f} at {_AGREEMENT_SAMPLES} samples; {threads} threads each"
    for clock in CLOCKS:
        ours, theirs = (np.array([getattr(seconds, clock) for seconds in one]) for one in zip(*pairs, strict=True))
        spread = f"{(theirs / ours).min():.3g} to {(theirs / ours).max():.3g} in {len(pairs)} views"
        means = float(ours.mean()), float(theirs.mean())
        yield Ratio(IMAGE_WORK, "Blender Cycles", clock, *means, IMAGE_AIM, f"{note}; {spread}")


def plain_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Render a view by both in turn on one thread, each in the variant that is chosen here.

    Raises
    ------
    BoresightError
        If the images do not agree.
    """
    limit_threads(1)
    scene, variant = speed_scene(_FACETS, 1), choose_variant()
    if not variant.is_wavefront:
        yield Absent(PLAIN_WORK, f"the variant {variant.name} takes minutes for Mitsuba's own images")
        return
    view, renderer = scene.views[0], scene.renderer(variant)
    plain = plain_mitsuba(scene, variant)
    alike = agreement(renderer.render(view), plain())
    if alike < LEAST_CORRELATION_PLAIN:
        raise BoresightError(f"our image and plain Mitsuba's correlate by {alike:.4f} only: their times say nothing")
    ours, theirs = in_turn(2 * settings.rounds, timed(partial(renderer.render, view)), timed(plain))
    yield Ratio(PLAIN_WORK, "plain Mitsuba", "cpu", ours.cpu, theirs.cpu, agreement=f"correlation {alike:.4f}")


def plain_mitsuba(scene: SpeedScene, variant: Variant) -> Any:
    """Return a function that renders the first view as Mitsuba's handbook does: radiance factor (H, W).

    Its film is cropped to the window of the body, which is what we trace.
    """
    window = scene.window(0)
    pose = np.eye(4)
    pose[:3, :3] = scene.views[0].T_cam_body.rotation.T @ np.diag([-1.0, -1.0, 1.0])  # Mitsuba's x is left, its y up
    pose[:3, 3] = scene.views[0].T_cam_body.camera_position_m
    distance_m = float(np.linalg.norm(scene.views[0].T_cam_body.translation_m))
    mi = load_mitsuba(variant)
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}})
    world = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True},
            "body": build_shape(mi, scene.mesh, bsdf),
            "sun": {
                "type": "directional",
                "direction": [float(-x) for x in SUN_DIR_BODY],
                "irradiance": {"type": "rgb", "value": float(np.pi)},
            },
            "camera": {
                "type": "perspective",
                "fov_axis": "x",
                "fov": float(np.degrees(FOV_RAD)),
                "near_clip": 0.1 * distance_m,
                "far_clip": 10.0 * distance_m,
                "to_world": mi.ScalarTransform4f(pose),
                "sampler": {"type": "independent", "sample_count": SAMPLES},
                "film": {
                    "type": "hdrfilm",
                    "width": SIZE_PX,
                    "height": SIZE_PX,
                    "crop_offset_x": window.column,
                    "crop_offset_y": window.row,
                    "crop_width": window.width,
                    "crop_height": window.height,
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                },
            },
        }
    )

    def render() -> NDArray[np.float32]:
        image = np.zeros((SIZE_PX, SIZE_PX), dtype=np.float32)
        image[window.slices] = np.array(mi.render(world, spp=SAMPLES), dtype=np.float32)[..., 0]
        return image

    return render


def scaling_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Let one worker, and then two, render the same images; the time of an image of one over that of two.

    Clock time, for what is asked is what the user waits: on a machine with other guests it tells of those too.
    """
    if cores() < 2:
        yield Absent(SCALING_WORK, "this process may use one core only")
        return
    one, two = float("inf"), float("inf")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        _seconds(pool, 2)
        for _ in range(settings.rounds):
            one, two = min(one, _seconds(pool, 1)), min(two, _seconds(pool, 2))
    images = _VIEWS * _TURNS
    yield Ratio(SCALING_WORK, "one worker", "wall", two / (2 * images), one / images, SCALING_AIM, "the same images")


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
