"""Accuracy beside its cost: sizes of data bases, times, failures, and the figure of them."""

import json
from itertools import combinations

import numpy as np
import pytest
from matplotlib.transforms import Bbox
from scipy.stats import binomtest
from stored_runs import RunBuilder, find

from boresight.reports.figures.comparison import Traded, draw_trade_off
from boresight.reports.figures.style import render
from boresight.reports.kinds import report_figures, report_grids
from boresight.reports.kinds.trade_off import NO_ESTIMATE, OFF, ON, UNDECIDED, Standing, costs, trade_grid
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
    assert corners.errors["position_error_m"].value == 20.0
    # Trials 0 to 2 have an estimate and take 30, 40 and 50 ms; the image is not the estimator's.
    assert corners.seconds.value == pytest.approx(0.04)
    interval = binomtest(2, 4).proportion_ci(method="wilson")
    assert (corners.failed.value, corners.failed.low) == (0.5, pytest.approx(interval.low))
    assert (maplets.failed.value, maplets.size_bytes) == (0.0, 160_000)


def test_methods_that_keep_the_attitude_trade_the_line_of_sight(builder):
    """A position 60 m off, by the prior's attitude, is no failure where the line of sight is better than the prior."""
    for estimator, off_m in (("prior", 30.0), ("centroid", 3.0), ("limb", 31.0)):
        for trial in range(4):
            builder.trial(trial, PRIOR, PRIOR if estimator == "prior" else ((60.0, 0, 0), 1.0), estimator=estimator)
            pose = {"tx_m": off_m, "ty_m": 0.0, "tz_m": 1e4, "true_tx_m": 0.0, "true_ty_m": 0.0, "true_tz_m": 1e4}
            builder.tables["rows"][-1] |= pose
            builder.add("timings", trial=trial, scenario=ITOKAWA, estimator=estimator, stage=estimator, seconds=0.01)
    run = builder.write(estimators=["prior", "centroid", "limb"], products=[], report=None)
    found = {one.estimator: one for one in costs(read_run(run))}
    assert [(name, *one.errors) for name, one in found.items()] == [
        (one, "sight_error_m") for one in ("centroid", "limb")
    ]
    assert found["centroid"].errors["sight_error_m"].value == pytest.approx(3.0, rel=1e-4)
    assert [found[name].failed.value for name in ("centroid", "limb")] == [0.0, 1.0]


def test_the_table_holds_accuracy_and_cost(builder):
    grid = trade_grid(read_run(fill(builder)))
    lines = [dict(zip(grid.columns, row, strict=True)) for row in grid.rows]
    assert [line["estimator"] for line in lines] == ["corners", "maplets"]
    assert (lines[0]["ok"], lines[0]["time ms [95 %]"]) == ("3/4", "40.0")
    assert [line["on board kB"] for line in lines] == ["50.0", "160"]
    assert [line["landmarks"] for line in lines] == ["400", "200"]
    assert lines[1]["failures % [95 %]"].startswith("0 [0")
    assert [line["front of the scenario"] for line in lines] == [
        "on it", "not shown to be off it, against corners",
    ]  # fmt: skip


def test_the_size_is_a_number_of_the_report(builder):
    content = read_content(fill(builder))
    size = find(content.records, scenario=ITOKAWA, estimator="maplets", measure="database_bytes")
    assert (size.value, size.unit, size.statistic) == (160_000, "bytes", "count")
    (traded,) = (one for one in report_figures(content) if one.stem == "trade_off_itokawa")
    times, sizes = ([float(c.lines[0].get_xdata()[0]) for c in axes.containers] for axes in traded.figure.axes[:2])
    assert (times, sizes) == (pytest.approx([40.0, 45.0]), [50.0, 160.0]), "milliseconds and kilobytes"
    files = write_report(content.run.folder)
    assert (files.folder / "trade_off_itokawa.png").stat().st_size > 10_000
    assert "Accuracy and its cost" in files.markdown.read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_nothing_is_traded_without_times(builder):
    for trial in range(3):
        for estimator in ("corners", "maplets"):
            builder.trial(trial, PRIOR, ((4.0, 0, 0), 0.1), estimator=estimator)
    content = read_content(builder.write(estimators=["corners", "maplets"], report=None))
    assert trade_grid(content.run) is None
    assert not [one for one in report_figures(content) if one.stem.startswith("trade_off")]


