"""Files of missions, which are not part of the project: only tests that are marked ``data`` see them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

#: Set for the whole session by ``tests/conftest.py`` to the value that BORESIGHT_DATA had when it began.
GIVEN = "BORESIGHT_DATA_OF_TESTS"


def needs_data(*paths: str) -> pytest.MarkDecorator:
    """Mark a test that reads mission data: it sees BORESIGHT_DATA, and is skipped where a path is not below it."""
    return pytest.mark.data(*paths)


def data_path(path: str) -> Path:
    """Return a path below the data folder, whether it is there or not."""
    return Path(os.environ.get(GIVEN) or "/no-mission-data") / path


def data_file(path: str) -> Path:
    """Return a path below the data folder for a test marked with ``needs_data``; skip the test where it is absent."""
    if os.environ.get("BORESIGHT_DATA") != os.environ.get(GIVEN, ""):
        pytest.fail(f"reads {path} of the data folder: mark the test with needs_data")
    skip_without(path)
    return data_path(path)


def skip_without(*paths: str) -> None:
    """Skip the running test, naming the first of the paths that is not below the data folder."""
    if not os.environ.get(GIVEN):
        pytest.skip("needs mission data: set BORESIGHT_DATA")
    for path in paths:
        if not data_path(path).exists():
            pytest.skip(f"needs {path} under BORESIGHT_DATA")
