"""Kinds of trial: their interface, and the look-up by name."""

from __future__ import annotations

import difflib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self, cast

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.pool.steps import report_progress
from boresight.scenarios.errors import BoresightError

if TYPE_CHECKING:
    from boresight.campaign.products import BuiltAssets, BuiltProduct, MissingProduct
    from boresight.campaign.resolved import ResolvedCampaign
    from boresight.scenarios.load import LoadedScenario

Record = dict[str, object]
Records = dict[str, list[Record]]


class Witnessed(Protocol):
    """A trial of one method with its truth, observation and estimate. The types are those of the kind of trial."""

    @property
    def image(self) -> NDArray[np.float32] | None:
        """Image (H, W); None where methods see tracks or data."""
        ...

    @property
    def truth(self) -> object:
        """The truth."""
        ...

    @property
    def observation(self) -> object:
        """Input of the method."""
        ...

    @property
    def estimate(self) -> object | None:
        """Result of the method; None if it raised or broke its contract."""
        ...


Witness = Callable[[Witnessed], None]
"""Called with each trial of one method, for inspection."""

Prepare = Callable[["ResolvedCampaign", "LoadedScenario", "BuiltAssets"], "Sequence[BuiltProduct | MissingProduct]"]

_KINDS = "boresight.campaign.kinds"


def add_records(records: Records, found: Records, key: Record | None = None) -> None:
    """Add what a trial found to the records of each table, each with the columns of ``key`` before its own."""
    for table, added in found.items():
        records.setdefault(table, []).extend({**(key or {}), **record} for record in added)


def each_trial(trials: Sequence[int], scenario: str, one: Callable[[int], Mapping[str, Records]]) -> Records:
    """Run trials one after another: the records of each table, with their keys.

    Parameters
    ----------
    trials
        Their numbers.
    scenario
        Name of the scenario.
    one
        Runs a trial: label of a method to its records, without their key.
    """
    records: Records = {}
    for number, trial in enumerate(trials):
        for label, found in one(trial).items():
            add_records(records, found, {"trial": trial, "scenario": scenario, "estimator": label})
        report_progress("trials of a block", number + 1, len(trials))
    return records


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """Run folder and settings of a worker. Rows do not depend on them, but a method over ``limit_s`` is stopped.

    ``limit_s`` is the time limit of a method in a trial, s; None: no limit.
    """

    run: Path
    jobs: int
    keep_images: bool
    limit_s: float | None = None


class Trials(Protocol):
    """The trials of one scenario in a worker: the only code with access to both truth and estimate."""

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the trials of one method alone, which pass all of its stages to ``witness``.

        The records equal those of a run bit for bit. A kind that has nothing to show never calls the witness.
        """
        ...

    def run(self, trials: range) -> Records:
        """Run trials: the records of each stored table, in the order of trials and methods."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of trial.

    Parameters
    ----------
    name
        The value of ``experiment`` in a campaign.
    version
        Part of every run's digest; raised when rows change and no version of a method or renderer does.
    block_trials
        Number of trials that are computed, stored and resumed together.
    method_version
        Returns the version of a method (an estimator) by its name; raises BoresightError if it is unknown.
    check_scenario
        Raises BoresightError for a scenario on which its trials cannot run.
    methods
        Builds the methods that need no assets, by their labels; raises BoresightError for options that cannot run.
    prepare
        Builds the products of the trials before the first; a method whose product cannot be built has no trials.
        None if there is nothing to build.
    open
        Opens the trials of a scenario in a worker.
    databases
        Whether trials may use several data bases or worlds of craters.
    process_trials
        Restart a worker after this many trials, to bound memory leaks of libraries. Mitsuba has been
        reported to fail after some thousands of renderings in one process.
    """

    name: str
    version: int
    block_trials: int
    method_version: Callable[[str], int]
    check_scenario: Callable[[LoadedScenario], object]
    methods: Callable[[ResolvedCampaign, LoadedScenario], Mapping[str, object]]
    open: Callable[[ResolvedCampaign, LoadedScenario, WorkerContext], Trials]
    prepare: Prepare | None = None
    databases: bool = False
    process_trials: int = 1000

    @property
    def process_blocks(self) -> int:
        """Number of blocks that a worker process runs before it is replaced."""
        return max(1, self.process_trials // self.block_trials)


def kind_names() -> list[str]:
    """List the kinds of trial: one for each folder of `campaign.kinds`."""
    folders = pkgutil.iter_modules(import_module(_KINDS).__path__)
    return sorted(folder.name.replace("_", "-") for folder in folders if folder.ispkg)


def kind_named(name: str) -> Kind:
    """Look up a kind of trial.

    Raises
    ------
    BoresightError
        If there is none of that name.
    """
    if name not in kind_names():
        near = difflib.get_close_matches(name, kind_names(), n=1)
        hint = f"did you mean {near[0]}?" if near else f"choose one of {', '.join(kind_names())}"
        raise BoresightError(f"experiment: {name!r} is not a kind of trial; {hint}")
    return cast("Kind", import_module(module_of(name)).KIND)


def module_of(name: str) -> str:
    """Return the package of a kind of trial."""
    return f"{_KINDS}.{name.replace('-', '_')}"
