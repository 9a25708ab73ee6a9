"""How measured values are printed in the cells of tables."""

from __future__ import annotations

import math

from reports.schema.grid import NO_VALUE, number
from reports.statistics.measured import Measured

_SMALL_P = 1e-3


def interval(measured: Measured, scale: float = 1.0) -> str:
    """Print a value with its 95 % interval, in units of 1 / ``scale``."""
    if measured.value is None:
        return NO_VALUE
    value = _bounded(scale * measured.value)
    if measured.low is None or measured.high is None:
        return value
    return f"{value} [{_bounded(scale * measured.low)}, {_bounded(scale * measured.high)}]"


def _bounded(value: float) -> str:
    return "∞" if math.isinf(value) else number(value)


def chance(p: float | None) -> str:
    """Print the p of a test."""
    return f"< {_SMALL_P:g}" if p is not None and p < _SMALL_P else number(p)
