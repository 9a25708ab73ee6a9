"""What a report says of a grid of scenarios, against errors whose ratios are known."""

import itertools

import numpy as np
import pandas as pd
import pytest
from stored_runs import SCENARIO, RunBuilder, pose_error, seal

from boresight.reports.figures.comparison import HeatMap, draw_curves, draw_heat_maps
from boresight.reports.figures.style import Points
from boresight.reports.kinds import report_grids
from boresight.reports.kinds.design_data import DesignData, Outcome, outcomes
from boresight.reports.kinds.designs import design_figures, design_grids
from boresight.reports.pages.build import html_page, write_report
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run
from boresight.reports.tables import failure_grid

TRIALS = 40
POSITION = Outcome("landmark-harris", "", "position_error_m")


def store(builder: RunBuilder, design: str, axes: list[dict], factors: dict[tuple[str, ...], float]) -> DesignData:
    """Store a run in which every scenario's errors are those of the first, trial by trial, times a factor."""
    rng = np.random.default_rng(3)
    base = rng.lognormal(2.0, 1.0, TRIALS)
    scenarios = []
    for number, (levels, factor) in enumerate(factors.items()):
        name = f"rock-{number}"
        named = dict(zip((axis["name"] for axis in axes), levels, strict=True))
        # Sorted as JSON objects are stored: the order of the axes is said elsewhere.
        scenarios.append({"name": name, "base": "rock", "levels": dict(sorted(named.items()))})
        for trial, error in enumerate(base):
            known = trial or number  # the first trial of the reference failed
            final = pose_error(np.array([error * factor, 0.0, 0.0]), error * factor / 10.0)
            prior = {f"prior_{key}": value for key, value in pose_error(np.array([50.0, 0.0, 0.0]), 2.0).items()}
            key = {"trial": trial, "scenario": name, "reason": "", "image": "", "n_landmarks": 9}
            row = final if known else dict.fromkeys(final, np.nan)
            status = "ok" if known else "failed"
            builder.add("rows", **key, estimator="landmark-harris", status=status, **prior, **row)
            own = {key.removeprefix("prior_"): value for key, value in prior.items()}
            builder.add("rows", **key, estimator="prior", status="ok", **prior, **own)
    grid = {"design": design, "axes": axes, "scenarios": scenarios}
    builder.write(grid=grid, scenarios={one["name"]: {} for one in scenarios}, report=None)
    run = read_run(builder.folder)
    assert run.manifest.grid is not None
    return DesignData(run, run.manifest.grid)


def axis(name: str, *levels: str, values: list[float] | None = None) -> dict:
    return {"name": name, "label": f"the {name}", "levels": list(levels), "values": values}


@pytest.fixture
def square(builder) -> DesignData:
    laws = ("b", "a")
    factors = {("b", "b"): 1.0, ("b", "a"): 3.0, ("a", "b"): 4.0, ("a", "a"): 2.0}
    return store(builder, "full", [axis("truth", *laws), axis("onboard", *laws)], factors)


def test_changes_are_the_factors_whatever_the_spread(square):
    """Lognormal errors of a factor e: the paired ratio is exact, with an interval of no width."""
    change = square.change("rock-1", "rock-0", POSITION)
    assert change.value == pytest.approx(3.0)
    assert change.low == pytest.approx(3.0)
    assert change.high == pytest.approx(3.0)


def test_a_square_of_levels_is_compared_with_its_diagonal(square):
    position, attitude, trials = design_grids(square.run)
    assert position.columns == (
        "the truth", "the onboard", "prior, m", "landmark-harris", "landmark-harris, change",
    )  # fmt: skip
    assert attitude.columns == tuple(name for name in position.columns if name != "prior, m")
    for grid in (position, attitude, trials):
        assert [row[:2] for row in grid.rows] == [("b", "b"), ("b", "a"), ("a", "b"), ("a", "a")]
    for grid in (position, attitude):
        assert [row[-1] for row in grid.rows] == ["-", "3.00 [3.00, 3.00]", "2.00 [2.00, 2.00]", "-"]
    assert trials.columns[2:] == ("landmark-harris, solved", "landmark-harris, success")
    assert [row[2] for row in trials.rows] == [f"{TRIALS - 1}/{TRIALS}", *[f"{TRIALS}/{TRIALS}"] * 3]
    assert [bool(grid.note) for grid in (position, attitude, trials)] == [True, False, True], "each note stands once"


