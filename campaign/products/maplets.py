"""Maplets of a scenario, extracted from the shape that the spacecraft believes in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from boresight.campaign.products.databases import checked_options
from boresight.estimators.maplets.build import METHOD_VERSION, MapletOptions, build_maplets
from boresight.estimators.maplets.database import MapletDatabase
from boresight.scenarios.bodies import load_body
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.base import SpecModel

KIND = "maplets"


def parse(options: Mapping[str, object]) -> MapletOptions:
    """Validate the options of a data base."""
    return MapletOptions.model_validate(options)


def versions() -> list[int]:
    """Return the versions of all code that a data base depends on, except the renderer."""
    return [METHOD_VERSION]


def announcement(options: SpecModel) -> str:
    """Describe the effort of a build."""
    side = checked_options(KIND, options, MapletOptions).side
    return f"{side} x {side} heights each"


def build(scenario: LoadedScenario, options: SpecModel, folder: Path, jobs: int, variant: str) -> None:
    """Extract maplets from the scenario's believed shape and store them in ``folder``."""
    del jobs, variant
    mesh = load_body(scenario.spec.body, scenario.search_dirs).mesh
    build_maplets(mesh, checked_options(KIND, options, MapletOptions)).save(folder)


def load(folder: Path) -> MapletDatabase:
    """Read a stored data base."""
    return MapletDatabase.load(folder)


def about(folder: Path) -> dict[str, object]:
    """Describe a stored data base for the manifest."""
    database = load(folder)
    return {"n_landmarks": len(database), "nodes": database.side**2, "spacing_m": database.spacing_m}
