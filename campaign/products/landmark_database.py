"""Landmark data base of a scenario: render images, detect corners, de-project, cluster, triangulate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from boresight.campaign.products.database_images import database_images, map_images
from boresight.campaign.products.databases import ProductKind, content_key
from boresight.estimators.landmark.database import (
    METHOD_VERSION,
    CandidateOptions,
    DatabaseOptions,
    LandmarkDatabase,
    database_from_candidates,
    extract_candidates,
)
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.cache import default_cache
from boresight.scenarios.load import LoadedScenario

KIND = "landmark-database"
VERSION = 1

CANDIDATES_KIND = "landmark-candidates"
CANDIDATES_VERSION = 1


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkCandidates:
    """Candidate landmarks: de-projected corners of rendered images, (C, 3) for each image, body frame, m.

    ``images_from_store`` is the number of images from the store; None if the candidates came from the cache.
    """

    by_image: tuple[FloatArray, ...]
    images_from_store: int | None


def landmark_candidates(
    scenario: LoadedScenario, options: CandidateOptions, jobs: int | None, variant: str
) -> LandmarkCandidates:
    """Return the candidates of ``scenario``, as the spacecraft believes it to be, from the cache if they are there.

    The images (`database_images`) are stored as well, so that other corner options render nothing again. Further fields
    of a derived model of options are ignored. For ``jobs`` see `map_images`.
    """
    options = CandidateOptions.model_validate({name: getattr(options, name) for name in CandidateOptions.model_fields})
    stored: list[int] = []

    def build(folder: Path) -> None:
        found = map_images(jobs, options.images, _candidates_of_images, scenario, options, variant)
        stored.append(sum(from_store for _, from_store in found))
        np.save(folder / "points_m.npy", np.concatenate([np.empty((0, 3)), *(points for points, _ in found)]))
        np.save(folder / "counts.npy", np.array([len(points) for points, _ in found], dtype=np.int64))

    key = content_key(scenario, CANDIDATES_KIND, options, [CANDIDATES_VERSION, METHOD_VERSION], variant)
    folder = default_cache().folder(CANDIDATES_KIND, key, build)
    points_m, counts = (np.load(folder / name, allow_pickle=False) for name in ("points_m.npy", "counts.npy"))
    return LandmarkCandidates(tuple(np.split(points_m, np.cumsum(counts)[:-1])), stored[0] if stored else None)


def _candidates_of_images(
    scenario: LoadedScenario, options: CandidateOptions, variant: str, images: Sequence[int]
) -> list[tuple[FloatArray, bool]]:
    """Find the candidates of some images, and whether each image came from the store."""
    pictured = database_images(
        scenario, images, (0.0, options.phase_deg_max), options.seed, variant, options.range_m, options.camera
    )
    return [(extract_candidates(image.pixels, image.deproject, options), image.from_store) for image in pictured]


def build(
    scenario: LoadedScenario, options: DatabaseOptions, folder: Path, jobs: int, variant: str
) -> Mapping[str, object]:
    """Build the data base of ``scenario`` from its candidates and store it in ``folder``."""
    candidates = landmark_candidates(scenario, options, jobs, variant)
    database = database_from_candidates(candidates.by_image, options)
    database.save(folder)
    if candidates.images_from_store is None:
        source = {"candidates_from_cache": sum(map(len, candidates.by_image))}
    else:
        source = {"images_from_store": candidates.images_from_store}
    return {"images": len(candidates.by_image), **source, "landmarks": len(database.means_m)}


PRODUCT = ProductKind(
    options=DatabaseOptions,
    versions=lambda: [VERSION, METHOD_VERSION],
    announce=lambda options: f"{options.images} images",
    build=build,
    load=LandmarkDatabase.load,
    about=lambda database: {"n_landmarks": len(database.means_m), "n_facets": len(database.facets)},
)
