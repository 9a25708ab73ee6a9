"""Skip tests of the program that is built with Ceres."""

from __future__ import annotations

import pytest
from benchmarks import ceres

from boresight.scenarios.errors import BoresightError


def skip_without_ceres() -> None:
    """Skip the test if there is no compiler or no Ceres; a program that cannot be built fails it."""
    try:
        ceres.version()
    except BoresightError as error:
        pytest.skip(str(error))
