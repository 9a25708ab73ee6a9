"""A method at work in a trial: what goes wrong in it is stored as a result, what goes wrong in scoring is not."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from campaign.experiments.registry import Record, Records
from campaign.guard import STOPPED, Call, StoppedError, guarded
from estimators.contract import NoProductError

T = TypeVar("T")

_MOST_CHARACTERS = 300
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")


def _to_nobody(answer: object) -> None:
    """Show an answer where there is no witness."""
    del answer


class GaveUpError(Exception):
    """What ``Work.judged`` takes for a failure with a reason, not for a fault."""


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
        """Let the method work, check what it answers, score that, and show it.

        Parameters
        ----------
        work
            Asks the method; may raise `GaveUpError`.
        check
            Raises if the answer breaks the contract, and lets nothing pass on which scoring could fail.
        score
            Returns the records of an answer, without their key.
        show
            Is shown the answer in the end, or None where there was none, also of a trial that goes wrong.

        Raises
        ------
        Exception
            What scoring raises: a fault of boresight, of which no row may be made.
        """
        answer: T | None = None
        try:
            answer = guarded(self.call, work)
        except GaveUpError as failure:
            return {"rows": [{**self.row, "status": "failed", "reason": str(failure), "n_landmarks": 0}]}
        except (Exception, SystemExit) as error:  # noqa: BLE001  the one place: a method's fault is a result
            return self._fault(_why(error), error)
        else:
            return self._scored(answer, check, score)
        finally:
            show(answer)

    def _scored(self, answer: T, check: Callable[[T], None], score: Callable[[T], Records]) -> Records:
        try:
            check(answer)
        except Exception as error:  # noqa: BLE001  rubbish may be anything
            return self._fault(f"returned rubbish: {error if type(error) is ValueError else _named(error)}", error)
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
