"""What was known exactly on board stands beside every headline, wherever that is printed."""

from __future__ import annotations

import pytest
from stored_runs import SCENARIO
from terminal_text import terminal_lines

from boresight import summary
from boresight.reports.compare import compare_runs
from boresight.reports.kinds import brief_grids, report_grids
from boresight.reports.pages.build import write_report
from boresight.reports.pages.comparison import write_comparison
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run
from boresight.reports.run.limits import KNOWLEDGE_UNREADABLE, known_lines, short_line, single_draws
from boresight.reports.schema.grid import Grid
from boresight.reports.tables import reference_grid

CAMERA, VIEW = {"width_px": 64, "height_px": 64, "fov_deg": 20}, {"range_m": 2000}
IDEAL = {"name": SCENARIO, "camera": CAMERA, "viewpoint": VIEW}
BLURRED = IDEAL | {"detector": {"psf_sigma_px": 0.8}, "onboard": {"focal_error": 0.01}}
LINE = (
    "Perfect knowledge of: shape, reflectance, camera, Sun, spin, renderer, law of the pose errors; no albedo"
    " variation; no blur; no noise (no `detector`). Imperfect or no knowledge of: pose."
)
SHORT = (
    "Perfect knowledge of: shape, reflectance, Sun, spin, renderer, law of the pose errors; no albedo variation."
    " Imperfect or no knowledge of: camera,"
)


@pytest.fixture
def blurred(builder):
    builder.trial(0, ([3, 4, 0], 1), ([1, 0, 0], 1))
    builder.trial(1, ([3, 4, 0], 1), ([2, 0, 0], 1))
    return builder.write(scenarios={SCENARIO: BLURRED})


@pytest.mark.usefixtures("undrawn")
def test_a_report_says_it_in_full_before_and_shortly_beside_the_headline(blurred):
    files = write_report(blurred)
    full = "camera (focal length wrong by 1 %), pose, blur (0.8 px), noise."
    text, page = files.markdown.read_text(), files.html.read_text()
    assert text.index(full) < text.index("Pose error, ") < text.index(SHORT)
    assert page.index(full) < page.index("Pose error, "), "a page says it once, at its top"
    assert page.count(full) == 1
    assert SHORT not in page
    assert SHORT in " ".join(" ".join(terminal_lines(files.content)).split())
    assert SHORT in report_grids(files.content)[0].latex()
    assert any(full in line for line in summary(blurred).attrs["known"])


@pytest.mark.usefixtures("undrawn")
def test_a_comparison_says_it_of_all_its_runs(blurred, tmp_path):
    page, grids = write_comparison(compare_runs([blurred]), tmp_path / "compared")
    text = page.with_suffix(".md").read_text()
    assert text.index("blur (0.8 px), noise.") < text.index(SHORT)
    assert grids[0].known.startswith(SHORT)


def test_scenarios_with_the_same_share_a_line_and_others_have_their_own(builder):
    builder.trial(0, ([3, 4, 0], 1), ([1, 0, 0], 1))
    scenarios = {SCENARIO: IDEAL, "again": IDEAL | {"name": "again"}, "other": BLURRED | {"name": "other"}}
    run = read_run(builder.write(scenarios=scenarios))
    first, second = known_lines(run)
    assert first == f"itokawa, again: {LINE}"
    assert second.startswith("other: ")
    assert short_line(run, scenario="again") == LINE
    assert "In some scenarios only: camera, no blur, no noise." in short_line(run)


def test_a_grid_of_scenarios_has_one_line(builder):
    builder.trial(0, ([3, 4, 0], 1), ([1, 0, 0], 1))
    cells = {f"cell-{n}": IDEAL | {"name": f"cell-{n}", "onboard": {"focal_error": 0.01 * n}} for n in range(6)}
    (line,) = known_lines(read_run(builder.write(scenarios={SCENARIO: IDEAL} | cells)))
    assert "In some scenarios only: camera." in line


