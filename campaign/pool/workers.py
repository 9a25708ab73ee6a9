"""Work spread over processes, its results in order; a process that ends under its work is replaced."""

from __future__ import annotations

import atexit
import math
import multiprocessing
import os
import signal
import tempfile
import threading
import time
import warnings
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

from campaign.imaging.image_store import store_is_on, store_switched
from campaign.pool.guard import guarding
from renderers.mitsuba3.variant import gpu_of_worker
from scenarios.errors import MachineError

T = TypeVar("T")
Call = tuple[object, ...]
AfterDeath = Callable[[Sequence[Call], Path], Sequence[Call]]
"""Gets the calls that a process took with it, the one under way first, and the note that it left; returns those that
are to be made instead, as many."""

MOST_CALLS = 1_000_000
_SHORT_S = 1.0
"""A process whose last call was shorter is given a second one, which begins while the results of the first are stored;
behind a long one it would wait for it, be another process idle or not."""

_AHEAD = 8
"""Results for each process that may wait for an earlier one."""

_IDLE_S = 60.0


def no_replacement(lost: Sequence[Call], note: Path) -> Sequence[Call]:
    """Give up when a process ends under its work."""
    del lost, note
    raise MachineError(
        "a worker process was killed, most likely because memory ran out: use fewer --jobs; the same command"
        " continues the run"
    )


def in_order(
    jobs: int,
    function: Callable[..., T],
    calls: Iterable[Call],
    *,
    apart: bool = False,
    renew_after: int = MOST_CALLS,
    after_death: AfterDeath = no_replacement,
) -> Iterator[T]:
    """Yield ``function(*call)`` for each call, in order, holding only what is in flight.

    Parameters
    ----------
    jobs
        Worker processes; with one the calls are made in this process.
    function
        A function of a module, so that it can be sent to a worker.
    calls
        Arguments of each call.
    apart
        Whether a single job is a process of its own too, which this one outlives.
    renew_after
        Calls after which a process makes room for a fresh one: what leaks, in whatever library, is given back.
    after_death
        Says what becomes of calls whose process has ended.

    Raises
    ------
    BoresightError
        If a worker dies and ``after_death`` gives up; what a call raises is raised as it is.
    """
    if jobs == 1 and not apart:
        return (function(*call) for call in calls)
    return _spread(jobs, function, calls, renew_after, after_death)


def _spread(
    jobs: int, function: Callable[..., T], calls: Iterable[Call], renew_after: int, after_death: AfterDeath
) -> Iterator[T]:
    workers = _idle_workers().taken(jobs)
    waiting, again = enumerate(calls), deque[tuple[int, Call]]()
    results: dict[int, object] = {}
    next_index = 0
    try:
        while True:
            for worker in workers:
                worker.renew(renew_after)
                while worker.has_room(renew_after) and (again or _started(workers, results) < _AHEAD * jobs):
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
                wait([future for worker in workers for _, future in worker.in_flight], return_when=FIRST_COMPLETED)
                for worker in workers:
                    results.update(worker.answers())
                    again.extend(_replace_lost(worker, after_death))
            elif not again:
                _idle_workers().put_back(workers)
                workers = []
                return
    finally:
        # What was under way when the consumer stopped is not stored, which is as it should be.
        for worker in workers:
            worker.close(kill=True)


def _started(workers: Sequence[_Worker], results: dict[int, object]) -> int:
    return len(results) + sum(len(worker.in_flight) for worker in workers)


def _replace_lost(worker: _Worker, after_death: AfterDeath) -> list[tuple[int, Call]]:
    """Replace a process that has ended; return the calls that it took with it as they are to be made again."""
    lost = worker.lost()
    if not lost:
        return []
    instead = after_death([call for _, call in lost], worker.note)
    worker.note.unlink(missing_ok=True)  # the next process may end before any method is at work, which is not to blame
    return [(index, call) for (index, _), call in zip(lost, instead, strict=True)]


