"""Receiver operating characteristics (ROC): detection of bad solutions by the numbers that an estimator reports.

A solution is bad where its position error is above that of its prior, or above three times the median of all solutions.
Every number of the table ``diagnostics`` is a score. The area under its curve is the chance that a bad solution scores
higher than a good one (ties count half), by the statistic of Mann and Whitney; its interval is the percentile bootstrap
over whole trials or images, or, for very many independent trials, follows from the variance of ranks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import (
    ESTIMATOR,
    NO_VALUE,
    SCENARIO,
    Grid,
    GridColumn,
    record_column,
    record_grid,
    text_column,
)
from boresight.reports.schema.records import CONTROL, Record
from boresight.reports.statistics.intervals import FEW, LARGE, LEVEL, content_rng, draw_counts
from boresight.reports.statistics.measured import Measured, Sample
from boresight.scenarios.arrays import BoolArray, FloatArray

ABOVE_PRIOR, ABOVE_MEDIANS = "above-prior", "above-3-medians"
DEFINITIONS = {ABOVE_PRIOR: "position error above the prior's", ABOVE_MEDIANS: "position error above 3 medians"}
MEASURE = "outlier_score:"
AUC, TRUE_POSITIVES, THRESHOLD, BAD = "AUC", "TPR at 5 % FPR", "threshold at 5 % FPR", "bad solutions"
_FALSE_POSITIVES = 0.05
_MIN_CLASS = 5


@dataclass(frozen=True, slots=True, eq=False)
class OutlierScore:
    """A score (n,) of the solutions that have one, and which of them are bad (n,) by a definition.

    ``clusters`` (n,) are resampled as a whole.
    """

    scenario: str
    estimator: str
    name: str
    definition: str
    score: FloatArray
    bad: BoolArray
    clusters: NDArray[np.generic]

    @property
    def low_is_bad(self) -> bool:
        """Whether small values indicate bad solutions rather than large ones."""
        return area(self.score, self.bad) < 0.5

    @property
    def rising(self) -> FloatArray:
        """(n,) the score, negated where small values indicate bad solutions."""
        return -self.score if self.low_is_bad else self.score


def outlier_scores(run: RunData) -> Iterator[OutlierScore]:
    """Yield every score of every estimator, for each definition with at least five solutions of either kind."""
    for scenario, estimator in run.posed_pairs():
        rows = run.solved(scenario, estimator)
        if estimator == CONTROL or rows.empty:
            continue
        error = rows["position_error_m"].to_numpy()
        classes = {
            ABOVE_PRIOR: error > rows["prior_position_error_m"].to_numpy(),
            ABOVE_MEDIANS: error > 3.0 * np.median(error),
        }
        if run.table("diagnostics").empty:
            return
        classes = {one: bad for one, bad in classes.items() if min(bad.sum(), (~bad).sum()) >= _MIN_CLASS}
        if not classes:
            continue
        numbers, clusters = run.of(scenario, estimator, "diagnostics"), clusters_of(run, rows)
        by_trial = numbers.pivot(index="trial", columns="name", values="value").reindex(rows["trial"])
        for name in numbers["name"].unique():
            values = by_trial[name].to_numpy()
            known = np.isfinite(values)
            for definition, bad in classes.items() if len(np.unique(values[known])) > 1 else ():
                if min(bad[known].sum(), (~bad[known]).sum()) >= _MIN_CLASS:
                    own = (values[known], bad[known], clusters[known])
                    yield OutlierScore(scenario, estimator, str(name), definition, *own)


def roc_curve(score: FloatArray, bad: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Trace the rates (m + 1,) of flagging what scores at least each of m thresholds, from (0, 0) on.

    Return false positives, true positives and thresholds; these descend, and the first is infinite.
    """
    order = np.argsort(-score, kind="stable")
    last_of_value = np.append(np.diff(score[order]) != 0.0, True)
    true = np.cumsum(bad[order])[last_of_value] / bad.sum()
    false = np.cumsum(~bad[order])[last_of_value] / (~bad).sum()
    return np.append(0.0, false), np.append(0.0, true), np.append(np.inf, score[order][last_of_value])


def area(score: FloatArray, bad: BoolArray) -> float:
    """Measure the area under the curve."""
    return float(_areas(score, bad, np.ones((1, len(score)), dtype=np.int32))[0])


