"""What the vision layer of a sequence of images was like: features, repeatability, matches and tracks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.measures import Record, clusters_of, unit_of
from reports.run_data import RunData, select
from reports.statistics import MEAN, MEDIAN, measure
from reports.tables import Grid, counts, value_of

VISION = "vision"
"""Stage of what the vision layer did to the images, whatever estimator used its tracks."""

_MEASURES = {
    "n_features": "features_per_image",
    "repeatability": "repeatability_share",
    "n_matches": "matches_per_image",
    "right_share": "right_share",
    "n_kept": "kept_per_image",
    "kept_right_share": "kept_right_share",
    "survival": "track_survival_share",
    "n_tracks": "tracks_per_image",
    "n_wrong": "wrong_per_image",
    "error_px": "track_error_px",
    "sigma_px": "track_sigma_px",
}
_LABELS = {
    "features_per_image": "features found in an image",
    "repeatability_share": "features of the frame before, in sight here, found again, %",
    "matches_per_image": "matches of descriptors",
    "right_share": "right ones among the matches, %",
    "kept_per_image": "matches that agree with one motion",
    "kept_right_share": "right ones among those that agree, %",
    "track_survival_share": "tracks of the frame before that go on, %",
    "tracks_per_image": "tracks seen in a frame",
    "wrong_per_image": "tracks more than 3 px off",
    "track_error_px": "RMS error of a coordinate of the others, px",
    "track_sigma_px": "what estimators are told of it, px",
}
_NOTE = (
    "Mean over the frames of a trial, then over trials. The starts of one set of images are not independent of each"
    " other: the interval tells how trials differ, not how another body would."
)


def vision_records(run: RunData) -> list[Record]:
    """Measure the vision layer of each scenario and estimator: means over the frames of each trial.

    Runs of before the column ``survival`` tell the others.
    """
    records: list[Record] = []
    if run.vision.empty:
        return records
    for scenario, estimator in run.pairs():
        frames = select(run.vision, scenario, estimator)
        for column, name in _MEASURES.items():
            if column not in frames:
                continue
            trials = frames.groupby("trial", as_index=False)[column].mean()
            values = trials[column].to_numpy(dtype=np.float64) * (100.0 if name.endswith("_share") else 1.0)
            known = np.isfinite(values)
            clusters = clusters_of(run, trials.assign(scenario=scenario))[known]
            for statistic, measured in zip(
                (MEAN, MEDIAN), measure(values[known], clusters, (MEAN, MEDIAN)), strict=True
            ):
                records.append(
                    Record(
                        scenario, estimator, VISION, "", name, unit_of(name), statistic.name, measured.value,
                        measured.low, measured.high, int(known.sum()), len(trials),
                    )
                )  # fmt: skip
    return records


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
            _LABELS[group[0].measure],
            value_of(group[0], interval=True),
            counts(group[0]),
        )
        for group in shared.values()
    )
    heads = ("scenario", "tracks of", "quantity", "mean [95 %]", "trials")
    return Grid("Vision layer", heads, rows, frozenset({0, 1, 2}), _NOTE) if rows else None