def test_the_terminal_shows_the_final_error_alone(full_run):
    grid = {
        "design": "full",
        "axes": [axis("world", "a")],
        "scenarios": [{"name": SCENARIO, "base": "rock", "levels": {"world": "a"}}],
    }
    run = read_run(full_run(grid=grid))
    stages = [one.title.split(":")[0] for one in design_grids(run)]
    assert stages == ["Position error, m", "Position error after centroiding, m", "Attitude error, deg", "Trials"]
    assert [one.title.split(":")[0] for one in design_grids(run, brief=True)] == ["Position error, m", "Trials"]


def test_estimators_stand_beside_each_other(builder):
    """A second method with twice the errors of the first: a column of each matrix, not a table of its own."""
    axes = [axis("world", "a", "b")]
    store(builder, "full", axes, {("a",): 1.0, ("b",): 4.0})
    for row in [one for one in builder.tables["rows"] if one["estimator"] == "landmark-harris"]:
        builder.tables["rows"].append(
            {**row, "estimator": "another", "position_error_m": 2.0 * row["position_error_m"]}
        )
    grid = {
        "design": "full",
        "axes": axes,
        "scenarios": [{"name": f"rock-{i}", "base": "rock", "levels": {"world": x}} for i, x in enumerate("ab")],
    }
    estimators = ["prior", "landmark-harris", "another"]
    builder.write(grid=grid, scenarios={"rock-0": {}, "rock-1": {}}, report=None, estimators=estimators)
    run = read_run(builder.folder)
    position, _, trials = design_grids(run)
    assert position.columns == ("the world", "prior, m", "landmark-harris", "another")
    data = DesignData(run, run.manifest.grid)
    medians = [[float(cell.split()[0]) for cell in row[2:]] for row in position.rows]
    known = [data.median(name, POSITION).value for name in ("rock-0", "rock-1")]
    assert medians == [pytest.approx([value, 2.0 * value], rel=5e-3) for value in known]
    heads = ("solved", "success")
    assert trials.columns[1:] == tuple(f"{name}, {head}" for name in ("landmark-harris", "another") for head in heads)
    assert [one.title for one in design_grids(run, brief=True)] == [position.title, trials.title]
    page = html_page(read_content(run.folder), [])
    assert page.count(position.title) == 1, "a table that the top of the page shows is not shown again"


def test_the_median_is_that_of_the_trials_with_an_estimate(square):
    rows = square.run.rows
    mine = rows[(rows["scenario"] == "rock-2") & (rows["estimator"] == "landmark-harris")]
    assert square.median("rock-2", POSITION).value == pytest.approx(float(mine["position_error_m"].median()))
    assert len(square.errors("rock-0", POSITION)) == TRIALS - 1


def test_main_effects_multiply(builder):
    effects = {"focal": 1.5, "sun": 1.0, "pole": 0.5}
    axes = [axis(name, "0", "1", values=[0, 1]) for name in effects]
    factors = {
        levels: float(np.prod([e for e, level in zip(effects.values(), levels, strict=True) if level == "1"]))
        for levels in itertools.product("01", repeat=3)
    }
    data = store(builder, "two-level", axes, factors)
    position, attitude, trials = design_grids(data.run)
    for grid in (position, attitude):
        assert [row[3].split()[0] for row in grid.rows] == ["1.50", "1.00", "0.500"]
    solved = [trials.columns.index(f"landmark-harris, solved {end}") for end in ("from", "to")]
    assert [trials.rows[0][i] for i in solved] == [f"{4 * TRIALS - 1}/{4 * TRIALS}", f"{4 * TRIALS}/{4 * TRIALS}"]
    assert write_report(builder.folder).figures


@pytest.mark.usefixtures("undrawn")
def test_each_axis_is_compared_with_the_reference(builder):
    axes = [axis("focal", "0", "1", "2", values=[0, 1, 2]), axis("law", "a", "b")]
    factors = {("0", "a"): 1.0, ("1", "a"): 1.5, ("2", "a"): 2.5, ("0", "b"): 0.25}
    data = store(builder, "one-at-a-time", axes, factors)
    grid = design_grids(data.run)[0]
    assert [row[:2] for row in grid.rows] == [
        ("reference", ""), ("the focal", "1"), ("the focal", "2"), ("the law", "b"),
    ]  # fmt: skip
    assert [row[4].split()[0] for row in grid.rows] == ["-", "1.50", "2.50", "0.250"]
    assert [row[2] for row in grid.rows] == ["50.0 [50.0, 50.0]"] * 4, "the prior"
    stems = {path.stem for path in write_report(builder.folder).figures}
    assert stems == {"curves_position_rock_landmark-harris", "curves_attitude_rock_landmark-harris"}


