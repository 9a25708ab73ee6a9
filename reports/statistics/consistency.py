"""Whether estimators know how wrong they are, and how far they stay from what their observations allow."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.run.clusters import clusters_of
from reports.run.data import RunData, select
from reports.schema.grid import NO_VALUE, Grid, number, value_of
from reports.schema.records import Record, find
from reports.statistics.intervals import FloatArray
from reports.statistics.measured import MEAN, MEDIAN, Measured, measure
from reports.statistics.weighed import NEES, Judged, judged_pair, weighed_errors, weighed_label

CONSISTENCY = "consistency"
"""Stage of the records that hold a covariance or a bound against the errors."""

BAND, INSIDE, RATIO = "mean if consistent", "share within 95 %", "RMS ratio"
ERRORS = {"position": "position_error_m", "attitude": "attitude_error_deg"}
FORETOLD = {f"{what}_over_sigma": f"{what}_sigma" for what in ERRORS}
BOUNDED = {f"{what}_over_bound": f"{what}_bound" for what in ERRORS}
_UNITS = {"position": "m", "attitude": "deg"}


_NOTE = (
    "NEES: the squared error weighed by the estimator's own covariance; NIS: the squared innovation weighed by what the"
    " filter foretells of it. Where covariances are true, 95 % of the means of as many trials lie in the band; a mean"
    " above it tells a covariance that is too small. Within 95 %: share of the trials inside the central 95 % of the"
    " distribution. RMS error over the one that the covariance foretells, and over the Cramer-Rao bound of the"
    " estimator's own observations: 1 is all that they allow. The covariance of the paper's method, which uses no"
    " prior, is that bound itself, under the covariances that its data base gives the landmarks."
)


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
    kinds = list(weighed_errors(run))
    posed = set(run.posed_pairs())
    for scenario, estimator in run.pairs():
        own = select(run.rows, scenario, estimator)
        rows = own[own["status"] == "ok"]
        subject = _Subject(scenario, estimator, rows, clusters_of(run, rows), len(own))
        for kind in kinds:
            found = judged_pair(run, kind, scenario, estimator)
            records += [] if found is None else _judged_records(subject, kind.name, found)
        if (scenario, estimator) in posed:
            records += _ratio_records(subject)
    return records


def _judged_records(subject: _Subject, name: str, found: Judged) -> Iterator[Record]:
    for statistic, measured in (
        (MEAN.name, found.mean),
        (MEDIAN.name, found.median),
        (BAND, found.band),
        (INSIDE, found.inside),
    ):
        yield subject.record(name, statistic, measured, found.n)


def _ratio_records(subject: _Subject) -> Iterator[Record]:
    for what, error in ERRORS.items():
        for name, column in (FORETOLD | BOUNDED).items():
            foretold = f"{column}_{_UNITS[what]}"
            if name.startswith(what) and foretold in subject.rows:
                pair = subject.rows[[error, foretold]].to_numpy(dtype=np.float64)
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
    own = [r for r in records if r.stage == CONSISTENCY]
    lines = dict.fromkeys((r.scenario, r.estimator, r.measure) for r in own if r.statistic == BAND)
    told = {(scenario, estimator) for scenario, estimator, _ in lines}
    lines |= dict.fromkeys((r.scenario, r.estimator, "") for r in own if (r.scenario, r.estimator) not in told)
    heads = (
        "scenario", "estimator", "weighed", "mean [95 %]", "band", "within 95 %", "position, RMS over foretold",
        "attitude, RMS over foretold", "position, RMS over bound", "attitude, RMS over bound",
    )  # fmt: skip

    def cells(scenario: str, estimator: str, kind: str) -> tuple[str, ...]:
        def get(measure: str, statistic: str) -> Record | None:
            return find(own, scenario=scenario, estimator=estimator, measure=measure, statistic=statistic)

        band = get(kind, BAND)
        ends = NO_VALUE if band is None else f"{number(band.low)} to {number(band.high)}"
        what = NO_VALUE if band is None else f"{weighed_label(kind)} ({number(band.value)} expected)"
        posed = kind in ("", NEES)
        ratios = (value_of(get(name, RATIO) if posed else None, interval=True) for name in (*FORETOLD, *BOUNDED))
        mean, inside = (value_of(get(kind, name), interval=True) for name in (MEAN.name, INSIDE))
        return (scenario, estimator, what, mean, ends, inside, *ratios)

    rows = tuple(cells(*line) for line in lines)
    grid = Grid("Covariance and bound", heads, rows, frozenset({0, 1, 2}), _NOTE)
    empty = {i for i in range(6, len(heads)) if all(row[i] == NO_VALUE for row in rows)}
    return grid.keep(*(head for i, head in enumerate(heads) if i not in empty)) if rows else None
