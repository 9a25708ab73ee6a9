"""A method at work in a trial: what goes wrong in it is stored as a result, what goes wrong in scoring is not."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from boresight.campaign.pool.captured import CapturedOutput
from boresight.campaign.pool.guard import STOPPED, Call, StoppedError, guarded, unmoved
from boresight.campaign.trial.kind import Record, Records
from boresight.estimators.contract import NoProductError
from boresight.scenarios.errors import printable

T = TypeVar("T")

_MOST_CHARACTERS = 300
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")


def _to_nobody(answer: object) -> None:
    """Show an answer where there is no witness."""
    del answer


class GaveUpError(Exception):
    """What ``Work.judged`` takes for a failure with a reason, not for a fault."""


class _RubbishError(Exception):
    """An answer breaks the contract; its cause is what the check raised."""


@dataclass(frozen=True, slots=True)
class Work:
    """What a method is to do in a trial.

    Parameters
    ----------
    call
        Which trial and whose.
    method
        What it is called: an estimator, a detector.
    row
        What the trial's row says whatever becomes of it.
    """

    call: Call
    method: str
    row: Record

    def judged(
        self,
        work: Callable[[], T],
        check: Callable[[T], None],
        score: Callable[[T], Records],
        show: Callable[[T | None], None] = _to_nobody,
    ) -> Records:
        """Let the method work, check what it answers, score that, and show it; what it says is a table ``said``.

        Parameters
        ----------
        work
            Asks the method; may raise `GaveUpError`.
        check
            Raises if the answer breaks the contract, and lets nothing pass on which scoring could fail.
        score
            Returns the records of an answer, without their key.
        show
            Is shown the answer in the end, also of a trial that goes wrong; None where there was none, or one that
            breaks the contract.

        Raises
        ------
        Exception
            What scoring raises: a fault of boresight, of which no row may be made.
        """
        sound: T | None = None
        captured = CapturedOutput()
        try:
            with unmoved(), captured.capturing():
                sound = self._sound(work, check)
        except GaveUpError as failure:
            row: Record = {**self.row, "status": "failed", "reason": str(failure), "n_landmarks": 0}
            found: Records = {"rows": [row]}
        except _RubbishError as rubbish:
            found = self._fault(str(rubbish), rubbish.__cause__ or rubbish)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001  the one place: a method's fault is a result
            found = self._fault(_why(error), error)
        else:
            found = self._scored(sound, score)
        finally:
            show(sound)
        for row in found["rows"]:
            row["reason"] = printable(str(row["reason"]))
        return found | captured.records()

    def _sound(self, work: Callable[[], T], check: Callable[[T], None]) -> T:
        """Return an answer that keeps the contract; nobody else sees one that does not."""
        answer = guarded(self.call, work)
        try:
            check(answer)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise _RubbishError(f"returned rubbish: {error if type(error) is ValueError else _named(error)}") from error
        return answer

    def _scored(self, answer: T, score: Callable[[T], Records]) -> Records:
        try:
            return score(answer)
        except Exception as error:
            error.add_note(f"while scoring {self.call}: this is a fault of boresight, and nothing is stored of it")
            raise

    def _fault(self, what: str, error: BaseException) -> Records:
        """Complete the row of a trial in which the method did something wrong, and keep the trace."""
        # Addresses are others in every process, and rows are to be the same.
        said = _ADDRESS.sub("0x...", " ".join(f"the {self.method} {what}".split()))
        row: Record = {**self.row, "status": "error", "reason": said[:_MOST_CHARACTERS], "n_landmarks": 0}
        return {"rows": [row], "tracebacks": [{"traceback": "".join(traceback.format_exception(error))}]}


def _why(error: BaseException) -> str:
    if isinstance(error, StoppedError):
        return f"{STOPPED}{error}"
    if isinstance(error, NoProductError):
        return f"cannot work: {error}"
    return f"raised {_named(error)}"


def _named(error: BaseException) -> str:
    return traceback.format_exception_only(error)[0]
