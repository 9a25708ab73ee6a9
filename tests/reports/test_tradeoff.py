"""Accuracy beside its cost: sizes of data bases, times, failures, and the figure of them."""

import numpy as np
import pytest
from scipy.stats import binomtest
from stored_runs import RunBuilder, find

from boresight.reports.figures.comparison import draw_trade_off
from boresight.reports.figures.style import render
from boresight.reports.kinds import report_kind
from boresight.reports.kinds.trade_off import costs, trade_grid
from boresight.reports.pages.build import write_report
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run
from boresight.reports.statistics.measured import Measured

PRIOR = ((40.0, 0.0, 0.0), 1.0)
ITOKAWA = "itokawa"
PRODUCTS = [
    {"kind": "landmark-database", "n_landmarks": 400, "bytes": 50_000},
    {"kind": "maplets", "n_landmarks": 200, "bytes": 160_000},
]


def fill(builder, **manifest):
    """Four trials: ``corners`` fails once and is worse than the prior once, ``maplets`` is always well."""
    corners = [((20.0, 0, 0), 0.5), ((10.0, 0, 0), 0.3), ((90.0, 0, 0), 2.0), None]
    for trial, found in enumerate(corners):
        builder.trial(trial, PRIOR, PRIOR, estimator="prior")
        for estimator, final in (("corners", found), ("maplets", ((4.0, 0, 0), 0.1))):
            builder.trial(trial, PRIOR, final, estimator=estimator)
            key = {"trial": trial, "scenario": ITOKAWA, "estimator": estimator}
            seconds = {"feature_extraction": 0.02, "recognition": 0.01 * (1 + trial), "image": 5.0}
            for stage, time in seconds.items():
                builder.add("timings", **key, stage=stage, seconds=time)
    owners = ("corners", "maplets")
    products = [
        {**product, "scenario": ITOKAWA, "estimator": name} for name, product in zip(owners, PRODUCTS, strict=True)
    ]
    return builder.write(**{"estimators": ["prior", *owners], "products": products, "report": None} | manifest)


def test_costs_by_hand(builder):
    corners, maplets = costs(read_run(fill(builder)))
    assert (corners.estimator, corners.n_ok, corners.n, corners.landmarks, corners.size_bytes) == (
        "corners", 3, 4, 400, 50_000,
    )  # fmt: skip
    assert corners.position_m.value == 20.0
    # Trials 0 to 2 have an estimate and take 30, 40 and 50 ms; the image is not the estimator's.
    assert corners.seconds.value == pytest.approx(0.04)
    interval = binomtest(2, 4).proportion_ci(method="wilson")
    assert (corners.failed.value, corners.failed.low) == (0.5, pytest.approx(interval.low))
    assert (maplets.failed.value, maplets.size_bytes) == (0.0, 160_000)


def test_the_table_holds_accuracy_and_cost(builder):
    grid = trade_grid(read_run(fill(builder)))
    lines = [dict(zip(grid.columns, row, strict=True)) for row in grid.rows]
    assert [line["estimator"] for line in lines] == ["corners", "maplets"]
    assert (lines[0]["ok"], lines[0]["time an image ms"]) == ("3/4", "40.0")
    assert [line["data base kB"] for line in lines] == ["50.0", "160"]
    assert [line["bytes a landmark"] for line in lines] == ["125", "800"]
    assert lines[1]["failures % [95 %]"].startswith("0 [0")


def test_the_size_is_a_number_of_the_report(builder):
    content = read_content(fill(builder))
    size = find(content.records, scenario=ITOKAWA, estimator="maplets", measure="database_bytes")
    assert (size.value, size.unit, size.statistic) == (160_000, "bytes", "count")
    (traded,) = (one for one in report_kind(content.run).figures(content) if one.stem == "trade_off_itokawa")
    times, sizes = ([float(c.lines[0].get_xdata()[0]) for c in axes.containers] for axes in traded.figure.axes[:2])
    assert (times, sizes) == (pytest.approx([40.0, 45.0]), [50.0, 160.0]), "milliseconds and kilobytes"
    files = write_report(content.run.folder)
    assert (files.folder / "trade_off_itokawa.png").stat().st_size > 10_000
    assert "Accuracy and its cost" in files.markdown.read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("products", [[], [{**PRODUCTS[0], "scenario": "elsewhere", "estimator": "corners"}]])
def test_nothing_is_traded_where_no_data_base_is_known(builder, products):
    content = read_content(fill(builder, products=products))
    assert trade_grid(content.run) is None
    files = write_report(content.run.folder)
    assert not list(files.folder.glob("trade_off*"))


