"""What a review board sees first: the requirement, its verdict, and the error over range with the failures marked."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from stored_runs import ESTIMATOR, SCENARIO

from boresight.reports.figures.named import run_label
from boresight.reports.kinds.ranges import range_figures
from boresight.reports.kinds.requirements import judged, requirement_grid
from boresight.reports.kinds.tornado import swings
from boresight.reports.pages.build import write_report
from boresight.reports.pages.content import headline
from boresight.reports.run.data import read_run
from boresight.reports.run.limits import single_draws

LIMIT = "boresight_error_m < 8 in 80 % at 90 %"
TRIALS = 40


def fly(builder, farthest_m, **manifest):
    """Fly from ``farthest_m`` down to 1 km; the four farthest trials have no estimate, the fifth is off by 9 m."""
    for trial, range_m in enumerate(np.geomspace(farthest_m, 1e3, TRIALS)):
        depth_m = 9.0 if trial == 4 else 2.0 + 0.01 * trial
        final = ((30.0, 40.0, depth_m), 0.1) if trial > 3 else None
        for estimator, estimate in (("prior", ((0.0, 0.0, 90.0), 0.1)), (ESTIMATOR, final)):
            builder.trial(
                trial, ((0.0, 0.0, 90.0), 0.1), estimate, estimator=estimator, reason="" if estimate else "far"
            )
            builder.tables["rows"][-1] |= {"range_m": range_m, "latitude_deg": 8.49 + 1e-5 * trial}
    return builder.write(**{"report": None, "requirements": [{"that": LIMIT}]} | manifest)


def drawn(run):
    """Return the axes of the only panel, and its lines by their labels."""
    (figure,) = range_figures(read_run(run))
    (axes,) = (one for one in figure.figure.axes if one.get_visible())
    return figure, axes, {line.get_label(): line for line in axes.lines}


def test_each_trial_has_its_point_or_its_cross(builder):
    figure, axes, lines = drawn(fly(builder, 1e5))
    assert figure.stem == f"error_over_range_boresight_error_m_{SCENARIO}"
    over_km = np.geomspace(100.0, 1.0, TRIALS)
    np.testing.assert_allclose(lines["no estimate"].get_xdata(), over_km[:4])
    point = np.column_stack([lines["a trial"].get_xdata(), lines["a trial"].get_ydata()])
    np.testing.assert_allclose(point[4:, 0], over_km[4:])
    np.testing.assert_allclose(point[4:, 1], [9.0, *(2.0 + 0.01 * np.arange(5, TRIALS))])
    assert np.isnan(point[:4, 1]).all()
    assert set(lines["prior"].get_ydata()) == {90.0}
    assert list(lines["required"].get_ydata()) == [8.0, 8.0]
    assert axes.get_title() == f"{ESTIMATOR}: solved 36/40"
    assert axes.get_ylim()[0] < point[4:, 1].min()
    assert axes.get_ylim()[1] > 90.0


@pytest.mark.parametrize(("farthest_m", "scale", "label"), [(1e5, "log", "km"), (9e3, "linear", "m")])
def test_the_axis_is_logarithmic_where_ranges_differ_by_ten(builder, farthest_m, scale, label):
    _, axes, _ = drawn(fly(builder, farthest_m))
    assert axes.get_xscale() == scale
    assert axes.get_xlabel() == f"range, {label}"
    low, high = np.array(axes.get_xlim()) * (1e3 if label == "km" else 1.0)
    assert low < 1e3 < farthest_m < high


def test_none_is_drawn_at_one_range(builder):
    assert not list(range_figures(read_run(fly(builder, 1.1e3))))


def test_without_a_limit_it_is_the_position_error(builder):
    figure, _, lines = drawn(fly(builder, 1e5, requirements=[{"that": "solved in 80 % at 90 %"}]))
    assert figure.stem.startswith("error_over_range_position_error_m")
    assert "required" not in lines
    assert np.nanmax(lines["a trial"].get_ydata()) > 50.0


@pytest.mark.usefixtures("undrawn")
def test_the_first_screen_has_requirement_verdict_and_error_over_range(builder):
    files = write_report(fly(builder, 1e5, description="Fly it."))
    text, page = files.markdown.read_text(encoding="utf-8"), files.html.read_text(encoding="utf-8")
    required = (
        "position error along the boresight below 8 m in at least 80 % of all trials, with 90 % confidence: 1 undecided"
    )
    order = [
        f"- Required: {required}",
        "### Requirements",
        "](error_over_range",
        "### Pose error",
        "## How the numbers",
    ]
    places = [text.index(one) for one in order]
    assert places == sorted(places)
    body = page[page.index("<body>") :]
    shown = re.findall(r'<dd>([^<]*confidence[^<]*)</dd>|<h2[^>]*>(.*?)</h2>|<img [^>]*alt="([^"]*)"', body)
    assert [next(filter(None, one)) for one in shown[:2]] == [required, "Requirements"]
    assert shown[2][2].startswith("Bars from one quantile"), "the tornado is right after the requirements"
    assert "against the range" in shown[3][2]
    assert text.count("Fly it.") == 1, "notes do not say again what the card says"


def test_a_miss_is_told_from_a_failure(builder):
    run = read_run(fly(builder, 1e5))
    (one,) = judged(run)
    assert (one.verdict.missed, one.unsolved) == (5, 4)
    row = dict(zip(requirement_grid(run).columns, requirement_grid(run).rows[0], strict=True))
    assert (row["missed"], row["no estimate"]) == ("5/40", "4")
    assert re.fullmatch(r"[\d.]+ m", row["reached"])


@pytest.mark.usefixtures("undrawn")
def test_many_verdicts_too_come_before_the_first_picture(builder):
    asked = [{"that": f"boresight_error_m < {limit} in 80 % at 90 %"} for limit in range(2, 12)]
    page = write_report(fly(builder, 1e5, requirements=asked)).html.read_text(encoding="utf-8")
    assert page.index("Requirements</h2>") < page.index("<img ")
    assert page.count("below 11 m") == 1


def test_the_headline_is_of_the_measure_that_is_required(builder):
    run = read_run(fly(builder, 1e5))
    assert "median position error along the boresight 2.2" in headline(run)
    both = [{"that": LIMIT}, {"that": "attitude_error_deg < 1 in 80 % at 90 %"}]
    assert "median position error 50.0" in headline(read_run(fly(builder, 1e5, requirements=both)))


def test_a_condition_that_is_the_same_in_print_moves_nothing(builder):
    run = read_run(fly(builder, 1e5))
    own = run.rows[run.rows["estimator"] == ESTIMATOR]
    found = [one.condition for one in swings(run, own["range_m"], 0.5)]
    assert "range, m" in found
    assert "latitude of the camera, deg" not in found


def test_the_footer_counts_the_trials_of_the_rows(builder):
    run = read_run(fly(builder, 1e5, trials=50))
    assert ", 40 of 50 trials, seed" in run_label(run)
    whole = replace(run, manifest=run.manifest.model_copy(update={"trials": TRIALS}))
    assert ", 40 trials, seed" in run_label(whole)


def test_intervals_are_of_one_trajectory(builder):
    flown = {"name": SCENARIO, "viewpoint": {"trajectory": {"table": "states.csv"}}}
    assert single_draws(read_run(fly(builder, 1e5, scenarios={SCENARIO: flown}))) == "one trajectory"
