"""One set of compiled kernels for all tests, mission data for tests marked ``data``, and what each test costs."""

from __future__ import annotations

import gc
import json
import os
import resource
import time
from collections.abc import Generator, Iterator
from pathlib import Path

import cv2  # noqa: F401  has a BLAS of its own
import pytest
import scipy.linalg  # noqa: F401  has another than numpy
from mission_data import GIVEN, skip_without
from threadpoolctl import threadpool_limits
from yardstick import yardstick_s

from boresight.scenarios.cache import default_cache

gc.disable()  # importing makes hardly any garbage: what is imported is left out of every collection from then on

# Each cache of its own would compile the kernels again, which takes a minute.
os.environ.setdefault("NUMBA_CACHE_DIR", str(default_cache().root / "kernels"))

# As in the workers of a run: OpenBLAS's threads spin while they wait. Commands that tests start set their own limits.
threadpool_limits(limits=1, user_api="blas")

# xdist's workers inherit both variables from the process that starts them.
NO_DATA = "/no-mission-data"
if os.environ.get("BORESIGHT_DATA") != NO_DATA:
    os.environ[GIVEN] = os.environ.get("BORESIGHT_DATA", "")
    os.environ["BORESIGHT_DATA"] = NO_DATA

# Threads of two processes on two cores mostly wait for each other: each worker of xdist keeps to a core of its own.
if (worker := os.environ.get("PYTEST_XDIST_WORKER")) and hasattr(os, "sched_setaffinity"):
    theirs = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {theirs[int(worker.removeprefix("gw")) % len(theirs)]})

TIMES = os.environ.get("BORESIGHT_TEST_TIMES", "")
"""Folder for the processor times of the tests, one file for each process (see ``tests/folder_times.py``)."""


ORDER = (
    *("estimators/test_slam_sequences.py", "scenarios/test_craters.py", "estimators/test_crater_classic.py"),
    *("reports", "renderers", "scenarios", "estimators", "campaign"),
)
"""Files that compile most kernels, then folders that need few, then those whose tests need all."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the tests so that one worker of xdist seldom needs a kernel while the other compiles it."""
    places = [f"tests/{name}" for name in ORDER]
    items.sort(key=lambda item: next((k for k, place in enumerate(places) if item.nodeid.startswith(place)), -1))


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Keep bodies, images and data bases away from the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("BORESIGHT_CACHE", str(folder))
        yield folder


def processor_s() -> float:
    """Return the processor time of this process and of its children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def note(what: str, seconds: float) -> None:
    """Write down a processor time of this process, if times are wanted."""
    if TIMES:
        with (Path(TIMES) / f"{os.getpid()}.jsonl").open("a") as stream:
            stream.write(json.dumps([what, seconds]) + "\n")


def pytest_collection_finish() -> None:
    """Note what importing and collecting took, and the yardstick a first time; tests of tests note nothing.

    Collecting garbage again and again over all that is imported takes a third of the time of the tests: what is
    imported by now is left out, and garbage is collected once a file.
    """
    gc.collect()
    gc.freeze()
    if TIMES:
        del os.environ["BORESIGHT_TEST_TIMES"]
        note("collecting", processor_s())
        note("yardstick", yardstick_s())


def pytest_sessionfinish() -> None:
    """Note the yardstick a second time, in processes that ran tests."""
    if TIMES and "BORESIGHT_TEST_TIMES" not in os.environ:
        note("yardstick", yardstick_s())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """Show the data folder to a marked test and its fixtures, and to no other; add up what the test costs."""
    before = processor_s()
    if item.get_closest_marker("data") is not None:
        os.environ["BORESIGHT_DATA"] = os.environ[GIVEN]
    try:
        return (yield)
    finally:
        os.environ["BORESIGHT_DATA"] = NO_DATA
        if nextitem is None or nextitem.path != item.path:
            gc.collect()
        note(item.nodeid, processor_s() - before)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a marked test by name where what it needs is absent."""
    for marker in item.iter_markers("data"):
        skip_without(*marker.args)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Fail a test that skips itself for lack of data without the marker: no run with data would ever include it."""
    report = yield
    if report.skipped and "BORESIGHT_DATA" in str(report.longrepr) and item.get_closest_marker("data") is None:
        report.outcome, report.longrepr = "failed", f"{item.nodeid} skips without data: mark it with needs_data"
    return report
