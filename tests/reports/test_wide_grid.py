"""What a report says of a grid of more cells than a page can show."""

import itertools
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from stored_grids import PHASES, RANGES, TRIALS, size_m, store_thousand, store_wide
from stored_runs import RunBuilder, pose_error

from boresight.reports.kinds import brief_grids, pooled, report_figures, report_grids
from boresight.reports.kinds.maps import level_maps
from boresight.reports.kinds.pooled import EXTREMES, MOST_CELLS, MOST_LEVELS, shown_levels
from boresight.reports.pages.build import html_page
from boresight.reports.pages.content import content_of, read_content
from boresight.reports.run.data import GridAxis
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.scenarios.load import load_scenario

METHODS = tuple(f"method-{k}" for k in range(7))
CELLS = len(RANGES) * len(PHASES) * len(METHODS)


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    assert CELLS > MOST_CELLS
    return read_content(store_wide(tmp_path_factory.mktemp("wide") / "run", methods=METHODS))


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The same grid of two methods, few enough for maps."""
    return read_content(store_wide(tmp_path_factory.mktemp("two") / "run", methods=METHODS[:2]))


def test_levels_are_pooled_over_the_other_axes(wide):
    position = [grid for grid in report_grids(wide) if grid.title.startswith("Position")]
    assert [grid.title.split(", ")[-1] for grid in position] == ["by range", "by phase", "best and worst cells"]
    by_phase = position[1]
    assert by_phase.columns == ("estimator", "solved", "success", "all", *PHASES)
    assert [row[0] for row in by_phase.rows] == ["prior", *METHODS]
    sizes = [size_m(i, 2, 3, trial) for i in range(len(RANGES)) for trial in range(TRIALS)]
    assert by_phase.rows[4][6].split(" [")[0] == f"{np.median(sizes):.0f}"
    n = len(RANGES) * len(PHASES) * TRIALS
    assert by_phase.rows[4][1:3] == (f"{n}/{n}", f"{n}/{n}")
    assert by_phase.rows[len(METHODS)][1] == f"{n - TRIALS}/{n}", "of the last method a cell has failed"
    assert by_phase.rows[len(METHODS)][-1].endswith(f" of the {4 * TRIALS} that ended")
    assert "table.csv" in position[0].note


def test_the_extreme_cells_are_in_full(wide):
    (grid,) = (one for one in report_grids(wide) if one.title.endswith("best and worst cells"))
    assert len(grid.rows) == 2 * EXTREMES
    assert [row[:4] for row in grid.rows[:2]] == [("best", "0 km", "0 deg", f"method-{k}") for k in (0, 1)]
    worst = grid.rows[EXTREMES]
    assert worst == ("worst", "4 km", "5 deg", METHODS[-1], f"0/{TRIALS}", "-", "-"), (
        "a failure is worse than any error"
    )
    assert grid.rows[EXTREMES + 1][3:] == (
        METHODS[-2], f"{TRIALS}/{TRIALS}", grid.rows[EXTREMES + 1][5],
        f"{size_m(4, 5, len(METHODS) - 2, TRIALS - 1):.0f}",
    )  # fmt: skip


def test_the_page_stays_short_and_says_where_all_cells_are(wide):
    assert list(report_figures(wide)) == []
    assert max(len(grid.rows) for grid in (*report_grids(wide), *brief_grids(wide))) <= 2 * EXTREMES
    page = html_page(wide, [])
    assert f"30 scenarios and {CELLS} cells" in page
    assert "every cell is in table.csv" in page
    assert "18 further scenarios: manifest.json" in page
    assert "rock-1-5" in page
    assert "rock-2-0" not in page
    medians = wide.table().query("stage == 'final' and measure == 'position_error_m' and statistic == 'median'")
    assert len(medians) == CELLS


def cells_of(figure):
    """Texts of the cells of each panel of a heat map, by column and row."""
    panels = [axes for axes in figure.axes if axes.texts]
    return [{tuple(map(int, text.get_position())): text.get_text() for text in axes.texts} for axes in panels]


def test_maps_have_the_medians_and_trials_of_the_last_two_axes(two):
    run = two.run
    error, last = level_maps(run, run.manifest.grid)  # no covariance was stated
    assert (error.stem, last.stem) == ("map_error_method-0", "map_error_method-1")
    (cells,) = cells_of(error.figure)
    assert len(cells) == len(RANGES) * len(PHASES)
    median = np.median([size_m(2, 3, 0, trial) for trial in range(TRIALS)])
    assert cells[3, 2].startswith(f"{median:.0f}\n[")
    assert cells[3, 2].endswith(f"\n{TRIALS}/{TRIALS}")
    assert cells_of(last.figure)[0][5, 4] == f"-\n0/{TRIALS}"


def test_maps_of_errors_come_before_the_failures_of_a_page(two):
    drawn = list(level_maps(two.run, two.run.manifest.grid))
    page = html_page(two, [(one, b"png") for one in drawn])
    assert drawn
    assert all(page.index(f'alt="{one.alt}"') < page.index("Failures by reason") for one in drawn)


def test_a_grid_without_an_estimate_has_no_map(tmp_path):
    run = read_content(store_wide(tmp_path / "run", RANGES[:2], PHASES[:2], METHODS[:1], 2)).run
    failed = replace(run, rows=run.rows.assign(status="failed", **dict.fromkeys(POSE_COLUMNS, np.nan)))
    assert list(level_maps(failed, run.manifest.grid)) == []


def test_maps_of_the_line_of_sight_are_in_pixels_and_apart_by_the_axis_before(tmp_path):
    """Of two bodies, which are pooled, at two ranges: an error of so many pixels is as many times farther out."""
    builder, scenarios, specs, focal_px = RunBuilder(tmp_path / "run"), [], {}, 500.0
    camera = f"camera={{width_px: 64, height_px: 64, focal_px: [{focal_px}, {focal_px}]}}"
    spec = load_scenario("quickstart", (camera,)).spec.model_dump(mode="json")
    prior = {f"prior_{key}": value for key, value in pose_error(np.array([50.0, 0.0, 0.0]), 1.0).items()}
    axes = {"body": ("a", "b"), "scenario": ("well", "badly"), "value": ("10", "30"), "phase": ("low", "high")}
    for body, known, size, phase in itertools.product(*axes.values()):
        name, range_m = f"rock-{body}-{known}-{size}-{phase}", 30_000.0 / float(size)
        levels = dict(zip(axes, (body, known, size, phase), strict=True))
        scenarios.append({"name": name, "base": "rock", "levels": levels})
        specs[name] = spec
        for trial in range(TRIALS):
            off_px = 0.1 * (1 + trial) * (3.0 if known == "badly" else 1.0)
            seen = {"tx_m": off_px * range_m / focal_px, "ty_m": 0.0, "tz_m": range_m}
            true = {"true_tx_m": 0.0, "true_ty_m": 0.0, "true_tz_m": range_m}
            errors = pose_error(np.array([seen["tx_m"], 0.0, 0.0]), 1.0)
            key = {"trial": trial, "scenario": name, "estimator": "limb", "status": "ok", "reason": "", "image": ""}
            builder.add("rows", **key, range_m=range_m, sight_nees=3.0, **prior, **errors, **seen, **true)
    told = [{"name": name, "label": name, "levels": list(levels), "values": None} for name, levels in axes.items()]
    grid = {"design": "full", "axes": told, "scenarios": scenarios}
    run = read_content(builder.write(grid=grid, scenarios=specs, estimators=["limb"], report=None, trials=TRIALS)).run
    error, nees = level_maps(run, run.manifest.grid)
    assert "Pooled over body." in error.caption
    well, badly = cells_of(error.figure)
    for place in itertools.product(range(2), range(2)):
        assert well[place].startswith("0.45")
        assert badly[place].startswith("1.35")
        assert well[place].endswith(f"\n{2 * TRIALS}/{2 * TRIALS}")
    assert cells_of(nees.figure)[0][0, 0].startswith("1.50")


def test_comparisons_grow_with_the_number_of_estimators_alone(wide):
    paired = wide.table().query("stage == 'paired' and statistic == 'median' and measure == 'position_difference_m'")
    assert len(paired) == 30 * (len(METHODS) - 1)
    assert set(paired["reference"]) == {"method-0"}


def test_of_very_many_cells_the_table_has_the_last_errors_as_they_are_in_full(wide, monkeypatch):
    monkeypatch.setattr(pooled, "MOST_MEASURED", CELLS - 1)
    huge = content_of(wide.run)
    key = ["scenario", "estimator", "stage", "reference", "measure", "statistic"]
    short, full = huge.table().set_index(key), wide.table().set_index(key)
    assert len(short) == CELLS * (4 + 1)
    pd.testing.assert_frame_equal(short, full.reindex(short.index), check_like=True)
    assert "both errors at the last stage alone" in " ".join(huge.notes)
    assert "alone; all else" not in " ".join(wide.notes)
    assert report_grids(huge) == report_grids(wide)


_REPORT = """
import resource, sys
from pathlib import Path
from boresight.reports.pages.build import write_report
write_report(Path(sys.argv[1]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


@pytest.mark.long
def test_the_report_of_a_thousand_scenarios_and_fifty_methods_fits_into_2_gib(tmp_path):
    folder = store_thousand(tmp_path / "run")
    ran = subprocess.run([sys.executable, "-c", _REPORT, folder], stdout=subprocess.PIPE, text=True, check=True)
    assert float(ran.stdout) < 2.0, "peak of the resident memory, GiB"
    assert (folder / "report" / "report.html").stat().st_size < 5e6


def test_an_axis_shows_a_dozen_levels_with_both_ends():
    shown = shown_levels(GridAxis(name="x", label="x", levels=tuple(map(str, range(100)))))
    assert len(shown) == MOST_LEVELS
    assert (shown[0], shown[-1]) == ("0", "99")
    assert shown_levels(GridAxis(name="x", label="x", levels=("a", "b"))) == ("a", "b")


def test_a_grid_that_a_page_can_show_has_every_cell(tmp_path):
    content = read_content(store_wide(tmp_path / "run", RANGES[:2], PHASES[:2], METHODS[:3], 3))
    assert [len(grid.rows) for grid in report_grids(content)][:2] == [4, 4]
    assert not any("cells of a scenario" in note for note in content.notes)
