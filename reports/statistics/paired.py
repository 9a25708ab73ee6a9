"""Comparisons over common trials: differences of estimators, sign test, failure rates, and main effects of factors.

The first estimator that a campaign names, after the control, is what the others are compared with. Differences are
those of trials that both solved. The null hypothesis of the sign test is that either of a pair is better with
equal chance; the noise realisations of one real image count as one, by the sign of their median.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.clusters import clusters_of, units_of
from boresight.reports.run.data import RunData
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.grid import ESTIMATOR, SCENARIO, Grid, counts, record_column, record_grid, text_column
from boresight.reports.schema.records import CONTROL, Record
from boresight.reports.statistics.intervals import LEVEL, content_rng, draw_counts, wilson
from boresight.reports.statistics.measured import MEDIAN, Measured, Sample, share_of, widened

PAIRED = "paired"
"""Stage of the records that compare an estimator with another, which their ``reference`` names."""

DIFFERENCES = {"position_difference_m": "position_error_m", "attitude_difference_deg": "attitude_error_deg"}
FAILURE_RATE = "failure_rate"
BETTER, SIGN_TEST = "share better", "sign test p"
OWN, THEIRS, DIFFERENCE = "rate", "rate of the other", "difference"
_NORMAL_95 = 1.959964
_LEAST_SIGNS = 6
"""With fewer, even equal signs have p above 5 %: 2 / 2^5 is 6 %."""


def main_effects(errors: Mapping[str, pd.Series], high: Mapping[str, Sequence[bool]]) -> list[Measured]:
    """Estimate the factor by which an error changes where each axis is high.

    Least squares of ``ln e_ts = a_t + sum_k b_k x_sk`` over trials t and scenarios s, with a constant of its own for
    each trial (a view and a prior) and x = 0 or 1: without failures b_k is the difference of the means at high and at
    low, and with some the effects of the other axes stay unbiased. The interval is a percentile bootstrap over trials.

    ``errors`` are those of each scenario by trial, failed trials being absent; ``high`` says for each scenario whether
    each of K axes is high. Return exp(b_k) of the K axes, without a value where the trials do not separate them.
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
    blocks = draw_counts(len(normal), content_rng(normal, right))
    drawn = np.array([_solution(counts, normal, right) for block in blocks for counts in block])
    tail = 50.0 * (1.0 - LEVEL)
    low, top = np.nanpercentile(drawn, [tail, 100.0 - tail], axis=0)
    return [Measured(*map(float, np.exp(values))) for values in zip(point, low, top, strict=True)]


