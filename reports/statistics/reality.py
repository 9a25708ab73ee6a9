"""Real errors over simulated ones: what a simulation predicts of real images or tracks, and whether it came so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import NO_VALUE, Grid, number, row_grid
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.consistency import POSE_DEGREES, POSITION_DEGREES
from boresight.reports.statistics.intervals import FEW, LEVEL, content_rng, draw_counts
from boresight.reports.statistics.measured import MEAN, measure
from boresight.scenarios.arrays import BoolArray, FloatArray

WITHIN = (0.7, 1.4)
"""Ratios of the medians that count as predicted."""
_CENTRAL = (0.05, 0.95)
_NEES = {"nees": POSE_DEGREES, "mean_position_nees": POSITION_DEGREES}
_TEXT = ("seen", "method", "in the central 90 %", "verdict")
_NOTE = (
    "Median position error of the trials with an estimate, where both have the same images of those with one in both;"
    " of sequences that of the last frame. The interval of 95 % of a ratio is that of resampled images, the same for"
    " both where both have them; where tracks share their images, of the simulated trials alone. As predicted: it lies"
    f" within {WITHIN[0]:g} to {WITHIN[1]:g}; differs: outside; open: neither; no interval: fewer than ten images with"
    " an estimate. The central 90 % are those of the simulated errors. The real error also has that of the reference."
    " NEES/n is the mean NEES over its degrees of freedom, of all trials with an estimate and of sequences over their"
    " frames: 1 where covariances are true. Its intervals are those of resampled images or sequences."
)


@dataclass(frozen=True, eq=False)
class Side:
    """Errors of a method in a scenario: (n,) values, NaN without an estimate, and the independent unit of each."""

    error_m: FloatArray
    unit: NDArray[np.str_]

    @classmethod
    def of(cls, run: RunData, scenario: str, estimator: str) -> Side:
        """Take the errors of a run."""
        rows = run.rows[(run.rows["scenario"] == scenario) & (run.rows["estimator"] == estimator)]
        error_m = rows["position_error_m"].where(rows["status"] == "ok").to_numpy(dtype=np.float64)
        return cls(error_m, clusters_of(run, rows).astype(str))

    @property
    def found(self) -> FloatArray:
        """The errors of the trials with an estimate."""
        return self.error_m[np.isfinite(self.error_m)]

    @property
    def units_found(self) -> int:
        """Number of units with an estimate."""
        return len(np.unique(self.unit[np.isfinite(self.error_m)]))

    def where(self, kept: BoolArray) -> Side:
        """Keep the errors of some trials; the others count as without an estimate."""
        return replace(self, error_m=np.where(kept, self.error_m, np.nan))

    @property
    def median_m(self) -> float:
        """Median error; NaN without any."""
        return float(np.median(self.found)) if len(self.found) else np.nan

    def medians_m(self, names: NDArray[np.str_], counts: NDArray[np.int32]) -> FloatArray:
        """(b,) medians where the unit ``names[c]`` is there ``counts[i, c]`` times; NaN without an estimate."""
        ok = np.isfinite(self.error_m)
        order = np.argsort(self.error_m[ok], kind="stable")
        values, unit = self.error_m[ok][order], self.unit[ok][order]
        if not len(values):
            return np.full(len(counts), np.nan)
        upto = counts[:, np.searchsorted(names, unit)].cumsum(axis=1)
        half = 0.5 * upto[:, -1:]
        low, high = (upto < half).sum(axis=1), (upto <= half).sum(axis=1)
        last = len(values) - 1
        middle = 0.5 * (values[np.minimum(low, last)] + values[np.minimum(high, last)])
        return np.where(half[:, 0] > 0.0, middle, np.nan)


def ratio_interval(real: Side, simulated: Side, *, shared: bool = False) -> tuple[float, float] | None:
    """Interval of 95 % of the ratio of the medians, by resampling units; None with fewer than ten.

    Units that both sides have, as images, are drawn once for both. ``shared``: all trials of the real side share their
    data, and only those of the simulated one are drawn.
    """
    ours, theirs = np.unique(real.unit), np.unique(simulated.unit)
    if simulated.units_found < FEW or (not shared and real.units_found < FEW):
        return None
    rng = content_rng(real.error_m, simulated.error_m)
    of_simulated = np.vstack(list(draw_counts(len(theirs), rng)))
    if shared:
        tops = np.full(len(of_simulated), real.median_m)
    elif np.array_equal(ours, theirs):
        tops = real.medians_m(ours, of_simulated)
    else:
        tops = real.medians_m(ours, np.vstack(list(draw_counts(len(ours), rng))))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = tops / simulated.medians_m(theirs, of_simulated)
    if not np.isfinite(ratios).all():
        return None
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(ratios, [tail, 100.0 - tail])
    return float(low), float(high)


def verdict(interval: tuple[float, float] | None) -> str:
    """Say whether a ratio is as predicted, by its interval alone."""
    if interval is None:
        return "no interval"
    low, high = interval
    if low >= WITHIN[0] and high <= WITHIN[1]:
        return "as predicted"
    return "differs" if high < WITHIN[0] or low > WITHIN[1] else "open"


def reality_rows(
    seen: str, real: tuple[RunData, str], simulated: tuple[RunData, str], *, shared: bool = False
) -> Iterator[dict[str, str]]:
    """Yield a line for each estimator that a real and a simulated scenario, of a run each, have in common."""
    labels = [set(run.rows.loc[run.rows["scenario"] == scenario, "estimator"]) for run, scenario in (real, simulated)]
    for label in (one for one in real[0].manifest.estimators if one in labels[0] & labels[1] and one != CONTROL):
        ours, theirs = Side.of(*real, label), Side.of(*simulated, label)
        counts = f"{len(ours.found)}/{len(ours.error_m)}", f"{len(theirs.found)}/{len(theirs.error_m)}"
        if np.array_equal(ours.unit, theirs.unit):
            both = np.isfinite(ours.error_m) & np.isfinite(theirs.error_m)
            ours, theirs = ours.where(both), theirs.where(both)
        interval = ratio_interval(ours, theirs, shared=shared)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = float(np.divide(ours.median_m, theirs.median_m))
        low, high = np.quantile(theirs.found, _CENTRAL) if len(theirs.found) else (np.nan, np.nan)
        central = "yes" if low <= ours.median_m <= high else "no"
        yield {
            "seen": seen,
            "method": label,
            "real, m": _printed(ours.median_m),
            "ok, real": counts[0],
            "simulated, m": _printed(theirs.median_m),
            "ok, simulated": counts[1],
            "in the central 90 %": central if np.isfinite(ratio) else NO_VALUE,
            "ratio [95 %]": _printed(ratio) + _interval(*interval or (None, None)),
            "verdict": verdict(interval) if np.isfinite(ratio) else NO_VALUE,
            "NEES/n, real": _consistency(*real, label),
            "NEES/n, simulated": _consistency(*simulated, label),
        }


def _consistency(run: RunData, scenario: str, estimator: str) -> str:
    """Print the mean NEES over its degrees of freedom; no value of an estimator without a covariance."""
    rows = run.solved(scenario, estimator)
    column = next(name for name in _NEES if name in rows)
    known = rows[rows[column].notna()]
    values = known[column].to_numpy(dtype=np.float64) / _NEES[column]
    (mean,) = measure(values, clusters_of(run, known), (MEAN,))
    return number(mean.value) + _interval(mean.low, mean.high)


def _interval(low: float | None, high: float | None) -> str:
    return "" if low is None else f" [{number(low)}, {number(high)}]"


def reality_grid(rows: list[dict[str, str]]) -> Grid:
    """Lay the lines out as one table."""
    return row_grid("Real over simulated", rows, _TEXT, _NOTE)


def _printed(value: float) -> str:
    return number(float(value)) if np.isfinite(value) else NO_VALUE


def levels_of(run: RunData, axes: Mapping[str, str]) -> dict[tuple[str, ...], str]:
    """Return the scenarios of a grid's levels: those of ``axes`` (name: level) fixed, by the levels of the others."""
    grid = run.manifest.grid
    if grid is None:
        return {}
    rest = [axis.name for axis in grid.axes if axis.name not in axes]
    return {
        tuple(one.levels[name] for name in rest): one.name
        for one in grid.scenarios
        if all(one.levels.get(axis) == level for axis, level in axes.items())
    }
