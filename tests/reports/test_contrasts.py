"""Ratios of mean errors between estimators, and reductions between scenarios, against numbers worked out by hand."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest
from stored_runs import find

from boresight.reports.kinds.sequence import cycle_ratio_records, ratio_records, reduction_records
from boresight.reports.published import Comparison, PublishedValue
from boresight.reports.run.data import RunData
from boresight.reports.statistics.measured import timing_measures
from boresight.reports.statistics.paired import BETTER, SIGN_TEST

RNG = np.random.default_rng(5)
COMMON = RNG.gamma(3.0, 2.0, 200)


def run_of(errors):
    """A run whose rows hold errors by (scenario, estimator), as far as these records read one."""
    rows = pd.concat(
        pd.DataFrame(
            {"scenario": s, "estimator": e, "trial": np.arange(len(v)), "error_after_1_m": v, "error_after_2_m": np.nan}
        )
        for (s, e), v in errors.items()
    ).assign(image="", database=np.nan)
    manifest = SimpleNamespace(scenarios={s: {"name": s} for s, _ in errors}, grid=None)
    return RunData(Path("run"), manifest, rows, {"epochs": rows})


def means(run):
    return [r for r in ratio_records(run) if r.statistic == "mean"]


def test_the_ratio_of_two_estimators_is_paired():
    run = run_of({("a", "one"): 2.0 * COMMON, ("a", "two"): COMMON})
    records = {(r.estimator, r.reference): r for r in means(run)}
    assert set(records) == {("one", "two"), ("two", "one")}  # no second revolution, no record of it
    record = records["one", "two"]
    assert (record.value, record.low, record.high) == pytest.approx((2.0, 2.0, 2.0))  # what is common cancels
    assert records["two", "one"].value == pytest.approx(0.5)


def test_trials_without_an_error_are_counted_out():
    holes = COMMON.copy()
    holes[:30] = np.nan
    record = means(run_of({("a", "one"): holes, ("a", "two"): COMMON}))[0]
    assert (record.n_ok, record.n) == (170, 200)
    assert record.value == pytest.approx(1.0)


@pytest.mark.parametrize("against", ["b", "two"])
def test_a_reduction_is_from_a_scenario_or_from_an_estimator(against):
    other = ("b", "one") if against == "b" else ("a", "two")
    before, after = COMMON, 0.4 * RNG.permutation(COMMON)
    published = PublishedValue(
        scenario="a", estimator="one", against=against, measure="error_after_1_reduction", stage="reduction",
        statistic="mean", printed="60 %", tolerance=10, place="here",
    )  # fmt: skip
    run = run_of({("a", "one"): after, other: before})
    (record,) = reduction_records(run, Comparison(conditions="", values=(published,)))
    assert record.value == pytest.approx(60.0)
    # The delta method's deviation of a ratio of two independent means with the same relative scatter.
    sigma = 100 * 0.4 * np.sqrt(2.0 / len(COMMON)) * COMMON.std() / COMMON.mean()
    assert (record.high - record.low) / (2 * 1.96 * sigma) == pytest.approx(1.0, abs=0.15)
    assert record.unit == "%"


def test_the_ratio_of_cycle_times_is_that_of_the_trials_that_compile_nothing():
    """The first of seven trials compiles for 0.4 s a cycle, and the last of one estimator failed: it has no time."""
    run = run_of({("a", "one"): COMMON[:7], ("a", "two"): COMMON[:7]})
    times = {"one": [0.4, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3], "two": [6e-3] * 7}
    rows = [
        {"scenario": "a", "estimator": name, "trial": trial, "stage": "cycle", "seconds": seconds}
        for name, own in times.items()
        for trial, seconds in enumerate(own)
    ]
    run = RunData(run.folder, run.manifest, run.rows, {**run.tables, "timings": pd.DataFrame(rows)})
    ratio = next(record for record in cycle_ratio_records(run) if record.estimator == "one")
    assert (ratio.value, ratio.statistic, ratio.n_ok, ratio.n) == (pytest.approx(0.75), "median", 6, 6)
    timed = find(timing_measures(run), estimator="one", stage="cycle", statistic="median")
    assert (timed.value, timed.n_ok, timed.n) == (pytest.approx(4.5e-3), 6, 7)


def test_the_sign_test_is_over_trials():
    two = COMMON + np.where(np.arange(200) < 130, 1.0, -1.0)
    found = {(r.estimator, r.statistic): r for r in ratio_records(run_of({("a", "one"): COMMON, ("a", "two"): two}))}
    share, chance = found["one", BETTER], found["one", SIGN_TEST]
    assert (share.value, share.n_ok) == (130 / 200, 200)
    assert chance.value == pytest.approx(binomtest(130, 200).pvalue)
    assert found["two", BETTER].value == 70 / 200
