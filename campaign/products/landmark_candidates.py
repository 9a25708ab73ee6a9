"""Candidate landmarks of a scenario, kept in the cache: other clusters find no corner and render no image again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from campaign.products.database_images import database_images
from campaign.products.keys import content_key
from campaign.products.spread import over_images
from estimators.landmark.build import METHOD_VERSION, CandidateOptions, extract_candidates
from scenarios.cache import default_cache
from scenarios.load import LoadedScenario

KIND = "landmark-candidates"
VERSION = 1

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Candidate landmarks.

    Parameters
    ----------
    by_image
        (C, 3) points for each image, body frame, m.
    images_from_store
        How many of the images were not rendered for it; None where the candidates themselves were kept.
    """

    by_image: tuple[FloatArray, ...]
    images_from_store: int | None


def candidates_of(scenario: LoadedScenario, options: CandidateOptions, jobs: int, variant: str) -> Candidates:
    """Return the candidates of ``scenario``, from the cache where they are in it.

    The images (`database_images`) are kept as well, so that other corners render nothing again.

    Parameters
    ----------
    scenario
        As the spacecraft believes it to be.
    options
        Images and corners; further fields of a derived model have no part in it.
    jobs
        Workers, or ``spread.IN_THIS_PROCESS``.
    variant
        The Mitsuba variant.
    """
    options = CandidateOptions.model_validate({name: getattr(options, name) for name in CandidateOptions.model_fields})
    stored: list[int] = []

    def build(folder: Path) -> None:
        found = over_images(jobs, options.images, _of_images, scenario, options, variant)
        stored.append(sum(from_store for _, from_store in found))
        np.save(folder / "points_m.npy", np.concatenate([np.empty((0, 3)), *(points for points, _ in found)]))
        np.save(folder / "counts.npy", np.array([len(points) for points, _ in found], dtype=np.int64))

    key = content_key(scenario, KIND, options, [VERSION, METHOD_VERSION], variant)
    folder = default_cache().folder(KIND, key, build)
    points_m, counts = (np.load(folder / name, allow_pickle=False) for name in ("points_m.npy", "counts.npy"))
    return Candidates(tuple(np.split(points_m, np.cumsum(counts)[:-1])), stored[0] if stored else None)


def _of_images(
    scenario: LoadedScenario, options: CandidateOptions, variant: str, images: Sequence[int]
) -> list[tuple[FloatArray, bool]]:
    """Find the candidates of some images, and whether each image came from the store."""
    pictured = database_images(
        scenario, images, (0.0, options.phase_deg_max), options.seed, variant, options.range_m, options.camera
    )
    return [(extract_candidates(image.pixels, image.deproject, options), image.from_store) for image in pictured]
