"""The landmark data base of a scenario: render, detect corners, de-project, cluster, triangulate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from campaign.products.landmark_candidates import candidates_of
from estimators.landmark.build import METHOD_VERSION, DatabaseOptions, database_from_candidates
from estimators.landmark.database import LandmarkDatabase
from scenarios.load import LoadedScenario
from scenarios.spec.base import SpecModel

KIND = "landmark-database"
VERSION = 1


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
    """Build the data base of ``scenario`` from its candidates and store it in ``folder``."""
    options = _checked(options)
    candidates = candidates_of(scenario, options, jobs, variant)
    database_from_candidates(candidates.by_image, options).save(folder)
    images = {"images": len(candidates.by_image)}
    if candidates.images_from_store is None:
        return {**images, "candidates_from_cache": sum(map(len, candidates.by_image))}
    return {**images, "images_from_store": candidates.images_from_store}


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
