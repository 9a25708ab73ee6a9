"""Requirements of a campaign on this machine: data, packages, and time by the rate of its last run here.

The rate is stored in the cache.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from types import MappingProxyType

from boresight.estimators.slam.registry import EXTRAS
from boresight.scenarios.cache import default_cache
from boresight.scenarios.data import is_there
from boresight.scenarios.load import LoadedCampaign, LoadedScenario, load_scenario
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.body import EMBEDDED_NAMES

_KIND, _FILE = "rates", "rate.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_LEAST_TRIALS = 2

_OF_DATA = ("body", "onboard", "images")


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
    named = [("shapes", spec.body.shape), ("shapes", onboard_spec(spec).body.shape)]
    if spec.images is not None:
        named.append(("images", spec.images.folder))
        named += [("spice", kernel) for kernel in (spec.images.spice.kernels if spec.images.spice else ())]
    if spec.sequence is not None and spec.sequence.tracks is not None:
        named += [("tables", spec.sequence.tracks.table), ("tables", spec.sequence.tracks.poses)]
    for kind, name in dict.fromkeys(named):
        if name not in EMBEDDED_NAMES:
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
