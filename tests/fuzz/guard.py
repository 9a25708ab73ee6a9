"""What a reader may do with any input: return or raise BoresightError in printable lines, soon, in little memory."""

from __future__ import annotations

import faulthandler
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from boresight.scenarios.errors import BoresightError

LIMIT_S, LIMIT_BYTES = 5.0, 1 << 30
LONGEST_WAIT_S = 60.0


class TooSlowError(BaseException):
    """A reader took longer than it may. It derives from BaseException so that no reader catches it."""


class TooMuchError(BaseException):
    """A reader took more memory than it may."""


def fed(read: Callable[[bytes, Path], object], content: bytes, folder: Path) -> BoresightError | None:
    """Let a reader read; return what it complained about.

    Its time is that of this process, as the machine may be busy. A reader that waits forever takes no time: the process
    ends, and says where it was, after a minute by the clock.

    Raises
    ------
    TooSlowError, TooMuchError
        It took more than 5 s of this process, or more than 1 GiB.
    AssertionError
        Its complaint is not lines of printable text.
    """
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory begins anew
    allowed = max(_kib("VmHWM"), _kib("VmRSS") + (LIMIT_BYTES >> 10))
    before, complaint = signal.signal(signal.SIGPROF, _late), None
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    faulthandler.dump_traceback_later(LONGEST_WAIT_S, exit=True)
    started = time.process_time()
    try:
        read(content, folder)
    except BoresightError as error:
        complaint = error
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    if time.process_time() - started > LIMIT_S:  # in compiled code, which no signal interrupts
        raise TooSlowError(f"{time.process_time() - started:.1f} s")
    if (peak := _kib("VmHWM")) > allowed:
        raise TooMuchError(f"{peak - allowed} KiB beyond the limit")
    if complaint is not None:
        lines = str(complaint).split("\n")
        assert all(line.strip() and line.isprintable() for line in lines), ascii(str(complaint))
    return complaint


def _late(_signal: int, _frame: FrameType | None) -> None:
    raise TooSlowError(f"more than {LIMIT_S:g} s")


def _kib(what: str) -> int:
    """Return resident memory of this process in KiB: VmHWM is its peak, VmRSS what it has now."""
    return int(re.search(rf"{what}:\s+(\d+)", Path("/proc/self/status").read_text())[1])
