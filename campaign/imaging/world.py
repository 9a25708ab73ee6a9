"""One scenario made real in this process: body, renderer, detector or image set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from campaign.imaging.imager import Imager, open_renderer
from campaign.imaging.real_images import images_digest, open_images
from renderers.images import ImageSet, reach
from renderers.mitsuba3 import BodyRenderer
from scenarios.bodies import Body, load_body
from scenarios.craters import CrateredSurface, check_size, cratered_surface, shape_digest
from scenarios.draw import Stream, draw_aimed_view, draw_view, generator
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, TriangleMesh, View
from scenarios.load import LoadedScenario
from scenarios.onboard import onboard_spec
from scenarios.spec.world import ViewpointSpec

_MOST_DRAWS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What a camera saw in one trial, with the truth of it: for experiments only, never for an estimator.

    Parameters
    ----------
    image
        (H, W) float32.
    view
        The true view (for real images the reference pose).
    further
        Other poses to score against, by name.
    image_name
        File name of a real image, or ''.
    time_s
        Epoch of a real image, or 0.
    from_store
        Whether the image was rendered in an earlier run.
    """

    image: NDArray[np.float32]
    view: View
    further: dict[str, View]
    image_name: str = ""
    time_s: float = 0.0
    from_store: bool = False


class Source(Protocol):
    """Where the images of an experiment come from."""

    def sight(self, seed: int, trial: int) -> Sight:
        """Produce the image and the truth of one trial."""
        ...

    def view(self, seed: int, trial: int) -> View:
        """Tell the true view of one trial without its image."""
        ...

    def flush(self) -> None:
        """Keep what was rendered, at the end of a block of trials."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class RenderedSource:
    """Images rendered from views drawn at random, or taken from the store of those."""

    scenario: LoadedScenario
    camera: Camera
    shape: TriangleMesh
    imager: Imager

    def sight(self, seed: int, trial: int) -> Sight:
        """Draw a view, render it and expose the detector."""
        view = self.view(seed, trial)
        image, from_store = self.imager.image(view, seed, trial, generator(seed, Stream.DETECTOR, trial))
        return Sight(image, view, {}, from_store=from_store)

    def flush(self) -> None:
        """Keep what was rendered."""
        self.imager.flush()

    def view(self, seed: int, trial: int) -> View:
        """Draw views until one has the body clear of the parts of the detector that are to stay clear."""
        rng, viewpoint = generator(seed, Stream.TRUTH, trial), self.scenario.spec.viewpoint
        clear = () if viewpoint is None else viewpoint.keep_clear_px
        for _ in range(_MOST_DRAWS):
            if viewpoint is not None and viewpoint.targets:
                view = draw_aimed_view(viewpoint, self.scenario.spec.lighting, self.camera, self.shape, rng)
            else:
                view = draw_view(self.scenario.spec, self.camera, rng)
            if not clear or not reach(view, self.imager.renderer.outline_m, clear):
                return view
        raise BoresightError(
            f"{self.scenario.path}: viewpoint.keep_clear_px: the body reached into it in {_MOST_DRAWS} views of trial"
            f" {trial}: make it smaller, or the range larger"
        )


@dataclass(frozen=True, slots=True, eq=False)
class RealSource:
    """Real images: trial t looks at image t modulo their number, so that few trials cover many images."""

    images: ImageSet
    truth: str
    further: tuple[str, ...]
    realisations: int

    def sight(self, seed: int, trial: int) -> Sight:
        """Read the trial's image."""
        if trial >= len(self.images) * self.realisations:
            raise BoresightError(
                f"trial {trial}: the image set has {len(self.images)} images x {self.realisations} noise"
                f" realisations: ask for at most {len(self.images) * self.realisations} trials"
            )
        index = trial % len(self.images)
        return Sight(
            self.images.image(index),
            self.images.view(index, self.truth),
            {name: self.images.view(index, name) for name in (self.truth, *self.further)},
            self.images.names[index],
            self.images.time_s(index),
        )

    def view(self, seed: int, trial: int) -> View:
        """Tell the reference pose of the trial's image."""
        del seed
        return self.images.view(trial % len(self.images), self.truth)

    def flush(self) -> None:
        """Do nothing: real images are on the disk already."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A scenario with everything that it takes to see it; ``ground`` is the surface of a cratered body."""

    scenario: LoadedScenario
    camera: Camera
    body: Body
    renderer: BodyRenderer
    source: Source
    ground: CrateredSurface | None = None


