"""Work spread over processes, its results in order."""

from __future__ import annotations

import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from joblib import Parallel, delayed

from campaign.image_store import store_is_on, store_switched
from scenarios.errors import BoresightError

T = TypeVar("T")


def in_order(jobs: int, function: Callable[..., T], calls: Iterable[tuple[object, ...]]) -> Iterator[T]:
    """Yield ``function(*call)`` for each call, in order, holding only what is in flight.

    Parameters
    ----------
    jobs
        Worker processes; with one the calls are made in this process.
    function
        A function of a module, so that it can be sent to a worker.
    calls
        Arguments of each call.

    Raises
    ------
    BoresightError
        If a worker dies; what a call raises is raised as it is.
    """
    parallel = Parallel(n_jobs=jobs, return_as="generator", pre_dispatch="2*n_jobs", batch_size=1)
    with _workers_deaf_to_interrupts():
        results = parallel(delayed(_with_switch)(store_is_on(), function, *call) for call in calls)
    try:
        # Not `yield from`, which would close the results before the warning below is silenced.
        for result in results:  # noqa: UP028
            yield result
    except BrokenProcessPool as error:
        raise BoresightError(
            "a worker process was killed, most likely because memory ran out: use fewer --jobs; the same command"
            " continues the run"
        ) from error
    finally:
        # What was under way when the consumer stopped is not stored, which is as it should be.
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            results.close()


def _with_switch(images_kept: bool, function: Callable[..., T], *call: object) -> T:
    """Call in a worker, which may have started before the store of images was switched."""
    with store_switched(images_kept):
        return function(*call)


@contextmanager
def _workers_deaf_to_interrupts() -> Iterator[None]:
    """Let processes that start here inherit a deaf ear: a terminal sends Ctrl-C to all, but the parent ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
