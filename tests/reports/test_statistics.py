import warnings

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from reports.statistics import (
    LARGE,
    MEAN,
    MEDIAN,
    P95,
    RMS,
    ROOT_MEDIAN_SQUARE,
    ClusteredSample,
    Measured,
    bootstrap,
    content_rng,
    large_sample_interval,
    measure,
)

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


@given(
    st.lists(st.tuples(st.floats(-100, 100), st.integers(0, 3)), min_size=4, max_size=30),
    st.lists(st.integers(0, 4), min_size=4, max_size=4),
    st.booleans(),
)
def test_resampled_statistics_equal_those_of_the_repeated_sample(pairs, counts, positive):
    values, codes = (np.array(column) for column in zip(*pairs, strict=True))
    values = np.abs(values) if positive else values
    counts = np.array(counts, dtype=np.int32)
    assume(counts[codes].sum() > 0)
    found = ClusteredSample(values, codes).evaluate(counts[None, :], ALL)[:, 0]
    repeated = np.repeat(values, counts[codes])
    for ours, statistic in zip(found, ALL, strict=True):
        assert ours == pytest.approx(statistic.of(repeated), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("size", [499, 500, 2000])
def test_resampled_statistics_of_many_values_equal_those_of_the_repeated_sample(size):
    rng = np.random.default_rng(size)
    values, codes = rng.normal(size=size).round(1), rng.integers(0, 40, size)
    counts = rng.integers(0, 4, (5, 40)).astype(np.int32)
    found = ClusteredSample(values, codes).evaluate(counts, ALL)
    for ours, statistic in zip(found, ALL, strict=True):
        assert ours == pytest.approx([statistic.of(np.repeat(values, count[codes])) for count in counts], rel=1e-9)


@pytest.mark.parametrize(
    ("statistic", "function"),
    [(MEDIAN, np.median), (MEAN, np.mean), (RMS, lambda x, axis: np.sqrt(np.mean(x**2, axis=axis)))],
)
def test_interval_agrees_with_scipys_percentile_bootstrap(statistic, function):
    values = np.random.default_rng(2).gamma(2.0, 10.0, size=150)
    ours = measure(values, np.arange(150), (statistic,))[0]
    theirs = stats.bootstrap(
        (values,), function, n_resamples=20_000, method="percentile", rng=np.random.default_rng(3)
    ).confidence_interval
    width = theirs.high - theirs.low
    assert ours.low == pytest.approx(theirs.low, abs=0.1 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.1 * width)


def test_interval_of_the_median_covers_the_truth_at_its_level():
    """600 repetitions at 95 %: binomial standard error 0.9 %, so [0.92, 0.98] is more than 3 sigma on each side."""
    rng = np.random.default_rng(4)
    covered = 0
    for _ in range(600):
        low, high = _interval(rng.exponential(size=60), np.arange(60), MEDIAN, rng)
        covered += low <= np.log(2) <= high
    assert 0.92 <= covered / 600 <= 0.98


def test_clusters_are_needed_where_trials_share_an_image():
    """40 images with 10 realisations: resampling images covers, resampling trials claims far too much."""
    rng = np.random.default_rng(5)
    images, each, repetitions = 40, 10, 300
    by_image, by_trial = 0, 0
    for _ in range(repetitions):
        values = np.repeat(rng.normal(size=images), each) + 0.3 * rng.normal(size=images * each)
        codes = np.repeat(np.arange(images), each)
        low, high = _interval(values, codes, MEAN, rng)
        by_image += low <= 0.0 <= high
        low, high = _interval(values, np.arange(len(values)), MEAN, rng)
        by_trial += low <= 0.0 <= high
    assert by_image / repetitions > 0.90
    assert by_trial / repetitions < 0.65


def _interval(values, codes, statistic, rng):
    return np.percentile(bootstrap(values, codes, (statistic,), rng, resamples=400)[0], [2.5, 97.5])


@pytest.mark.parametrize("labels", [["a"] * 6, [7] * 6])
def test_one_cluster_gives_a_value_without_an_interval(labels):
    measured = measure(np.arange(6.0), np.array(labels), ALL)
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


def test_blocks_that_split_the_resamples_draw_from_one_stream(monkeypatch):
    values, codes = np.random.default_rng(8).normal(size=40), np.arange(40)
    whole = bootstrap(values, codes, ALL, np.random.default_rng(9), resamples=100)
    monkeypatch.setattr("reports.statistics._CHUNK", 40 * 7)
    split = bootstrap(values, codes, ALL, np.random.default_rng(9), resamples=100)
    np.testing.assert_allclose(split, whole, rtol=1e-12)  # sums of other lengths round differently


def test_inputs_are_not_changed():
    values, clusters = np.array([3.0, -1.0, 2.0]), np.array(["b", "a", "b"])
    before = values.copy(), clusters.copy()
    measure(values, clusters, ALL)
    np.testing.assert_array_equal(values, before[0])
    np.testing.assert_array_equal(clusters, before[1])


@pytest.mark.parametrize("statistic", ALL, ids=lambda s: s.name)
def test_large_samples_need_no_resampling(statistic):
    """The ends agree with the bootstrap's to a tenth of the width, which is the bootstrap's own noise."""
    values = np.random.default_rng(8).gamma(2.0, 10.0, size=LARGE) - 3.0
    found = measure(values, np.arange(LARGE), (statistic,))[0]
    assert (found.low, found.high) == large_sample_interval(values, statistic)
    draws = bootstrap(values, np.arange(LARGE), (statistic,), np.random.default_rng(9))[0]
    low, high = np.percentile(draws, [2.5, 97.5])
    assert found.low == pytest.approx(low, abs=0.1 * (high - low))
    assert found.high == pytest.approx(high, abs=0.1 * (high - low))


@pytest.mark.parametrize(("statistic", "truth"), [(MEDIAN, np.log(2)), (P95, np.log(20)), (MEAN, 1.0), (RMS, 2**0.5)])
def test_large_sample_intervals_cover_the_truth_at_their_level(statistic, truth):
    """400 repetitions at 95 %: binomial standard error 1.1 %, so [0.915, 0.985] is more than 3 sigma on each side."""
    rng = np.random.default_rng(10)
    covered = 0
    for _ in range(400):
        low, high = large_sample_interval(rng.exponential(size=2000), statistic)
        covered += low <= truth <= high
    assert 0.915 <= covered / 400 <= 0.985


def test_large_samples_in_clusters_are_resampled():
    values = np.repeat(np.random.default_rng(11).normal(size=LARGE // 2), 2)
    clustered = measure(values, np.repeat(np.arange(LARGE // 2), 2), (MEAN,))[0]
    independent = measure(values, np.arange(LARGE), (MEAN,))[0]
    widths = [m.high - m.low for m in (clustered, independent)]
    assert widths[0] == pytest.approx(2**0.5 * widths[1], rel=0.08)