def believed(scenario: LoadedScenario) -> LoadedScenario:
    """Return a scenario as the spacecraft knows it."""
    return replace(scenario, spec=onboard_spec(scenario.spec))


def trial_limit(scenario: LoadedScenario) -> int | None:
    """Return how many trials a scenario's real images are good for; None where images are rendered.

    Every image is read once on the way, so that a damaged one is found before a campaign starts.
    """
    spec = scenario.spec
    if spec.images is None:
        return None
    images = open_images(scenario)
    images.check_images()
    return len(images) * spec.images.noise_realisations


def check_craters(scenario: LoadedScenario) -> None:
    """Refuse a cratered body that this machine has no room for, before a campaign starts."""
    spec = scenario.spec
    if spec.craters is None:
        return
    mesh = load_body(spec.body, scenario.search_dirs).mesh
    try:
        check_size(mesh, spec.craters)
    except BoresightError as error:
        raise BoresightError(f"{scenario.path}: {error}") from error


def check_bodies(scenario: LoadedScenario) -> None:
    """Refuse a body that cannot be read, the true one and the believed one, and views from inside it.

    Whatever is made of them would fail, and that would be taken for the fault of the method that asks for it.
    """
    spec = scenario.spec
    mesh = load_body(spec.body, scenario.search_dirs).mesh
    load_body(onboard_spec(spec).body, scenario.search_dirs)
    if spec.viewpoint is not None:
        _check_range(scenario, mesh, spec.viewpoint)


def typical_range_m(scenario: LoadedScenario) -> float:
    """Return the range of a scenario's views: of its viewpoint, or the median over its real images."""
    spec = scenario.spec
    if spec.viewpoint is not None:
        return spec.viewpoint.range_m
    images = open_images(scenario)
    return float(np.median([np.linalg.norm(images.view(i).T_cam_body.translation_m) for i in range(len(images))]))


def open_world(scenario: LoadedScenario, variant: str) -> World:
    """Build a scenario's world once per process; scenes do not pickle, so every worker has its own."""
    # A file that changed under the same name is another world.
    return _built(scenario, variant, shape_digest(scenario.spec, scenario.search_dirs), images_digest(scenario))


@lru_cache(maxsize=1)
def _built(scenario: LoadedScenario, variant: str, *_content: str) -> World:
    spec = scenario.spec
    camera = spec.camera.camera()
    body = load_body(spec.body, scenario.search_dirs)
    ground = None if spec.craters is None else cratered_surface(spec.body, spec.craters, scenario.search_dirs)
    renderer = open_renderer(scenario, variant)
    if spec.images is not None:
        images = open_images(scenario)
        source: Source = RealSource(images, spec.images.truth, spec.images.also_score, spec.images.noise_realisations)
        return World(scenario, camera, body, renderer, source, ground)
    if spec.viewpoint is None:
        raise BoresightError(f"{scenario.path}: give either viewpoint or images")
    _check_range(scenario, body.mesh, spec.viewpoint)
    imager = Imager.open(scenario, variant, renderer, Stream.TRUTH, spec.viewpoint, spec.lighting)
    source = RenderedSource(scenario, camera, body.mesh, imager)
    return World(scenario, camera, body, renderer, source, ground)


def _check_range(scenario: LoadedScenario, mesh: TriangleMesh, viewpoint: ViewpointSpec) -> None:
    """Refuse a range at which some of the drawn views would be from inside the body, before the first of them."""
    x, y, z = mesh.vertices_m.T
    latitudes_deg = np.degrees(np.arctan2(z, np.hypot(x, y)))
    south_deg, north_deg = viewpoint.latitude_deg.uniform
    below = (latitudes_deg >= south_deg) & (latitudes_deg <= north_deg)
    reach_m = float(np.linalg.norm(mesh.vertices_m[below], axis=1).max(initial=0.0))
    if viewpoint.range_m <= reach_m:
        raise BoresightError(
            f"{scenario.path}: viewpoint.range_m: {viewpoint.range_m:g} m leads into the body, which reaches"
            f" {reach_m:.6g} m from its origin at those latitudes: choose a larger range"
        )