def test_the_levels_of_a_single_axis_stand_beside_each_other(builder):
    world = axis("world", "matched", "mismatched")
    run = store(builder, "full", [world], {("matched",): 1.0, ("mismatched",): 4.0}).run
    drawn = {one.stem: one.figure for one in design_figures(run)}
    assert list(drawn) == ["compare", "cumulative_rock-0", "cumulative_rock-1"]
    errors, success, _ = drawn["compare"].axes
    lines = [label.get_text() for label in errors.get_yticklabels()]
    assert lines == ["prior, rock-0", "landmark-harris, rock-0", "prior, rock-1", "landmark-harris, rock-1"]
    median = {line.get_ydata()[0]: line.get_xdata()[0] for line in errors.lines if line.get_markersize() == 5}
    rows = run.rows[run.rows["estimator"] == "landmark-harris"]
    known = rows.groupby("scenario")["position_error_m"].median()
    assert (median[1], median[3]) == pytest.approx((known["rock-0"], known["rock-1"]))
    assert len(success.lines) == 2, "a rate of success for each level of the estimator, none of the prior"


def test_a_single_axis_without_a_position_is_not_drawn(builder):
    run = store(builder, "full", [axis("world", "matched", "mismatched")], {("matched",): 1.0}).run
    run.rows["position_error_m"] = np.nan
    assert not list(design_figures(run))


def test_outcomes_include_the_centroid_where_it_is_a_stage(full_run):
    run = read_run(full_run())
    assert [(o.stage, o.measure) for o in outcomes(run)] == [
        ("centroid", "position_error_m"), ("", "position_error_m"), ("", "attitude_error_deg"),
    ]  # fmt: skip


@pytest.mark.usefixtures("undrawn")
def test_an_unfinished_grid_has_a_report(builder, square):
    """Scenarios that have not been run are left out, and a cell without them is empty."""
    file = builder.folder / "rows" / "block-0.parquet"
    rows = pd.read_parquet(file)
    rows[rows["scenario"] != "rock-3"].to_parquet(file)
    assert len(design_grids(read_run(seal(builder.folder)))[0].rows) == 3
    assert write_report(builder.folder).html.exists()


def test_matrix_shows_its_numbers_where_they_belong():
    matrix = HeatMap(
        "error", ("r0", "r1"), ("c0", "c1"), np.array([[1.0, np.nan], [3.0, 4.0]]), [["a", "b"], ["c", "d"]]
    )
    [axes] = draw_heat_maps([matrix], "down", "across", "title").axes
    assert [(text.get_text(), text.get_position()) for text in axes.texts] == [
        ("a", (0, 0)), ("b", (1, 0)), ("c", (0, 1)), ("d", (1, 1)),
    ]  # fmt: skip
    assert [label.get_text() for label in axes.get_yticklabels()] == ["r0", "r1"]
    assert axes.yaxis_inverted()


def test_curves_join_points_in_the_order_of_the_abscissa():
    points = Points(
        np.array([2.0, 0.0, 1.0]), np.array([4.0, 1.0, 2.0]), np.array([[3.0, 5.0], [0.5, 2.0], [1.0, 3.0]])
    )
    figure = draw_curves([("x", {"method": points})], "y", "title")
    line = figure.axes[0].containers[0].lines[0]
    np.testing.assert_array_equal(line.get_xydata(), [[0.0, 1.0], [1.0, 2.0], [2.0, 4.0]])
    bars = figure.axes[0].containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose([bar[:, 1] for bar in bars], [[0.5, 2.0], [1.0, 3.0], [3.0, 5.0]])


