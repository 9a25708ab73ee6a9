"""Comparisons of detectors and matchers of craters, and of counts, by numbers that follow from a few rows by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from stored_runs import SCENARIO, RunBuilder, pose_error

from boresight.reports.compare import compare_runs
from boresight.reports.compare.trials import trial_numbers
from boresight.reports.pages.comparison import write_comparison
from boresight.reports.run.data import read_run
from boresight.reports.schema.tables import kind_schema

ELLIPSE = dict.fromkeys(("u_px", "v_px", "major_px", "minor_px", "angle_deg"), 20.0)
ERRORS = ("centre_error_px", "major_error_px", "minor_error_px")
NO_POSE = {f"{prefix}{name}": np.nan for prefix in ("", "prior_") for name in pose_error(np.zeros(3), 0)}


def row(builder, estimator, trial, status="ok", n=0):
    key = {"trial": trial, "scenario": SCENARIO, "estimator": estimator}
    builder.add("rows", **key, **NO_POSE, status=status, reason="", image="", n_landmarks=n)
    return key


def detections(builder, key, hits, false, kept=True):
    """Add detections: of detectable craters with the error of their centres, and of nothing."""
    for rank, error in enumerate((*hits, *[None] * false)):
        known = {"crater": -1, "detectable": False, "clean": False, **dict.fromkeys(ERRORS, np.nan)}
        if error is not None:
            known = {"crater": rank, "detectable": True, "clean": False, **dict.fromkeys(ERRORS, error)}
        builder.add("detections", **key, rank=rank, confidence=0.5, kept=kept, duplicate=False, **ELLIPSE, **known)


@pytest.fixture
def detectors(tmp_path):
    """Three images with 4, 2 and no detectable craters; ``shy`` refuses the second, ``keen`` raises on the third."""
    builder = RunBuilder(tmp_path / "run")
    for trial, there in enumerate((4, 2, 0)):
        counts = {"n_craters": 9, "n_detectable": there, "n_clean": 0}
        builder.add("crater_images", trial=trial, scenario=SCENARIO, phase_deg=50.0, **counts)
    first = row(builder, "shy", 0)
    detections(builder, first, [0.2], 0)
    detections(builder, first, [0.9], 3, kept=False)
    row(builder, "shy", 1, "failed")
    row(builder, "shy", 2)
    detections(builder, row(builder, "keen", 0), [0.1, 0.3, 0.8], 1)
    detections(builder, row(builder, "keen", 1), [0.5], 3)
    row(builder, "keen", 2, "error")
    return builder.write(estimators=["shy", "keen"])


def median_of(found, estimator):
    subject = next(one for one in found.subjects if one.estimator == estimator)
    return subject.solved[0].value, subject.counted[0].value, subject.n_ok, subject.n


@pytest.mark.parametrize(
    ("metric", "shy", "keen"),
    [
        # Its third image has no crater to be missed: left out. The refused one counts as worse than any.
        ("missed_share", (75.0, np.inf, 1, 2), ((25.0 + 50.0) / 2, 50.0, 2, 3)),
        ("false_alarm_share", (0.0, np.inf, 1, 2), ((25.0 + 75.0) / 2, 75.0, 2, 3)),
        ("centre_error_px", (0.2, np.inf, 1, 2), ((0.3 + 0.5) / 2, 0.5, 2, 3)),
    ],
)
def test_detectors_are_compared_image_by_image(detectors, metric, shy, keen):
    found = compare_runs([detectors], metric)
    assert median_of(found, "shy") == pytest.approx(shy)
    assert median_of(found, "keen") == pytest.approx(keen)
    (contrast,) = found.contrasts
    assert (contrast.first[0], contrast.n_both, contrast.n) == ("keen", 1, 2)


def test_centres_are_compared_over_the_craters_that_both_found(detectors):
    """One crater of the first image, none of the second, which one method refused; the third ended in an error."""
    found = compare_runs([detectors], "common_centre_error_px")
    assert median_of(found, "shy") == pytest.approx((0.2, 0.2, 1, 1))
    assert median_of(found, "keen") == pytest.approx((0.1, np.inf, 1, 2))
    (contrast,) = found.contrasts
    assert contrast.median.value == pytest.approx(-0.1)


def test_what_is_left_out_is_said_and_the_missed_share_comes_first(detectors, tmp_path):
    found = compare_runs([detectors])
    assert found.metric.name == "missed_share"
    assert list(trial_numbers(read_run(detectors))) == [
        "missed_share",
        "false_alarm_share",
        "centre_error_px",
        "common_centre_error_px",
    ]
    text = write_comparison(found, tmp_path / "out")[0].with_suffix(".md").read_text()
    assert "Left out: trials without a crater to go by, 1 of 6" in text
    assert "negative is better" in text
    assert "failures worst" in text


def test_a_pair_without_common_craters_is_no_failure_of_a_matcher(tmp_path):
    builder = RunBuilder(tmp_path / "run")
    for trial, (common, correct, wrong) in enumerate(((10, 8, 2), (5, 5, 0), (0, 0, 0))):
        key = row(builder, "vote", trial, "ok" if common else "failed")
        counts = {"n_common": common, "n_correct": correct, "n_wrong": wrong, "n_missed": common - correct}
        builder.add("crater_matches", **key, view_deg=5.0, sun_deg=9.0, epipolar_offset_px=1.0, **counts)
    run = builder.write(estimators=["vote"])
    assert median_of(compare_runs([run]), "vote") == (10.0, 10.0, 2, 2)
    assert median_of(compare_runs([run], "wrong_share"), "vote") == (10.0, 10.0, 2, 2)


def test_counts_are_neither_better_nor_worse(tmp_path):
    builder = RunBuilder(tmp_path / "run")
    for estimator, landmarks in {"base": (300, 310, 290), "strict": (200, 190, None)}.items():
        for trial, count in enumerate(landmarks):
            key = row(builder, estimator, trial, "failed" if count is None else "ok")
            if count is not None:
                builder.add("diagnostics", **key, name="candidates", value=9000.0)
                builder.add("diagnostics", **key, name="landmarks", value=float(count))
    found = compare_runs([builder.write(estimators=["base", "strict"], campaign={"experiment": "landmark-database"})])
    assert found.metric.name == "landmarks"
    (contrast,) = found.contrasts
    assert contrast.median.value == -110.0
    assert (contrast.p_of_all, contrast.better_of_all.value) == (None, None)
    _, grids = write_comparison(found, tmp_path / "out")
    assert "less %" in grids[1].columns
    for words in ("better", "worst", "of all", "Of all"):
        assert all(words not in grid.markdown() for grid in grids)
    assert set(pd.read_csv(tmp_path / "out" / "subjects.csv")["trials"]) == {"all", "solved"}


@pytest.mark.parametrize(
    ("experiment", "first"),
    [
        ("crater-detection", "missed_share"),
        ("crater-matching", "missed_share"),
        ("landmark-database", "landmarks"),
        ("image-survey", "detections_an_image"),
        ("single-image", "position_error_m"),
    ],
)
def test_the_metrics_known_before_a_run_are_those_of_its_kind(experiment, first):
    names = kind_schema(experiment).metrics
    assert names[0] == first
    assert ("position_error_m" in names) == (experiment == "single-image")