def test_an_estimator_that_never_answers_has_no_accuracy(builder):
    run = read_run(fill(builder, estimators=["prior", "corners", "maplets", "dark"]))
    for trial in range(4):
        builder.trial(trial, PRIOR, None, estimator="dark", reason="black")
    run = read_run(builder.write(estimators=["prior", "corners", "maplets", "dark"], report=None))
    grid = trade_grid(run)
    line = dict(zip(grid.columns, grid.rows[-1], strict=True))
    assert (line["estimator"], line["ok"], line["position m [95 %]"]) == ("dark", "0/4", "-")
    assert line["front of the scenario"] == NO_ESTIMATE


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
    return [cost.in_scenario.beside[0][1] if cost.in_scenario.verdict == OFF else "" for cost in costs(run)]


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


@pytest.mark.parametrize(("size", "dominated"), [(40_000, ["other", ""]), (60_000, ["", ""]), (None, ["other", ""])])
def test_a_shape_on_board_counts_as_a_data_base_does(builder, size, dominated):
    """``other`` is better in all, and reads no data base: it holds a shape, or nothing (None)."""
    shapes = [{"scenario": ITOKAWA, "estimator": "other", "facets": 9, "bytes": size}] if size else []
    assert race(builder, (0.5, 0.5, 0.5, 0.0), size=None, shapes=shapes) == dominated


def test_equal_methods_are_seldom_dominated(tmp_path):
    """Errors, attitudes and times of one law: three independent intervals would have to lie on one side."""
    found = [race(RunBuilder(tmp_path / str(seed)), (1.0, 1.0, 1.0, 0.0), seed=seed, trials=12) for seed in range(10)]
    assert all(one == ["", ""] for one in found)


LEVELS = ("near", "far")


def cells(builder, factors, trials=40, kind="sequence", **manifest):
    """Store tracks of ``a`` and ``b`` at two levels: errors and times are 10 m and 0.1 s times factors, with noise."""
    rng = np.random.default_rng(1)
    for (level, name), (error, time) in factors.items():
        for trial in range(trials):
            key = {"trial": trial, "scenario": level, "estimator": name}
            size = 10.0 * error * rng.lognormal(0.0, 0.1)
            builder.add("rows", **key, status="ok", reason="", n_landmarks=0, image="", position_error_m=size)
            builder.add("epochs", **key, frame=0, position_error_m=size)
            builder.add("timings", **key, stage="cycle", seconds=0.1 * time * rng.lognormal(0.0, 0.1))
    axes = [{"name": "range", "label": "range of it", "levels": LEVELS, "values": None}]
    scenarios = [{"name": level, "base": "rock", "levels": {"range": level}} for level in LEVELS]
    grid = {"design": "full", "axes": axes, "scenarios": scenarios}
    told = {"scenarios": {level: {} for level in LEVELS}, "estimators": ["a", "b"], "report": None, "grid": grid}
    return builder.write(**told | manifest)


FACTORS = {("near", "a"): (1.0, 1.0), ("near", "b"): (0.5, 2.0), ("far", "a"): (2.0, 2.0), ("far", "b"): (1.0, 4.0)}
"""At both levels ``b`` is more accurate and slower; far away all is twice as bad, so that ``b`` there is like ``a``."""


def test_the_levels_of_a_grid_of_sequences_have_one_front(builder):
    found = costs(read_run(cells(builder, FACTORS)))
    assert [(cost.scenario, cost.estimator) for cost in found] == [
        ("near", "a"), ("near", "b"), ("far", "a"), ("far", "b"),
    ]  # fmt: skip
    assert {cost.in_scenario for cost in found} == {Standing(ON)}, "each is the more accurate or the faster one"
    near_a, near_b, far_a, far_b = (cost.over_grid for cost in found)
    assert near_a == near_b == Standing(ON)
    assert (far_a.verdict, far_a.beside) == (OFF, (("near", "a"),)), "b is as fast: not better beyond an interval"
    assert (far_b.verdict, far_b.beside) == (OFF, (("near", "b"),)), "a is as accurate"


def test_time_alone_decides_nothing_between_scenarios(builder):
    """What ignores the axis has equal errors at both levels, and a time that follows the load of the machine."""
    run_folder = cells(builder, {("near", "a"): (1.0, 1.0), ("far", "a"): (1.0, 2.0), ("far", "b"): (2.0, 4.0)})
    near = [row["position_error_m"] for row in builder.tables["rows"] if row["scenario"] == "near"]
    for row in builder.tables["rows"]:
        if (row["scenario"], row["estimator"]) == ("far", "a"):
            row["position_error_m"] = near[row["trial"]]
    found = costs(read_run(builder.write(**json.loads((run_folder / "manifest.json").read_text()))))
    assert [cost.over_grid.verdict for cost in found][1:] == [UNDECIDED, OFF]


