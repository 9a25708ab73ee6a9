"""Statistics of the vision layer of a sequence of images: features, repeatability, matches and tracks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.clusters import clusters_of, groups
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid, counts, value_of
from boresight.reports.schema.records import Record
from boresight.reports.schema.tables import measure_heading, unit_of
from boresight.reports.statistics.measured import MEAN, MEDIAN, measure

VISION = "vision"
"""Stage of what the vision layer did to the images, whatever estimator used its tracks."""

_MEASURES = {
    "n_features": "features_per_image",
    "repeatability": "repeatability_share",
    "n_matches": "matches_per_image",
    "right_share": "right_share",
    "n_kept": "kept_per_image",
    "kept_right_share": "kept_right_share",
    "lost_right": "lost_right_share",
    "survival": "track_survival_share",
    "n_tracks": "tracks_per_image",
    "n_wrong": "wrong_per_image",
    "error_px": "track_error_px",
    "sigma_px": "track_sigma_px",
}
_NOTE = (
    "Mean over the frames of a trial, then over trials. The starts on one set of images are not independent of each"
    " other: intervals are over sets, and one set by itself has none."
)


def vision_records(run: RunData) -> list[Record]:
    """Measure the vision layer of each scenario and estimator: means over the frames of each trial."""
    records: list[Record] = []
    if run.table("vision").empty:
        return records
    for group, members in groups(run):
        shown = run.table("vision")[run.table("vision")["scenario"].isin(members)]
        for estimator in dict.fromkeys(shown["estimator"]):
            frames = _with_lost(shown[shown["estimator"] == estimator])
            trials = frames.groupby(["scenario", "trial"], as_index=False)[[*_MEASURES]].mean()
            records += _records(group, str(estimator), trials, clusters_of(run, trials))
    return records


def _with_lost(frames: pd.DataFrame) -> pd.DataFrame:
    """Add the share of the right matches of each frame that were not kept: all of them where nothing was kept."""
    right = frames["n_matches"] * frames["right_share"]
    kept = (frames["n_kept"] * frames["kept_right_share"]).where(frames["n_kept"] > 0, 0.0)
    return frames.assign(lost_right=1.0 - kept / right.where(right > 0.0))


def _records(group: str, estimator: str, trials: pd.DataFrame, clusters: NDArray[np.generic]) -> Iterator[Record]:
    """Yield mean and median of every measure over ``trials``, a row for each."""
    for column, name in _MEASURES.items():
        values = trials[column].to_numpy(dtype=np.float64) * (100.0 if name.endswith("_share") else 1.0)
        known = np.isfinite(values)
        statistics = (MEAN, MEDIAN)
        for statistic, found in zip(statistics, measure(values[known], clusters[known], statistics), strict=True):
            yield Record(
                group, estimator, VISION, "", name, unit_of(name), statistic.name, found.value, found.low,
                found.high, int(known.sum()), len(trials),
            )  # fmt: skip


def vision_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the vision layer; estimators that saw the same tracks share a line, None without images."""
    lines = [r for r in records if r.stage == VISION and r.statistic == MEAN.name]
    shared: dict[tuple[object, ...], list[Record]] = {}
    for line in lines:
        shared.setdefault((line.scenario, line.measure, line.value, line.low, line.high), []).append(line)
    rows = tuple(
        (
            group[0].scenario,
            ", ".join(line.estimator for line in group),
            measure_heading(group[0].measure),
            value_of(group[0], interval=True),
            counts(group[0]),
        )
        for group in shared.values()
    )
    heads = ("scenario", "tracks of", "quantity", "mean [95 %]", "trials")
    return Grid("Vision layer", heads, rows, frozenset({0, 1, 2}), _NOTE) if rows else None
