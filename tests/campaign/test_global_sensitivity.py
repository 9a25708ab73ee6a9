"""Sobol's indices and rank correlations against functions whose indices are known in closed form."""

import numpy as np
import pytest
from scipy.stats import spearmanr
from stored_runs import SCENARIO, RunBuilder

from boresight.campaign.runs.sensitivity import draw_samples, parse_over
from boresight.reports.compare.global_sensitivity import (
    FIRST,
    RANK,
    TOTAL,
    VariedKey,
    outcome_of,
    rank_shares,
    same_results,
    sobol_shares,
)
from boresight.reports.run.data import read_run
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.measured import MEAN, MEDIAN
from boresight.scenarios.errors import BoresightError

PI = [VariedKey(name, -np.pi, np.pi) for name in "abc"]


def test_indices_of_ishigami_s_function_are_those_in_closed_form():
    x = draw_samples(PI, 4096, "sobol", 3)
    a, b = 7.0, 0.1
    y = np.sin(x[:, 0]) + a * np.sin(x[:, 1]) ** 2 + b * x[:, 2] ** 4 * np.sin(x[:, 0])
    variance = a**2 / 8 + b * np.pi**4 / 5 + b**2 * np.pi**8 / 18 + 0.5
    first = [0.5 * (1 + b * np.pi**4 / 5) ** 2 / variance, a**2 / 8 / variance, 0.0]
    total = [first[0] + 8 * b**2 * np.pi**8 / 225 / variance, first[1], 8 * b**2 * np.pi**8 / 225 / variance]
    found = sobol_shares(PI, y, 3)
    np.testing.assert_allclose([m.value for m in found[FIRST]], first, atol=0.03)
    np.testing.assert_allclose([m.value for m in found[TOTAL]], total, atol=0.03)
    assert all(m.low <= m.value <= m.high for name in found for m in found[name])


def test_a_hypercube_fills_every_stratum_and_ranks_are_scipy_s():
    x = draw_samples(PI, 50, "latin-hypercube", 3)
    strata = np.floor((x + np.pi) / (2 * np.pi) * 50).astype(int)
    assert all(sorted(column) == list(range(50)) for column in strata.T)
    y = np.exp(x[:, 0]) + 0.1 * np.random.default_rng(1).normal(size=50)
    found = rank_shares(x, y)[RANK]
    assert found[0].value == pytest.approx(spearmanr(x[:, 0], y).statistic)
    assert found[0].low > 0.8
    assert found[1].low < 0.0 < found[1].high
    np.testing.assert_array_equal(x, draw_samples(PI, 50, "latin-hypercube", 3))


def test_what_does_not_vary_has_no_index():
    assert sobol_shares(PI, np.ones(40), 1) == {}
    assert rank_shares(np.random.default_rng(1).random((40, 3)), np.ones(40)) == {}


@pytest.mark.parametrize(
    ("text", "why"),
    [("camera.fov_deg", "KEY=LOW:HIGH"), ("camera.fov_deg=1:1", "not below"), ("x=2:__import__('os')", "KEY=LOW:HIGH")],
)
def test_a_range_that_is_none(text, why):
    with pytest.raises(BoresightError, match=why):
        parse_over(text)


def test_a_range_is_read():
    assert parse_over("pose_error.attitude.angle_deg.max=.5:5e0") == VariedKey(
        "pose_error.attitude.angle_deg.max", 0.5, 5.0
    )
    with pytest.raises(BoresightError, match="power of two"):
        draw_samples(PI, 12, "sobol", 1)


def test_failures_count_and_results_are_compared_bit_for_bit(tmp_path):
    builder = RunBuilder(tmp_path / "run")
    prior = ((40.0, 0.0, 0.0), 1.0)
    errors = {"same": 10.0, "other": np.nextafter(10.0, 11.0), SCENARIO: 10.0}
    for scenario, first in errors.items():
        for trial, length in enumerate([first, 20.0, None]):
            builder.trial(trial, prior, None if length is None else ((length, 0.0, 0.0), 0.5))
            builder.tables["rows"][-1]["scenario"] = scenario
    run = read_run(builder.write(scenarios={name: {} for name in errors}))
    assert outcome_of(run, measure_of("position_error_m"), MEDIAN, SCENARIO, "landmark-harris") == 20.0
    assert same_results(run, SCENARIO, "same", "landmark-harris")
    assert not same_results(run, SCENARIO, "other", "landmark-harris")


@pytest.mark.parametrize(
    ("lengths", "median", "mean"),
    [([1.0, 2.0, 9.0], 2.0, 4.0), ([1.0, 2.0, None], 2.0, 1.5), ([1.0, None, None], np.inf, 1.0)],
)
def test_without_priors_a_failure_is_worse_than_any_error(tmp_path, lengths, median, mean):
    builder = RunBuilder(tmp_path / "run")
    for trial, length in enumerate(lengths):
        builder.trial(trial, ((np.nan, 0.0, 0.0), np.nan), None if length is None else ((length, 0.0, 0.0), 0.5))
    run = read_run(builder.write())
    found = [
        outcome_of(run, measure_of("position_error_m"), one, SCENARIO, "landmark-harris") for one in (MEDIAN, MEAN)
    ]
    assert found == pytest.approx([median, mean])


def test_other_detections_are_other_results_though_rows_are_the_same(tmp_path):
    builder = RunBuilder(tmp_path / "run")
    ellipse = dict.fromkeys(("v_px", "major_px", "minor_px", "angle_deg"), 20.0)
    errors = dict.fromkeys(("centre_error_px", "major_error_px", "minor_error_px"), 0.5)
    for scenario, u_px in (("base", 100.0), ("same", 100.0), ("other", 100.1)):
        builder.trial(0, ((40.0, 0.0, 0.0), 1.0), None, estimator="crater-classic")
        builder.tables["rows"][-1]["scenario"] = scenario
        key = {"trial": 0, "scenario": scenario, "estimator": "crater-classic", "rank": 0, "confidence": 0.9}
        known = {"kept": True, "crater": 3, "duplicate": False, "detectable": True, "clean": True}
        builder.add("detections", **key, **known, u_px=u_px, **ellipse, **errors)
    run = read_run(builder.write(scenarios={name: {} for name in ("base", "same", "other")}))
    assert same_results(run, "base", "same", "crater-classic")
    assert not same_results(run, "base", "other", "crater-classic")