class _Worker:
    """One worker process: started when there is work, replaced when it has ended.

    Parameters
    ----------
    place
        Its number among those that are kept, from 0, by which it gets its GPU.
    """

    def __init__(self, place: int) -> None:
        self.place = place
        descriptor, name = tempfile.mkstemp(prefix="boresight-worker-")
        os.close(descriptor)
        self.note = Path(name)
        self.in_flight: deque[tuple[tuple[int, Call], Future[tuple[float, object]]]] = deque()
        self._executor: ProcessPoolExecutor | None = None
        self._calls_made = 0
        self._last_s = math.inf

    def has_room(self, renew_after: int) -> bool:
        """Whether it can be given a call now."""
        return len(self.in_flight) < (2 if self._last_s < _SHORT_S else 1) and self._calls_made < renew_after

    def rest(self) -> None:
        """Forget how long its calls took: the next may be of another kind."""
        self._last_s = math.inf

    def renew(self, renew_after: int) -> None:
        """Let a process that has worked enough end, so that the next call starts another."""
        if self._calls_made >= renew_after and not self.in_flight:
            self._end(kill=False)

    def give(self, item: tuple[int, Call], function: Callable[..., object]) -> bool:
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
            # loky replaces a process that has grown by 300 MB since its first call, which is no news for a terminal.
            warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
            self._executor = ProcessPoolExecutor(
                max_workers=1, timeout=_IDLE_S, initializer=_end_with_parent, initargs=(os.getpid(), self.note),
                env=gpu_of_worker(self.place),
            )  # fmt: skip
        return self._executor

    def answers(self) -> Iterator[tuple[int, object]]:
        """Yield what has come back; raise what a call has raised."""
        while self.in_flight and self.in_flight[0][1].done() and not self._is_lost():
            (index, _), future = self.in_flight.popleft()
            self._last_s, answer = future.result()
            yield index, answer

    def lost(self) -> list[tuple[int, Call]]:
        """Return the calls of a process that has ended, and be ready for a new one; none while it lives."""
        if not self._is_lost():
            return []
        lost = [item for item, _ in self.in_flight]
        self.in_flight.clear()
        self._end(kill=True)
        return lost

    def _is_lost(self) -> bool:
        """Whether the process ended before it answered the first of its calls."""
        first = self.in_flight[0][1] if self.in_flight else None
        return first is not None and first.done() and isinstance(first.exception(), BrokenProcessPool)

    def close(self, kill: bool) -> None:
        """End the process, at once or when it is idle."""
        self._end(kill)
        self.note.unlink(missing_ok=True)

    def _end(self, kill: bool) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=kill)
        self._executor, self._calls_made = None, 0


class _IdleWorkers:
    """Processes without work, kept for the next: to start one and open a world in it takes as long as many trials."""

    def __init__(self) -> None:
        self._workers: list[_Worker] = []
        atexit.register(self._remove_notes)

    def taken(self, count: int) -> list[_Worker]:
        """Take so many."""
        kept, self._workers = self._workers[:count], self._workers[count:]
        places = (place for place in naturals() if place not in {worker.place for worker in kept})
        return [*kept, *(_Worker(next(places)) for _ in range(count - len(kept)))]

    def put_back(self, workers: Sequence[_Worker]) -> None:
        """Keep some for later."""
        for worker in workers:
            worker.rest()
        self._workers = sorted([*self._workers, *workers], key=lambda worker: worker.place)

    def _remove_notes(self) -> None:
        for worker in self._workers:
            worker.note.unlink(missing_ok=True)


@cache
def _idle_workers() -> _IdleWorkers:
    return _IdleWorkers()


def _timed_call(images_kept: bool, note: Path, function: Callable[..., T], call: Call) -> tuple[float, T]:
    """Make a call in a worker, which may have started before the store of images was switched; time it, in s."""
    with store_switched(images_kept), guarding(note=note):
        start = time.perf_counter()
        answer = function(*call)
        return time.perf_counter() - start, answer


def _end_with_parent(parent: int, note: Path) -> None:
    """Ignore SIGINT, and end this worker soon after its parent.

    A worker that outlives a killed run would take cores from the next start of it, and nobody else is left then to
    remove its note.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        note.unlink(missing_ok=True)
        os._exit(1)

    threading.Thread(target=watch, name="follow-parent", daemon=True).start()


@contextmanager
def _allow_child_processes() -> Iterator[None]:
    """Let a worker of Dask start a process: it may be a daemon, to which Python forbids that; ours end on their own."""
    this = multiprocessing.current_process()
    before = this.daemon
    this.daemon = False
    try:
        yield
    finally:
        this.daemon = before


@contextmanager
def _sigint_deferred() -> Iterator[None]:
    """Let SIGINT wait while a process may start, and keep it from the child, which inherits the mask.

    A terminal sends Ctrl-C to all processes of its group, but the parent ends the workers. The mask alone would not
    make it wait here: another thread, one of BLAS say, takes the signal, and Python raises in the middle of the start.
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
