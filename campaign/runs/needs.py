"""What data a campaign needs that do not come with boresight, and whether this machine has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from scenarios.bodies import EMBEDDED
from scenarios.data import find_data_file, find_data_folder
from scenarios.errors import BoresightError
from scenarios.load import LoadedCampaign, LoadedScenario, load_scenario
from scenarios.onboard import onboard_spec

_Find = Callable[[str, Sequence[Path], str, str], Path]
_OF_DATA = ("body", "onboard", "images")


@dataclass(frozen=True, slots=True)
class Need:
    """A file or a folder, as a scenario names it, and whether it is there."""

    name: str
    found: bool

    def __str__(self) -> str:
        """Name it, and say if it is missing."""
        return self.name if self.found else f"{self.name} (missing)"


def data_needed(campaign: LoadedCampaign) -> tuple[Need, ...]:
    """List what the scenarios of a campaign, and those of its grid, read from the data folder, each once."""
    found = {need.name: need for scenario in _scenarios(campaign) for need in _of_scenario(scenario)}
    return tuple(found.values())


def _scenarios(campaign: LoadedCampaign) -> Iterator[LoadedScenario]:
    """Yield each scenario, and it with each level of the grid that may change what is read."""
    near, axes = campaign.path.parent, campaign.spec.grid.axes.values() if campaign.spec.grid else ()
    for name in campaign.spec.scenarios:
        yield load_scenario(name, base=campaign.overrides, near=near)
        for level in (level for axis in axes for level in axis.overrides.values()):
            if any(key.split(".")[0] in _OF_DATA for key in level):
                yield load_scenario(name, base=campaign.overrides, levels=[level], near=near)


def _of_scenario(scenario: LoadedScenario) -> Iterator[Need]:
    spec, dirs = scenario.spec, scenario.search_dirs
    for shape in dict.fromkeys((spec.body.shape, onboard_spec(spec).body.shape)):
        if shape not in EMBEDDED:
            yield Need(shape, _is_there(find_data_file, shape, dirs, "shapes"))
    if spec.images is not None:
        yield Need(f"{spec.images.folder}/", _is_there(find_data_folder, spec.images.folder, dirs, "images"))


def _is_there(
    find: Callable[[str, Sequence[Path], str, str], Path], name: str, dirs: Sequence[Path], kind: str
) -> bool:
    try:
        find(name, dirs, kind, "")
    except BoresightError:
        return False
    return True
