"""The band in which most trials lie, over time."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.statistics.intervals import is_told

SHARES = (0.05, 0.95)


def percentile_band(values: pd.Series, over: pd.Series) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ends of the band of 5 to 95 % of ``values`` at each of ``over``; of all where there are too few."""
    groups = values.groupby(over)
    told = groups.count().map(lambda n: is_told(n, SHARES[0])).to_numpy()
    low, high = (groups.quantile(share).to_numpy() for share in SHARES)
    return np.where(told, low, groups.min()), np.where(told, high, groups.max())


def band_label(trials: int) -> str:
    """Say of which trials the band is."""
    return "the band of 5 to 95 % of them" if is_told(trials, SHARES[0]) else "the band of all of them"
