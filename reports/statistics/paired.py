"""Comparisons over common trials: differences of estimators, sign test, failure rates, and main effects of factors.

The first estimator that a campaign names, after the control, is what the others are compared with. Differences are
those of trials that both solved. The null hypothesis of the sign test is that either of a pair is better with
equal chance; the noise realisations of one real image count as one, by the sign of their median.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData, select
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.grid import Grid, counts, value_of
from boresight.reports.schema.records import CONTROL, Record, find
from boresight.reports.schema.tables import unit_of
from boresight.reports.statistics.intervals import LEVEL, RESAMPLES, content_rng, draw_counts, wilson
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, share_of, widened

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

    Parameters
    ----------
    errors
        The errors of each scenario by trial; failed trials are absent.
    high
        For each scenario whether each of K axes is high.

    Returns
    -------
    effects
        exp(b_k) of the K axes; without a value where the trials do not separate them.
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
    """Solve a resample in which trial t occurs ``counts[t]`` times; NaN where it does not separate the axes."""
    try:
        return np.asarray(np.linalg.solve(np.tensordot(counts, normal, 1), counts @ right))
    except np.linalg.LinAlgError:
        return np.full(right.shape[1], np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two estimators on the trials of a scenario: their rows, trial for trial."""

    scenario: str
    estimator: str
    against: str
    rows: pd.DataFrame
    base: pd.DataFrame

    def record(self, name: str, statistic: str, measured: Measured, n_ok: int) -> Record:
        return Record(
            self.scenario, self.estimator, PAIRED, self.against, name, unit_of(name), statistic,
            measured.value, measured.low, measured.high, n_ok, len(self.rows),
        )  # fmt: skip


def paired_records(run: RunData) -> list[Record]:
    """Compare every estimator with the first one of its scenario; nothing where there is only one."""
    records: list[Record] = []
    for pair in _pairs(run):
        both = ((pair.rows["status"] == "ok") & (pair.base["status"] == "ok")).to_numpy()
        clusters = clusters_of(run, pair.rows[["scenario", "trial"]])
        for name, error in DIFFERENCES.items():
            difference = (pair.rows[error].to_numpy() - pair.base[error].to_numpy())[both]
            records += _difference_records(pair, name, difference, clusters[both])
        records += _failure_records(pair, clusters)
    return records


def _pairs(run: RunData) -> Iterator[_Pair]:
    order = {str(label): place for place, label in enumerate(run.manifest.estimators)}
    for scenario in dict.fromkeys(scenario for scenario, _ in run.posed_pairs()):
        found = [name for where, name in run.posed_pairs() if where == scenario and name != CONTROL]
        names = sorted(found, key=lambda name: order.get(name, len(order)))
        tables = {name: select(run.rows, scenario, name).set_index("trial", drop=False) for name in names}
        for name in names[1:]:
            trials = tables[name].index.intersection(tables[names[0]].index)
            yield _Pair(scenario, name, names[0], tables[name].loc[trials], tables[names[0]].loc[trials])


def _difference_records(
    pair: _Pair, name: str, difference: NDArray[np.float64], clusters: NDArray[np.generic]
) -> Iterator[Record]:
    """Yield the median of the differences (negative is better), the share of negative ones and the test's p."""
    n = len(difference)
    yield pair.record(name, MEDIAN.name, measure(difference, clusters, (MEDIAN,))[0], n)
    share, chance, decided = sign_test(difference, clusters)
    yield pair.record(name, BETTER, share, decided)
    yield pair.record(name, SIGN_TEST, chance, decided)


def sign_test(difference: NDArray[np.float64], clusters: NDArray[np.generic]) -> tuple[Measured, Measured, int]:
    """Test whether differences (n,) are as often above zero as below; a cluster counts once, by its median.

    The signs of two to five clusters can never be significant: where clusters have several trials, their shares
    are tested against one half by Student's t instead, see `_share_test`.

    Returns
    -------
    share, chance, decided
        Share of clusters with a negative median, with Wilson's interval; p of the exact two-sided test; the number of
        clusters that are not zero.
    """
    if 1 < len(np.unique(clusters)) < min(_LEAST_SIGNS, len(difference)):
        return _share_test(difference, clusters)
    signs = pd.Series(difference).groupby(np.asarray(clusters)).median().to_numpy() if len(difference) else difference
    better, decided = int((signs < 0.0).sum()), int((signs != 0.0).sum())
    if not decided:
        return Measured(None), Measured(None), 0
    chance = _sign_chance(better, decided)
    return Measured(better / decided, *wilson(better, decided)), Measured(chance), decided


