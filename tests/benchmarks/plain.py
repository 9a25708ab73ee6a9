"""Our images beside those of Mitsuba as it comes: its own camera, Sun, reflectance, integrator and film."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.ratio import Absent, Ratio
from benchmarks.scene import ALBEDO, FOV_RAD, SAMPLES, SIZE_PX, SUN_DIR_BODY, SpeedScene, agreement, speed_scene
from benchmarks.settings import Settings
from benchmarks.timing import in_turn, timed
from boresight.renderers.mitsuba3 import Variant, choose_variant, limit_threads
from boresight.renderers.mitsuba3.rays import PixelWindow
from boresight.renderers.mitsuba3.scene import build_shape
from boresight.renderers.mitsuba3.variant import load_mitsuba
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View

_FACETS = 190_000
LEAST_CORRELATION = 0.97  # at four samples, which Mitsuba draws at random
WORK = "image of 0.2 M facets, 512 x 512, 4 samples, shadows"


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
        yield Absent(WORK, f"the variant {variant.name} takes minutes for Mitsuba's own images")
        return
    view, renderer = scene.views[0], scene.renderer(variant)
    plain = plain_mitsuba(scene, variant)
    alike = agreement(renderer.render(view), plain())
    if alike < LEAST_CORRELATION:
        raise BoresightError(f"our image and plain Mitsuba's correlate by {alike:.4f} only: their times say nothing")
    ours, theirs = in_turn(2 * settings.rounds, timed(partial(renderer.render, view)), timed(plain))
    yield Ratio(WORK, "plain Mitsuba", "cpu", ours.cpu, theirs.cpu, agreement=f"correlation {alike:.4f}")


def plain_mitsuba(scene: SpeedScene, variant: Variant) -> Any:
    """Return a function that renders the first view as Mitsuba's handbook does: radiance factor (H, W).

    Its film is cropped to the window of the body, which is what we trace.
    """
    window = scene.window(0)
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
            "camera": _camera(mi, scene.views[0], window),
        }
    )

    def render() -> NDArray[np.float32]:
        image = np.zeros((SIZE_PX, SIZE_PX), dtype=np.float32)
        image[window.slices] = np.array(mi.render(world, spp=SAMPLES), dtype=np.float32)[..., 0]
        return image

    return render


def _camera(mi: Any, view: View, window: PixelWindow) -> dict[str, object]:
    pose = np.eye(4)
    pose[:3, :3] = view.T_cam_body.rotation.T @ np.diag([-1.0, -1.0, 1.0])  # Mitsuba's x is left, its y up
    pose[:3, 3] = view.T_cam_body.camera_position_m
    distance_m = float(np.linalg.norm(view.T_cam_body.translation_m))
    return {
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
    }
