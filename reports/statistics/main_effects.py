"""Main effects of two-level factors on an error, trial by trial, with the failures left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from reports.statistics.intervals import LEVEL
from reports.statistics.measured import Measured
from reports.statistics.resampling import RESAMPLES, content_rng, draw_counts


def main_effects(errors: Mapping[str, pd.Series], high: Mapping[str, Sequence[bool]]) -> list[Measured]:
    """Estimate the factor by which an error changes where each axis is high.

    Least squares of ``ln e_ts = a_t + sum_k b_k x_sk`` over trials t and scenarios s, with a constant of its own for
    each trial (a view and a prior) and x = 0 or 1: without failures b_k is the difference of the means at high and at
    low, and with some the other axes still do not lean on it. The interval is a percentile bootstrap over trials.

    Parameters
    ----------
    errors
        The errors of each scenario by trial; failed trials are absent.
    high
        For each scenario whether each of K axes is high.

    Returns
    -------
    effects
        exp(b_k) of the K axes; without a value where the trials do not tell them apart.
    """
    table = pd.DataFrame({name: np.log(series.clip(lower=1e-12)) for name, series in errors.items()})
    count = len(next(iter(high.values())))
    levels = np.array([high[name] for name in table.columns], dtype=np.float64).reshape(-1, count)
    squares, products = [], []
    for logs in table.to_numpy():
        known = np.isfinite(logs)
        if known.sum() > 1:
            x, y = levels[known] - levels[known].mean(axis=0), logs[known] - logs[known].mean()
            squares.append(x.T @ x)
            products.append(x.T @ y)
    if not squares or np.linalg.matrix_rank(np.sum(squares, axis=0)) < count:
        return [Measured(None)] * count
    normal, right = np.array(squares), np.array(products)
    point = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
    counts = draw_counts(len(normal), RESAMPLES, content_rng(normal, right))
    drawn = np.array([_solution(c, normal, right) for c in counts])
    tail = 50.0 * (1.0 - LEVEL)
    low, top = np.nanpercentile(drawn, [tail, 100.0 - tail], axis=0)
    return [Measured(*map(float, np.exp(values))) for values in zip(point, low, top, strict=True)]


def _solution(counts: np.ndarray, normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a resample in which trial t occurs ``counts[t]`` times; NaN where it does not tell the axes apart."""
    try:
        return np.asarray(np.linalg.solve(np.tensordot(counts, normal, 1), counts @ right))
    except np.linalg.LinAlgError:
        return np.full(right.shape[1], np.nan)
