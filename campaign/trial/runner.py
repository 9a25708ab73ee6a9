"""One runner for the trials of all kinds: draw a trial, ask each method, check what it returns, score, show."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

from boresight.campaign.pool.guard import Call
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, Trials, add_records
from boresight.campaign.trial.methods import Unbuilt, build_all, require_built
from boresight.campaign.trial.work import Work
from boresight.estimators.options import model_of
from boresight.scenarios.errors import BoresightError, MachineError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import EstimatorSpec

Method = TypeVar("Method")
Drawn = TypeVar("Drawn")
Answer = TypeVar("Answer")


class OptionsMethod(Protocol):
    """A method that is built from its options alone."""

    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build the method; raise BoresightError for wrong options."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class TrialRunner(Trials, Generic[Method, Drawn, Answer]):
    """Trials in which every method is asked about the same draw: a kind is ``draw``, ``ask``, ``check`` and ``score``.

    What a method raises or returns against its contract becomes a row with status ``error``. What the other steps
    raise is an error of boresight or of the machine, and ends the run, but for `undrawable`.
    """

    called: ClassVar[str] = "estimator"
    """Sort of the methods, for messages."""

    undrawable: ClassVar[tuple[type[BoresightError], ...]] = ()
    """Raised by ``draw`` where chance leaves nothing to ask about; all methods have failed then."""

    undrawable_reason: ClassVar[str] = "there is no such trial"

    methods: Mapping[str, Method | Unbuilt]

    @abstractmethod
    def draw(self, trial: int) -> Drawn:
        """Draw a trial: truth, images, and what methods see of them."""

    def given(self, drawn: Drawn, label: str) -> Drawn:
        """Return the draw as one method gets it: the same for all, unless it is made while the method works."""
        return drawn

    def row(self, drawn: Drawn) -> Record:
        """Return the columns of a row that no method can change."""
        return {}

    @abstractmethod
    def ask(self, method: Method, drawn: Drawn) -> Answer:
        """Let a method work on its own copy of what it may see; may raise `GaveUpError`."""

    def check(self, answer: Answer, drawn: Drawn) -> None:
        """Raise if an answer breaks the contract; scoring must not fail on what passes."""

    @abstractmethod
    def score(self, answer: Answer, drawn: Drawn) -> Records:
        """Score an answer: the records of each table without their key, of ``rows`` the one that completes `row`."""

    def shown(self, answer: Answer | None, drawn: Drawn) -> InspectedTrial[Any, Any, Any] | None:
        """Return what an inspector sees of a trial, ``answer`` None without a valid one; None if there is nothing."""
        return None

    def of_draw(self, drawn: Drawn) -> Records:
        """Return records of the draw itself, which belong to no method."""
        return {}

    def of_all(self, drawn: Drawn) -> Records:
        """Return records that each method has, whatever it returns: times of images, quality of tracks."""
        return {}

    def trial(self, trial: int) -> Records:
        """Run one trial with all methods."""
        key: Record = {"trial": trial, "scenario": self.scenario}
        try:
            drawn = self.draw(trial)
        except MachineError:
            raise
        except self.undrawable as error:
            reason = f"{self.undrawable_reason}: {error}"
            failed: Record = {"image": "", "status": "failed", "reason": reason, "n_landmarks": 0}
            rows = [
                {**key, "estimator": label, **failed, "database": self.database.get(label)} for label in self.methods
            ]
            return {"rows": rows}
        records: Records = {}
        add_records(records, self.of_draw(drawn), key)
        for label, method in self.methods.items():
            own = self.given(drawn, label)
            found = self._asked(Call(self.scenario, trial, label), method, own)
            add_records(found, self.of_all(own))
            found["rows"][0]["database"] = self.database.get(label)
            add_records(records, found, {**key, "estimator": label})
        return records

    def _asked(self, call: Call, method: Method | Unbuilt, drawn: Drawn) -> Records:
        """Ask one method, check and score its answer: records without their key."""
        row: Record = {"image": "", **self.row(drawn)}

        def score(answer: Answer) -> Records:
            scored = self.score(answer, drawn)
            return {**scored, "rows": [{**row, **scored["rows"][0]}]}

        def show(answer: Answer | None) -> None:
            seen = None if self.inspector is None else self.shown(answer, drawn)
            if self.inspector is not None and seen is not None:
                self.inspector(seen)

        return Work(call, self.called, row).run(
            lambda: self.ask(require_built(method), drawn), lambda answer: self.check(answer, drawn), score, show
        )


Optioned = TypeVar("Optioned", bound=OptionsMethod)


class MethodRunner(TrialRunner[Optioned, Drawn, Answer]):
    """Trials of methods that are built from their options alone, with no assets."""

    @classmethod
    @abstractmethod
    def method_class(cls, name: str) -> type[Optioned]:
        """Return the class of a method; raise BoresightError if the name is unknown."""

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of a method."""
        return cls.method_class(name).version

    @classmethod
    def options_model(cls, name: str) -> type[SpecModel] | None:
        """Return the model of the options of a method, if it has one."""
        return model_of(cls.method_class(name))

    @classmethod
    def build(cls, entry: EstimatorSpec) -> Optioned:
        """Build a method of a campaign."""
        return cls.method_class(entry.name).from_options(entry.options)

    @classmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> Mapping[str, Optioned | Unbuilt]:
        """Build the methods; refuse wrong options."""
        return build_all(campaign, scenario, cls.entries(campaign, scenario), cls.build)
