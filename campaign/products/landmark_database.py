"""The landmark data base of a scenario: render, detect corners, de-project, cluster, triangulate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from campaign.image_store import ImageStore
from campaign.machine import use_threads
from campaign.parallel import in_order
from campaign.world import World, open_world, typical_range_m
from estimators.landmark.build import METHOD_VERSION, DatabaseOptions, database_from_candidates, extract_candidates
from estimators.landmark.database import LandmarkDatabase
from scenarios.draw import Stream, draw_lit_view, generator
from scenarios.geometry import View
from scenarios.load import LoadedScenario
from scenarios.spec.base import SpecModel
from scenarios.spec.distribution import Uniform
from scenarios.spec.world import LightingSpec, ViewpointSpec

KIND = "landmark-database"
VERSION = 1
_CHUNK_IMAGES = 10


def parse(options: Mapping[str, object]) -> DatabaseOptions:
    """Validate the options of a data base."""
    return DatabaseOptions.model_validate(options)


def versions() -> list[int]:
    """List the versions of all code that a data base depends on, beside the renderer's."""
    return [VERSION, METHOD_VERSION]


def announcement(options: SpecModel) -> str:
    """Say what takes time in a build."""
    return f"{_checked(options).images} images"


def build(scenario: LoadedScenario, options: SpecModel, folder: Path, jobs: int, variant: str) -> Mapping[str, object]:
    """Build the data base of ``scenario`` and store it in ``folder``.

    The images are noise free, of the scenario's own body, BRDF and camera (without distortion), from random
    directions at the scenario's range, with the Sun anywhere within the largest phase angle (Rowell et al. 2015,
    section 4.1). They are kept, so that other corners or clusters render nothing again.
    """
    options = _checked(options)
    chunks = [range(i, min(i + _CHUNK_IMAGES, options.images)) for i in range(0, options.images, _CHUNK_IMAGES)]
    calls = ((scenario, options, chunk, variant, jobs) for chunk in chunks)
    found = [image for chunk in in_order(jobs, _candidates, calls) for image in chunk]
    database = database_from_candidates([candidates for candidates, _ in found], options)
    database.save(folder)
    from_store = sum(stored for _, stored in found)
    return {"images": len(found), "images_from_store": from_store}


def load(folder: Path) -> LandmarkDatabase:
    """Read a stored data base."""
    return LandmarkDatabase.load(folder)


def about(folder: Path) -> dict[str, object]:
    """Describe a stored data base for the manifest."""
    database = load(folder)
    return {"n_landmarks": len(database.means_m), "n_facets": len(database.facets)}


def _checked(options: SpecModel) -> DatabaseOptions:
    if not isinstance(options, DatabaseOptions):
        raise TypeError(f"{KIND}: options are a {type(options).__name__}, not DatabaseOptions")
    return options


def _candidates(
    scenario: LoadedScenario, options: DatabaseOptions, images: Sequence[int], variant: str, jobs: int
) -> list[tuple[NDArray[np.float64], bool]]:
    """Find the candidates of some images, and whether each image came from the store."""
    use_threads(jobs)
    world = open_world(scenario, variant)
    viewpoint = ViewpointSpec(range_m=typical_range_m(scenario))
    lighting = LightingSpec(phase_deg=Uniform(uniform=(0.0, options.phase_deg_max)))
    store = ImageStore.open(scenario, variant, Stream.DATABASE, viewpoint, lighting)
    found = []
    for image in images:
        rng = generator(options.seed, Stream.DATABASE, image)
        view = draw_lit_view(viewpoint, lighting, world.camera.pinhole, rng)
        pixels, stored = store.image(options.seed, image, view, world.renderer.render)
        found.append((_candidates_of(world, view, pixels, options), stored))
    store.flush()
    return found


def _candidates_of(
    world: World, view: View, image: NDArray[np.float32], options: DatabaseOptions
) -> NDArray[np.float64]:
    return extract_candidates(image, lambda uv: world.renderer.surface(view, uv).points_body_m, options)
