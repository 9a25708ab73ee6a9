"""Images that data bases are made of: rendered from random directions under a random Sun, and kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from campaign.imaging.image_store import ImageStore
from campaign.imaging.world import open_world, typical_range_m
from scenarios.draw import Stream, draw_aimed_view, draw_lit_view, generator
from scenarios.geometry import Camera, TriangleMesh, View
from scenarios.load import LoadedScenario
from scenarios.spec.camera import CameraSpec
from scenarios.spec.distribution import Uniform
from scenarios.spec.world import LightingSpec, ViewpointSpec

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DatabaseImage:
    """An image of the believed body, its view, what takes its pixels back to the surface, and whether it was kept."""

    pixels: NDArray[np.float32]
    view: View
    scenario: LoadedScenario
    variant: str
    from_store: bool

    def deproject(self, uv_px: FloatArray) -> FloatArray:
        """Points of the surface (N, 3), body frame, m, at pixel positions (N, 2); NaN where a pixel sees the sky."""
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
    """Yield noise-free images of the scenario's own body and BRDF.

    From random directions, at a range and by a camera of their own (without distortion), with the Sun anywhere within
    a range of phase angles (Rowell et al. 2015, section 4.1). Where the scenario aims its images at lit ground, so are
    these: a camera that always looks at the centre would never see the ends of a long body from near. They are kept, so
    that another data base of the same views renders nothing again.

    Parameters
    ----------
    scenario
        As the spacecraft believes it to be.
    images
        Numbers of the images, from 0.
    phase_deg, seed
        Of their Suns, uniform, and of their views.
    variant
        The Mitsuba variant.
    range_m, camera
        Those of the scenario where they are left out.
    """
    world, camera = open_world(scenario, variant), camera or scenario.spec.camera
    spec = scenario.spec.viewpoint
    viewpoint = ViewpointSpec(
        range_m=range_m or typical_range_m(scenario), targets=() if spec is None else spec.targets
    )
    measure = scenario.spec.lighting.measure if viewpoint.targets else "solid-angle"
    lighting = LightingSpec(phase_deg=Uniform(uniform=phase_deg), measure=measure)
    pictured = replace(scenario, spec=scenario.spec.model_copy(update={"camera": camera}))
    store = ImageStore.open(pictured, variant, Stream.DATABASE, viewpoint, lighting)
    for image in images:
        rng = generator(seed, Stream.DATABASE, image)
        view = _drawn(viewpoint, lighting, camera.camera().pinhole, world.body.mesh, rng)
        pixels, stored = store.image(seed, image, view, world.renderer.render)
        yield DatabaseImage(pixels, view, scenario, variant, stored)
    store.flush()


def _drawn(
    viewpoint: ViewpointSpec, lighting: LightingSpec, camera: Camera, shape: TriangleMesh, rng: np.random.Generator
) -> View:
    if viewpoint.targets:
        return draw_aimed_view(viewpoint, lighting, camera, shape, rng)
    return draw_lit_view(viewpoint, lighting, camera, rng)
