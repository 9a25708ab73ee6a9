"""Calls distributed over worker processes, with results in order; a worker that ends during a call is replaced."""

from __future__ import annotations

import math
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
import warnings
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from itertools import count as naturals
from pathlib import Path
from typing import TypeVar, cast

from joblib.externals.loky import ProcessPoolExecutor

from boresight.campaign.imaging.image_store import store_is_on, store_switched
from boresight.campaign.pool.guard import guarding
from boresight.campaign.pool.steps import progress_listener, read_step, written_to
from boresight.renderers.mitsuba3.variant import gpu_of_worker
from boresight.scenarios.errors import MachineError

T = TypeVar("T")
Arguments = tuple[object, ...]
AfterDeath = Callable[[Sequence[Arguments], Path], Sequence[Arguments]]
"""Called with what a process did not finish, the current call first, and its note file; returns as many calls to make
instead."""

MOST_CALLS = 1_000_000
_SHORT_S = 1.0
"""A worker whose last call was shorter than this gets a second call in advance, which starts while the results of the
first are stored. After a long call it would wait although another worker may be idle."""

_AHEAD = 8
"""Results per worker that may wait for the result of an earlier call."""

_IDLE_S = 60.0
_STEPS = "steps"
_LOOK_S = 1.0


def no_replacement(lost: Sequence[Arguments], note: Path) -> Sequence[Arguments]:
    """Raise an error when a worker process ends during a call."""
    del lost, note
    raise MachineError(
        "a worker process was killed, most likely because memory ran out: use fewer --jobs; the same command"
        " continues the run"
    )


def in_order(
    jobs: int,
    function: Callable[..., T],
    calls: Iterable[Arguments],
    *,
    apart: bool = False,
    renew_after: int = MOST_CALLS,
    after_death: AfterDeath = no_replacement,
) -> Iterator[T]:
    """Yield ``function(*call)`` for each call, in order, keeping only results that wait for an earlier one.

    The function is one of a module, so that it can be pickled. With one job, the calls are made in this process or, if
    ``apart``, in a worker process too, so that this process survives a crash. A worker process is replaced after
    ``renew_after`` calls, which releases memory leaked by libraries. ``after_death`` decides which calls replace those
    whose process has ended, and may raise BoresightError. Exceptions of a call are re-raised unchanged.
    """
    if jobs == 1 and not apart:
        return (function(*call) for call in calls)
    return _spread(jobs, function, calls, renew_after, after_death)


def _spread(
    jobs: int, function: Callable[..., T], calls: Iterable[Arguments], renew_after: int, after_death: AfterDeath
) -> Iterator[T]:
    workers = _idle_workers().taken(jobs)
    waiting, again = enumerate(calls), deque[tuple[int, Arguments]]()
    results: dict[int, object] = {}
    next_index = 0
    try:
        while True:
            for worker in workers:
                worker.renew(renew_after)
                while worker.has_room(renew_after) and (
                    again or len(results) + sum(len(one.in_flight) for one in workers) < _AHEAD * jobs
                ):
                    item = again.popleft() if again else next(waiting, None)
                    if item is None:
                        break
                    if not worker.give(item, function):
                        again.appendleft(item)
                        break
            if next_index in results:
                yield cast("T", results.pop(next_index))
                next_index += 1
            elif any(worker.in_flight for worker in workers):
                _wait_for_one(workers)
                for worker in workers:
                    results.update(worker.answers())
                    again.extend(worker.calls_to_repeat(after_death))
            elif not again:
                _idle_workers().put_back(workers)
                workers = []
                return
    finally:
        # Results of calls in flight when the consumer stops are discarded: it stores whole blocks only.
        for worker in workers:
            worker.close(kill=True)


def _wait_for_one(workers: Sequence[_Worker]) -> None:
    """Wait until a call has ended, passing the progress of the workers to the listener."""
    futures, listener = [future for worker in workers for _, future in worker.in_flight], progress_listener()
    if listener is None:
        wait(futures, return_when=FIRST_COMPLETED)
        return
    while not wait(futures, _LOOK_S, FIRST_COMPLETED).done:
        for worker in workers:
            step = read_step(worker.steps)
            if step is not None:
                listener(worker.index, step)


