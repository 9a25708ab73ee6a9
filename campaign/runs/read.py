"""Campaigns and their scenarios as they are written, without the code that runs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import (
    ConfigEntry,
    LoadedCampaign,
    LoadedScenario,
    file_kind,
    load_campaign,
    load_scenario,
    names_in,
    scenario_names,
)
from boresight.scenarios.spec.campaign import CampaignSpec, GridCell, GridVariation, grid_cells

CATALOG = Path(__file__).parents[1] / "catalog"


def campaign_names() -> list[str]:
    """Return the names of the campaigns that come with boresight."""
    return names_in(CATALOG)


def is_campaign(name: str) -> bool:
    """Tell campaigns from scenarios: by the catalogue first, by the keys of the file otherwise."""
    if name in campaign_names():
        return True
    if name in scenario_names():
        return False
    return file_kind(Path(name), campaign_names()) == "campaign"


@dataclass(frozen=True, slots=True)
class CampaignFiles:
    """A campaign, its scenarios, and the place in its grid of each that has one, by name."""

    loaded: LoadedCampaign
    scenarios: tuple[LoadedScenario, ...]
    variations: Mapping[str, GridVariation]


def read_campaign(name_or_path: str, overrides: Sequence[str] = (), *, embedded: bool = False) -> CampaignFiles:
    """Read a campaign and its scenarios, with ``--set`` overrides put on every scenario.

    With ``embedded``, built-in bodies replace the shape files that they stand for, but for real images. Raise
    BoresightError if a file, a key or a value is wrong, or two scenarios share a name.
    """
    loaded = load_campaign(name_or_path, CATALOG)
    found = [read_source(loaded, source, overrides, embedded=embedded) for source in sources(loaded.spec)]
    names = [scenario.spec.name for scenario, _ in found]
    if len(set(names)) != len(names):
        raise BoresightError(f"{loaded.place_of('scenarios')}: scenarios: two of them are called the same: {names}")
    variations = {scenario.spec.name: variation for scenario, variation in found if variation is not None}
    return CampaignFiles(loaded, tuple(scenario for scenario, _ in found), variations)


@dataclass(frozen=True, slots=True)
class Source:
    """Source of a scenario of a campaign: its file or name, and its cell of the grid, if there is one."""

    file: str
    cell: GridCell | None


def sources(campaign: CampaignSpec) -> list[Source]:
    """List where the scenarios of a campaign come from, each in all variations of its grid, in their order."""
    every = (None,) if campaign.grid is None else grid_cells(campaign.grid)
    return [Source(file, cell) for file in campaign.scenarios for cell in every]


def read_source(
    loaded: LoadedCampaign, source: Source, overrides: Sequence[str | ConfigEntry], *, embedded: bool = False
) -> tuple[LoadedScenario, GridVariation | None]:
    """Read one scenario of a campaign."""
    cell = source.cell
    named = () if cell is None else zip(cell.levels.items(), cell.overrides, strict=True)
    levels = [loaded.level(axis, level, one) for (axis, level), one in named]
    near = loaded.path.parent
    one = load_scenario(source.file, overrides, base=loaded.overrides, levels=levels, near=near, embedded=embedded)
    if cell is None:
        return one, None
    base = one.spec.name
    own_name = "-".join(filter(None, (base, cell.suffix)))
    return replace(one, spec=one.spec.model_copy(update={"name": own_name})), GridVariation(base, cell.levels)
