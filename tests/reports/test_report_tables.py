from dataclasses import replace

import pandas as pd
import pytest
from stored_runs import RunBuilder
from terminal_text import printed_lines, terminal_lines

from boresight.reports.compare import compare_runs
from boresight.reports.pages.content import notes, read_content
from boresight.reports.run.data import read_run
from boresight.reports.run.outcomes import reason_lines, unsolved_lines
from boresight.reports.schema.grid import Grid, number, value_of
from boresight.reports.schema.records import Record, count_of
from boresight.reports.tables import failure_grid, pose_grids, reference_grid, timing_grid

LINE = Record("s", "e", "recognition", "", "position_error_m", "m", "median", 20.94, 19.06, 121.4, 9, 10)


@pytest.mark.parametrize(
    ("value", "printed"),
    [
        (20.94, "20.9"),
        (0.0581, "0.0581"),
        (2.0, "2.00"),
        (119.4, "119"),
        (0.0, "0"),
        (-3.456, "-3.46"),
        (4.66e-17, "0"),
        (None, "-"),
    ],
)
def test_numbers_have_three_digits(value, printed):
    assert number(value) == printed


def test_a_cell_without_a_value_is_explained_below_the_table():
    rows = (("one", "3"), ("other", "-"))
    assert printed_lines([Grid("Table", ("name", "n"), rows)])[-2].startswith("-: no value: nothing was counted, or")
    assert not any("no value" in line for line in printed_lines([Grid("Table", ("name", "n"), rows[:1])]))


@pytest.mark.parametrize(
    ("many", "said"), [(0, "0 trials"), (1, "1 trial"), (2, "2 trials"), (100_000, "100,000 trials")]
)
def test_one_is_no_plural(many, said):
    assert count_of(many, "trial") == said


@pytest.mark.parametrize(
    ("changes", "printed"),
    [
        ({}, "20.9 [19.1, 121]"),
        ({"low": None, "high": None}, "20.9"),
        ({"value": None, "low": None, "high": None}, "-"),
        ({"measure": "seconds", "unit": "s", "value": 0.0067, "low": 0.0066, "high": 0.0068}, "6.70 ms [6.60, 6.80]"),
        ({"measure": "seconds", "unit": "s", "value": 32.7, "low": 30.0, "high": 33.0}, "32.7 s [30.0, 33.0]"),
        ({"statistic": "count", "value": 1409.0, "low": 1409.0, "high": 1409.0}, "1409"),
    ],
)
def test_values_are_printed_with_interval_and_unit(changes, printed):
    assert value_of(replace(LINE, **changes), interval=True) == printed


def test_markdown_keeps_a_cell_with_a_bar_in_one_piece():
    text = Grid("T", ("a", "b"), (("x | y", "1"),), note="N.").markdown()
    assert text == "### T\n\nN.\n\n| a | b |\n| :-- | --: |\n| x \\| y | 1 |\n"


def test_pose_table_shows_the_common_prior_once_and_every_stage(full_run):
    content = read_content(full_run())
    (grid,) = pose_grids(content.records, content.run)
    assert [row[:3] for row in grid.rows] == [
        ("", "prior", "120/120"),
        ("landmark-harris", "after centroiding", "120/120"),
        ("landmark-harris", "after recognition", "114/120"),
        ("landmark-harris", "failures at prior", "120/120"),
    ]
    assert all(len(row) == len(grid.columns) for row in grid.rows)


def test_line_of_failures_is_left_out_where_there_are_none(builder):
    builder.trial(0, ([1, 0, 0], 1), ([1, 0, 0], 1))
    builder.trial(1, ([2, 0, 0], 1), ([1, 0, 0], 1))
    content = read_content(builder.write())
    (grid,) = pose_grids(content.records, content.run)
    assert [row[1] for row in grid.rows] == ["prior", "final"]


def test_one_trial_prints_values_without_intervals_and_none_prints_dashes(builder):
    builder.trial(0, ([3, 4, 0], 1), None, reason="black image")
    content = read_content(builder.write())
    (grid,) = pose_grids(content.records, content.run)
    prior, final, _ = grid.rows
    assert prior[4] == "5.00"
    assert final[2:] == ("0/1", "0/1", *("-",) * 9)


def test_reasons_that_differ_in_numbers_alone_are_counted_together(builder):
    for trial, reason in enumerate(["3 of 9 lost", "4 of 9 lost", "no 1st corner", "no 1st corner", "5 craters"]):
        builder.trial(trial, ([3, 4, 0], 1), None, reason=reason)
    grid = failure_grid(read_content(builder.write()).run)
    assert {row[3]: row[4] for row in grid.rows} == {"n of n lost": "2", "no 1st corner": "2", "5 craters": "1"}
    assert "n stands for numbers" in grid.note


def test_many_failures_are_counted_over_all_scenarios(builder):
    for trial in range(2):
        builder.trial(trial, ([3, 4, 0], 1), None, reason="black image")
    run = read_content(builder.write()).run
    rows = pd.concat([run.rows.assign(scenario=f"rock-{k}") for k in range(41)])
    grid = failure_grid(replace(run, rows=rows))
    assert grid.columns == ("estimator", "status", "reason", "scenarios", "trials")
    assert [row[2:] for row in grid.rows] == [("black image", "41", "82")]
    assert "failures.csv" in grid.note


