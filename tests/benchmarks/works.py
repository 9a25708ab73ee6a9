"""The comparisons by name, and all of them in one table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType

from benchmarks import ceres
from benchmarks.images import image_ratios
from benchmarks.paper import recognition_ratios
from benchmarks.plain import plain_ratios
from benchmarks.ratio import Absent, Ratio, SpeedTable
from benchmarks.rays import ray_ratios
from benchmarks.scaling import scaling_ratios
from benchmarks.sequences import adjustment_ratios, kernel_ratios, smoother_ratios
from benchmarks.settings import Settings
from boresight.campaign.machine import describe, load, package_versions
from boresight.campaign.runs.manifest import commit_here, now
from boresight.scenarios.errors import BoresightError

Work = Callable[[Settings], Iterator[Ratio | Absent]]

WORKS: Mapping[str, Work] = MappingProxyType(
    {
        "plain": plain_ratios,
        "kernels": kernel_ratios,
        "images": image_ratios,
        "rays": ray_ratios,
        "adjustment": adjustment_ratios,
        "smoother": smoother_ratios,
        "recognition": recognition_ratios,
        "scaling": scaling_ratios,
    }
)
QUICK = "quick"
GROUPS: Mapping[str, Sequence[str]] = MappingProxyType({"all": tuple(WORKS), QUICK: ("plain", "kernels")})
_PEERS = ("gtsam", "embreex")


def names_of(name: str) -> Sequence[str]:
    """Return the works that a name stands for; none where it is no name of such."""
    return GROUPS.get(name, (name,) if name in WORKS else ())


def speed_table(names: Sequence[str], settings: Settings, tell: Callable[[str], None]) -> SpeedTable:
    """Do works one after the other, and gather what they come to.

    Parameters
    ----------
    names
        Keys of ``WORKS``.
    settings
        How much is done.
    tell
        Hears which work begins.
    """
    found: list[Ratio | Absent] = []
    before = load()
    for name in names:
        tell(name)
        found += WORKS[name](settings)
    return SpeedTable(
        tuple(item for item in found if isinstance(item, Ratio)),
        tuple(item for item in found if isinstance(item, Absent)),
        commit_here(),
        now(),
        {**describe(), "load_before": before, "load_after": load()},
        package_versions() | {name: _version(name) for name in _PEERS} | {"Ceres": _ceres_version()},
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def _ceres_version() -> str:
    try:
        return ceres.version()
    except BoresightError:
        return "absent"
