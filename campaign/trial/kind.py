"""Kinds of trial: what the class of one declares, and the look-up by name."""

from __future__ import annotations

import difflib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar, cast

from boresight.campaign.pool.steps import report_progress
from boresight.estimators.registry import bases_of, with_bases
from boresight.scenarios.arrays import Image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load.lengths import lengths_left_out, with_lengths

if TYPE_CHECKING:
    from boresight.campaign.products import BuiltAssets, Prepared
    from boresight.campaign.resolved import ResolvedCampaign
    from boresight.scenarios.load import LoadedScenario
    from boresight.scenarios.spec.base import SpecModel
    from boresight.scenarios.spec.campaign import EstimatorSpec
    from boresight.scenarios.spec.scenario import ScenarioSpec

Truth = TypeVar("Truth")
Observed = TypeVar("Observed")
Estimated = TypeVar("Estimated")

Record = dict[str, object]
Records = dict[str, list[Record]]

_KINDS = "boresight.campaign.kinds"


@dataclass(frozen=True, slots=True, eq=False)
class InspectedTrial(Generic[Truth, Observed, Estimated]):
    """A trial of one method: truth, input of the method, and its result, whose types depend on the kind of trial.

    ``estimate`` is None if the method raised or broke its contract. ``image`` (H, W) is as the camera took it, None
    where methods see tracks or data; ``image_name`` is the file of a real one, else ''.
    """

    truth: Truth
    observation: Observed
    estimate: Estimated | None
    image: Image | None = None
    image_name: str = ""


Prediction = Callable[[], Mapping[str, float] | None]
"""Predicts RMS errors of a method in a trial, by the names of `boresight.campaign.trial.score.MEASURES`."""

Inspector = Callable[[InspectedTrial[Any, Any, Any]], None]
"""Called with each trial of one method, for inspection."""


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """Run folder and settings of a worker. Rows do not depend on them, but a method over ``limit_s`` is stopped.

    ``limit_s`` is the time limit of a method in a trial, s; None: no limit.
    """

    run: Path
    jobs: int
    keep_images: bool
    limit_s: float | None = None

    def image_folder(self, scenario: str) -> Path | None:
        """Return the folder in which the images of a scenario are kept; None to keep none."""
        return self.run / "images" / scenario if self.keep_images else None


