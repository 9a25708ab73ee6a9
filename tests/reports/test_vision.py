"""The vision layer told from stored frames, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from stored_runs import ESTIMATOR, SCENARIO

from boresight.reports.kinds.sequence import vision_grid, vision_records
from boresight.reports.run.data import read_run

FRAMES = {  # by trial: features, share of tracks that go on, tracks, wrong ones; the first frame goes on from none
    0: [(100, None, 30, 0), (200, 0.5, 30, 3), (300, 0.9, 30, 0)],
    1: [(400, None, 20, 2), (400, 1.0, 20, 2), (400, 0.6, 20, 2)],
}


def told(builder):
    for trial, frames in FRAMES.items():
        for name in (ESTIMATOR, "other"):
            error = (np.ones(3), 0.1)
            builder.trial(trial, error, error, estimator=name)
            for frame, (features, survival, tracks, wrong) in enumerate(frames):
                numbers = {
                    "n_features": features, "repeatability": 0.9, "n_matches": 50, "right_share": 0.8, "n_kept": 40,
                    "kept_right_share": 1.0, "survival": survival, "n_tracks": tracks, "n_wrong": wrong,
                    "error_px": 0.4, "sigma_px": 0.5,
                }  # fmt: skip
                builder.add("vision", trial=trial, scenario=SCENARIO, estimator=name, frame=frame, **numbers)
    return vision_records(read_run(builder.write()))


def test_means_are_over_the_frames_of_a_trial_and_then_over_trials(builder):
    records = told(builder)
    means = {r.measure: r.value for r in records if r.statistic == "mean" and r.estimator == ESTIMATOR}
    assert means["features_per_image"] == pytest.approx((200 + 400) / 2)
    assert means["track_survival_share"] == pytest.approx((70 + 80) / 2)
    assert means["tracks_per_image"] == pytest.approx(25)
    assert means["wrong_per_image"] == pytest.approx((1 + 2) / 2)
    assert means["lost_right_share"] == pytest.approx(0.0), "40 of 50 matches are right, and 40 right ones are kept"


def test_all_right_matches_are_lost_in_a_frame_that_keeps_none(builder):
    """Two frames with 20 right matches of 40: one keeps 15, the other none. The first frame has no matches."""
    error = (np.ones(3), 0.1)
    builder.trial(0, error, error)
    for frame, (matches, right, kept, kept_right) in enumerate(
        [(0, None, 0, None), (40, 0.5, 15, 1.0), (40, 0.5, 0, None)]
    ):
        numbers = {"n_matches": matches, "right_share": right, "n_kept": kept, "kept_right_share": kept_right}
        builder.add("vision", trial=0, scenario=SCENARIO, estimator=ESTIMATOR, frame=frame, **numbers)
    records = vision_records(read_run(builder.write()))
    (lost,) = (r.value for r in records if r.measure == "lost_right_share" and r.statistic == "mean")
    assert lost == pytest.approx((25.0 + 100.0) / 2)


def test_estimators_of_the_same_tracks_share_a_line_and_lines_go_with_the_work(builder):
    rows = vision_grid(told(builder)).rows
    assert {row[1] for row in rows} == {f"{ESTIMATOR}, other"}
    first = [row[2].split()[0] for row in rows]
    assert first == [
        "features",
        "features",
        "matches",
        "right",
        "matches",
        "right",
        "right",
        "tracks",
        "tracks",
        "tracks",
        "RMS",
        "standard",
    ]