def test_centroiding_alone_has_an_offset_and_no_attitude(builder):
    """What leaves the attitude as it was is not compared by it; what it reports of centroids is, in pixels."""
    axes = [axis("law", "a", "b")]
    store(builder, "full", axes, {("a",): 1.0, ("b",): 2.0})
    for scenario, offset in (("rock-0", 1.0), ("rock-1", 3.0)):
        for trial in range(TRIALS):
            key = {"trial": trial, "scenario": scenario, "estimator": "centroid"}
            pose = pose_error(np.array([offset, 0.0, 0.0]), 2.0)
            own = {f"prior_{name}": value for name, value in pose_error(np.array([50.0, 0.0, 0.0]), 2.0).items()}
            builder.add("rows", **key, reason="", image="", n_landmarks=0, status="ok", **own, **pose)
            builder.add("diagnostics", **key, name="centroid_offset_px", value=offset * (1.0 + trial / TRIALS))
    builder.write(
        grid={
            "design": "full",
            "axes": axes,
            "scenarios": [{"name": f"rock-{i}", "base": "rock", "levels": {"law": x}} for i, x in enumerate("ab")],
        },
        scenarios={"rock-0": {}, "rock-1": {}},
        report=None,
    )
    run = read_run(builder.folder)
    mine = [one for one in outcomes(run) if one.estimator == "centroid"]
    assert [one.measure for one in mine] == ["centroid_offset_px", "position_error_m"]
    assert mine[0].label == "offset of the brightness centroid, px"
    data = DesignData(run, run.manifest.grid)
    assert data.change("rock-1", "rock-0", mine[0]).value == pytest.approx(3.0)
    assert data.ok(["rock-0", "rock-1"], mine[0]) == f"{2 * TRIALS}/{2 * TRIALS}"


def test_a_report_tells_of_the_grid_and_not_of_each_scenario(square):
    content = read_content(square.run.folder)
    assert [grid.title for grid in report_grids(content)] == [
        "Position error, m: truth against onboard, rock",
        "Attitude error, deg: truth against onboard, rock",
        "Trials: truth against onboard, rock",
        "Failures by reason",
    ]
    assert not any("Scenario rock" in note for note in content.notes)
    assert len(content.table()) > len(square.design.scenarios)


def test_sequences_are_compared_by_their_errors_after_whole_revolutions(builder):
    """A trial that failed after the first revolution counts for it; one that failed before does not."""
    rng = np.random.default_rng(3)
    base = rng.lognormal(1.0, 0.5, TRIALS)
    axes = [axis("noise", "0", "2", values=[0.0, 2.0])]
    scenarios = []
    for name, level, factor in (("rock", "0", 1.0), ("rock-noise-2", "2", 3.0)):
        scenarios.append({"name": name, "base": "rock", "levels": {"noise": level}})
        for trial, error in enumerate(base):
            lost = trial < 4 and level == "2"
            nothing = {**dict.fromkeys(pose_error(np.ones(3), 1.0), np.nan)}
            prior = {f"prior_{key}": value for key, value in nothing.items()}
            key = {"trial": trial, "scenario": name, "estimator": "ba-slam"}
            status, reason = ("failed", f"frame {trial}: {trial} of 9 lost") if trial < 8 else ("ok", "")
            builder.add(
                "rows", **key, status=status, reason=reason, image="", n_landmarks=9, **prior, **nothing,
                error_after_1_m=np.nan if lost else factor * error, error_after_2_m=np.nan,
                landmark_rmse_m=1.0, settled_landmark_rmse_m=1.0, final_landmark_rmse_m=1.0, mean_position_nees=3.0,
            )  # fmt: skip
            builder.add("epochs", **key, frame=0, anomaly_deg=0.0, position_error_m=error, landmark_rmse_m=1.0,
                        settled_landmark_rmse_m=1.0)  # fmt: skip
    grid = {"design": "one-at-a-time", "axes": axes, "scenarios": scenarios}
    builder.write(grid=grid, scenarios={one["name"]: {} for one in scenarios}, report=None)
    run = read_run(builder.folder)
    assert outcomes(run) == [Outcome("ba-slam", "sequence", "error_after_1_m")]
    errors, trials = design_grids(run)
    assert errors.title == "Position error after 1 revolution, m: one at a time, rock"
    assert errors.columns == ("axis", "level", "ba-slam", "ba-slam, change")
    assert errors.rows[1][3].split()[0] == "3.00"
    assert (trials.columns[-1], trials.rows[1][-1]) == ("ba-slam, ok", f"{TRIALS - 4}/{TRIALS}")
    assert sorted(failure_grid(run).rows) == [
        (n, "ba-slam", "failed", "n of n lost", "8") for n in ("rock", "rock-noise-2")
    ]
    write_report(run.folder)
    made = {path.stem for path in (run.folder / "report").glob("*.png")}
    assert made == {"curves_error_after_1_m_rock", "levels_error_after_1_m_rock"}
