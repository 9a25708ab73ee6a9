import warnings

import numpy as np
import pytest
from scipy.stats import binomtest

from boresight.reports.statistics.intervals import content_rng
from boresight.reports.statistics.measured import (
    MEAN,
    MEDIAN,
    P95,
    P99,
    RMS,
    ROOT_MEDIAN_SQUARE,
    Measured,
    Sample,
    Statistic,
    measure,
    measure_share,
    share_of,
)
from boresight.reports.statistics.paired import rate_difference, sign_test

ALL = (MEDIAN, MEAN, RMS, ROOT_MEDIAN_SQUARE, P95)


def test_statistics_of_a_hand_computed_sample():
    values = np.array([-3.0, 1.0, 2.0, 4.0])
    assert MEDIAN.of(values) == 1.5
    assert RMS.of(values) == pytest.approx(np.sqrt(30 / 4))
    assert ROOT_MEDIAN_SQUARE.of(values) == pytest.approx(np.sqrt((4 + 9) / 2))  # squares 1, 4, 9, 16


@pytest.mark.parametrize(
    ("statistic", "expected"),
    [
        (MEDIAN, np.log(2)),
        (MEAN, 1.0),
        (RMS, np.sqrt(2)),
        (ROOT_MEDIAN_SQUARE, np.log(2)),
        (P95, np.log(20)),
    ],
)
def test_statistics_of_an_exponential_sample_approach_their_closed_forms(statistic, expected):
    values = np.random.default_rng(1).exponential(size=200_000)
    assert statistic.of(values) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("labels", [["a"] * 6, [7] * 6])
def test_one_cluster_gives_a_value_without_an_interval(labels):
    measured = measure(np.arange(6.0), np.array(labels), (MEDIAN, MEAN, RMS, ROOT_MEDIAN_SQUARE))
    assert all(m.value is not None and m.low is None and m.high is None for m in measured)


def test_no_values_give_nothing_and_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert measure(np.empty(0), np.empty(0), ALL) == [Measured(None)] * len(ALL)


def test_same_content_gives_the_same_interval_and_other_content_another():
    values = np.random.default_rng(6).normal(size=50)
    clusters = np.arange(50)
    assert measure(values, clusters, ALL) == measure(values.copy(), clusters, ALL)
    assert content_rng(values).random() != content_rng(values + 1e-12).random()


def test_inputs_are_not_changed():
    values, clusters = np.array([3.0, -1.0, 2.0]), np.array(["b", "a", "b"])
    before = values.copy(), clusters.copy()
    measure(values, clusters, ALL)
    np.testing.assert_array_equal(values, before[0])
    np.testing.assert_array_equal(clusters, before[1])


@pytest.mark.parametrize(
    ("statistic", "least"), [(MEDIAN, 1), (Statistic("90 %", 0.9), 10), (P95, 20), (P99, 100), (MEAN, 1)]
)
def test_a_quantile_beyond_which_less_than_one_value_is_expected_has_none(statistic, least):
    values = np.arange(1.0, 101.0)
    assert measure(values[:least], np.arange(least), (statistic,))[0].value is not None
    if least > 1:
        assert measure(values[: least - 1], np.arange(least - 1), (statistic,)) == [Measured(None)]


def test_a_share_that_never_failed_has_an_interval_of_how_often_it_may():
    """Wilson's of 60 of 60 is [93.98, 100]; four clusters of fifteen tell of four alone."""
    yes = np.ones(60)
    alone = measure_share(yes, np.ones(60), np.arange(60))
    assert (alone.value, alone.low, alone.high) == (100.0, pytest.approx(93.98, abs=0.01), 100.0)
    of_images = measure_share(yes, np.ones(60), np.arange(60) // 15)
    assert of_images.low == pytest.approx(51.01, abs=0.01)
    assert measure_share(np.zeros(60), np.full(60, 7.0), np.arange(60)).high == pytest.approx(6.02, abs=0.01)
    assert measure_share(np.zeros(2), np.zeros(2), np.arange(2)).value is None


def test_a_share_of_independent_trials_has_wilsons_interval():
    """Of 47 of 60: [66.4, 86.9]."""
    found = measure_share(np.arange(60) < 47.0, np.ones(60), np.arange(60))
    assert (found.low, found.high) == (pytest.approx(66.4, abs=0.1), pytest.approx(86.9, abs=0.1))


def test_a_share_of_few_clusters_stays_a_share():
    found = measure_share(np.array([10.0, 10.0, 9.0]), np.full(3, 10.0), np.arange(3))
    assert 0.0 <= found.low < found.value < found.high <= 100.0


def test_a_share_of_trials_is_bounded_by_trials_where_all_of_every_cluster_succeed():
    """Nothing tells then how alike trials of a data base are; 100 of 100 is Wilson's [96.3, 100] in all tables."""
    data_base = np.arange(100) % 5
    named = np.array([f"data base {number}" for number in data_base])
    assert share_of(np.ones(100, dtype=bool), named).low == pytest.approx(0.963, abs=0.001)
    alike, apart = share_of(data_base < 1, np.arange(100)), share_of(data_base < 1, data_base)
    assert apart.low < alike.low < alike.value == apart.value == 0.2 < alike.high < apart.high


def test_noise_realisations_that_agree_are_as_many_as_their_images():
    """Three images, two realisations each, all alike: three yes of three, not six of six."""
    image, yes, no = np.repeat(["a.png", "b.png", "c.png"], 2), np.ones(6, dtype=bool), np.zeros(6, dtype=bool)
    found = share_of(yes, image)
    assert (found.low, found.high) == (binomtest(3, 3).proportion_ci(method="wilson").low, 1.0)
    share, chance, _ = sign_test(np.full(6, -1.0), image)
    assert chance.value == binomtest(3, 3).pvalue == 0.25
    assert share.low == found.low
    assert rate_difference(yes, no, image) == rate_difference(yes[:3], no[:3])
    assert rate_difference(no, no, image) == rate_difference(no[:3], no[:3])


def test_a_record_counts_the_values_that_there_are():
    sample = Sample("scene", "own", "final", 4)
    (record,) = sample.records("position_error_m", np.array([1.0, np.nan, 3.0]), np.arange(3), (MEDIAN,))
    assert (record.value, record.unit, record.n_ok, record.n) == (2.0, "m", 2, 4)
