"""What a reader may do with any input: return or raise BoresightError in printable lines, soon, in little memory."""

from __future__ import annotations

import faulthandler
import re
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from boresight.scenarios.errors import BoresightError
from hostile.target import Target

LIMIT_S = 5.0
LONGEST_WAIT_S = 60.0
LIMIT_BYTES = 1 << 30


class TooSlowError(BaseException):
    """A reader took longer than it may. It derives from BaseException so that no reader catches it."""


class TooMuchError(BaseException):
    """A reader took more memory than it may."""


def fed(target: Target, content: bytes, folder: Path) -> BoresightError | None:
    """Let a reader read; return what it complained about.

    Raises
    ------
    TooSlowError, TooMuchError
        It took more than 5 s of this process, or more than 1 GiB.
    AssertionError
        Its complaint is not lines of printable text.
    """
    complaint = None
    with _limited():
        try:
            target.read(content, folder)
        except BoresightError as error:
            complaint = error
    if complaint is not None:
        lines = str(complaint).split("\n")
        assert all(line.strip() and line.isprintable() for line in lines), ascii(str(complaint))
    return complaint


@contextmanager
def _limited() -> Iterator[None]:
    """Hold what is within to the limits: time of this process, as the machine may be busy, and resident memory.

    Who waits for ever takes no time: the process ends, and says where it was, after a minute by the clock.
    """
    _forget_peak()
    allowed = max(_peak_bytes(), _resident_bytes() + LIMIT_BYTES)
    before = signal.signal(signal.SIGPROF, _late)
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    faulthandler.dump_traceback_later(LONGEST_WAIT_S, exit=True)
    started = time.process_time()
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    if time.process_time() - started > LIMIT_S:  # in compiled code, which no signal interrupts
        raise TooSlowError(f"{time.process_time() - started:.1f} s")
    if _peak_bytes() > allowed:
        raise TooMuchError(f"{_peak_bytes() - allowed + LIMIT_BYTES} bytes")


def _late(_signal: int, _frame: FrameType | None) -> None:
    raise TooSlowError(f"more than {LIMIT_S:g} s")


def _forget_peak() -> None:
    """Begin the peak of resident memory anew, which else is that of all that the process ever did."""
    Path("/proc/self/clear_refs").write_text("5")


def _peak_bytes() -> int:
    return 1024 * int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1])


def _resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()
