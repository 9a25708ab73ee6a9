"""Errors of a comparison in bins of the conditions of their trials, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from boresight.reports.compare.metrics import Metric
from boresight.reports.compare.trials import CONDITIONS
from boresight.reports.figures.axes import Points
from boresight.reports.schema.common import BORESIGHT, LATERAL
from boresight.reports.schema.kinds.crater_detection import DETECTION
from boresight.reports.schema.kinds.crater_matching import MATCHING
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, share_of
from boresight.scenarios.arrays import FloatArray

ATTITUDE = "attitude_error_deg"
SUCCESS = "success"
RADIAL, TRANSVERSE = "radial_error_m", "transverse_error_m"
_LABELS: Mapping[str, str] = {
    "range_m": "range, m",
    "phase_deg": "phase angle, deg",
    "latitude_deg": "latitude of the camera, deg",
    "n_landmarks": "landmarks used",
    "prior": "error of the prior",
    "anomaly_deg": "anomaly, deg",
    "distance_m": "distance to the body, m",
    LATERAL: "across boresight, m",
    BORESIGHT: "along boresight, m",
    ATTITUDE: "attitude, deg",
    SUCCESS: "success, %",
    RADIAL: "radial, m",
    TRANSVERSE: "transverse, m",
}
OWN_BINS = "n_landmarks"
_BIN_TRIALS = 20
_MOST_BINS = 8
_FRAMES = 60
_FEWEST = 5


@dataclass(frozen=True, slots=True, eq=False)
class ConditionTables:
    """Rows with errors and with the conditions that they are drawn against.

    Parameters
    ----------
    tables
        Label of each subject to its rows: conditions, errors, ``failed`` and ``cluster``.
    errors, conditions
        Columns of the errors that have values, and of the conditions that differ between trials.
    """

    tables: Mapping[str, pd.DataFrame]
    errors: tuple[str, ...]
    conditions: tuple[str, ...]


def axis_label(name: str, metric: Metric) -> str:
    """Return the axis label of a condition or an error, with its unit."""
    if name == "value":
        return metric.axis
    return f"{_LABELS[name]}, {metric.unit}" if name == "prior" else _LABELS[name]


def trials_by_condition(tables: Mapping[str, pd.DataFrame], metric: Metric) -> ConditionTables:
    """Choose errors and conditions of the trials of single images."""
    components = (LATERAL, BORESIGHT, ATTITUDE)
    errors = components if metric.name in components else ("value", *components)
    # The shares of craters found or matched are computed from their number, so it is not one of their conditions.
    given = [name for name in CONDITIONS if name != OWN_BINS or metric.name not in (*DETECTION, *MATCHING)]
    return _condition_tables(tables, errors, (*given, "prior"))


def prepare_frames(epochs: pd.DataFrame) -> pd.DataFrame:
    """Choose fewer than 120 evenly spaced frames of each sequence; more add little, as frames are correlated."""
    stride = max(1, int(epochs["frame"].max() + 1) // _FRAMES)
    kept = epochs[epochs["frame"] % stride == 0]
    distance = np.linalg.norm(kept[[f"true_{axis}_m" for axis in "xyz"]].to_numpy(dtype=np.float64), axis=1)
    return kept.assign(
        value=kept["position_error_m"],
        **{RADIAL: kept["radial_m"].abs(), TRANSVERSE: np.hypot(kept["along_m"], kept["cross_m"])},
        distance_m=distance,
        failed=False,
    )


def frames_by_condition(tables: Mapping[str, pd.DataFrame]) -> ConditionTables:
    """Choose errors and conditions of the frames of sequences; success is a property of whole sequences."""
    return _condition_tables(tables, ("value", RADIAL, TRANSVERSE), ("anomaly_deg", "distance_m", "n_landmarks"))


def _condition_tables(
    tables: Mapping[str, pd.DataFrame], errors: Sequence[str], conditions: Sequence[str]
) -> ConditionTables:
    whole = pd.concat(tables.values())
    known = [name for name in errors if whole[name].notna().any()]
    success = [SUCCESS] if whole["failed"].any() else []
    return ConditionTables(tables, (*known, *success), tuple(name for name in conditions if _varies(whole[name])))


def _varies(values: pd.Series) -> bool:
    known = values.dropna().to_numpy(dtype=np.float64)
    return len(known) > 0 and float(np.ptp(known)) > 1e-6 * max(float(np.abs(known).max()), 1e-12)


def binned_errors(split: ConditionTables, error: str, condition: str) -> Iterator[tuple[str, Points]]:
    """Yield medians of an error, or success rates, in bins of a condition, for each subject whose condition varies.

    The abscissa of a bin is the median of its condition. Bins of fewer than five independent trials are left out. All
    subjects have the same bins, except for the number of landmarks, which may differ widely between estimators.
    """
    varying = {label: table for label, table in split.tables.items() if _varies(table[condition])}
    for label, table in varying.items():
        edges = _bin_edges([table] if condition == OWN_BINS else list(varying.values()), condition)
        known = table[table[condition].notna() & (table[error].notna() if error != SUCCESS else True)]
        place = np.clip(np.searchsorted(edges, known[condition].to_numpy(), side="right") - 1, 0, len(edges) - 2)
        points = []
        for _, own in known.groupby(place):
            clusters = own["cluster"].to_numpy()
            if error == SUCCESS:
                share = share_of(~own["failed"].to_numpy(dtype=bool), clusters)
                found = Measured(
                    *(None if end is None else 100.0 * end for end in (share.value, share.low, share.high))
                )
            else:
                found = measure(own[error].to_numpy(dtype=np.float64), clusters, (MEDIAN,))[0]
            if len(np.unique(clusters)) >= _FEWEST and None not in (found.value, found.low, found.high):
                points.append((float(own[condition].median()), found.value, found.low, found.high))
        if points:
            x, y, *ends = np.array(points, dtype=np.float64).T
            yield label, Points(x, y, np.column_stack(ends))


def _bin_edges(tables: Sequence[pd.DataFrame], condition: str) -> FloatArray:
    """Choose edges (b + 1,) of bins that contain equal numbers of rows of all tables together."""
    longest = max(int(table.loc[table[condition].notna(), "cluster"].nunique()) for table in tables)
    bins = int(np.clip(longest // _BIN_TRIALS, 1, _MOST_BINS))
    values = pd.concat([table[condition].dropna() for table in tables])
    return np.unique(np.quantile(values.to_numpy(dtype=np.float64), np.linspace(0.0, 1.0, bins + 1)))
