"""One runner for the trials of all kinds: build methods, draw a trial, ask each, check what it returns, score, show.

Wrong options are refused; a method that cannot be built fails in its own rows.
"""

from __future__ import annotations

import json
import re
import traceback
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Generic, NoReturn, Protocol, Self, TypeVar, cast

from boresight.campaign.pool.captured import CapturedOutput
from boresight.campaign.pool.guard import STOPPED, Call, StoppedError, guarded, unmoved
from boresight.campaign.products import MissingProduct
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, Trials, add_records
from boresight.estimators.contract import Assets, NoProductError
from boresight.estimators.options import OptionsError, model_of
from boresight.estimators.registry import estimator_class
from boresight.scenarios.errors import (
    BoresightError,
    InsideBodyError,
    MachineError,
    UndrawableError,
    printable,
    text_of,
)
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.onboard import onboard_camera
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import EstimatorSpec

T = TypeVar("T")

_MOST_CHARACTERS = 300
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")

Method = TypeVar("Method")
Drawn = TypeVar("Drawn")
Answer = TypeVar("Answer")


class GaveUpError(Exception):
    """A failure with a reason, which is not an error of the method."""


class _InvalidResultError(Exception):
    """A result breaks the contract; the cause is the exception of the check."""


@dataclass(frozen=True, slots=True)
class Work:
    """A method in a trial: its call, its sort for messages, and the columns of the row that no result changes."""

    call: Call
    method: str
    row: Record

    def run(
        self,
        work: Callable[[], T],
        check: Callable[[T], None],
        score: Callable[[T], Records],
        show: Callable[[T | None], None] = lambda result: None,
    ) -> Records:
        """Run the method, then validate and score its result; its output is stored in the table ``said``.

        ``work`` calls the method and may raise `GaveUpError`. ``check`` raises if the result breaks the contract;
        scoring must not fail on a result that passes. ``score`` returns the records of a result, without their key.
        ``show`` is called with the result at the end, with None if there is none, or an invalid one.

        Raises
        ------
        Exception
            Raised by scoring: an error of boresight, which must not be stored as a row.
        """
        valid: T | None = None
        captured = CapturedOutput()
        try:
            with unmoved(), captured.capturing():
                result = guarded(self.call, work)
                try:
                    check(result)
                except KeyboardInterrupt:
                    raise
                except BaseException as error:
                    why = str(error) if type(error) is ValueError else _named(error)
                    raise _InvalidResultError(f"returned an invalid result: {why}") from error
                valid = result
        except (GaveUpError, InsideBodyError) as failure:
            led = "the pose was led below the ground: " if isinstance(failure, InsideBodyError) else ""
            row: Record = {**self.row, "status": "failed", "reason": f"{led}{failure}", "n_landmarks": 0}
            found: Records = {"rows": [row]}
        except _InvalidResultError as error:
            found = self._fault(str(error), error.__cause__ or error)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001  here alone: an error of a method is a result
            found = self._fault(_why(error), error)
        else:
            try:
                found = score(valid)
            except Exception as error:
                error.add_note(f"while scoring {self.call}: this is an error of boresight, and no row is stored")
                raise
        finally:
            show(valid)
        for row in found["rows"]:
            row["reason"] = printable(str(row["reason"]))
        return found | captured.records()

    def _fault(self, what: str, error: BaseException) -> Records:
        """Return the row of a trial in which the method raised or returned something invalid, and its traceback."""
        # Addresses differ between processes, and rows must not.
        reason = _ADDRESS.sub("0x...", " ".join(f"the {self.method} {what}".split()))
        row: Record = {**self.row, "status": "error", "reason": reason[:_MOST_CHARACTERS], "n_landmarks": 0}
        return {"rows": [row], "tracebacks": [{"traceback": "".join(traceback.format_exception(error))}]}


def _why(error: BaseException) -> str:
    if isinstance(error, StoppedError):
        return f"{STOPPED}{error}"
    if isinstance(error, NoProductError):
        return f"cannot work: {error}"
    return f"raised {_named(error)}"