def test_an_estimator_that_never_answers_has_no_accuracy(builder):
    builder.trial(0, PRIOR, None, estimator="corners", reason="black")
    builder.trial(0, PRIOR, ((4.0, 0, 0), 0.1), estimator="maplets")
    owned = [{**PRODUCTS[0], "scenario": ITOKAWA, "estimator": "corners"}]
    run = read_run(builder.write(estimators=["corners", "maplets"], products=owned))
    rows = trade_grid(run).rows
    assert rows[0][2:5] == ("0/1", "-", "-")
    assert rows[1][-4:] == ("-", "-", "-", "-")


def race(builder, other, *, size=60_000, seed=0, trials=40, **manifest):
    """``first`` beside ``other``, whose errors and times are those of the first times factors, with noise."""
    rng, size_of = np.random.default_rng(seed), {"first": 50_000, "other": size}
    ratios = {"first": (1.0, 1.0, 1.0, 0.0)} | {"other": other}
    for trial in range(trials):
        for name, (position, attitude, time, failures) in ratios.items():
            vector = (10.0 * position * rng.lognormal(0.0, 0.2), 0.0, 0.0)
            found = None if rng.uniform() < failures else (vector, 0.1 * attitude * rng.lognormal(0.0, 0.2))
            builder.trial(trial, PRIOR, found, estimator=name)
            key = {"trial": trial, "scenario": ITOKAWA, "estimator": name}
            builder.add("timings", **key, stage="recognition", seconds=0.1 * time * rng.lognormal(0.0, 0.2))
    products = [
        {**PRODUCTS[0], "scenario": ITOKAWA, "estimator": name, "bytes": own} for name, own in size_of.items() if own
    ]
    run = read_run(builder.write(**{"estimators": list(ratios), "products": products, "report": None} | manifest))
    return [cost.dominated_by for cost in costs(run)]


WORSE = (1.5, 1.5, 1.5, 0.4)


@pytest.mark.parametrize(
    ("other", "size", "dominated"),
    [
        (WORSE, 60_000, ["", "first"]),
        (WORSE, 50_000, ["", "first"]),
        (WORSE, 40_000, ["", ""]),  # a smaller data base
        (WORSE, None, ["", ""]),  # none
        ((0.8, 1.5, 1.5, 0.4), 60_000, ["", ""]),  # a better position
        ((1.5, 0.8, 1.5, 0.4), 60_000, ["", ""]),  # a better attitude
        ((1.5, 1.5, 0.8, 0.4), 60_000, ["", ""]),  # a shorter time
        ((1.5, 1.5, 1.5, 0.03), 60_000, ["", ""]),  # one or two failures of 40 are within the interval
        ((1.5, 1.5, 1.5, 0.0), 60_000, ["", "first"]),  # no failure of either
        ((0.5, 0.5, 0.5, 0.0), 40_000, ["other", ""]),
        ((0.5, 0.5, 0.5, 0.0), None, ["", ""]),  # none, but a shape that is not counted
    ],
)
def test_an_estimator_is_dominated_if_another_is_better_in_all(builder, other, size, dominated):
    assert race(builder, other, size=size) == dominated


def test_equal_methods_are_seldom_dominated(tmp_path):
    """Errors, attitudes and times of one law: three independent intervals would have to lie on one side."""
    found = [race(RunBuilder(tmp_path / str(seed)), (1.0, 1.0, 1.0, 0.0), seed=seed, trials=12) for seed in range(20)]
    assert all(one == ["", ""] for one in found)


def test_a_grid_has_the_table_for_each_scenario(builder):
    axes = [{"name": "world", "label": "world", "levels": ["a"], "values": None}]
    levels = [{"name": ITOKAWA, "base": "rock", "levels": {"world": "a"}}]
    for design, shown in (("full", 1), ("two-level", 0)):
        content = read_content(fill(builder, grid={"design": design, "axes": axes, "scenarios": levels}))
        titles = [grid.title for grid in report_kind(content.run).tables(content) if grid is not None]
        assert sum("Accuracy and its cost" in title for title in titles) == shown


def test_marks_lie_at_their_costs():
    found = {"position_error_m": Measured(4.0, 3.0, 5.0), "attitude_error_deg": Measured(0.1, 0.08, 0.12)}
    errors = {name: {"maplets": one, "shape": one} for name, one in found.items()}
    spent = {"ms": {"maplets": 500.0, "shape": 2000.0}, "kB": {"maplets": 160.0}}
    figure = draw_trade_off(errors, spent, {"position_error_m": 45.0, "attitude_error_deg": 1.0}, "T", ["Credit"])
    assert render(figure, "png")[:4] == b"\x89PNG"
    time, size = figure.axes[:2]
    assert [tuple(np.ravel(c.lines[0].get_xydata())) for c in time.containers] == [(500.0, 4.0), (2000.0, 4.0)]
    assert [tuple(np.ravel(c.lines[0].get_xydata())) for c in size.containers] == [(160.0, 4.0)]
    assert [list(line.get_ydata()) for line in time.lines if line.get_label() == "prior"] == [[45.0, 45.0]]
