"""Run a method in a trial: its faults are stored as results, faults of scoring are raised."""

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
        except GaveUpError as failure:
            row: Record = {**self.row, "status": "failed", "reason": str(failure), "n_landmarks": 0}
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