def _solution(counts: np.ndarray, normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a resample in which trial t occurs ``counts[t]`` times; NaN where it does not separate the axes."""
    try:
        return np.asarray(np.linalg.solve(np.tensordot(counts, normal, 1), counts @ right))
    except np.linalg.LinAlgError:
        return np.full(right.shape[1], np.nan)


def paired_records(run: RunData) -> list[Record]:
    """Compare every estimator with the first one of its scenario; nothing where there is only one."""
    records: list[Record] = []
    labels: dict[str, list[str]] = {}
    for scenario, name in run.posed_pairs():
        labels.setdefault(scenario, []).extend([name] if name != CONTROL else [])
    for scenario, found in labels.items():
        first, *others = sorted(found, key=run.place_of) or [""]
        of_first = run.of(scenario, first).set_index("trial", drop=False)
        for name in others:
            rows = run.of(scenario, name).set_index("trial", drop=False)
            base = of_first
            if not rows.index.equals(base.index):
                trials = rows.index.intersection(base.index)
                rows, base = rows.loc[trials], base.loc[trials]
            sample = Sample(scenario, name, PAIRED, len(rows), first)
            records += _pair_records(run, sample, rows, base)
    return records


def _pair_records(run: RunData, sample: Sample, rows: pd.DataFrame, base: pd.DataFrame) -> Iterator[Record]:
    """Compare the rows of two estimators, trial for trial.

    Of the errors: the median of the differences (negative is better), the share of negative ones and the test's p; of
    the failures: both rates, and their difference.
    """
    both = ((rows["status"] == "ok") & (base["status"] == "ok")).to_numpy()
    clusters = clusters_of(run, rows[["scenario", "trial"]])
    for name, error in DIFFERENCES.items():
        difference = (rows[error].to_numpy() - base[error].to_numpy())[both]
        yield from sample.records(name, difference, clusters[both], (MEDIAN,))
        share, chance, decided = sign_test(difference, clusters[both])
        yield sample.record(name, BETTER, share, decided)
        yield sample.record(name, SIGN_TEST, chance, decided)
    mine, theirs = ~succeeded(rows), ~succeeded(base)
    if len(mine):
        yield sample.record(FAILURE_RATE, OWN, share_of(mine, clusters))
        yield sample.record(FAILURE_RATE, THEIRS, share_of(theirs, clusters))
        yield sample.record(FAILURE_RATE, DIFFERENCE, rate_difference(mine, theirs, clusters))


def sign_test(difference: NDArray[np.float64], clusters: NDArray[np.generic]) -> tuple[Measured, Measured, int]:
    """Test whether differences (n,) are as often above zero as below; a cluster counts once, by its median.

    The signs of two to five clusters can never be significant: where clusters have several trials, their shares are
    tested against one half by Student's t instead, see `_share_test`.

    Return the share of clusters with a negative median, with Wilson's interval; p of the exact two-sided test; and the
    number of clusters that are not zero.
    """
    if 1 < len(np.unique(clusters)) < min(_LEAST_SIGNS, len(difference)):
        return _share_test(difference, clusters)
    signs: NDArray[np.floating] = difference  # of clusters of one trial each
    if len(np.unique(clusters)) < len(difference):
        signs = pd.Series(difference).groupby(np.asarray(clusters)).median().to_numpy()
    better, decided = int((signs < 0.0).sum()), int((signs != 0.0).sum())
    if not decided:
        return Measured(None), Measured(None), 0
    chance = _sign_chance(better, decided)
    return Measured(better / decided, *wilson(better, decided)), Measured(chance), decided


@lru_cache(maxsize=1024)
def _sign_chance(better: int, decided: int) -> float:
    """Return p of the exact two-sided sign test."""
    # Imported here, as it takes 1 s, and runs of one method need none of it.
    from scipy.stats import binomtest

    return float(binomtest(better, decided).pvalue)


def _share_test(difference: NDArray[np.float64], clusters: NDArray[np.generic]) -> tuple[Measured, Measured, int]:
    """Test the shares of negative differences in few clusters against one half, leaving out zeros.

    R. Ibragimov and U. Mueller, t-statistic based correlation and heterogeneity robust inference, Journal of Business &
    Economic Statistics 28, 2010: Student's t over the clusters holds its level of 5 % however their variances differ.
    Its p is at least that of the sign test of as many independent trials, and of those of `units_of` where all agree:
    few clusters may be alike by chance.
    """
    decided = difference != 0.0
    if not decided.any():
        return Measured(None), Measured(None), 0
    better, own = difference[decided] < 0.0, clusters[decided]
    alike = len(np.unique(better)) == 1
    n = units_of(own) if alike else len(better)
    chance = _sign_chance(n * int(better[0]) if alike else int(better.sum()), n)
    shares = pd.Series(better.astype(float)).groupby(own).mean().to_numpy()
    if len(shares) > 1 and shares.std() > 0.0:
        from scipy.stats import ttest_1samp

        chance = max(chance, float(ttest_1samp(shares, 0.5).pvalue))
    return share_of(better, own), Measured(chance), len(better)


def rate_difference(
    mine: NDArray[np.bool_], theirs: NDArray[np.bool_], clusters: NDArray[np.generic] | None = None
) -> Measured:
    """Difference of two rates over the same trials, negative where the first is smaller.

    With b and c trials of n that one and the other alone have marked, the variance of the difference is
    (b + c - (b - c)^2 / n) / n^2 (McNemar), here with half a trial more in each of the four cells, which keeps the
    level
    where b and c are few (A. Agresti and Y. Min, Statistics in Medicine 24, 2005). Where trials form clusters the
    interval is that of these if it is wider.
    """
    n, alone, other = len(mine), int((mine & ~theirs).sum()), int((~mine & theirs).sum())
    if clusters is not None and n in (alone, other, n - alone - other):  # all trials agree
        units = units_of(clusters)
        n, alone, other = units, units * (alone == n), units * (other == n)
    more = n + 2.0
    centre = (alone - other) / more
    half = float(_NORMAL_95 * np.sqrt(alone + other + 1.0 - (alone - other) ** 2 / more) / more)
    found = Measured((alone - other) / n, max(centre - half, -1.0), min(centre + half, 1.0))
    return widened(found, mine.astype(np.float64) - theirs.astype(np.float64), clusters, (-1.0, 1.0))


_NOTE = (
    "On the same images and priors: median of the differences of the errors, trial by trial (negative is better),"
    " share of trials in which it is better, and p of the sign test. Failures: no estimate, or a position error"
    " above the prior's."
)
_COLUMNS = (
    SCENARIO,
    ESTIMATOR,
    text_column("against", lambda key: key.reference),
    record_column("both ok", printed=counts),
    *(
        column
        for name, head in zip(DIFFERENCES, ("position m [95 %]", "attitude deg [95 %]"), strict=True)
        for column in (
            record_column(head, name, MEDIAN.name, interval=True),
            record_column("better", name, BETTER),
            record_column("p", name, SIGN_TEST),
        )
    ),
    record_column("failures", FAILURE_RATE, OWN),
    record_column("of the other", FAILURE_RATE, THEIRS),
    record_column("difference [95 %]", FAILURE_RATE, DIFFERENCE, interval=True),
)


def paired_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate estimators against the first one on the same trials; None where there is only one."""
    key = (PAIRED, next(iter(DIFFERENCES)), MEDIAN.name)
    lines = [r for r in records if (r.stage, r.measure, r.statistic) == key]
    return record_grid("Estimators on the same trials", _COLUMNS, records, lines, _NOTE)
