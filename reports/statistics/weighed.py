"""Errors and innovations weighed by the covariances that estimators claim: NEES and NIS.

Both are chi-square where the covariance P of the error or innovation e is true: e^T P^-1 e with as many degrees of
freedom as e has components (Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). A covariance that is too small gives more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2

from reports.run.clusters import clusters_of
from reports.run.data import TRIAL_KEY, RunData, select
from reports.statistics.intervals import FloatArray
from reports.statistics.measured import MEAN, MEDIAN, Measured, measure, share_of

NEES, NIS = "nees", "innovation"
AT_EPOCH = f"{NEES}_at_epoch"
_AFTER, _EPOCH = f"{NEES}_after_", "epoch_nees"
POSE_DEGREES, STATE_DEGREES, POSITION_DEGREES = 6, 6, 3
_NIS_DEGREES = "innovation_degrees"
_TAILS = (0.025, 0.975)
_TURN_DEG = 360.0
_SAME_FRAME_DEG = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """One kind of weighed error of the trials of a run.

    Parameters
    ----------
    name
        Of the records: ``nees`` of a pose, ``nees_after_K`` of a position after K revolutions, ``nees_at_epoch``
        of position and velocity of an orbit, ``innovation``.
    expected
        Mean where covariances are true, in the unit of ``ratio``.
    table
        ``scenario``, ``estimator``, ``trial``, ``ratio`` (the weighed square, of innovations a measurement) and
        ``degrees`` (of freedom of the whole square, which is ratio * degrees / expected).
    """

    name: str
    expected: int
    table: pd.DataFrame


@dataclass(frozen=True, slots=True)
class Judged:
    """Weighed errors against their distribution.

    Parameters
    ----------
    n
        How many.
    mean, median
        With their intervals.
    band
        What the mean is expected to be, and where 95 % of the means of as many would lie.
    inside
        Share of the trials within the 95 % of the distribution, 2.5 % being left out at either end.
    """

    n: int
    mean: Measured
    median: Measured
    band: Measured
    inside: Measured


def weighed_errors(run: RunData) -> Iterator[Weighed]:
    """Yield every kind of weighed error that the estimators of a run give; nothing of those that claim no covariance.

    An innovation that a gate refused is no part of the mean that an estimator reports, which is a little small for it.
    """
    if run.table("orbits").empty:  # Rows of orbits repeat what the table of orbits has.
        rows = run.rows[(run.rows["status"] == "ok") & run.rows[NEES].notna()]
        yield from _some(NEES, POSE_DEGREES, rows.assign(ratio=rows[NEES], degrees=POSE_DEGREES))
    if not run.table("epochs").empty:
        known = run.table("epochs")[run.table("epochs")[NEES].notna()]
        known = known.assign(ratio=known[NEES], degrees=POSITION_DEGREES)
        last = float(run.table("epochs")["anomaly_deg"].max())
        for k in range(1, int((last + _SAME_FRAME_DEG) // _TURN_DEG) + 1):
            at = known[(known["anomaly_deg"] - k * _TURN_DEG).abs() < _SAME_FRAME_DEG]
            yield from _some(f"{_AFTER}{k}", POSITION_DEGREES, at)
    if _EPOCH in run.table("orbits"):
        # The table has it over the number of degrees of freedom, so that 1 is expected.
        solved = run.table("orbits")[run.table("orbits")[_EPOCH].notna()]
        squares = solved.assign(ratio=STATE_DEGREES * solved[_EPOCH], degrees=STATE_DEGREES)
        yield from _some(AT_EPOCH, STATE_DEGREES, squares)
    told = run.table("diagnostics")[run.table("diagnostics")["name"].isin([NIS, _NIS_DEGREES])]
    wide = told.pivot_table(index=TRIAL_KEY, columns="name", values="value").reset_index()
    if {NIS, _NIS_DEGREES} <= set(wide):
        whole = wide.dropna().rename(columns={NIS: "ratio", _NIS_DEGREES: "degrees"})
        yield from _some(NIS, 1, whole)


def weighed_label(name: str) -> str:
    """Name a kind of weighed error in words."""
    if name.startswith(_AFTER):
        turns = name.removeprefix(_AFTER)
        return f"NEES of the position after {turns} revolution{'' if turns == '1' else 's'}"
    known = {NEES: "NEES of the pose", AT_EPOCH: "NEES of the orbit at its epoch", NIS: "NIS of a measurement"}
    return known.get(name, name)


def _some(name: str, expected: int, table: pd.DataFrame) -> Iterator[Weighed]:
    if len(table):
        yield Weighed(name, expected, table[["scenario", "estimator", "trial", "ratio", "degrees"]])


def judged_pair(run: RunData, weighed: Weighed, scenario: str, estimator: str) -> Judged | None:
    """Judge what one estimator claims in one scenario; None where it claims nothing."""
    own = select(weighed.table, scenario, estimator)
    if own.empty:
        return None
    return judge(
        own["ratio"].to_numpy(np.float64), own["degrees"].to_numpy(np.float64), weighed.expected, clusters_of(run, own)
    )


def judge(ratios: FloatArray, degrees: FloatArray, expected: int, clusters: NDArray[np.generic]) -> Judged:
    """Hold weighed errors (n,), n >= 1, against the chi-square distribution of their degrees of freedom (n,)."""
    mean, median = measure(ratios, clusters, (MEAN, MEDIAN))
    whole = float(pd.Series(degrees).groupby(np.asarray(clusters)).mean().sum())
    low, high = (expected * chi2.ppf(tail, degrees) / degrees for tail in _TAILS)
    inside = share_of((ratios >= low) & (ratios <= high), clusters)
    return Judged(len(ratios), mean, median, consistent_mean(whole, expected), inside)


def consistent_mean(degrees: float, expected: int) -> Measured:
    """Bound the mean of weighed errors with ``degrees`` of freedom in all at the 95 % level."""
    low, high = (expected * float(chi2.ppf(tail, degrees)) / degrees for tail in _TAILS)
    return Measured(float(expected), low, high)
