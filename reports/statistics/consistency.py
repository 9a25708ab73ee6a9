"""Consistency of covariances: NEES, NIS, and RMS errors over their predicted values and Cramer-Rao bounds.

NEES and NIS are chi-square where the covariance P of the error or innovation e is true: e^T P^-1 e with as many
degrees of freedom as e has components (Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, section 5.4). A covariance that is too small gives larger values.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import gammaincinv

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import TRIAL_KEY, RunData
from boresight.reports.run.outcomes import keeping_attitude, revolution_ends
from boresight.reports.schema.grid import (
    ESTIMATOR,
    NO_VALUE,
    SCENARIO,
    Grid,
    GridColumn,
    number,
    record_column,
    record_grid,
)
from boresight.reports.schema.records import Key, Record, by_key
from boresight.reports.schema.tables import kind_schema
from boresight.reports.statistics.measured import MEAN, MEDIAN, Measured, Sample, measure, share_of
from boresight.scenarios.arrays import FloatArray

CONSISTENCY = "consistency"
"""Stage of the records that compare errors with a covariance or a bound."""

BAND, INSIDE, RATIO = "mean if consistent", "share in the 95 % ellipsoid", "RMS ratio"
WRONG = "share worse than the prior, and sure"
_RATIOS = {
    "position_over_sigma": ("position_error_m", "position_sigma_m"),
    "position_over_bound": ("position_error_m", "position_bound_m"),
    "attitude_over_sigma": ("attitude_error_deg", "attitude_sigma_deg"),
    "attitude_over_bound": ("attitude_error_deg", "attitude_bound_deg"),
}
"""Each error, and the column of its RMS by the covariance or the bound."""
_NOTE = (
    "NEES: the squared error weighted by the inverse of the estimator's own covariance; NIS: the squared"
    " innovation weighted by the inverse of the covariance that the filter predicts for it. Where covariances are"
    " true, 95 % of the means of as many trials lie in the band; a mean above it indicates a covariance that is"
    " too small. In 95 %: share of the trials whose error is in the ellipsoid that should hold 95 % of them. Worse and"
    " sure: share of those that are worse than the prior with a NEES of five times the expected one, which a filter"
    " would believe. The last columns are the RMS error over the one that the covariance predicts, and over the"
    " Cramer-Rao bound of the estimator's own observations: 1 is the best that these allow. The covariance of the"
    " paper's method, which uses no prior, is that bound itself, under the covariances that its data base gives the"
    " landmarks."
)

NEES, NIS = "nees", "innovation"
AT_EPOCH, SIGHT_NEES = f"{NEES}_at_epoch", "sight_nees"
_AFTER, _EPOCH = f"{NEES}_after_", "epoch_nees"
POSE_DEGREES, STATE_DEGREES, POSITION_DEGREES, SIGHT_DEGREES = 6, 6, 3, 2
_NIS_DEGREES = "innovation_degrees"
_TAILS = (0.025, 0.975)
_SURE = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedErrors:
    """One kind of squared error of the trials of a run, normalised by its covariance.

    ``name`` is ``nees`` of a pose, ``sight_nees`` of the direction to the body's origin, ``nees_after_K`` of a position
    after K revolutions, ``nees_at_epoch`` of position and velocity of an orbit, or ``innovation``. ``expected`` is the
    mean where covariances are true, in the unit of ``ratio``. Columns of the table: ``scenario``, ``estimator``,
    ``trial``, ``ratio`` (the normalised square, of innovations per measurement), ``degrees`` (of freedom of the whole
    square, which is ratio * degrees / expected) and, of poses, ``worse`` (whether the position is worse than the
    prior's).
    """

    name: str
    expected: int
    table: pd.DataFrame

    def test(self, clusters: NDArray[np.generic]) -> dict[str, Measured]:
        """Compare them, at least one, with their distribution; ``clusters`` (n,) are what of them is independent.

        By the names of statistics: mean and median; `BAND`, the expected mean and the range of 95 % of the means of as
        many; `INSIDE`, the share of the trials in the ellipsoid of 95 %; and, of poses, `WRONG`.
        """
        ratios, degrees = (self.table[name].to_numpy(np.float64) for name in ("ratio", "degrees"))
        mean, median = measure(ratios, clusters, (MEAN, MEDIAN))
        whole = float(pd.Series(degrees).groupby(np.asarray(clusters)).mean().sum())
        inside = share_of(ratios <= self.expected * chi_square_quantile(0.95, degrees) / degrees, clusters)
        band = consistent_mean(whole, self.expected)
        found = {MEAN.name: mean, MEDIAN.name: median, BAND: band, INSIDE: inside}
        if "worse" in self.table:
            sure = ratios > _SURE * self.expected
            found[WRONG] = share_of(self.table["worse"].to_numpy(bool) & sure, clusters)
        return found


def normalised_errors(run: RunData) -> Iterator[NormalisedErrors]:
    """Yield every kind of normalised error in a run; nothing of estimators that give no covariance.

    The mean innovation that an estimator reports leaves out those that its gate rejected, and is a little small for it.
    """
    source = kind_schema(run.manifest.experiment).nees
    table = run.rows if source == "rows" else run.table(source)
    if source == "rows":
        solved = table[table["status"] == "ok"]
        worse = solved["position_error_m"] > solved["prior_position_error_m"]
        yield from _some(NEES, POSE_DEGREES, solved.assign(worse=worse), NEES, POSE_DEGREES)
        # Where an estimator keeps the prior's attitude, most of the NEES of its pose is the prior's.
        kept = solved[solved["estimator"].isin(keeping_attitude(solved))]
        yield from _some(SIGHT_NEES, SIGHT_DEGREES, kept, SIGHT_NEES, SIGHT_DEGREES)
    elif source == "epochs":
        for k, ends in revolution_ends(table):
            yield from _some(f"{_AFTER}{k}", POSITION_DEGREES, ends, NEES, POSITION_DEGREES)
    else:  # over its degrees of freedom, so that 1 is expected
        whole = table.assign(**{_EPOCH: STATE_DEGREES * table[_EPOCH]})
        yield from _some(AT_EPOCH, STATE_DEGREES, whole, _EPOCH, STATE_DEGREES)
    told = run.table("diagnostics")[run.table("diagnostics")["name"].isin([NIS, _NIS_DEGREES])]
    wide = told.pivot_table(index=TRIAL_KEY, columns="name", values="value").reset_index()
    if {NIS, _NIS_DEGREES} <= set(wide):
        yield from _some(NIS, 1, wide.dropna(), NIS, wide.dropna()[_NIS_DEGREES])


def nees_of_all(run: RunData) -> dict[str, pd.DataFrame]:
    """Return the NEES of each estimator that states a covariance, all scenarios together.

    The column ``ratio`` is the NEES over the expected one. Of sequences it is that after the last revolution.
    """
    found: dict[str, pd.DataFrame] = {}
    for kind in normalised_errors(run):
        if kind.name not in (NIS, SIGHT_NEES):
            table = kind.table.assign(ratio=kind.table["ratio"] / kind.expected)
            found |= {str(name): own for name, own in table.groupby("estimator", sort=False)}
    return {name: found[name] for name in run.manifest.estimators if name in found}


def _some(
    name: str, expected: int, table: pd.DataFrame, column: str, degrees: int | pd.Series
) -> Iterator[NormalisedErrors]:
    """Yield the normalised errors of the rows that have one in a column; nothing where none has."""
    columns = [*TRIAL_KEY, "ratio", "degrees", *({"worse"} & set(table))]
    known = table.assign(ratio=table[column], degrees=degrees)[columns].dropna()
    if len(known):
        yield NormalisedErrors(name, expected, known)


def normalised_label(name: str) -> str:
    """Return the label of a kind of normalised error."""
    if name.startswith(_AFTER):
        turns = name.removeprefix(_AFTER)
        return f"NEES of the position after {turns} revolution{'' if turns == '1' else 's'}"
    known = {
        NEES: "NEES of the pose",
        SIGHT_NEES: "NEES across the line of sight",
        AT_EPOCH: "NEES of the orbit at its epoch",
        NIS: "NIS of a measurement",
    }
    return known.get(name, name)


def chi_square_quantile(share: float, degrees: FloatArray | float) -> FloatArray:
    """Return quantiles of chi-square distributions. scipy.stats has them too, but takes 1 s to import."""
    return np.asarray(2.0 * gammaincinv(np.asarray(degrees) / 2.0, share))


def consistent_mean(degrees: float, expected: int) -> Measured:
    """Bound the mean of normalised errors with ``degrees`` of freedom in all at the 95 % level."""
    low, high = (expected * float(chi_square_quantile(tail, degrees)) / degrees for tail in _TAILS)
    return Measured(float(expected), low, high)


def consistency_records(run: RunData) -> list[Record]:
    """Compare errors with every covariance and bound; no records of estimators that give neither."""
    records: list[Record] = []
    kinds = list(normalised_errors(run))
    tables = [dict(list(kind.table.groupby(["scenario", "estimator"], sort=False))) for kind in kinds]
    posed = set(run.posed_pairs())
    for scenario, estimator in run.pairs():
        own = run.of(scenario, estimator)
        sample = Sample(scenario, estimator, CONSISTENCY, len(own), unit="")
        for kind, of_pair in zip(kinds, tables, strict=True):
            if (scenario, estimator) in of_pair:
                errors = replace(kind, table=of_pair[scenario, estimator])
                found = errors.test(clusters_of(run, errors.table))
                records += [sample.record(kind.name, name, part, len(errors.table)) for name, part in found.items()]
        if (scenario, estimator) in posed:
            records += _ratio_records(run, sample, run.solved(scenario, estimator))
    return records


def _ratio_records(run: RunData, sample: Sample, rows: pd.DataFrame) -> Iterator[Record]:
    """Compare the pose errors of solved trials with what covariances and bounds foretell."""
    clusters = clusters_of(run, rows)
    for name, columns in _RATIOS.items():
        pair = np.column_stack([rows[column].to_numpy(dtype=np.float64) for column in columns])
        # A prior without error predicts a zero RMS, over which no ratio exists.
        known = np.isfinite(pair).all(axis=1) & (pair[:, 1] > 0.0)
        if known.any():
            measured = rms_ratio(pair[known, 0], pair[known, 1], clusters[known])
            yield sample.record(name, RATIO, measured, int(known.sum()))


def rms_ratio(errors: FloatArray, sigmas: FloatArray, clusters: NDArray[np.generic]) -> Measured:
    """Return the RMS of errors (n,) over that of the predicted ones (n,), with its interval.

    The interval is that of the ratio of means R, linearised: of the mean of R + (e^2 - R s^2) / mean(s^2).
    """
    square, unit = errors**2, float(np.mean(sigmas**2))
    ratio = float(np.mean(square)) / unit
    found = measure(ratio + (square - ratio * sigmas**2) / unit, clusters, (MEAN,))[0]
    return found.each(lambda end: float(np.sqrt(max(end, 0.0))))


def _ratio_column(head: str, name: str) -> GridColumn:
    """Make a column of RMS ratios, on the lines of poses and of what has no normalised errors."""
    ratio = record_column(head, name, RATIO, interval=True)
    return GridColumn(head, lambda key, known: ratio.cell(key, known) if key.measure in ("", NEES) else NO_VALUE)


_COLUMNS = (
    SCENARIO,
    ESTIMATOR,
    GridColumn(
        "normalised",
        lambda key, known: (
            f"{normalised_label(key.measure)} ({number(known[key].value)} expected)" if key in known else NO_VALUE
        ),
        text=True,
    ),
    record_column("mean [95 %]", statistic=MEAN.name, interval=True),
    record_column("band", printed=lambda band: f"{number(band.low)} to {number(band.high)}" if band else NO_VALUE),
    record_column("in 95 %", statistic=INSIDE, interval=True),
)
_OF_POSES = (
    record_column("worse and sure", statistic=WRONG, interval=True),
    *(
        _ratio_column(f"{what}, RMS over {over}", f"{what}_over_{of}")
        for over, of in (("predicted", "sigma"), ("bound", "bound"))
        for what in ("position", "attitude")
    ),
)


def consistency_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the consistency of covariances and bounds; None where no estimator gives any."""
    own = [r for r in records if r.stage == CONSISTENCY]
    bands = [r.key for r in own if r.statistic == BAND]
    with_band = {(key.scenario, key.estimator) for key in bands}
    others = [r for r in own if (r.scenario, r.estimator) not in with_band]
    lines = [*bands, *dict.fromkeys(Key(r.scenario, r.estimator, CONSISTENCY, statistic=BAND) for r in others)]
    known = by_key(own)
    shown = [one for one in _OF_POSES if any(one.cell(key, known) != NO_VALUE for key in lines)]
    return record_grid("Covariance and bound", (*_COLUMNS, *shown), own, lines, _NOTE)
