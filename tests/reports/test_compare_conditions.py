"""Binned curves against plain NumPy, coverage curves against drawn chi-squares."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import bootstrap, chi2

from boresight.reports.compare.figures import (
    SUCCESS,
    binned_errors,
    frames_by_condition,
    prepare_frames,
    trials_by_condition,
)
from boresight.reports.figures.comparison import draw_coverage
from boresight.reports.figures.style import plot_styles
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.consistency import NormalisedErrors

POSITION = measure_of("position_error_m")


def trials(rng, n, scale=1.0):
    phase = rng.uniform(0.0, 60.0, n)
    error = scale * (1.0 + phase / 10.0) * rng.gamma(4.0, 0.25, n)
    return pd.DataFrame(
        {
            "phase_deg": phase,
            "range_m": 2000.0,
            "latitude_deg": np.nan,
            "n_landmarks": np.nan,
            "prior": rng.uniform(20.0, 60.0, n),
            "value": error,
            "lateral_error_m": 0.6 * error,
            "boresight_error_m": 0.8 * error,
            "attitude_error_deg": np.nan,
            "failed": error > 8.0 * scale,
            "cluster": [f"7:{i}" for i in range(n)],
        }
    )


def test_bins_hold_the_medians_of_their_trials():
    table = trials(np.random.default_rng(1), 400)
    errors, conditions = trials_by_condition({"one": table}, POSITION)
    assert conditions == ("phase_deg", "prior"), "a range that never changes and unknown ones are left out"
    assert errors == ("value", "lateral_error_m", "boresight_error_m", SUCCESS)
    ((label, points),) = binned_errors({"one": table}, "value", "phase_deg")
    assert label == "one"
    in_order = table.sort_values("phase_deg")
    parts = [in_order.iloc[50 * i : 50 * (i + 1)] for i in range(8)]
    np.testing.assert_allclose(points.y, [part["value"].median() for part in parts])
    np.testing.assert_allclose(points.x, [part["phase_deg"].median() for part in parts])
    theirs = [
        bootstrap((part["value"].to_numpy(),), np.median, method="percentile", rng=3).confidence_interval
        for part in parts
    ]
    np.testing.assert_allclose(points.low_high, theirs, rtol=0.06)


def test_success_is_a_rate_of_all_trials_of_a_bin():
    table = trials(np.random.default_rng(2), 400)
    table.loc[table["failed"], "value"] = np.nan
    ((_, points),) = binned_errors({"one": table}, SUCCESS, "phase_deg")
    order = np.argsort(table["phase_deg"].to_numpy())
    rates = 100.0 * (~table["failed"].to_numpy()[order]).reshape(8, 50).mean(axis=1)
    np.testing.assert_allclose(points.y, rates)
    assert points.y[0] > points.y[-1]


def test_subjects_share_bins_but_those_of_their_own_landmarks():
    rng = np.random.default_rng(3)
    few, many = trials(rng, 200), trials(rng, 200, scale=0.5)
    few["n_landmarks"], many["n_landmarks"] = rng.poisson(30, 200), rng.poisson(300, 200)
    tables = {"few": few, "many": many}
    landmarks = dict(binned_errors(tables, "value", "n_landmarks"))
    assert landmarks["few"].x.max() < 60 < landmarks["many"].x.min()
    assert len(landmarks["few"].x) > 5
    assert len(landmarks["many"].x) > 5
    phases = dict(binned_errors(tables, "value", "phase_deg"))
    assert abs(phases["few"].x - phases["many"].x).max() < 3.0


def test_frames_are_thinned_and_trials_stay_what_is_independent():
    rng = np.random.default_rng(4)
    parts = []
    for trial in range(30):
        angle = np.arange(0.0, 361.0, 2.0)
        parts.append(
            pd.DataFrame(
                {
                    "frame": range(len(angle)), "anomaly_deg": angle, "n_landmarks": 10, "cluster": f"7:{trial}",
                    "radial_m": -3.0, "along_m": 4.0, "cross_m": 12.0, "true_x_m": 790.0, "true_y_m": 0.0,
                    "true_z_m": 0.0, "position_error_m": 13.0 + rng.normal(),
                }
            )
        )  # fmt: skip
    frames = prepare_frames(pd.concat(parts))
    assert frames.groupby("cluster").size().max() <= 61
    errors, conditions = frames_by_condition({"one": frames})
    assert conditions == ("anomaly_deg",)
    assert errors == ("value", "radial_error_m", "transverse_error_m")
    points = {error: dict(binned_errors({"one": frames}, error, "anomaly_deg"))["one"] for error in errors}
    np.testing.assert_allclose(points["radial_error_m"].y, 3.0)
    np.testing.assert_allclose(points["transverse_error_m"].y, np.hypot(4.0, 12.0))
    # Thirty trials, each with one error for all its frames: the interval is that of thirty numbers.
    width = np.ptp(points["value"].low_high, axis=1)
    assert np.all(width > 0.3)


@pytest.mark.parametrize(("scale", "inside"), [(1.0, True), (1.6, False)])
def test_coverage_curves_of_true_claims_stay_in_the_band(scale, inside):
    degrees = np.full(300, 3.0)
    squares = scale * np.random.default_rng(5).chisquare(3, 300)
    table = pd.DataFrame({"ratio": squares, "degrees": degrees, "cluster": np.arange(300)})
    figure = draw_coverage({"one": NormalisedErrors("nees", 3, table)}, plot_styles(["one"]), "T")
    (axes,) = figure.axes
    claimed, share = axes.lines[-1].get_data()
    np.testing.assert_allclose(share[100], np.mean(squares <= chi2.ppf(0.5, 3)))
    band = np.sqrt(claimed * (1 - claimed) / 300)
    assert (np.abs(share - claimed).max() < 3.0 * band.max()) == inside
