"""Whether estimators know how wrong they are, and how far they stay from what their observations allow.

The error e of a pose weighed by the covariance P of its estimator, NEES = e^T P^-1 e, is chi-square with 6 degrees of
freedom where P is true (Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). A covariance that is too small gives more than 6.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2

from reports.clusters import clusters_of
from reports.grid import NO_VALUE, Grid, number, value_of
from reports.paired import share_of
from reports.records import Record, find
from reports.run_data import RunData, select
from reports.statistics import MEAN, MEDIAN, FloatArray, Measured, measure

CONSISTENCY = "consistency"
"""Stage of the records that hold a covariance or a bound against the errors."""

NEES = "nees"
DEGREES = 6
BAND, INSIDE, RATIO = "mean if consistent", "share within 95 %", "RMS ratio"
ERRORS = {"position": "position_error_m", "attitude": "attitude_error_deg"}
FORETOLD = {f"{what}_over_sigma": f"{what}_sigma" for what in ERRORS}
BOUNDED = {f"{what}_over_bound": f"{what}_bound" for what in ERRORS}
_UNITS = {"position": "m", "attitude": "deg"}


@dataclass(frozen=True, slots=True, eq=False)
class _Subject:
    """The solved trials of an estimator, of all its trials, and what is resampled as a whole."""

    scenario: str
    estimator: str
    rows: pd.DataFrame
    clusters: NDArray[np.generic]
    n: int

    def record(self, name: str, statistic: str, measured: Measured, n_ok: int) -> Record:
        return Record(
            self.scenario, self.estimator, CONSISTENCY, "", name, "", statistic,
            measured.value, measured.low, measured.high, n_ok, self.n,
        )  # fmt: skip


def consistency_records(run: RunData) -> list[Record]:
    """Hold every covariance and every bound against the errors; nothing of estimators that give neither."""
    records: list[Record] = []
    for scenario, estimator in run.posed_pairs() if NEES in run.rows else ():
        own = select(run.rows, scenario, estimator)
        rows = own[own["status"] == "ok"]
        subject = _Subject(scenario, estimator, rows, clusters_of(run, rows), len(own))
        records += [*_nees_records(subject), *_ratio_records(subject)]
    return records


def consistent_mean(n: int) -> tuple[float, float]:
    """Bound the mean of ``n`` independent NEES of a true covariance at the 95 % level."""
    return float(chi2.ppf(0.025, DEGREES * n)) / n, float(chi2.ppf(0.975, DEGREES * n)) / n


def _nees_records(subject: _Subject) -> Iterator[Record]:
    known = subject.rows[NEES].notna().to_numpy()
    nees = subject.rows[NEES].to_numpy(dtype=np.float64)[known]
    clusters = subject.clusters[known]
    if not len(nees):
        return
    for statistic, measured in zip((MEAN, MEDIAN), measure(nees, clusters, (MEAN, MEDIAN)), strict=True):
        yield subject.record(NEES, statistic.name, measured, len(nees))
    band = Measured(float(DEGREES), *consistent_mean(len(np.unique(clusters))))
    yield subject.record(NEES, BAND, band, len(nees))
    low, high = consistent_mean(1)
    yield subject.record(NEES, INSIDE, share_of((nees >= low) & (nees <= high)), len(nees))


def _ratio_records(subject: _Subject) -> Iterator[Record]:
    for what, error in ERRORS.items():
        for name, column in (FORETOLD | BOUNDED).items():
            if name.startswith(what):
                pair = subject.rows[[error, f"{column}_{_UNITS[what]}"]].to_numpy(dtype=np.float64)
                # A prior without error foretells none: there is nothing to hold against it.
                known = np.isfinite(pair).all(axis=1) & (pair[:, 1] > 0.0)
                if known.any():
                    measured = rms_ratio(pair[known, 0], pair[known, 1], subject.clusters[known])
                    yield subject.record(name, RATIO, measured, int(known.sum()))


def rms_ratio(errors: FloatArray, sigmas: FloatArray, clusters: NDArray[np.generic]) -> Measured:
    """Return the RMS of errors (n,) over that of what was foretold (n,), with its interval.

    The interval is that of the ratio of means R, linearised: of the mean of R + (e^2 - R s^2) / mean(s^2).
    """
    square, unit = errors**2, float(np.mean(sigmas**2))
    ratio = float(np.mean(square)) / unit
    found = measure(ratio + (square - ratio * sigmas**2) / unit, clusters, (MEAN,))[0]
    ends = (found.value, found.low, found.high)
    return Measured(*(None if end is None else float(np.sqrt(max(end, 0.0))) for end in ends))


def consistency_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate what estimators say of their own errors, and their bounds; None where none says anything."""
    subjects = dict.fromkeys((r.scenario, r.estimator) for r in records if r.stage == CONSISTENCY)
    heads = (
        "scenario", "estimator", "NEES mean [95 %]", "band", "within 95 %", "position, RMS over foretold",
        "attitude, RMS over foretold", "position, RMS over bound", "attitude, RMS over bound",
    )  # fmt: skip

    def cells(scenario: str, estimator: str) -> tuple[str, ...]:
        def get(measure: str, statistic: str) -> Record | None:
            key = {"scenario": scenario, "estimator": estimator, "stage": CONSISTENCY}
            return find(records, **key, measure=measure, statistic=statistic)

        band = get(NEES, BAND)
        ends = NO_VALUE if band is None else f"{number(band.low)} to {number(band.high)}"
        ratios = (value_of(get(name, RATIO), interval=True) for name in (*FORETOLD, *BOUNDED))
        mean, inside = (value_of(get(NEES, name), interval=True) for name in (MEAN.name, INSIDE))
        return (scenario, estimator, mean, ends, inside, *ratios)

    note = (
        "NEES: the squared error of the pose weighed by the estimator's own covariance, in the mean 6 where that is"
        " true (95 % of the means of as many trials lie in the band), more where it is too small. RMS error over the"
        " one that the covariance foretells, and over the Cramer-Rao bound of the estimator's own observations: 1 is"
        " all that they allow. The covariance of the paper's method, which uses no prior, is that bound itself, under"
        " the covariances that its data base gives the landmarks."
    )
    rows = tuple(cells(*subject) for subject in subjects)
    return Grid("Covariance and bound", heads, rows, frozenset({0, 1}), note) if rows else None
