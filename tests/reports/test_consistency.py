"""Covariances and bounds held against errors whose distribution is known."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2, kstest
from stored_runs import RunBuilder, find, pose_error

from boresight.reports.pages.content import covariance_line
from boresight.reports.run.data import read_run
from boresight.reports.run.outcomes import revolution_ends
from boresight.reports.statistics.consistency import (
    BAND,
    INSIDE,
    NEES,
    RATIO,
    SIGHT_NEES,
    WRONG,
    NormalisedErrors,
    consistency_grid,
    consistency_records,
    consistent_mean,
    normalised_errors,
    rms_ratio,
)

TRIALS = 400


def store(builder: RunBuilder, scale: float, known: bool = True):
    """Store trials whose errors are ``scale`` times what their covariance says; the first one failed."""
    rng = np.random.default_rng(11)
    for trial in range(TRIALS):
        error = rng.normal(size=6) * scale
        sigma_m = float(rng.uniform(1.0, 3.0))
        final = pose_error(error[:3] * sigma_m / np.sqrt(3.0), 0.5)
        prior = {f"prior_{key}": value for key, value in pose_error(np.array([50.0, 0.0, 0.0]), 2.0).items()}
        told = {
            "nees": float(error @ error) if known else np.nan,
            "position_sigma_m": sigma_m if known else np.nan,
            "attitude_sigma_deg": 0.25 if known else np.nan,
            "position_bound_m": np.nan,
            "attitude_bound_deg": 0.5 if known else np.nan,
        }
        builder.add(
            "rows", trial=trial, scenario="rock", estimator="landmark-harris", reason="", image="", n_landmarks=9,
            status="ok" if trial else "failed", **prior, **final, **told,
        )  # fmt: skip
    builder.write(scenarios={"rock": {}}, report=None)
    return read_run(builder.folder)


def value(records, measure, statistic):
    found = find(records, scenario="rock", estimator="landmark-harris", measure=measure, statistic=statistic)
    assert found is not None
    return found


def test_a_true_covariance_is_found_true(builder):
    records = consistency_records(store(builder, 1.0))
    mean, band = value(records, NEES, "mean"), value(records, NEES, BAND)
    assert band.low < mean.value < band.high
    assert mean.n_ok == TRIALS - 1
    assert mean.n == TRIALS
    assert value(records, NEES, INSIDE).value == pytest.approx(0.95, abs=0.03)
    assert value(records, "position_over_sigma", RATIO).value == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(("scale", "word"), [(0.5, ", too large"), (1.0, ""), (2.0, ", too small")])
def test_the_top_of_the_page_says_whether_covariances_hold(builder, scale, word):
    run = store(builder, scale)
    mean = float(run.rows["nees"][1:].mean()) / 6.0
    found = re.fullmatch(r"mean NEES .*: landmark-harris (\S+) \[(\S+), (\S+)\](.*)", covariance_line(run))
    assert float(found[1]) == pytest.approx(mean, rel=0.005) and float(found[2]) < mean < float(found[3])
    assert found[4] == word


def test_without_covariances_the_page_says_nothing_of_them(builder):
    assert covariance_line(store(builder, 1.0, known=False)) == ""


@pytest.mark.parametrize(("attitude_deg", "expected"), [(0.5, None), (2.0, 2)])
def test_methods_that_keep_the_attitude_are_held_to_the_line_of_sight(builder, attitude_deg, expected):
    rng = np.random.default_rng(4)
    for trial in range(50):
        prior = {f"prior_{key}": value for key, value in pose_error(np.array([50.0, 0.0, 0.0]), 2.0).items()}
        builder.add(
            "rows", trial=trial, scenario="rock", estimator="landmark-harris", reason="", image="", n_landmarks=0,
            status="ok", nees=6.0, sight_nees=rng.chisquare(2), **prior, **pose_error(np.ones(3), attitude_deg),
        )  # fmt: skip
    builder.write(scenarios={"rock": {}}, report=None)
    kinds = {kind.name: kind for kind in normalised_errors(read_run(builder.folder))}
    assert kinds[NEES].expected == 6
    assert (kinds[SIGHT_NEES].expected if SIGHT_NEES in kinds else None) == expected


def test_a_covariance_that_is_too_small_shows(builder):
    records = consistency_records(store(builder, 2.0))
    assert value(records, NEES, "mean").low > value(records, NEES, BAND).high
    assert value(records, NEES, "mean").value == pytest.approx(24.0, rel=0.1)
    assert value(records, NEES, INSIDE).value == pytest.approx(chi2.cdf(chi2.ppf(0.95, 6) / 4.0, 6), abs=0.06)
    assert value(records, "position_over_sigma", RATIO).value == pytest.approx(2.0, rel=0.1)
    assert value(records, "attitude_over_sigma", RATIO).value == pytest.approx(2.0)
    assert value(records, "attitude_over_bound", RATIO).value == pytest.approx(1.0)


def test_answers_that_are_worse_than_the_prior_and_sure_are_counted(builder):
    """The prior is 50 m off; of 400 trials some are 20 times as far off as their covariance says."""
    run = store(builder, 20.0)
    solved = run.rows[run.rows["status"] == "ok"]
    wrong = (solved["position_error_m"] > 50.0) & (solved["nees"] > 30.0)
    assert 0.02 < wrong.mean() < 0.98
    assert value(consistency_records(run), NEES, WRONG).value == pytest.approx(wrong.mean())


def test_errors_that_are_known_to_be_none_have_no_ratio(builder):
    run = store(builder, 1.0)
    run.rows[["position_sigma_m", "attitude_sigma_deg"]] = 0.0
    names = {record.measure for record in consistency_records(run)}
    assert names == {NEES, "attitude_over_bound"}


def test_what_is_not_told_is_not_tabulated(builder):
    assert consistency_grid(consistency_records(store(builder, 1.0, known=False))) is None


def test_the_table_has_a_line_and_no_invented_bound(builder):
    grid = consistency_grid(consistency_records(store(builder, 1.0)))
    [row] = grid.rows
    assert "position, RMS over bound" not in grid.columns
    assert row[grid.columns.index("band")] == "5.66 to 6.34"


def test_the_band_holds_the_means_of_many_samples():
    """Against drawn sums of squares: 95 % of the means of 50 lie in the band."""
    means = (np.random.default_rng(2).normal(size=(4000, 50, 6)) ** 2).sum(axis=2).mean(axis=1)
    band = consistent_mean(300, 6)
    low, high = band.low, band.high
    assert np.mean((means > low) & (means < high)) == pytest.approx(0.95, abs=0.015)
    assert kstest(50 * means, chi2(300).cdf).pvalue > 1e-3


def test_the_interval_of_a_ratio_is_that_of_resampled_ratios():
    """Against the plain bootstrap of the ratio itself."""
    rng = np.random.default_rng(5)
    sigma = rng.uniform(1.0, 2.0, 500)
    error = sigma * np.abs(rng.normal(size=500))
    found = rms_ratio(error, sigma, np.arange(500))
    draws = rng.integers(0, 500, (4000, 500))
    ratios = np.sqrt((error[draws] ** 2).mean(axis=1) / (sigma[draws] ** 2).mean(axis=1))
    assert (found.low, found.high) == pytest.approx(tuple(np.percentile(ratios, [2.5, 97.5])), abs=0.01)


def test_the_nis_is_held_against_its_degrees_of_freedom():
    """Drawn chi-squares of 40 to 400 degrees: the mean lies in the band, and 95 % of the trials in theirs."""
    rng = np.random.default_rng(13)
    degrees = rng.integers(40, 400, 3000)
    ratios = rng.chisquare(degrees) / degrees
    found = NormalisedErrors("innovation", 1, pd.DataFrame({"ratio": ratios, "degrees": degrees})).test(np.arange(3000))
    assert found[BAND].value == 1.0
    assert found[BAND].low < found["mean"].value < found[BAND].high
    assert found[INSIDE].value == pytest.approx(0.95, abs=0.012)
    # Weighted by degrees the mean is chi-square of them all; by trials its spread is at least that.
    assert found[BAND].high - found[BAND].low == pytest.approx(2 * 1.96 * np.sqrt(2 / degrees.sum()), rel=0.01)


def test_realisations_of_one_image_widen_the_band():
    ratios = np.full(40, 6.0)
    errors = NormalisedErrors(NEES, 6, pd.DataFrame({"ratio": ratios, "degrees": ratios}))
    alone, shared = (errors.test(np.arange(40) // n) for n in (1, 4))
    assert shared[BAND].high - 6 == pytest.approx(2 * (alone[BAND].high - 6), rel=0.1)


def test_sequences_are_judged_after_whole_revolutions(builder):
    """Positions of three axes: one estimator tells its errors truly, one of half their size, one nothing."""
    rng = np.random.default_rng(3)
    nothing = {f"{prefix}{name}": np.nan for prefix in ("", "prior_") for name in pose_error(np.zeros(3), 0)}
    for label, scale in (("true", 1.0), ("bold", 2.0), ("silent", np.nan)):
        for trial in range(300):
            key = {"trial": trial, "scenario": "rock", "estimator": label}
            builder.add("rows", **key, **nothing, status="ok", reason="", image="", n_landmarks=9, nees=np.nan)
            for angle in (0.0, 180.0, 360.0):
                nees = float(np.sum((scale * rng.normal(size=3)) ** 2))
                builder.add("epochs", **key, frame=int(angle), anomaly_deg=angle, position_error_m=1.0, nees=nees,
                            landmark_rmse_m=1.0, settled_landmark_rmse_m=1.0)  # fmt: skip
    run = read_run(builder.write(scenarios={"rock": {}}, estimators=["true", "bold", "silent"]))
    assert [kind.name for kind in normalised_errors(run)] == ["nees_after_1"]
    assert [(k, set(ends["anomaly_deg"])) for k, ends in revolution_ends(run.table("epochs"))] == [(1, {360.0})]
    grid = consistency_grid(consistency_records(run))
    assert [row[1] for row in grid.rows] == ["bold", "true"]
    records = {r.estimator: r for r in consistency_records(run) if r.statistic == "mean"}
    assert records["true"].value == pytest.approx(3.0, abs=0.4)
    assert records["bold"].value == pytest.approx(12.0, abs=1.6)
    assert grid.rows[0][2] == "NEES of the position after 1 revolution (3.00 expected)"
    assert len(grid.columns) == 6, "columns of poses are left out"
