"""Descriptor data base of a scenario: features of rendered images, de-projected onto the body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from boresight.campaign.products.database_images import database_images, map_images
from boresight.campaign.products.databases import checked_options
from boresight.estimators.descriptors.database import (
    METHOD_VERSION,
    DescriptorDatabase,
    DescriptorOptions,
    ViewFeatures,
    view_features,
)
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.base import SpecModel

KIND = "descriptors"


def parse(options: Mapping[str, object]) -> DescriptorOptions:
    """Validate the options of a data base."""
    return DescriptorOptions.model_validate(options)


def versions() -> list[int]:
    """Return the versions of all code that a data base depends on, except the renderer."""
    return [METHOD_VERSION]


def announcement(options: SpecModel) -> str:
    """Describe the effort of a build."""
    options = checked_options(KIND, options, DescriptorOptions)
    return f"{options.kind}, {options.images} images"


def build(scenario: LoadedScenario, options: SpecModel, folder: Path, jobs: int, variant: str) -> Mapping[str, object]:
    """Build the data base of ``scenario`` and store it in ``folder``."""
    options = checked_options(KIND, options, DescriptorOptions)
    found = map_images(jobs, options.images, _of_images, scenario, options, variant)
    views = tuple(features for features, _ in found)
    provenance = {"options": options.model_dump(mode="json"), "method_version": METHOD_VERSION}
    DescriptorDatabase(options.kind, views, provenance).save(folder)
    return {"images": len(views), "images_from_store": sum(kept for _, kept in found)}


def load(folder: Path) -> DescriptorDatabase:
    """Read a stored data base."""
    return DescriptorDatabase.load(folder)


def about(folder: Path) -> dict[str, object]:
    """Describe a stored data base for the manifest."""
    database = load(folder)
    return {"descriptors": database.kind, "n_landmarks": database.n_features}


def _of_images(
    scenario: LoadedScenario, options: DescriptorOptions, variant: str, images: Sequence[int]
) -> list[tuple[ViewFeatures, bool]]:
    return [
        (view_features(image.pixels, image.view, image.deproject, options), image.from_store)
        for image in database_images(scenario, images, (0.0, options.phase_deg_max), options.seed, variant)
    ]