def test_what_is_not_told_apart_is_said_in_words(builder):
    """Four trials have no interval of a median."""
    grid = trade_grid(read_run(cells(builder, FACTORS, trials=4)))
    lines = [dict(zip(grid.columns, row, strict=True)) for row in grid.rows]
    assert grid.columns[:3] == ("range of it", "estimator", "ok")
    assert lines[0]["front of the scenario"] == f"{UNDECIDED}, against b"
    assert lines[0]["front of the grid"] == f"{UNDECIDED}, against b, a at far and 1 more"
    assert "-" not in {cell for line in lines for cell in line.values()}


def test_scenarios_that_are_no_grid_have_a_front_each(builder):
    found = costs(read_run(cells(builder, FACTORS, grid=None)))
    assert {(cost.in_scenario.verdict, cost.over_grid) for cost in found} == {(ON, None)}


def test_of_a_wide_grid_the_cells_that_nothing_beats_are_listed(builder, monkeypatch):
    monkeypatch.setattr("boresight.reports.kinds.trade_off.MOST_CELLS", 3)
    run = read_run(cells(builder, FACTORS))
    assert [(cost.scenario, cost.estimator) for cost in costs(run)] == [("near", "a"), ("near", "b")]
    assert "Of 4 cells" in trade_grid(run).note


def test_a_grid_has_the_table_for_each_scenario(builder):
    axes = [{"name": "world", "label": "world", "levels": ["a"], "values": None}]
    levels = [{"name": ITOKAWA, "base": "rock", "levels": {"world": "a"}}]
    for design, shown in (("full", 1), ("two-level", 0)):
        content = read_content(fill(builder, grid={"design": design, "axes": axes, "scenarios": levels}))
        titles = [grid.title for grid in report_grids(content)]
        assert sum("Accuracy and its cost" in title for title in titles) == shown


def test_marks_lie_at_their_costs():
    errors = {"position_error_m": Measured(4.0, 3.0, 5.0), "attitude_error_deg": Measured(0.1, 0.08, 0.12)}
    labels = {"position_error_m": "position error, m", "attitude_error_deg": "attitude error, deg"}
    marks = [
        Traded("maplets", errors, {"ms": 500.0, "kB": 160.0}, note="near"),
        Traded("shape", errors, {"ms": 2000.0}, off=True),
    ]
    prior = {"position_error_m": 45.0, "attitude_error_deg": 1.0}
    figure = draw_trade_off(marks, labels, prior, "T", ["Credit"])
    assert render(figure, "png")[:4] == b"\x89PNG"
    time, size = figure.axes[:2]
    assert [tuple(np.ravel(c.lines[0].get_xydata())) for c in time.containers] == [(500.0, 4.0), (2000.0, 4.0)]
    assert [tuple(np.ravel(c.lines[0].get_xydata())) for c in size.containers] == [(160.0, 4.0)]
    assert [list(line.get_ydata()) for line in time.lines if line.get_label() == "prior"] == [[45.0, 45.0]]
    assert [c.lines[0].get_markerfacecolor() == "none" for c in time.containers] == [False, True], "off is open"
    assert [text.get_text() for text in time.texts] == ["near"]


def test_labels_of_marks_that_lie_close_do_not_overlap():
    """Nine in a tenth of a decade, some at one place, in all panels."""
    errors = [{"position_error_m": Measured(4.0 + 0.1 * (i // 2), 3.0, 6.0)} for i in range(9)]
    marks = [
        Traded("lmaps", error, {"ms": 500.0 + 5.0 * i, "kB": 160.0}, note=f"{i}00, 30 deg")
        for i, error in enumerate(errors)
    ]
    marks.append(Traded("limb", {"position_error_m": Measured(40.0, 30.0, 50.0)}, {"ms": 5.0, "kB": 10.0}))
    figure = draw_trade_off(marks, {"position_error_m": "position error, m"}, {}, "T")
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [text.get_window_extent() for text in axes.texts]
        assert len(boxes) == 9
        shared = (Bbox.intersection(a, b) for a, b in combinations(boxes, 2))
        assert all(box is None or box.width * box.height < 1e-6 for box in shared)
        assert all(box.x1 <= axes.bbox.x1 for box in boxes), "none is cut off at the right"
