"""A kind of trial: what a run needs of it, and where it is found by its name."""

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

from boresight.campaign.pool.steps import tell
from boresight.scenarios.errors import BoresightError

if TYPE_CHECKING:
    from boresight.campaign.products import BuiltAssets, BuiltProduct, MissingProduct
    from boresight.campaign.resolved import ResolvedCampaign
    from boresight.scenarios.load import LoadedScenario

Record = dict[str, object]
Records = dict[str, list[Record]]


class Witnessed(Protocol):
    """What came about in a trial of one method. The types are those of the kind of trial."""

    @property
    def image(self) -> NDArray[np.float32] | None:
        """Image (H, W); None where methods see tracks or data."""
        ...

    @property
    def truth(self) -> object:
        """What is true."""
        ...

    @property
    def observation(self) -> object:
        """What the method saw."""
        ...

    @property
    def estimate(self) -> object | None:
        """What the method returned; None where it raised or broke its contract."""
        ...


Witness = Callable[[Witnessed], None]
"""Is shown what came about in a trial of one method: truth, what the method saw, and what it returned."""

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
        tell("trials of a block", number + 1, len(trials))
    return records


@dataclass(frozen=True, slots=True)
class Bench:
    """Where and how a worker works; nothing here may change a row, but that a method over ``limit_s`` is stopped.

    ``limit_s`` is the time that a method may take for a trial, None for as long as it likes.
    """

    run: Path
    jobs: int
    keep_images: bool
    limit_s: float | None = None


class Trials(Protocol):
    """The trials of one scenario in a worker: the only code that sees truth and estimate together."""

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one method alone, all of whose stages ``witness`` is shown.

        Its records are those of a run bit for bit. A kind that has nothing to show never calls the witness.
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
        As campaigns give it under ``experiment``.
    version
        Part of every run's digest: raise it when rows change for another reason than the parts they are made of.
    block_trials
        How many trials are computed, stored and resumed together.
    method_version
        Returns the version of a method (an estimator) by its name; raises BoresightError if it is unknown.
    check_scenario
        Raises BoresightError for a scenario that its trials cannot have.
    methods
        Builds the methods that need no assets, by their labels; raises BoresightError for options that cannot run.
    prepare
        Builds what the trials need, before any of them; a product that cannot be made leaves its method without trials.
        None if there is nothing to build.
    open
        Makes the trials of a scenario ready in a worker.
    databases
        Whether trials may have several data bases, or worlds of craters, in turn.
    process_trials
        How many trials a worker process runs before it is replaced, which bounds what libraries leak. Mitsuba has been
        reported to fail after some thousands of renderings in one process.
    """

    name: str
    version: int
    block_trials: int
    method_version: Callable[[str], int]
    check_scenario: Callable[[LoadedScenario], object]
    methods: Callable[[ResolvedCampaign, LoadedScenario], Mapping[str, object]]
    open: Callable[[ResolvedCampaign, LoadedScenario, Bench], Trials]
    prepare: Prepare | None = None
    databases: bool = False
    process_trials: int = 1000

    @property
    def process_blocks(self) -> int:
        """How many blocks a worker process runs before it is replaced."""
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