def test_references_stand_below_the_truth_by_its_name(builder):
    builder.trial(0, ([3, 4, 0], 1), ([3, 4, 0], 1), image="a.png")
    axes = dict.fromkeys(("position_error_x_m", "position_error_y_m", "position_error_z_m"), 1.0)
    key = {"trial": 0, "scenario": "itokawa", "estimator": "landmark-harris", "reference": "label"}
    builder.add("references", **key, position_error_m=10.0, attitude_error_deg=2.0, **axes)
    content = read_content(builder.write(scenarios={"itokawa": {"images": {"truth": "ref"}}}))
    grid = reference_grid(content.records, content.run)
    assert [(row[1], row[3]) for row in grid.rows] == [("ref", "5.00"), ("label", "10.0")]
    assert any("neither is exact truth" in note for note in content.notes)


def test_published_values_stand_beside_ours_and_find_the_only_data_base(full_run):
    content = read_content(full_run())
    verdicts = {(c.published.measure, c.published.stage, c.published.statistic): c.verdict for c in content.compared}
    assert verdicts["database_landmarks", "database", "count"] == "reproduced"
    assert verdicts["seconds", "mesh_rendering", "median"] == "context"
    assert verdicts["seconds", "feature_extraction", "median"] == "not measured"
    table = content.table()
    ours = table[(table["measure"] == "position_error_m") & (table["published"] == 20.9)]
    assert list(ours["stage"]) == ["recognition"]
    assert (table["published"].notna().sum()) == sum(c.ours is not None for c in content.compared)


def test_a_data_base_of_nobody_is_not_given_to_one_of_several_estimators(builder):
    for estimator in ("a", "b"):
        builder.trial(0, ([3, 4, 0], 1), ([3, 4, 0], 1), estimator=estimator)
    product = {"kind": "landmark-database", "n_landmarks": 412, "n_facets": 820}
    content = read_content(builder.write(report="rowell2015-simulated", products=[product]))
    of_database = [c.verdict for c in content.compared if c.published.stage == "database"]
    assert of_database == ["not measured"] * 4


def test_timing_table_names_the_work_done(full_run):
    grid = timing_grid(read_content(full_run()).records)
    assert [row[2] for row in grid.rows] == ["data base image rendering", "recognition and pose estimation"]
    assert grid.rows[0][3].split()[1] == "ms"
    assert grid.rows[1][3].split()[1] == "s"


def test_terminal_table_fits_80_columns(full_run):
    lines = terminal_lines(full_run())
    assert max(len(line) for line in lines) <= 80
    rows = [line for line in lines if line.startswith("after recognition ")]
    assert len(rows) == 1
    assert "114/120" in rows[0]
    assert any("undecided" in line for line in lines)


def test_one_definition_of_success_in_report_terminal_and_comparison(builder):
    errors = ([3, 0, 0], [20, 0, 0], [4, 0, 0], None)
    for trial, error in enumerate(errors):
        builder.trial(trial, ([10, 0, 0], 1), None if error is None else (error, 1))
    folder = builder.write()
    content = read_content(folder)
    (grid,) = pose_grids(content.records, content.run)
    told = {row[1]: row[2:5] for row in grid.rows}
    assert grid.columns[2:5] == ("solved", "success", "position m")
    assert told["final"][:2] == ("3/4", "2/4")
    assert told["prior"][1] == "-"
    assert told["prior"][2].startswith("10.0"), "the prior's error from the rows: the run has no estimator of that name"
    line = next(line for line in terminal_lines(folder) if line.startswith("final"))
    assert line.split()[1:3] == ["3/4", "2/4"]
    (subject,) = compare_runs([folder]).subjects
    assert (subject.n_ok, subject.success.value) == (3, 0.5)


def test_reasons_are_counted_for_the_console_the_most_frequent_first(builder):
    for trial in range(9):
        builder.trial(trial, ([10, 0, 0], 1), None, reason=f"{trial} landmarks of {trial + 7.5} are visible")
    for trial in range(9, 16):
        builder.trial(trial, ([10, 0, 0], 1), None, reason=f"for the cause {'abcdefg'[trial - 9]}")
    builder.trial(16, ([10, 0, 0], 1), ([1, 0, 0], 1))
    lines = reason_lines(read_run(builder.write()))
    assert lines[0].startswith("no estimate in 16 of 17 trials")
    assert lines[1] == "  9 failed, landmark-harris: n landmarks of n are visible"
    assert len(lines) == 7
    assert lines[-1].startswith("  3 for 3 more reasons")
    solved = RunBuilder(builder.folder.parent / "solved")
    solved.trial(0, ([10, 0, 0], 1), ([1, 0, 0], 1))
    assert reason_lines(read_run(solved.write())) == []


def test_a_column_of_text_without_a_word_is_printed():
    grid = Grid("Sensitivity", ("key", "index", ""), (("camera.fov_deg", "0.50", ""),), frozenset({0, 2}))
    assert any(line.split() == ["camera.fov_deg", "0.50"] for line in printed_lines([grid]))


def test_a_method_that_solved_nothing_is_said_with_its_reasons_in_report_and_console(builder, monkeypatch):
    for trial, reason in enumerate(("no landmarks in view",) * 3 + ("the image is black",)):
        builder.trial(trial, ([10, 0, 0], 1), None, reason=reason)
    run = read_run(builder.write())
    (line,) = unsolved_lines(run)
    assert line.startswith("landmark-harris solved 0 of 4 of ")
    assert line.endswith(": 3 no landmarks in view; 1 the image is black")
    assert line in list(notes(run, None))
    monkeypatch.setattr("boresight.reports.run.outcomes._MOST_UNSOLVED", 0)
    assert unsolved_lines(run) == ["and 1 more method in a scenario"]
    builder.trial(4, ([10, 0, 0], 1), ([1, 0, 0], 1))
    assert unsolved_lines(read_run(builder.write())) == []
