"""The band in which most trials lie, over time."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.statistics.intervals import has_quantile

SHARES = (0.05, 0.95)


def band(values: pd.Series, over: pd.Series) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ends of the band of 5 to 95 % of ``values`` at each of ``over``; of all where there are too few."""
    groups = values.groupby(over)
    told = groups.count().map(lambda n: has_quantile(n, SHARES[0])).to_numpy()
    low, high = (groups.quantile(share).to_numpy() for share in SHARES)
    return np.where(told, low, groups.min()), np.where(told, high, groups.max())


def band_of(trials: int) -> str:
    """Say of which trials the band is."""
    return "the band of 5 to 95 % of them" if has_quantile(trials, SHARES[0]) else "the band of all of them"
