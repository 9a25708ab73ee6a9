"""Errors along the frames, also of estimators that have none: a path that hovers starts no adjustment."""

import pandas as pd
import pytest

from boresight.reports.figures.sequences import draw_starts, draw_traces
from boresight.reports.figures.style import render

COLUMNS = ["trial", "anomaly_deg", "position_error_m", "landmark_rmse_m"]
KNOWN = pd.DataFrame([[0, 0.0, 1.0, float("nan")], [0, 800.0, 2.0, float("nan")]], columns=COLUMNS)
NOTHING = KNOWN[:0]
TURNS = [360.0, 720.0]


def turns(axes):
    """Where whole revolutions are marked."""
    return [float(line.get_xdata()[0]) for line in axes.lines if line.get_linestyle() == ":"]


@pytest.mark.parametrize("order", [("estimated", "not"), ("not", "estimated")])
def test_an_estimator_without_frames_leaves_the_others_theirs(order):
    tables = {"estimated": KNOWN, "not": NOTHING}
    (axes,) = draw_traces({name: tables[name] for name in order}, "title").axes
    assert turns(axes) == TURNS


def test_no_frames_at_all_are_empty_panels():
    for figure in (draw_traces({"not": NOTHING}, "title"), draw_starts(NOTHING, "title")):
        assert figure.axes
        assert not any(turns(axes) for axes in figure.axes)
        assert render(figure, "png")


def test_frames_without_an_anomaly_are_drawn_over_time():
    free = KNOWN.assign(anomaly_deg=float("nan"), time_s=[0.0, 900.0])
    for figure in (draw_traces({"one": free, "not": NOTHING}, "title"), draw_starts(free, "title")):
        (axes,) = figure.axes
        assert axes.get_xlabel() == "time, s"
        assert [0.0, 900.0] in [list(line.get_xdata()) for line in axes.lines]
        assert turns(axes) == []
        assert render(figure, "png")
