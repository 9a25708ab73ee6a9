"""Images from which data bases are built, rendered with random directions of camera and Sun, by several workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.imaging.image_store import ImageStore
from boresight.campaign.imaging.preview import typical_range_m
from boresight.campaign.imaging.world import open_world
from boresight.campaign.pool.steps import report_progress
from boresight.campaign.pool.workers import in_order
from boresight.campaign.threads import use_threads
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, draw_aimed_view, generator
from boresight.scenarios.geometry import View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.camera import CameraSpec
from boresight.scenarios.spec.distribution import Uniform
from boresight.scenarios.spec.world import LightingSpec, ViewpointSpec

T = TypeVar("T")

_CHUNK_IMAGES = 10


def map_images(jobs: int | None, images: int, function: Callable[..., list[T]], *arguments: object) -> list[T]:
    """Apply ``function(*arguments, numbers)`` to chunks of image numbers in workers; return all results in order.

    Numbers are from 0. The function is one of a module, so that it can be pickled, and returns one result for each
    number. With ``jobs`` None it runs in this process, a worker with its number of threads already set.
    """
    chunks = [range(i, min(i + _CHUNK_IMAGES, images)) for i in range(0, images, _CHUNK_IMAGES)]
    if jobs is None:
        return [result for chunk in chunks for result in function(*arguments, chunk)]
    calls = ((jobs, function, arguments, chunk) for chunk in chunks)
    found: list[T] = []
    for results in in_order(jobs, _in_worker, calls):
        found += results
        report_progress("images", len(found), images)
    return found


def _in_worker(
    jobs: int, function: Callable[..., list[T]], arguments: tuple[object, ...], numbers: Sequence[int]
) -> list[T]:
    use_threads(jobs)
    return function(*arguments, numbers)


@dataclass(frozen=True, slots=True, eq=False)
class DatabaseImage:
    """Image of the believed body with its view, and whether it came from the store."""

    pixels: NDArray[np.float32]
    view: View
    scenario: LoadedScenario
    variant: str
    from_store: bool

    def deproject(self, uv_px: FloatArray) -> FloatArray:
        """Points of the surface (N, 3), body frame, m, at pixel positions (N, 2); NaN off the body."""
        return open_world(self.scenario, self.variant).renderer.surface(self.view, uv_px).points_body_m


def database_images(
    scenario: LoadedScenario,
    images: Sequence[int],
    phase_deg: tuple[float, float],
    seed: int,
    variant: str,
    range_m: float | None = None,
    camera: CameraSpec | None = None,
) -> Iterator[DatabaseImage]:
    """Yield noise-free images of the believed body and BRDF of a scenario, as the spacecraft believes it to be.

    Directions are random, the camera has no distortion, and the phase angle is uniform in an interval (Rowell et al.
    2015, section 4.1). If the scenario aims its images at lit ground, so do these: a camera pointed at the centre would
    never see the ends of a long body from a short range. The images are stored, so that another data base of the same
    views renders nothing again. They are numbered from 0; range and camera are those of the scenario if left out, where
    the range may be an altitude.
    """
    world, camera = open_world(scenario, variant), camera or scenario.spec.camera
    spec = scenario.spec.viewpoint
    place = {"range_m": range_m or typical_range_m(scenario)}
    if range_m is None and spec is not None and spec.altitude_m is not None:
        place = {"altitude_m": spec.median_range_m}
    viewpoint = ViewpointSpec(**place, targets=() if spec is None else spec.targets)
    measure = scenario.spec.lighting.measure if viewpoint.targets else "solid-angle"
    lighting = LightingSpec(phase_deg=Uniform(uniform=phase_deg), measure=measure)
    pictured = replace(scenario, spec=scenario.spec.model_copy(update={"camera": camera}))
    store = ImageStore.open(pictured, variant, Stream.DATABASE, viewpoint, lighting)
    for image in images:
        rng = generator(seed, Stream.DATABASE, image)
        view = draw_aimed_view(viewpoint, lighting, camera.camera().pinhole, world.body.mesh, rng, 0, world.ground)
        pixels, stored = store.image(seed, image, view, world.renderer.render)
        yield DatabaseImage(pixels, view, scenario, variant, stored)
    store.flush()
