"""Numbers that tell bad solutions: scipy's Mann-Whitney statistic, closed forms, Hanley and McNeil."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import mannwhitneyu, norm

from boresight.reports.pages.build import write_report
from boresight.reports.run.data import read_run
from boresight.reports.statistics.roc import (
    ABOVE_MEDIANS,
    ABOVE_PRIOR,
    AUC,
    BAD,
    MEASURE,
    THRESHOLD,
    TRUE_POSITIVES,
    OutlierScore,
    area,
    large_sample_area,
    measured_area,
    operating_point,
    outlier_grid,
    outlier_records,
    outlier_scores,
    roc_curve,
)

GOOD_ERROR, BAD_ERROR, PRIOR = (10.0, 0.0, 0.0), (80.0, 0.0, 0.0), ((50.0, 0.0, 0.0), 1.0)


def sample(seed, good=300, bad=60, shift=1.2, digits=8):
    rng = np.random.default_rng(seed)
    score = np.round(np.concatenate([rng.normal(size=good), rng.normal(shift, size=bad)]), digits)
    return score, np.repeat([False, True], [good, bad])


def outlier_score(score, bad):
    return OutlierScore("scene", "estimator", "score", ABOVE_PRIOR, score, bad, np.arange(len(score)))


@pytest.mark.parametrize("digits", [8, 1, 0], ids=["no ties", "some ties", "many ties"])
def test_the_area_is_that_of_mann_and_whitney(digits):
    score, bad = sample(1, digits=digits)
    statistic = mannwhitneyu(score[bad], score[~bad]).statistic / (bad.sum() * (~bad).sum())
    assert area(score, bad) == pytest.approx(statistic, abs=1e-12)
    false, true, _ = roc_curve(score, bad)
    assert np.trapezoid(true, false) == pytest.approx(statistic, abs=1e-12)


def test_each_point_of_the_curve_is_what_its_threshold_flags():
    score, bad = sample(2, digits=1)
    false, true, thresholds = roc_curve(score, bad)
    assert (false[0], true[0], false[-1], true[-1]) == (0.0, 0.0, 1.0, 1.0)
    for x, y, threshold in zip(false, true, thresholds, strict=True):
        assert x == np.mean(score[~bad] >= threshold)
        assert y == np.mean(score[bad] >= threshold)


def test_two_normal_laws_have_the_area_of_the_closed_form():
    score, bad = sample(3, good=40_000, bad=40_000)
    assert area(score, bad) == pytest.approx(norm.cdf(1.2 / np.sqrt(2.0)), abs=0.005)


def test_the_interval_is_as_wide_as_that_of_hanley_and_mcneil():
    score, bad = sample(4)
    found = measured_area(outlier_score(score, bad))
    a, n_bad, n_good = found.value, 60, 300
    q1, q2 = a / (2.0 - a), 2.0 * a * a / (1.0 + a)
    variance = (a * (1 - a) + (n_bad - 1) * (q1 - a * a) + (n_good - 1) * (q2 - a * a)) / (n_bad * n_good)
    assert (found.high - found.low) / (2 * 1.96 * np.sqrt(variance)) == pytest.approx(1.0, abs=0.25)
    assert found.low < a < found.high


def test_the_operating_point_flags_five_percent_of_the_good():
    score, bad = sample(5, good=2000, bad=2000)
    for sign in (1.0, -1.0):
        found = outlier_score(sign * score, bad)
        assert found.low_is_bad is (sign < 0)
        true, threshold = operating_point(found)
        beyond = sign * found.score >= sign * threshold
        assert np.mean(beyond[bad]) == true
        assert 0.045 < np.mean(beyond[~bad]) <= 0.05
        assert true == pytest.approx(norm.sf(norm.isf(0.05) - 1.2), abs=0.03)


@pytest.fixture
def run(builder):
    """100 solutions, 20 of them worse than their prior; one score tells them, one is chance, one never changes."""
    rng = np.random.default_rng(6)
    for trial in range(100):
        bad = trial % 5 == 0
        builder.trial(trial, PRIOR, (BAD_ERROR if bad else GOOD_ERROR, 0.5))
        builder.trial(trial, PRIOR, PRIOR, estimator="prior")
        key = {"trial": trial, "scenario": "itokawa", "estimator": "landmark-harris"}
        builder.add("diagnostics", **key, name="centroid_residual_px", value=rng.normal(3.0 if bad else 1.0, 0.8))
        builder.add("diagnostics", **key, name="chance", value=rng.normal())
        builder.add("diagnostics", **key, name="always", value=1.0)
    builder.trial(100, PRIOR, None, reason="no landmarks")
    return builder.write()


def test_scores_are_judged_over_the_solutions(run):
    found = list(outlier_scores(read_run(run)))
    assert [(d.name, d.definition) for d in found] == [
        (name, definition) for name in ("centroid_residual_px", "chance") for definition in (ABOVE_PRIOR, ABOVE_MEDIANS)
    ]
    assert all((len(d.bad), d.bad.sum()) == (100, 20) for d in found)
    records = {(r.measure, r.stage, r.statistic): r for r in outlier_records(read_run(run))}
    told = records[MEASURE + "centroid_residual_px", ABOVE_PRIOR, AUC]
    chance = records[MEASURE + "chance", ABOVE_PRIOR, AUC]
    assert told.low > 0.85
    assert chance.low < 0.5 < chance.high
    assert records[MEASURE + "chance", ABOVE_PRIOR, BAD].value == 20
    assert 1.0 < records[MEASURE + "centroid_residual_px", ABOVE_PRIOR, THRESHOLD].value < 3.5
    assert records[MEASURE + "centroid_residual_px", ABOVE_PRIOR, TRUE_POSITIVES].value > 0.5
    row = next(row for row in outlier_grid(list(records.values())).rows if row[3] == "centroid_residual_px")
    assert (row[4].split("/")[0], row[-1]) == ("20", "above")


def test_too_few_bad_solutions_are_not_judged(builder):
    for trial in range(50):
        builder.trial(trial, PRIOR, (BAD_ERROR if trial < 4 else GOOD_ERROR, 0.5))
        key = {"trial": trial, "scenario": "itokawa", "estimator": "landmark-harris"}
        builder.add("diagnostics", **key, name="chi2", value=float(trial))
    assert list(outlier_scores(read_run(builder.write()))) == []


def test_the_report_shows_table_and_figure(run):
    files = write_report(run)
    assert "Bad solutions, and the numbers that indicate them" in files.markdown.read_text()
    table = pd.read_csv(files.folder / "table.csv")
    assert {AUC, TRUE_POSITIVES, THRESHOLD, BAD} <= set(table["statistic"])
    assert any(path.name.startswith("outliers_") for path in files.figures)


def test_the_interval_of_many_trials_is_that_of_their_bootstrap():
    """The variance of ranks against resampling, on normal scores whose area is known: Phi(1 / sqrt 2)."""
    rng = np.random.default_rng(4)
    bad = rng.random(2000) < 0.2
    score = rng.normal(size=2000) + bad
    low, high = large_sample_area(score, bad)
    resampled = measured_area(OutlierScore("s", "e", "n", "d", score, bad, np.arange(2000)))
    assert low == pytest.approx(resampled.low, abs=0.004)
    assert high == pytest.approx(resampled.high, abs=0.004)
    assert low < norm.cdf(np.sqrt(0.5)) < high
