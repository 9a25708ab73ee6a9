"""Descriptor data base of a scenario: features of rendered images, de-projected onto the body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from boresight.campaign.products.database_images import database_images, map_images
from boresight.campaign.products.databases import ProductKind
from boresight.estimators.descriptors.database import (
    METHOD_VERSION,
    DescriptorDatabase,
    DescriptorOptions,
    ViewFeatures,
    view_features,
)
from boresight.scenarios.load import LoadedScenario


def build(
    scenario: LoadedScenario, options: DescriptorOptions, folder: Path, jobs: int, variant: str
) -> Mapping[str, object]:
    """Build the data base of ``scenario`` and store it in ``folder``."""
    found = map_images(jobs, options.images, _of_images, scenario, options, variant)
    views = tuple(features for features, _ in found)
    provenance = {"options": options.model_dump(mode="json"), "method_version": METHOD_VERSION}
    DescriptorDatabase(options.kind, views, provenance).save(folder)
    return {"images": len(views), "images_from_store": sum(kept for _, kept in found)}


def _of_images(
    scenario: LoadedScenario, options: DescriptorOptions, variant: str, images: Sequence[int]
) -> list[tuple[ViewFeatures, bool]]:
    return [
        (view_features(image.pixels, image.view, image.deproject, options), image.from_store)
        for image in database_images(scenario, images, (0.0, options.phase_deg_max), options.seed, variant)
    ]


PRODUCT = ProductKind(
    options=DescriptorOptions,
    versions=lambda: [METHOD_VERSION],
    announce=lambda options: f"{options.kind}, {options.images} images",
    build=build,
    load=DescriptorDatabase.load,
    about=lambda database: {"descriptors": database.kind, "n_landmarks": database.n_features},
)