def _named(error: BaseException) -> str:
    return traceback.format_exception_only(error)[0]


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

    undrawable: ClassVar[tuple[type[BoresightError], ...]] = (UndrawableError,)
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
        except BoresightError as error:
            raise BoresightError(f"trial {trial} of {self.scenario}: {error}") from error
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
    def predicts(cls, entry: EstimatorSpec) -> bool:
        """Whether the class of the method has ``predict``."""
        return hasattr(cls.method_class(entry.name), "predict")

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
        found: dict[str, Optioned | Unbuilt] = {}
        for entry in cls.entries(campaign, scenario):
            with located(campaign, entry.label):
                found[entry.label] = try_build(entry, scenario.spec.name, partial(cls.build, entry), BoresightError)
        return found


@dataclass(frozen=True, slots=True)
class Unbuilt:
    """Reason and traceback of a method that could not be built for a scenario."""

    reason: str
    trace: str


@contextmanager
def located(campaign: ResolvedCampaign, label: str) -> Iterator[None]:
    """Add file and line to errors about an estimator of a campaign, or its options."""
    try:
        yield
    except (MachineError, NoProductError):
        raise
    except BoresightError as error:
        one = campaign.entry("estimators", label)
        if one is None:
            raise
        for name, options in (one.section or {}).items():
            if isinstance(error, OptionsError):
                raise error.located(options, name) from error
        raise BoresightError(f"{one.place}: {error}") from error


def try_build(
    entry: EstimatorSpec, scenario: str, make: Callable[[], T], refused: type[BoresightError] = MachineError
) -> T | Unbuilt:
    """Build a method for a scenario; return the reason if it cannot be built.

    Raise BoresightError if ``make`` raises one of the kind ``refused``, which ends the run.
    """
    try:
        with unmoved():
            return make()
    except (KeyboardInterrupt, refused):
        raise
    except NoProductError as error:
        return Unbuilt(str(error), "".join(traceback.format_exception(error)))
    except BaseException as error:  # noqa: BLE001  whatever a method raises is its own fault
        options = f"its options are {json.dumps(entry.options)}" if entry.options else "its options are the defaults"
        reason = f"{entry.label} cannot be built for {scenario}: {text_of(error)}; {options}"
        return Unbuilt(reason, "".join(traceback.format_exception(error)))


def require_built(method: T | Unbuilt) -> T:
    """Return a method that was built.

    Raise `NoProductError` if it could not be built, with the traceback as a note. Each call raises a new exception: the
    traceback of one that is raised again would grow with each trial.
    """
    if not isinstance(method, Unbuilt):
        return method
    error = NoProductError(method.reason)
    error.add_note(method.trace)
    raise error


def unbuilt_products(scenario: LoadedScenario, found: Mapping[str, object]) -> list[MissingProduct]:
    """List the methods, by their labels, that could not be built."""
    name = scenario.spec.name
    return [MissingProduct(name, label, one.reason) for label, one in found.items() if isinstance(one, Unbuilt)]


def check_options(campaign: ResolvedCampaign, scenario: LoadedScenario, entries: Sequence[EstimatorSpec]) -> None:
    """Refuse wrong options of estimators before any product is built.

    An estimator reads its options before it requests a shape, a renderer or a product. Later errors, and those that are
    no `BoresightError`, are reported when the estimator is built.
    """
    for entry in entries:
        assets = _CameraAlone(onboard_camera(scenario.spec))
        try:
            with unmoved(), located(campaign, entry.label):
                estimator_class(entry.name).from_options(entry.options, cast("Assets", assets))
        except KeyboardInterrupt:
            raise
        except BoresightError as error:
            if not (assets.requested or isinstance(error, NoProductError)):
                raise
        except BaseException:  # noqa: BLE001, S112  raised again when the estimator is built
            continue


class _CameraAlone:
    """Assets with only the camera; ``requested``: whether anything else was requested."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.requested = False

    def __getattr__(self, name: str) -> NoReturn:
        self.requested = True
        raise NoProductError("options are checked before anything is built")