def test_the_kind_of_trials_comes_from_the_campaign(builder):
    builder.trial(0, ([3, 4, 0], 1), ([1, 0, 0], 1))
    run = read_run(builder.write(scenarios={SCENARIO: IDEAL}, campaign={"experiment": "pose-convergence"}))
    assert "which landmark is which" in short_line(run)


def test_scenarios_of_another_version_are_said_to_be_so(builder):
    builder.trial(0, ([3, 4, 0], 1), ([1, 0, 0], 1))
    content = read_content(builder.write(scenarios={SCENARIO: IDEAL | {"no_such_section": {}}}))
    assert KNOWLEDGE_UNREADABLE in content.notes
    assert [grid.known for grid in brief_grids(content)][:1] == [KNOWLEDGE_UNREADABLE]


def test_errors_against_an_aligned_reference_are_called_correlated(builder):
    images = {"folder": "set", "truth": "label", "also_score": ["ref"], "aligned": ["ref"]}
    spec = {"name": SCENARIO, "camera": CAMERA, "images": images}
    for trial in range(3):
        builder.trial(trial, ([3, 4, 0], 1), ([1, 0, 0], 1), image="a.png")
        key = {"trial": trial, "scenario": SCENARIO, "estimator": "landmark-harris"}
        for name in ("label", "ref"):
            error = {f"position_error_{axis}_m": 1.0 for axis in "xyz"}
            builder.add("references", **key, reference=name, position_error_m=2.0, attitude_error_deg=1.0, **error)
    content = read_content(builder.write(scenarios={SCENARIO: spec}))
    grid = reference_grid(content.records, content.run)
    assert grid is not None
    assert "Errors against ref are correlated with those of methods that align renderings of the shape" in grid.note
    assert [row[1] for row in grid.rows] == ["label", "ref"]


def test_a_grid_keeps_the_line_in_fewer_columns():
    grid = Grid("T", ("a", "b"), (("x", "1"),), known="Perfect knowledge of: a.")
    assert grid.keep("b").known == "Perfect knowledge of: a."
    assert grid.markdown().endswith("| x | 1 |\n\nPerfect knowledge of: a.\n")


def test_numbers_beyond_all_bounds_are_told_like_others(builder):
    """A stored run may hold what no camera meets: its report is read all the same."""
    builder.trial(0, ([3, 4, 0], 1), ([1, 0, 0], 1))
    huge = {"pose_error": {"position_cam_m": {"normal": [1e30] * 3}}, "onboard": {"sun_error_deg": {"normal": 1e30}}}
    run = read_run(builder.write(scenarios={SCENARIO: IDEAL | huge}))
    assert "Imperfect or no knowledge of: Sun, pose." in short_line(run)


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ([{}], ""),
        ([{"craters": {"seed": 1}}] * 2, "one world of craters"),
        ([{"craters": {"seed": 1}}, {"craters": {"seed": 2}}], "one world of craters each"),
        ([{"crater_pairs": {"craters": {"seed": 1}}}], "one world of craters"),
        ([{"crater_pairs": {"craters": None}}], ""),
        (
            [{"orbit": {"sightings": {"craters": 9}, "knowledge": {"shape_degree": degree}}} for degree in (8, 34)],
            "one world of craters and one a priori shape each",
        ),
        (
            [
                {
                    "craters": {"seed": 1},
                    "orbit": {"imaging": {"craters": {"seed": 2}}, "knowledge": {"shape_degree": 34}},
                }
            ],
            "one world of craters and one a priori shape",
        ),
    ],
)
def test_what_a_run_has_only_one_of_is_named(builder, sections, said):
    builder.trial(0, ([3, 4, 0], 1), ([1, 0, 0], 1))
    scenarios = {SCENARIO if not i else f"{i}": IDEAL | section for i, section in enumerate(sections)}
    assert single_draws(read_run(builder.write(scenarios=scenarios))) == said
