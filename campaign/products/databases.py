"""Data bases: the hash of what determines one, the seeds of several in one campaign, and the images for building one.

What is drawn once per run rather than in each trial (craters, errors of the believed shape) is drawn once for each data
base. Data base 0 is, bit for bit, that of a campaign with a single one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.imaging.image_store import ImageStore
from boresight.campaign.imaging.ranges import typical_range_m
from boresight.campaign.imaging.real_images import images_digest, open_survey
from boresight.campaign.imaging.world import open_world
from boresight.campaign.pool.steps import report_progress
from boresight.campaign.pool.workers import in_order
from boresight.campaign.threads import use_threads
from boresight.estimators.options import surveyed
from boresight.renderers.mitsuba3 import renderer_version
from boresight.renderers.rectify import rectify
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.craters import shape_digest
from boresight.scenarios.draw import Stream, draw_aimed_view, generator
from boresight.scenarios.geometry import View
from boresight.scenarios.load import LoadedScenario, canonical_json
from boresight.scenarios.spec.base import SpecModel, digest
from boresight.scenarios.spec.camera import CameraSpec
from boresight.scenarios.spec.distribution import Uniform
from boresight.scenarios.spec.onboard import OnboardSpec
from boresight.scenarios.spec.world import LightingSpec, ViewpointSpec

Options = TypeVar("Options", bound=SpecModel)
Product = TypeVar("Product")
T = TypeVar("T")

SEED_STEP = 10_000
"""Difference of the seeds of two data bases, large enough to avoid nearby seeds in other uses."""

_CHUNK_IMAGES = 10
"""Images that a worker makes at a time: those that the image store keeps together."""


def content_key(
    scenario: LoadedScenario,
    kind: str,
    options: SpecModel,
    versions: Sequence[int],
    variant: str,
    of_views: bool = False,
) -> str:
    """Return the hash of everything that determines a product of a scenario as the spacecraft believes it to be.

    ``versions`` are those of all code that it depends on, except the renderer. A product ``of_views`` depends on all
    that decides about images and priors, others on body, camera, reflectance and range.
    """
    spec = scenario.spec
    if of_views:
        kind = f"{kind} {digest(spec)}"
    above = spec.viewpoint is not None and spec.viewpoint.altitude_m is not None
    parts = {
        "kind": kind,
        "options": json.loads(options.model_dump_json(exclude_none=True)),
        "body": shape_digest(spec, scenario.search_dirs),
        "scenario": [canonical_json(part) for part in (spec.camera, spec.brdf, spec.rendering)],
        "shading": spec.body.shading,
        "altitude_m" if above else "range_m": typical_range_m(scenario),
        "versions": [*versions, renderer_version(spec)[1]],
        "variant": variant,
    }
    if surveyed(options.model_dump()) and spec.images is not None:
        parts["survey"] = [canonical_json(spec.images), images_digest(scenario)]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]


@dataclass(frozen=True, slots=True)
class ProductKind(Generic[Options, Product]):
    """A kind of product: built once from the believed scenario, stored in a folder, and used by estimators.

    ``versions`` returns those of all code that it depends on, except the renderer. ``announce`` describes the effort of
    a build. ``build`` builds it into an empty folder with a number of workers and a Mitsuba variant, and returns facts
    to report, if any. ``about`` describes it for the manifest, in plain values. ``of_views`` is as in `content_key`.
    """

    options: type[Options]
    versions: Callable[[], list[int]]
    announce: Callable[[Options], str]
    build: Callable[[LoadedScenario, Options, Path, int, str], Mapping[str, object] | None]
    load: Callable[[Path], Product]
    about: Callable[[Product], dict[str, object]]
    of_views: bool = False


def drawn_per_database(scenario: LoadedScenario) -> frozenset[str]:
    """Return what is drawn per data base: ``world`` (the craters), ``knowledge`` (errors of the believed shape)."""
    found = {"world"} if scenario.spec.craters is not None else set()
    return frozenset(found | ({"knowledge"} if _drawn_onboard(scenario.spec.onboard) else set()))


def with_database_craters(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the craters of a data base, which its images and its trials show."""
    craters = scenario.spec.craters
    if database == 0 or craters is None:
        return scenario
    return replace(scenario, spec=scenario.spec.model_copy(update={"craters": with_database_seed(craters, database)}))


def with_database_knowledge(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the errors of the believed shape of a data base."""
    drawn = _drawn_onboard(scenario.spec.onboard)
    if database == 0 or not drawn:
        return scenario
    onboard = scenario.spec.onboard.model_copy(update={k: with_database_seed(v, database) for k, v in drawn.items()})
    return replace(scenario, spec=scenario.spec.model_copy(update={"onboard": onboard}))


def with_database_seed(options: Options, database: int) -> Options:
    """Return options with the seed of a data base; a missing seed counts as 0."""
    if database == 0:
        return options
    seed: int = getattr(options, "seed") or 0  # noqa: B009  the type has no seed, but all models used here do
    return options.model_copy(update={"seed": seed + SEED_STEP * database})


def _drawn_onboard(onboard: OnboardSpec) -> dict[str, SpecModel]:
    """Return the sections of ``onboard`` that are drawn once per data base: those with a seed."""
    sections = {name: getattr(onboard, name) for name in OnboardSpec.model_fields}
    return {name: section for name, section in sections.items() if hasattr(section, "seed")}


def map_images(
    jobs: int | None,
    images: int,
    function: Callable[..., list[T]],
    *arguments: object,
    most_images: int = _CHUNK_IMAGES,
) -> list[T]:
    """Apply ``function(*arguments, numbers)`` to chunks of image numbers in workers; return all results in order.

    Numbers are from 0. The function is one of a module, so that it can be pickled, and returns one result for each
    number. With ``jobs`` None it runs in this process, a worker with its number of threads already set. A chunk is
    one of the image store, or ``most_images`` if that is less.
    """
    size = min(most_images, _CHUNK_IMAGES)
    chunks = [range(i, min(i + size, images)) for i in range(0, images, size)]
    if jobs is None:
        return [result for chunk in chunks for result in function(*arguments, chunk)]
    calls = ((jobs, function, arguments, chunk) for chunk in chunks)
    found: list[T] = []
    report_progress("images", 0, images)
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
    """Image of the believed body, or a real one of a survey, with its view, and whether it came from the store."""

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


def survey_images(scenario: LoadedScenario, variant: str) -> Iterator[DatabaseImage]:
    """Yield the real images of a scenario that are for data bases, without distortion, at their reference poses."""
    images = open_survey(scenario)
    for index in range(len(images)):
        seen = images.view(index)
        view = replace(seen, camera=seen.camera.pinhole)
        yield DatabaseImage(rectify(images.image(index), seen.camera), view, scenario, variant, from_store=False)
