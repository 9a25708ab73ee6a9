"""Kinds of experiment by name, and what a run needs of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, Protocol, Self, cast

if TYPE_CHECKING:
    from campaign.products import BuiltProduct, MissingProduct, Shelf
    from campaign.resolve import ResolvedCampaign
    from scenarios.load import LoadedScenario

Record = dict[str, object]
Records = dict[str, list[Record]]
Witness = Callable[[object], None]
"""Is shown what came about in a trial of one method: truth, what the method saw, and what it returned."""


def add_records(records: Records, found: Records, key: Record | None = None) -> None:
    """Add what a trial found to the records of each table, each with the columns of ``key`` before its own."""
    for table, added in found.items():
        records.setdefault(table, []).extend({**(key or {}), **record} for record in added)


@dataclass(frozen=True, slots=True)
class Bench:
    """Where and how a worker works; nothing here may change a row, but that a method over ``limit_s`` is stopped.

    ``limit_s`` is the time that a method may take for a trial, None for as long as it likes.
    """

    run: Path
    jobs: int
    keep_images: bool
    limit_s: float | None = None


class Experiment(Protocol):
    """A kind of trial: the only code that sees truth and estimate together.

    ``version`` is part of every run's digest: raise it when rows change for another reason than the parts they are
    made of. ``block_trials`` is how many trials are computed, stored and resumed together. ``kernels`` tells whether
    rows are worked out by the kernels of `estimators.slam.kernels`, of which there are two kinds.
    """

    kind: ClassVar[str]
    version: ClassVar[int]
    block_trials: ClassVar[int]
    kernels: ClassVar[bool]

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of a method (an estimator) by its name; raise BoresightError if it is unknown."""
        ...

    @classmethod
    def prepare(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, shelf: Shelf
    ) -> Sequence[BuiltProduct | MissingProduct]:
        """Build what the trials need, before any of them; one that cannot be made leaves its method without trials."""
        ...

    @classmethod
    def open(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, bench: Bench) -> Experiment:
        """Make the experiment ready in a worker."""
        ...

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one method alone, all of whose stages ``witness`` is shown.

        Its records are those of a run bit for bit. A kind that has nothing to show never calls the witness.
        """
        ...

    def run(self, trials: range) -> Records:
        """Run trials: the records of each stored table, in the order of trials and methods."""
        ...


_KINDS: Mapping[str, str] = MappingProxyType(
    {
        "single-image": "campaign.experiments.single_image:SingleImage",
        "landmark-database": "campaign.experiments.landmark_database:DatabaseTrials",
        "pose-convergence": "campaign.experiments.pose_convergence:PoseConvergence",
        "crater-matching": "campaign.experiments.crater_matching:CraterMatching",
        "crater-detection": "campaign.experiments.crater_detection:CraterDetection",
        "image-survey": "campaign.experiments.image_survey:ImageSurvey",
        "sequence": "campaign.experiments.sequence:SequenceTrials",
        "orbit-determination": "campaign.experiments.orbit_determination:OrbitTrials",
        "crater-navigation": "campaign.experiments.crater_navigation:CraterNavigationTrials",
    }
)


def experiment_class(kind: str) -> type[Experiment]:
    """Look up a kind of experiment that the campaign schema admits."""
    module, attribute = _KINDS[kind].split(":")
    return cast("type[Experiment]", getattr(import_module(module), attribute))
