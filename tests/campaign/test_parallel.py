"""Calls are spread over processes so that none waits for one process while another has nothing to do."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from boresight.campaign.pool import workers as parallel

LONG_S = 0.3


def begin(folder: Path, number: int) -> bool:
    """Leave a sign; the second call ends when the last has begun, and tells whether it has."""
    (folder / str(number)).touch()
    if number != 1:
        time.sleep(LONG_S)
        return True
    until = time.monotonic() + 20.0
    while not (folder / "4").exists() and time.monotonic() < until:
        time.sleep(0.01)
    return (folder / "4").exists()


def test_no_call_is_laid_behind_a_long_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "_SHORT_S", 0.1 * LONG_S)
    assert all(parallel.in_order(2, begin, [(tmp_path, number) for number in range(5)]))


def test_an_interrupt_that_comes_while_a_call_is_given_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(parallel.ProcessPoolExecutor):
        def submit(self, *call):  # type: ignore[no-untyped-def]
            os.kill(os.getpid(), signal.SIGINT)
            return super().submit(*call)

    monkeypatch.setattr(parallel, "ProcessPoolExecutor", Interrupted)
    monkeypatch.setattr(parallel, "_idle_workers", parallel._IdleWorkers)  # no process of another test's
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # pytest-xdist ignores it in its workers
    try:
        with pytest.raises(KeyboardInterrupt):
            list(parallel.in_order(2, abs, [(number,) for number in range(4)]))
    finally:
        signal.signal(signal.SIGINT, before)
