"""One set of compiled kernels for all tests, and mission data for the tests alone that are marked ``data``."""

from __future__ import annotations

import os
from collections.abc import Generator

import pytest
from mission_data import GIVEN, skip_without

from boresight.scenarios.cache import default_cache

# Each cache of its own would compile the kernels again, which takes a minute.
os.environ.setdefault("NUMBA_CACHE_DIR", str(default_cache().root / "kernels"))

# xdist's workers inherit both variables from the process that starts them.
NO_DATA = "/no-mission-data"
if os.environ.get("BORESIGHT_DATA") != NO_DATA:
    os.environ[GIVEN] = os.environ.get("BORESIGHT_DATA", "")
    os.environ["BORESIGHT_DATA"] = NO_DATA


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Show the data folder to a marked test and its fixtures, and to no other."""
    if item.get_closest_marker("data") is None:
        return (yield)
    os.environ["BORESIGHT_DATA"] = os.environ[GIVEN]
    try:
        return (yield)
    finally:
        os.environ["BORESIGHT_DATA"] = NO_DATA


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