@dataclass(frozen=True, eq=False, kw_only=True)
class Trials(ABC):
    """The trials of one scenario in a worker, with one of its data bases; a subclass is a kind of trial.

    ``methods`` maps a label to a method (an estimator, a detector), or to why it cannot be built. The ``inspector`` is
    shown the trials of all methods. ``database`` is the number of the data base, by the labels of the methods that have
    one.
    """

    name: ClassVar[str]
    """The value of ``experiment`` in a campaign."""

    version: ClassVar[int]
    """Part of every run's digest; raised when rows change and no version of a method or renderer does."""

    block_trials: ClassVar[int]
    """Number of trials that are computed, stored and resumed together."""

    process_trials: ClassVar[int] = 1000
    """Restart a worker after this many trials, to bound memory leaks of libraries. Mitsuba has been reported to fail
    after some thousands of renderings in one process."""

    databases: ClassVar[bool] = False
    """True if trials may use several data bases or worlds of craters."""

    scenario: str
    methods: Mapping[str, object]
    seed: int
    inspector: Inspector | None = None
    database: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    @abstractmethod
    def method_version(cls, name: str) -> int:
        """Return the version of a method by its name; raise BoresightError if it is unknown."""

    @classmethod
    def method_names(cls, entry: EstimatorSpec) -> tuple[str, ...]:
        """Return the names of the methods that an entry of a campaign runs: its own, and those that it builds on."""
        return with_bases(entry.name, entry.options)

    @classmethod
    def options_model(cls, name: str) -> type[SpecModel] | None:
        """Return the model of the options of a method by its name; None if it has none."""
        return None

    @classmethod
    def lengths(cls, entry: EstimatorSpec, scenario: LoadedScenario) -> dict[str, Any]:
        """Return the lengths that the options of a method leave out, for a scenario; sections within sections."""
        # Imported here: it loads the renderer, which the names of kinds do without.
        from boresight.campaign.imaging.world import scale_of

        scale = scale_of(scenario)

        def of(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
            model = cls.options_model(name)
            found = {} if model is None else lengths_left_out((model,), options, scale)
            for base in bases_of(name, options):
                if isinstance(options.get(base.section, {}), Mapping):  # else it is refused where options are read
                    found[base.section] = of(base.name, base.options)
            return found

        return of(entry.name, entry.options)

    @classmethod
    def entries(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> list[EstimatorSpec]:
        """Return the methods of a campaign with all lengths of their options, for a scenario."""
        return [
            entry.model_copy(update={"options": with_lengths(entry.options, cls.lengths(entry, scenario))})
            for entry in campaign.spec.estimators
        ]

    @classmethod
    @abstractmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Raise BoresightError for a scenario on which trials cannot run."""

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        """Return the sections and dotted keys of a scenario that neither methods nor scores of its trials depend on.

        They are refused where they are given, see `campaign.runs.unused`; those that no scenario of the kind can have
        are not among them.
        """
        return ()

    @classmethod
    @abstractmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> Mapping[str, object]:
        """Build the methods that need no assets, by their labels.

        Raise `BoresightError` for options that cannot run, also of methods that `open` builds with their assets.
        """

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, assets: BuiltAssets) -> Sequence[Prepared]:
        """Build the products of the trials before the first; a method whose product cannot be built has no trials."""
        return []

    @classmethod
    @abstractmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Open the trials of a scenario with the data base of a number in a worker."""

    @classmethod
    def made(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, number: int, **world: Any) -> Self:
        """Make the trials of a scenario in a world, with all methods that need no assets."""
        several = cls.databases and campaign.spec.databases > 1
        return cls(
            scenario=scenario.spec.name,
            methods=cls.build_methods(campaign, scenario),
            seed=campaign.seed,
            database=dict.fromkeys(campaign.labels, number) if several else {},
            **world,
        )

    @classmethod
    def process_blocks(cls) -> int:
        """Return the number of blocks that a worker process runs before it is replaced."""
        return max(1, cls.process_trials // cls.block_trials)

    def watched(self, label: str, inspector: Inspector) -> Self:
        """Return the trials of one method alone, shown to an inspector.

        The records equal those of a run bit for bit. A kind that has nothing to show never calls the inspector.
        """
        return replace(self, methods={label: self.methods[label]}, inspector=inspector)

    @abstractmethod
    def trial(self, trial: int) -> Records:
        """Run one trial with all methods: the records that it adds to each stored table."""

    @classmethod
    def predicts(cls, entry: EstimatorSpec) -> bool:
        """Whether a method of a campaign predicts its covariance without images."""
        return False

    def predictors(self, trial: int) -> Mapping[str, Prediction]:
        """Draw the geometry of a trial; return the prediction of each method that `predicts`, still to be computed."""
        return {}

    def flush(self) -> None:  # noqa: B027  most kinds render nothing
        """Store the rendered images, at the end of a block of trials."""

    def run(self, trials: range) -> Records:
        """Run trials: the records of each stored table, in the order of trials and methods."""
        return _each_trial((self,), trials)


@dataclass(frozen=True, slots=True, eq=False)
class PerDatabase:
    """Trials of one scenario with each of its data bases, most have one: trial t uses number t modulo their count."""

    parts: tuple[Trials, ...]

    @classmethod
    def open(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext) -> PerDatabase:
        """Open the trials of a scenario in a worker."""
        kind = kind_named(campaign.spec.experiment)
        return cls(tuple(kind.open(campaign, scenario, context, i) for i in range(campaign.spec.databases)))

    def of(self, trial: int) -> Trials:
        """Return the trials that share the data base of one trial."""
        return self.parts[trial % len(self.parts)]

    def run(self, trials: range) -> Records:
        """Run trials in their order."""
        return self.parts[0].run(trials) if len(self.parts) == 1 else _each_trial(self.parts, trials)


def _each_trial(parts: Sequence[Trials], trials: range) -> Records:
    records: Records = {}
    for number, trial in enumerate(trials):
        add_records(records, parts[trial % len(parts)].trial(trial))
        report_progress("trials of a block", number + 1, len(trials))
    for part in parts:
        part.flush()
    return records


def add_records(records: Records, found: Records, key: Record | None = None) -> None:
    """Add what a trial found to the records of each table, each with the columns of ``key`` before its own."""
    for table, added in found.items():
        records.setdefault(table, []).extend({**(key or {}), **record} for record in added)


def check_only_method(kind: str, only: str, name: str) -> None:
    """Refuse a method that is not the only one of a kind of trial."""
    if name != only:
        raise BoresightError(f"estimators: {name!r} has no part in {kind}: the only method is {only}")


def kind_names() -> list[str]:
    """List the kinds of trial: one for each folder of `campaign.kinds`."""
    folders = pkgutil.iter_modules(import_module(_KINDS).__path__)
    return sorted(folder.name.replace("_", "-") for folder in folders if folder.ispkg)


def kind_named(name: str) -> type[Trials]:
    """Look up a kind of trial; raise BoresightError if there is none of that name."""
    if name not in kind_names():
        near = difflib.get_close_matches(name, kind_names(), n=1)
        hint = f"did you mean {near[0]}?" if near else f"choose one of {', '.join(kind_names())}"
        raise BoresightError(f"experiment: {name!r} is not a kind of trial; {hint}")
    return cast("type[Trials]", import_module(module_of(name)).KIND)


def module_of(name: str) -> str:
    """Return the package of a kind of trial."""
    return f"{_KINDS}.{name.replace('-', '_')}"