class _Worker:
    """One worker process: started with its first call, replaced when it has ended. Its index from 0 selects its GPU."""

    def __init__(self, index: int) -> None:
        self.index = index
        folder = Path(tempfile.mkdtemp(prefix="boresight-worker-"))
        self._remove_folder = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.note, self.steps = folder / "call", folder / _STEPS
        self.in_flight: deque[tuple[tuple[int, Arguments], Future[tuple[float, object]]]] = deque()
        self._executor: ProcessPoolExecutor | None = None
        self._calls_made = 0
        self.last_s = math.inf

    def has_room(self, renew_after: int) -> bool:
        """Return whether it can accept a call now."""
        return len(self.in_flight) < (2 if self.last_s < _SHORT_S else 1) and self._calls_made < renew_after

    def renew(self, renew_after: int) -> None:
        """End a process that has made ``renew_after`` calls, so that the next call starts another."""
        if self._calls_made >= renew_after and not self.in_flight:
            self._end(kill=False)

    def give(self, item: tuple[int, Arguments], function: Callable[..., object]) -> bool:
        """Submit a call; return False if the process has just ended with other calls in flight."""
        call = (_timed_call, store_is_on(), self.note, function, item[1])
        with _allow_child_processes(), _sigint_deferred():
            try:
                future = self._started().submit(*call)
            except BrokenProcessPool:
                if self.in_flight:
                    return False
                self._end(kill=True)
                future = self._started().submit(*call)
        self._calls_made += 1
        self.in_flight.append((item, future))
        return True

    def _started(self) -> ProcessPoolExecutor:
        if self._executor is None:
            # loky replaces a process that has grown by 300 MB since its first call, and warns of it.
            warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
            self._executor = ProcessPoolExecutor(
                max_workers=1, timeout=_IDLE_S, initializer=_end_with_parent, initargs=(os.getpid(), self.note.parent),
                env=gpu_of_worker(self.index),
            )  # fmt: skip
        return self._executor

    def answers(self) -> Iterator[tuple[int, object]]:
        """Yield the available results in order; re-raise the exception of a call."""
        while self.in_flight and self.in_flight[0][1].done() and not self._is_lost():
            (index, _), future = self.in_flight.popleft()
            self.last_s, answer = future.result()
            yield index, answer

    def calls_to_repeat(self, after_death: AfterDeath) -> list[tuple[int, Arguments]]:
        """Return the calls to make again if the process has ended; none while it is alive."""
        if not self._is_lost():
            return []
        lost = [item for item, _ in self.in_flight]
        self.in_flight.clear()
        self._end(kill=True)
        instead = after_death([call for _, call in lost], self.note)
        # Or a later end of the process outside a method would be attributed to this call.
        self.note.unlink(missing_ok=True)
        return [(index, call) for (index, _), call in zip(lost, instead, strict=True)]

    def _is_lost(self) -> bool:
        """Return whether the process ended before it returned the first of its calls."""
        first = self.in_flight[0][1] if self.in_flight else None
        return first is not None and first.done() and isinstance(first.exception(), BrokenProcessPool)

    def close(self, kill: bool) -> None:
        """End the process, at once or when it is idle."""
        self._end(kill)
        self._remove_folder()

    def _end(self, kill: bool) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=kill)
        self._executor, self._calls_made = None, 0
        self.steps.unlink(missing_ok=True)  # of a process that was killed


class _IdleWorkers:
    """Idle worker processes, kept because starting one and opening a world in it takes as long as many trials."""

    def __init__(self) -> None:
        self._workers: list[_Worker] = []

    def taken(self, count: int) -> list[_Worker]:
        """Take ``count`` workers, new ones where too few are idle."""
        kept, self._workers = self._workers[:count], self._workers[count:]
        indices = (index for index in naturals() if index not in {worker.index for worker in kept})
        return [*kept, *(_Worker(next(indices)) for _ in range(count - len(kept)))]

    def put_back(self, workers: Sequence[_Worker]) -> None:
        """Return workers that are idle again."""
        for worker in workers:
            worker.last_s = math.inf  # the next call may be of another kind
        self._workers = sorted([*self._workers, *workers], key=lambda worker: worker.index)


@cache
def _idle_workers() -> _IdleWorkers:
    return _IdleWorkers()


def _timed_call(images_kept: bool, note: Path, function: Callable[..., T], call: Arguments) -> tuple[float, T]:
    """Make a call in a worker, with the parent's switch of the image store; return its duration, s, and result."""
    with store_switched(images_kept), guarding(note=note), written_to(note.with_name(_STEPS)):
        start = time.perf_counter()
        answer = function(*call)
        return time.perf_counter() - start, answer


def _end_with_parent(parent: int, folder: Path) -> None:
    """Initialise a worker process: ignore SIGINT, and exit within a second of the parent's end.

    A worker that survived a killed run would take cores from the next one. It removes its folder, as the parent no
    longer can.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=watch, name="follow-parent", daemon=True).start()


@contextmanager
def _allow_child_processes() -> Iterator[None]:
    """Allow a Dask worker, which may be a daemon process, to start child processes; ours exit with their parent."""
    this = multiprocessing.current_process()
    before = this.daemon
    this.daemon = False
    try:
        yield
    finally:
        this.daemon = before


@contextmanager
def _sigint_deferred() -> Iterator[None]:
    """Defer SIGINT while a process may start; the child inherits the mask and does not receive it.

    A terminal sends Ctrl-C to all processes of its group, but only the parent may end the workers. The mask alone does
    not defer it here: another thread, for example of BLAS, receives the signal, and Python raises during the start.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
        if came:
            signal.raise_signal(signal.SIGINT)
