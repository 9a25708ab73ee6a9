"""A campaign as its files describe it: its scenarios, and the data, the packages and the time that it takes here.

Nothing of the code that runs it is imported. The time is by the rate of its last run here, which is kept in the cache.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

from boresight.estimators.registry import EXTRAS
from boresight.scenarios.cache import default_cache
from boresight.scenarios.data import is_there
from boresight.scenarios.data.datasets import DataSet, datasets_providing
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
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.campaign import CampaignSpec, GridCell, GridVariation, grid_cells

CATALOG = Path(__file__).parents[1] / "catalog"

_KIND, _FILE = "rates", "rate.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_LEAST_TRIALS = 2

_OF_DATA = ("body", "onboard", "images")


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


@dataclass(frozen=True, slots=True)
class Need:
    """A file or a folder, as a scenario names it, or a package, and whether it is there.

    ``kind`` is the folder below the data folder where it is looked for first; '' for a package.
    """

    name: str
    found: bool
    kind: str = ""

    @property
    def word(self) -> str:
        """Its name in one word: ``data``, ``images``, or that of a package."""
        return {"": self.name, "images": "images"}.get(self.kind, "data")

    @property
    def data_sets(self) -> list[DataSet]:
        """Known data sets that have it; none for a package."""
        return datasets_providing([f"{self.kind}/{self.name}", self.name]) if self.kind else []


def needs(campaign: LoadedCampaign, known: Mapping[str, LoadedScenario] = MappingProxyType({})) -> tuple[Need, ...]:
    """List what the scenarios of a campaign and of its grid read from the data folder, and further packages.

    ``known`` are scenarios of the catalogue by name, which are not read again.
    """
    found = {need.name: need for scenario in _scenarios(campaign, known) for need in needs_of_scenario(scenario)}
    for extra in dict.fromkeys(EXTRAS[one.name] for one in campaign.spec.estimators if one.name in EXTRAS):
        found[extra] = Need(extra, find_spec(extra) is not None)
    return tuple(found.values())


def _scenarios(campaign: LoadedCampaign, known: Mapping[str, LoadedScenario]) -> Iterator[LoadedScenario]:
    """Yield each scenario, and it with each level of the grid that may change what is read."""
    changed = _change_data(campaign.overrides.section or {})
    near, axes = campaign.path.parent, campaign.spec.grid.axes.values() if campaign.spec.grid else ()
    for name in campaign.spec.scenarios:
        as_named = None if changed else known.get(name)
        yield as_named or load_scenario(name, base=campaign.overrides, near=near)
        for level in (level for axis in axes for level in axis.overrides.values()):
            if _change_data(level):
                yield load_scenario(name, base=campaign.overrides, levels=[level], near=near)


def _change_data(overrides: Iterable[str]) -> bool:
    """Return whether overrides of these keys may change what a scenario reads."""
    return any(key.split(".")[0] in _OF_DATA for key in overrides)


def needs_of_scenario(scenario: LoadedScenario) -> Iterator[Need]:
    """Yield the shapes, images, tracks and kernels that a scenario reads, whether they are there or not."""
    spec, dirs = scenario.spec, scenario.search_dirs
    named = [("shapes", file) for body in (*spec.bodies, onboard_spec(spec).body) for file in body.files]
    if spec.images is not None:
        named.append(("images", spec.images.folder))
        named += [("spice", kernel) for kernel in (spec.images.spice.kernels if spec.images.spice else ())]
    if spec.sequence is not None and spec.sequence.tracks is not None:
        tracks = spec.sequence.tracks
        named += [("tables", name) for name in (tracks.table, tracks.poses, tracks.spc) if name is not None]
    for kind, name in dict.fromkeys(named):
        yield Need(name, is_there(name, dirs, kind), kind)


def in_words(seconds: float) -> str:
    """Write a time in hours, minutes or seconds, of which it is one at least."""
    scale, unit = next(((s, u) for s, u in ((3600.0, "h"), (60.0, "min")) if seconds >= 1.5 * s), (1.0, "s"))
    return f"{max(seconds / scale, 1.0):.2g} {unit}"


def remember(name: str, trials: int, seconds: float, jobs: int) -> None:
    """Keep how long the trials of a run took; a few tell nothing, as the first ones compile and open what they need."""
    if trials >= _LEAST_TRIALS and _NAME.fullmatch(name):
        told = json.dumps({"core_s": seconds * jobs / trials, "trials": trials})
        default_cache().put(_KIND, name, lambda folder: (folder / _FILE).write_text(told, encoding="utf-8"))


def core_seconds(name: str) -> float | None:
    """Return the core seconds of a trial of a campaign, of one scenario with all estimators.

    Data bases are left aside. None if it has no readable run here.
    """
    kept = default_cache().find(_KIND, name) if _NAME.fullmatch(name) else None
    try:
        return None if kept is None else float(json.loads((kept / _FILE).read_text(encoding="utf-8"))["core_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
