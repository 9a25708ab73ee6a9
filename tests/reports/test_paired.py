"""Estimators on the same trials: hand-made differences, scipy's tests, McNemar's variance by simulation."""

import numpy as np
import pytest
from scipy.stats import binom, binomtest, ttest_1samp

from boresight.reports.pages.build import write_report
from boresight.reports.run.data import read_run
from boresight.reports.run.outcomes import succeeded
from boresight.reports.statistics.measured import MEDIAN
from boresight.reports.statistics.paired import (
    BETTER,
    DIFFERENCE,
    FAILURE_RATE,
    OWN,
    PAIRED,
    SIGN_TEST,
    THEIRS,
    paired_records,
)

PRIOR = ((40.0, 0.0, 0.0), 1.0)


def error(position_m, attitude_deg):
    return ((float(position_m), 0.0, 0.0), float(attitude_deg))


def fill(builder, base, other, images=None, **manifest):
    """Write a run of the estimators ``base`` and ``another``, which comes first by the alphabet alone."""
    for trial, (first, second) in enumerate(zip(base, other, strict=True)):
        image = "" if images is None else images[trial]
        builder.trial(trial, PRIOR, PRIOR, estimator="prior", image=image)
        builder.trial(trial, PRIOR, first, estimator="base", image=image)
        builder.trial(trial, PRIOR, second, estimator="another", image=image)
    return read_run(builder.write(estimators=["prior", "base", "another"], **manifest))


def by_key(run):
    records = paired_records(run)
    assert {(r.estimator, r.reference, r.stage) for r in records} == {("another", "base", PAIRED)}
    return {(r.measure, r.statistic): r for r in records}


def test_differences_are_those_of_trials_that_both_solved(builder):
    base = [error(20, 0.5), error(30, 0.6), None, error(10, 0.2), error(25, 0.4)]
    other = [error(15, 0.6), error(10, 0.1), error(5, 0.1), error(12, 0.3), None]
    found = by_key(fill(builder, base, other))
    position, attitude = found["position_difference_m", MEDIAN.name], found["attitude_difference_deg", MEDIAN.name]
    assert (position.value, position.n_ok, position.n, position.unit) == (-5.0, 3, 5, "m")
    assert attitude.value == pytest.approx(0.1)
    assert found["position_difference_m", BETTER].value == pytest.approx(2 / 3)
    assert found["attitude_difference_deg", BETTER].value == pytest.approx(1 / 3)


def test_the_sign_test_is_the_binomial_of_the_signs(builder):
    rng = np.random.default_rng(1)
    base, other = rng.uniform(10, 30, 80), rng.uniform(7, 27, 80)
    found = by_key(fill(builder, [error(x, 1) for x in base], [error(x, 1) for x in other]))
    better = int((other < base).sum())
    tail = binom.cdf(min(better, 80 - better), 80, 0.5)
    assert found["position_difference_m", SIGN_TEST].value == pytest.approx(2.0 * tail)
    share = found["position_difference_m", BETTER]
    assert share.low < share.value == better / 80 < share.high
    # Equal attitudes decide nothing.
    assert found["attitude_difference_deg", SIGN_TEST].value is None


# Ten realisations of each image: which trials are better, of how many, as how many these count, and the sign test.
REALISATIONS = {
    "two images of three: Student's t over 1, 1 and 0": (
        lambda t: t < 20,
        30,
        30,
        ttest_1samp([1.0, 1.0, 0.0], 0.5).pvalue,
    ),
    "six images of eight, each counted once": (lambda t: t < 60, 80, 8, binomtest(6, 8).pvalue),
    "six of ten of either image: Student's t would be certain": (
        lambda t: t % 10 < 6,
        20,
        20,
        binomtest(12, 20).pvalue,
    ),
}


@pytest.mark.parametrize("case", REALISATIONS)
def test_realisations_are_no_more_than_their_images_nor_than_their_trials(builder, case):
    better, trials, independent, chance = REALISATIONS[case]
    other = [error(19 if better(trial) else 25, 1) for trial in range(trials)]
    run = fill(builder, [error(20, 1)] * trials, other, [f"{trial // 10}.png" for trial in range(trials)])
    test = by_key(run)["position_difference_m", SIGN_TEST]
    assert (test.value, test.n_ok) == (pytest.approx(chance), independent)


def test_failures_count_missing_and_worse_solutions(builder):
    base = [error(20, 1), error(50, 1), None, error(39, 1)]
    other = [error(20, 1), error(20, 1), None, error(41, 1)]
    run = fill(builder, base, other)
    np.testing.assert_array_equal(succeeded(run.of("itokawa", "base")), [True, False, False, True])
    found = by_key(run)
    assert found[FAILURE_RATE, OWN].value == 0.5
    assert found[FAILURE_RATE, THEIRS].value == 0.5
    assert found[FAILURE_RATE, DIFFERENCE].value == 0.0
    assert found[FAILURE_RATE, OWN].low < 0.5 < found[FAILURE_RATE, OWN].high


def test_the_interval_of_the_failure_rates_difference_is_that_of_a_simulation(builder):
    """400 trials with 12 % and 7 % of failures that go together: the spread of 4,000 drawn differences."""
    rng = np.random.default_rng(3)

    def draw(n):
        hard = rng.random(n)
        return hard < 0.06, hard < 0.12 - 0.05 * (rng.random(n) < 0.5)

    ours, theirs = draw(400)
    found = by_key(fill(builder, [error(50 if f else 9, 1) for f in theirs], [error(50 if f else 8, 1) for f in ours]))
    record = found[FAILURE_RATE, DIFFERENCE]
    assert record.value == pytest.approx(ours.mean() - theirs.mean())
    assert (found[FAILURE_RATE, OWN].value, found[FAILURE_RATE, THEIRS].value) == (ours.mean(), theirs.mean())
    drawn = [np.subtract(*(failed.mean() for failed in draw(400))) for _ in range(4000)]
    assert (record.high - record.low) / (2 * 1.96 * np.std(drawn)) == pytest.approx(1.0, abs=0.25)


def test_one_estimator_is_compared_with_nothing(builder):
    for trial in range(3):
        builder.trial(trial, PRIOR, PRIOR, estimator="prior")
        builder.trial(trial, PRIOR, error(9, 1))
    assert paired_records(read_run(builder.write())) == []


@pytest.mark.usefixtures("undrawn")
def test_the_report_tabulates_pairs(builder):
    rng = np.random.default_rng(4)
    base, other = rng.uniform(10, 30, 60), rng.uniform(2, 9, 60)
    run = fill(builder, [error(x, 1) for x in base], [error(x, 0.5) for x in other])
    text = write_report(run.folder).markdown.read_text()
    line = next(line for line in text.splitlines() if line.startswith("| itokawa | another | base | 60/60 | -"))
    assert line.count("< 0.001") == 2