def _sign_chance(better: int, decided: int) -> float:
    """Return p of the exact two-sided sign test."""
    # Imported here, as it takes 1 s, and runs of one method need none of it.
    from scipy.stats import binomtest

    return float(binomtest(better, decided).pvalue)


def _share_test(difference: NDArray[np.float64], clusters: NDArray[np.generic]) -> tuple[Measured, Measured, int]:
    """Test the shares of negative differences in few clusters against one half, leaving out zeros.

    R. Ibragimov and U. Mueller, t-statistic based correlation and heterogeneity robust inference, Journal of Business &
    Economic Statistics 28, 2010: Student's t over the clusters holds its level of 5 % however their variances differ.
    Its p is at least that of the sign test of as many independent trials: few clusters may be alike by chance.
    """
    decided = difference != 0.0
    if not decided.any():
        return Measured(None), Measured(None), 0
    better, own = difference[decided] < 0.0, clusters[decided]
    chance = _sign_chance(int(better.sum()), len(better))
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
    more = n + 2.0
    centre = (alone - other) / more
    half = float(_NORMAL_95 * np.sqrt(alone + other + 1.0 - (alone - other) ** 2 / more) / more)
    found = Measured((alone - other) / n, max(centre - half, -1.0), min(centre + half, 1.0))
    return widened(found, mine.astype(np.float64) - theirs.astype(np.float64), clusters, (-1.0, 1.0))


def _failure_records(pair: _Pair, clusters: NDArray[np.generic]) -> Iterator[Record]:
    """Yield both failure rates with their intervals, and their difference, negative where there are fewer."""
    mine, theirs = ~succeeded(pair.rows), ~succeeded(pair.base)
    if not len(mine):
        return
    for name, failed in ((OWN, mine), (THEIRS, theirs)):
        yield pair.record(FAILURE_RATE, name, share_of(failed, clusters), len(mine))
    yield pair.record(FAILURE_RATE, DIFFERENCE, rate_difference(mine, theirs, clusters), len(mine))


def paired_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate estimators against the first one on the same trials; None where there is only one."""
    names = list(DIFFERENCES)
    lines = [r for r in records if r.stage == PAIRED and r.measure == names[0] and r.statistic == MEDIAN.name]
    heads = (
        "scenario", "estimator", "against", "both ok", "position m [95 %]", "better", "p", "attitude deg [95 %]",
        "better", "p", "failures", "of the other", "difference [95 %]",
    )  # fmt: skip

    def cells(line: Record) -> tuple[str, ...]:
        key = {"scenario": line.scenario, "estimator": line.estimator, "stage": PAIRED, "reference": line.reference}

        def get(measure: str, statistic: str, interval: bool = False) -> str:
            return value_of(find(records, **key, measure=measure, statistic=statistic), interval)

        differences = [
            cell
            for name in names
            for cell in (get(name, MEDIAN.name, interval=True), get(name, BETTER), get(name, SIGN_TEST))
        ]
        rates = (get(FAILURE_RATE, OWN), get(FAILURE_RATE, THEIRS), get(FAILURE_RATE, DIFFERENCE, interval=True))
        return (line.scenario, line.estimator, line.reference, counts(line), *differences, *rates)

    note = (
        "On the same images and priors: median of the differences of the errors, trial by trial (negative is better),"
        " share of trials in which it is better, and p of the sign test. Failures: no estimate, or a position error"
        " above the prior's."
    )
    rows = tuple(cells(line) for line in lines)
    return Grid("Estimators on the same trials", heads, rows, frozenset({0, 1, 2}), note) if rows else None
