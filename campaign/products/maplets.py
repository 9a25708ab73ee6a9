"""Maplets of a scenario, extracted from the shape that the spacecraft believes in."""

from __future__ import annotations

from pathlib import Path

from boresight.campaign.products.databases import ProductKind
from boresight.estimators.maplets.build import METHOD_VERSION, MapletOptions, build_maplets
from boresight.estimators.maplets.database import MapletDatabase
from boresight.scenarios.bodies import load_body
from boresight.scenarios.load import LoadedScenario


def build(scenario: LoadedScenario, options: MapletOptions, folder: Path, jobs: int, variant: str) -> None:
    """Extract maplets from the scenario's believed shape and store them in ``folder``."""
    del jobs, variant
    mesh = load_body(scenario.spec.body, scenario.search_dirs).mesh
    build_maplets(mesh, options).save(folder)


PRODUCT = ProductKind(
    options=MapletOptions,
    versions=lambda: [METHOD_VERSION],
    announce=lambda options: f"{options.side} x {options.side} heights each",
    build=build,
    load=MapletDatabase.load,
    about=lambda database: {"n_landmarks": len(database), "nodes": database.side**2, "spacing_m": database.spacing_m},
)
