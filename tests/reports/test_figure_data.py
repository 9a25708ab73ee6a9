"""Drawn values of figures against numbers computed by hand from a few made-up rows."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection
from matplotlib.quiver import Quiver

from boresight.reports.compare.figures import draw_summaries
from boresight.reports.compare.global_sensitivity import Sensitivity, draw_sensitivity
from boresight.reports.compare.subjects import RunComparison, Subject
from boresight.reports.figures.comparison import (
    Effect,
    HeatMap,
    Traded,
    draw_effects,
    draw_heat_maps,
    draw_trade_off,
)
from boresight.reports.figures.craters import (
    MatchedRims,
    draw_confidence_curves,
    draw_count_histogram,
    draw_crater_counts,
    draw_landmark_spans,
    draw_matched_pair,
    draw_orbit_errors,
    draw_rates,
    draw_residuals,
    draw_shares,
    draw_sightings_used,
)
from boresight.reports.figures.recognition import MatchedLandmarks, draw_matched_landmarks
from boresight.reports.figures.sequences import (
    TrackLifetimes,
    TrajectoryErrors,
    draw_error_bands,
    draw_landmark_map,
    draw_revolutions,
    draw_traces,
    draw_tracks,
    draw_trajectory,
)
from boresight.reports.figures.style import (
    grid_figure,
    mark_revolutions,
    percentile_band,
    scale_ordinate,
    step_histogram,
)
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.measured import Measured
from boresight.scenarios.geometry import Ellipses


def points(axes, **wanted):
    """Return (x, y) of each line with these properties, as lists."""
    lines = [one for one in axes.lines if all(getattr(one, f"get_{key}")() == value for key, value in wanted.items())]
    return [(list(map(float, one.get_xdata())), list(map(float, one.get_ydata()))) for one in lines]


def legend(figure):
    boxes = [*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))]
    return [text.get_text() for box in boxes for text in box.get_texts()]


def rims(*centres):
    n = len(centres)
    return Ellipses(np.array(centres, dtype=float).reshape(n, 2), np.tile([5.0, 4.0], (n, 1)), np.zeros(n))


def test_a_summary_has_errors_success_in_percent_and_the_difference():
    solved = tuple(Measured(value) for value in (3.0, 5.0, 4.0, 7.0, 9.0))
    counted = (Measured(3.5), *solved[1:])
    subjects = (
        Subject(("one",), "one", 4, 5, Measured(0.8, 0.7, 0.9), None, solved, counted, at_prior=True),
        Subject(("other",), "other", 5, 5, Measured(0.5), None, solved, solved, at_prior=True),
    )
    found = RunComparison((), measure_of("position_error_m"), ("estimator",), pd.DataFrame(), subjects, ())
    red, blue = (found.styles[one.names].colour for one in subjects)
    figure = draw_summaries(found, {("other",): Measured(-1.0, -2.0, 0.5)}, "one", "T")
    errors, success, differences = figure.axes
    assert points(errors, color=red, markerfacecolor="none") == [([3.5], [0.0])], "failures counted"
    assert points(errors, color=red, marker="|") == [([value], [0.0]) for value in (4.0, 7.0, 9.0)]
    assert points(success, color=red) == [([80.0], [0.0])]
    np.testing.assert_allclose(success.collections[0].get_segments(), [[[70.0, 0.0], [90.0, 0.0]]])
    assert points(differences, color=blue) == [([-1.0], [1.0])]
    assert (errors.get_xscale(), differences.get_xlabel()) == ("log", "median difference to\none, m")


def test_costs_are_in_milliseconds_and_kilobytes():
    errors = {"position_error_m": Measured(3.0), "attitude_error_deg": Measured(0.3)}
    labels = {"position_error_m": "position error, m", "attitude_error_deg": "attitude error, deg"}
    marks = [Traded("a", errors, {"time, ms": 100.0, "size, kB": 4.0})]
    figure = draw_trade_off(marks, labels, {"position_error_m": 9.0, "attitude_error_deg": 1.0}, "T")
    assert [points(axes, marker="o") for axes in figure.axes] == [
        [([100.0], [3.0])], [([4.0], [3.0])], [([100.0], [0.3])], [([4.0], [0.3])],
    ]  # fmt: skip


def test_a_confidence_curve_is_marked_at_the_detector_s_own_threshold():
    shares = {"false_share": [0.0, 0.04, 0.09], "detectable": [0.0, 0.5, 0.7], "clean": [0.0, 0.6, 0.8]}
    (axes,) = draw_confidence_curves({"a": pd.DataFrame(shares).assign(kept=[True, True, False])}, "T").axes
    assert points(axes, marker="o") == [([4.0], [50.0]), ([4.0], [60.0])]
    assert points(axes, marker="*") == [([5.0], [90.0])]


def test_rates_and_shares_of_several_stand_next_to_each_other():
    bins = {"a": [("x", (50.0, 40.0, 60.0))], "b": [("x", (55.0, 45.0, 65.0))]}
    (axes,) = draw_rates({"size": bins}, "T").axes
    assert points(axes, marker="o") == [([-0.06], [50.0]), ([0.06], [55.0])]
    curve = [("0 deg", (9.0, 8.0, 10.0), (1.0, 0.0, 2.0)), ("10 deg", (7.0, 6.0, 8.0), (3.0, 2.0, 4.0))]
    recall, wrong = draw_shares({"a": curve}, "angle").axes
    assert points(recall, marker="o") == [([0.0, 1.0], [9.0, 7.0])]
    assert points(wrong, marker="o") == [([0.0, 1.0], [1.0, 3.0])]
    assert [text.get_text() for text in wrong.get_xticklabels()] == ["0", "10"]


@pytest.mark.parametrize("image", [np.ones((60, 80), np.float32), np.zeros((0, 0), np.float32)])
def test_a_matched_pair_counts_and_numbers_its_craters(image):
    both = rims((10, 10), (20, 20), (30, 30)), rims((11, 10), (21, 20), (31, 30))
    found = MatchedRims(both, np.array([[0, 0], [1, 1], [2, 1]]), np.array([True, True, False]), np.array([[2, 2]]))
    figure = draw_matched_pair((image, image), found, "T")
    assert figure.get_suptitle() == "T: 2 right, 1 wrong, 1 missed"
    assert [[text.get_text() for text in axes.texts] for axes in figure.axes] == [["1", "2"]] * 2
    assert figure.axes[1].get_title() == "second look: 3 detections"


def test_indices_stand_at_their_values_and_the_base_is_marked():
    shares = {"total index": [Measured(0.3, 0.1, 0.5), Measured(0.6, 0.5, 0.7)]}
    found = Sensitivity("a", 1.5, np.array([1.0, 2.0]), {}, shares, ())
    indices, first, second = draw_sensitivity([found], ["x", "y"], np.array([[1.0, 5.0], [2.0, 6.0]]), "m").axes
    assert [bar.get_width() for bar in indices.patches] == [0.3, 0.6]
    assert points(first, marker="o") == [([1.0, 2.0], [1.0, 2.0])]
    assert points(second, marker="o") == [([5.0, 6.0], [1.0, 2.0])]
    assert points(second, linestyle="--") == [([0.0, 1.0], [1.5, 1.5])]


def test_counts_have_their_mean_and_median_and_the_paper_s():
    (axes,) = draw_count_histogram(np.array([1, 2, 9]), "x", "y", {"mean": 5.0}, "T").axes
    assert [patch.get_height() for patch in axes.patches if patch.get_height()] == [1.0, 1.0, 1.0]
    assert legend(axes.figure) == ["median 2", "mean 4", "paper: mean 5"]
    assert [points(axes, linestyle=line)[0][0][0] for line in (":", "--")] == [2.0, 4.0]
    images = pd.DataFrame({"n_detections": [3, 3, 5], "n_numbered": [1, 2, 2]})
    left, right = draw_crater_counts(images, pd.DataFrame({"hits": [2, 2, 4]}), "T").axes
    assert [patch.get_height() for patch in left.patches[:6]] == [0, 0, 0, 2, 0, 1]
    assert [patch.get_height() for patch in right.patches] == [2, 0, 1]


def test_spans_and_residuals_are_told_apart():
    spans = pd.DataFrame({"first_days": [2.0, 1.0, 3.0], "last_days": [4.0, 5.0, 6.0], "hits": 3, "n_other": [0, 1, 0]})
    assert legend(draw_landmark_spans(spans, "T")) == ["of one crater (2)", "with sightings of another (1)"]
    residuals = pd.DataFrame(
        {"time_days": np.arange(1.0, 7.0), "u_px": np.arange(1.0, 7.0), "v_px": -1.0,
         "used": [True, True, False, False, True, False], "wrong": [False, True, False, True, False, False]}
    )  # fmt: skip
    figure = draw_residuals(residuals, "T")
    assert points(figure.axes[0], marker=".") == [([1.0, 2.0, 5.0], [1.0, 2.0, 5.0])]
    assert figure.get_suptitle() == "T: 3 of 6 sightings"
    used = draw_sightings_used(residuals, "T")
    assert legend(used) == ["right, used: 2", "right, edited: 2", "wrong, edited: 1", "wrong, used: 1"]


def test_orbit_errors_are_medians_of_the_trials_and_end_of_arc_is_marked():
    errors = pd.DataFrame(
        {"estimator": "a", "trial": [0, 1, 2] * 2, "time_days": np.repeat([0.0, 1.0], 3), "position_sigma_m": 5.0,
         "predicted": np.repeat([False, True], 3), "position_error_m": [1.0, 2.0, 9.0, 3.0, 4.0, 20.0]}
    )  # fmt: skip
    (axes,) = draw_orbit_errors(errors, "T").axes
    assert points(axes, label="a") == [([0.0, 1.0], [2.0, 4.0])]
    band = axes.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (1.0, 20.0), "of three trials the band is their range"
    assert points(axes, linestyle="-", color="#5f6368") == [([0.0, 0.0], [0.0, 1.0])]


def test_residuals_over_an_image_are_magnified_and_their_rms_is_a_ring():
    seen = np.array([[13.0, 24.0], [40.0, 20.0]])
    found = MatchedLandmarks(seen, seen - [[3.0, 4.0], [0.0, 0.0]], np.array([2.0, np.nan]))
    over, spread, errors = draw_matched_landmarks(np.ones((60, 60)), found, "T").axes
    (arrows,) = (one for one in over.collections if isinstance(one, Quiver))
    assert over.get_title() == "2 landmarks: seen less predicted, x 1"
    np.testing.assert_array_equal(np.stack([arrows.U, arrows.V], 1), [[3.0, 4.0], [0.0, 0.0]])
    assert np.hypot(*spread.lines[1].get_data()).max() == pytest.approx(2.5)  # of 3, 4, 0 and 0
    assert points(errors, marker="o") == [([2.0], [5.0])]
    assert errors.get_title() == "1 lines of sight miss the body"


def test_effects_beyond_the_axis_are_arrows_and_dark_cells_have_white_text():
    (axes,) = draw_effects({"o": [Effect("a", 1.2, 1.1, 1.4, "9/9"), Effect("b", 300.0, 20.0, 900.0)]}, "T").axes
    assert (points(axes, marker="o"), points(axes, marker=">")) == ([([1.2], [0.0])], [([100.0], [1.0])])
    matrix = HeatMap("x", ("a",), ("c", "d"), np.array([[1.0, 4.0]]), [["one", "four"]])
    (axes,) = draw_heat_maps([matrix], "rows", "columns", "T").axes
    assert [(text.get_text(), text.get_color()) for text in axes.texts] == [("one", "black"), ("four", "white")]


def test_a_series_has_means_deviations_and_medians():
    rows = pd.DataFrame({"error_after_1_m": [1.0, 2.0, 9.0], "error_after_2_m": np.nan, "cluster": [0, 1, 2]})
    (axes,) = draw_revolutions({"a": {"10": rows, "20": rows + 1.0}}, "views", "T").axes
    assert points(axes, label="a") == [([0.0, 1.0], [4.0, 5.0])]
    assert points(axes, marker="_") == [([0.0], [2.0]), ([1.0], [3.0])]
    deviation = axes.collections[0].get_segments()[0]
    np.testing.assert_allclose(deviation[:, 1], [0.0, 4.0 + np.sqrt(19.0)])  # cut off at zero


def test_a_trace_is_the_median_with_the_first_trial_and_each_revolution():
    frames = pd.DataFrame(
        {"trial": np.repeat([0, 1, 2], 3), "anomaly_deg": [0.0, 360.0, 730.0] * 3, "landmark_rmse_m": np.nan,
         "position_error_m": [1.0, 1.0, 1.0, 2.0, 3.0, 4.0, 9.0, 8.0, 7.0]}
    )  # fmt: skip
    (axes,) = draw_traces({"a": frames}, "T").axes
    assert points(axes, label="a") == [([0.0, 360.0, 730.0], [2.0, 3.0, 4.0])]
    assert points(axes, linewidth=0.5) == [([0.0, 360.0, 730.0], [1.0, 1.0, 1.0])]
    assert [x[0] for x, _ in points(axes, linestyle=":")] == [360.0, 720.0]


def test_bands_of_few_values_are_their_range_and_of_many_their_percentiles():
    over = pd.Series(np.repeat([0.0, 1.0], [3, 101]))
    low, high = percentile_band(pd.Series([5.0, 1.0, 9.0, *range(101)]), over)
    np.testing.assert_allclose([low, high], [[1.0, 5.0], [9.0, 95.0]])


@pytest.mark.parametrize(
    ("values", "typical", "scale", "note"),
    [([1.0, 5.0], [1.0, 5.0], "linear", []), ([1.0, 50.0], [1.0, 50.0], "log", []),
     ([1.0, 6000.0], [1.0, 5.0], "log", ["up to 6e+03"])],
)  # fmt: skip
def test_an_ordinate_is_logarithmic_where_curves_are_far_apart(values, typical, scale, note):
    axes = grid_figure(1, 1)[1][0, 0]
    axes.plot([0.0, 1.0], values)
    mark_revolutions(axes, [])
    scale_ordinate(axes, typical)
    assert (axes.get_yscale(), [text.get_text() for text in axes.texts], len(axes.lines)) == (scale, note, 1)


ANOMALY = np.array([0.0, 90.0, 180.0, 270.0])
TRUE = 1000.0 * np.stack([np.cos(np.radians(ANOMALY)), np.sin(np.radians(ANOMALY)), 0.0 * ANOMALY], 1)


def test_errors_of_a_trajectory_are_within_three_sigma_or_counted():
    error = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.5, 0.0, 0.0], [4.0, 0.0, 0.0]])
    sigma = np.array([[1.0, np.nan, 1.0]] * 4)
    errors = TrajectoryErrors(ANOMALY, TRUE, TRUE + error, error, sigma, 300.0)
    radial, along, cross = draw_error_bands(errors, "T").axes
    titles = [axes.get_title(loc="left") for axes in (radial, along, cross)]
    assert titles == [
        "radial: 50 % of frames outside",
        "along-track: no covariance",
        "cross-track: 0 % of frames outside",
    ]
    assert radial.collections[0].get_paths()[0].vertices[:, 1].max() == 3.0
    plane, edge = draw_trajectory(errors, "T").axes
    assert "estimate, error x 20" in legend(plane.figure)
    ((x, y),) = points(plane, linestyle="--")
    np.testing.assert_allclose(np.array([x, y]).T, 1e-3 * (TRUE + 20.0 * error)[:, :2], atol=1e-12)
    ((_, z),) = points(edge, linestyle="--")
    np.testing.assert_allclose(z, 0.0, atol=1e-12)


def test_tracks_last_from_their_first_frame_to_their_last():
    tracks = TrackLifetimes(
        np.array([0.0, 90.0]), np.array([180.0, 270.0]), np.array([2.0, np.nan]), np.array([[90.0, 0.0]]),
        np.stack([ANOMALY, [1.0, 2.0, 2.0, 1.0]], 1), 270.0,
    )  # fmt: skip
    above, below, _ = draw_tracks(tracks, "T").axes
    unknown, known = (one.get_segments() for one in above.collections if isinstance(one, LineCollection))
    np.testing.assert_array_equal(known, [[[0.0, 0.0], [180.0, 0.0]]])
    np.testing.assert_array_equal(unknown, [[[90.0, 1.0], [270.0, 1.0]]])
    assert points(below, linestyle="-") == [(list(ANOMALY), [1.0, 2.0, 2.0, 1.0])]
    assert "1 seen wrongly" in legend(above.figure)


def test_landmark_errors_are_split_into_height_and_ground():
    where = np.array([[100.0, 0.0, 0.0], [0.0, 0.0, 50.0]])
    error = np.array([[3.0, 4.0, 0.0], [0.0, 1.0, -2.0]])
    chart, parts, _ = draw_landmark_map(where, error, np.array([False, True]), "T").axes
    np.testing.assert_allclose(chart.collections[0].get_offsets(), [[0.0, 0.0], [0.0, 90.0]])
    np.testing.assert_allclose(points(parts, marker="o"), [([4.0], [3.0]), ([1.0], [-2.0])])


def test_a_histogram_is_a_share_of_the_whole_sample():
    axes = grid_figure(1, 1)[1][0, 0]
    assert step_histogram(axes, np.array([0.5, 1.5, 9.0, 9.0]), np.array([0.0, 1.0, 3.0])) == 2
    np.testing.assert_allclose(axes.patches[0].get_data().values, [0.25, 0.125])