def _areas(score: FloatArray, bad: BoolArray, counts: NDArray[np.int32]) -> FloatArray:
    """Measure areas (b,) of samples in which solution i occurs ``counts[b, i]`` times; NaN where a class is empty."""
    order = np.argsort(score, kind="stable")
    ends = np.flatnonzero(np.append(np.diff(score[order]) != 0.0, True))
    weights = np.take(counts, order, axis=1).astype(np.int64)
    good_below = np.cumsum(weights * ~bad[order], axis=1)[:, ends]
    bad_below = np.cumsum(weights * bad[order], axis=1)[:, ends]
    good, wrong = (np.diff(below, axis=1, prepend=0) for below in (good_below, bad_below))
    wins = (wrong * (good_below - 0.5 * good)).sum(axis=1)
    pairs = good_below[:, -1] * bad_below[:, -1]
    areas: FloatArray = np.divide(wins, pairs, out=np.full(len(counts), np.nan), where=pairs > 0)
    return areas


def measured_area(found: OutlierScore) -> Measured:
    """Measure the area under the curve with its 95 % interval; without one where few are independent."""
    codes = np.unique(found.clusters, return_inverse=True)[1]
    if codes.max() + 1 < FEW:
        return Measured(area(found.score, found.bad))
    if codes.max() + 1 == len(codes) >= LARGE:
        return Measured(area(found.score, found.bad), *large_sample_area(found.score, found.bad))
    drawn = draw_counts(int(codes.max()) + 1, content_rng(found.score, found.bad, codes), len(codes))
    draws = [_areas(found.score, found.bad, np.take(counts, codes, axis=1)) for counts in drawn]
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(np.concatenate(draws), [tail, 100.0 - tail])
    return Measured(area(found.score, found.bad), float(low), float(high))


def large_sample_area(score: FloatArray, bad: BoolArray) -> tuple[float, float]:
    """Bound the area of many independent solutions at the 95 % level, without resampling.

    After E. DeLong, D. DeLong and D. Clarke-Pearson, Biometrics 44, 1988: the area is a mean over either class of the
    share of the other class that each member exceeds, and its variance is the sum of those two means' variances.
    """
    # Imported here, as it takes 1 s and few runs have so many trials.
    from scipy.stats import rankdata

    ranks, m, n = rankdata(score), int(bad.sum()), int((~bad).sum())
    of_bad = (ranks[bad] - rankdata(score[bad])) / n
    of_good = 1.0 - (ranks[~bad] - rankdata(score[~bad])) / m
    half = float(ndtri(0.5 * (1.0 + LEVEL)) * np.sqrt(of_bad.var(ddof=1) / m + of_good.var(ddof=1) / n))
    middle = float(of_bad.mean())
    return max(middle - half, 0.0), min(middle + half, 1.0)


def operating_point(found: OutlierScore) -> tuple[float, float]:
    """Find the highest true positive rate with at most 5 % of false positives, and its threshold."""
    false, true, thresholds = roc_curve(found.rising, found.bad)
    best = int(np.flatnonzero(false <= _FALSE_POSITIVES)[-1])
    return float(true[best]), float(-thresholds[best] if found.low_is_bad else thresholds[best])


def outlier_records(run: RunData) -> Iterator[Record]:
    """Measure every score: area under the curve, and the point of 5 % false positives."""
    for found in outlier_scores(run):
        sample = Sample(found.scenario, found.estimator, found.definition, len(found.bad), unit="")
        true, threshold = operating_point(found)
        yield sample.record(MEASURE + found.name, AUC, measured_area(found))
        yield sample.record(MEASURE + found.name, TRUE_POSITIVES, Measured(true))
        yield sample.record(MEASURE + found.name, THRESHOLD, Measured(threshold if np.isfinite(threshold) else None))
        yield sample.record(MEASURE + found.name, BAD, Measured(float(found.bad.sum())))


_NOTE = (
    "How well a number that the estimator reports indicates its bad solutions: area under the receiver operating"
    " characteristic (0.5 is chance; below it, small values indicate them), and the share of bad solutions beyond"
    " the threshold that flags 5 % of the good ones."
)
_COLUMNS = (
    SCENARIO,
    ESTIMATOR,
    text_column("bad", lambda key: DEFINITIONS[key.stage]),
    text_column("number", lambda key: key.measure.removeprefix(MEASURE)),
    record_column("of", statistic=BAD, printed=lambda bad: f"{round(bad.value or 0)}/{bad.n}" if bad else NO_VALUE),
    record_column("AUC [95 %]", interval=True),
    record_column(TRUE_POSITIVES, statistic=TRUE_POSITIVES),
    record_column("threshold", statistic=THRESHOLD),
    GridColumn("flagged", lambda key, known: "below" if (known[key].value or 0.0) < 0.5 else "above", text=True),
)


def outlier_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate how well the numbers that estimators report indicate bad solutions; None where there are none."""
    lines = [r for r in records if r.measure.startswith(MEASURE) and r.statistic == AUC]
    return record_grid("Bad solutions, and the numbers that indicate them", _COLUMNS, records, lines, _NOTE)
