from dataclasses import replace
from importlib import resources

import pytest

from reports.comparison import compare, judge
from reports.measures import Record
from reports.published import PublishedValue, load_published, parse, published_names
from scenarios.errors import BoresightError

# Abstract, sections 4.1, 4.2.1, 4.2.2, 4.3.1, 4.3.2 and table 1 of the paper, typed apart from the package's file.
SIMULATED = {
    ("attitude_error_deg", "prior", "median"): 1.00,
    ("attitude_error_deg", "recognition", "median"): 0.58,
    ("position_error_m", "prior", "median"): 45.3,
    ("position_error_m", "recognition", "median"): 20.9,
    ("position_error_x_m", "prior", "root-median-square"): 27.1,
    ("position_error_y_m", "prior", "root-median-square"): 27.4,
    ("position_error_z_m", "prior", "root-median-square"): 2.45,
    ("position_error_x_m", "recognition", "root-median-square"): 10.2,
    ("position_error_y_m", "recognition", "root-median-square"): 10.1,
    ("position_error_z_m", "recognition", "root-median-square"): 8.11,
    ("n_landmarks", "recognition", "median"): 59,
    ("n_landmarks", "recognition", "mean"): 56,
    ("landmark_error_m", "recognition", "median"): 1.99,
    ("database_landmarks", "database", "count"): 409,
    ("database_facets", "database", "count"): 814,
    ("seconds", "mesh_rendering", "median"): 32.7,
    ("seconds", "centroid", "median"): 0.00670,
    ("seconds", "feature_extraction", "median"): 0.758,
    ("seconds", "recognition", "median"): 0.520,
}
REAL = {
    ("attitude_error_deg", "prior", "median"): 1.04,
    ("attitude_error_deg", "recognition", "median"): 0.90,
    ("position_error_m", "prior", "median"): 107,
    ("position_error_m", "recognition", "median"): 119,
    ("position_error_x_m", "prior", "root-median-square"): 59.3,
    ("position_error_y_m", "prior", "root-median-square"): 58.0,
    ("position_error_z_m", "prior", "root-median-square"): 3.4,
    ("position_error_x_m", "recognition", "root-median-square"): 74.7,
    ("position_error_y_m", "recognition", "root-median-square"): 46.7,
    ("position_error_z_m", "recognition", "root-median-square"): 43.1,
    ("n_landmarks", "recognition", "median"): 44,
    ("database_landmarks", "database", "count"): 337,
    ("database_facets", "database", "count"): 670,
}


@pytest.mark.parametrize(
    ("name", "expected"),
    [("rowell2015-simulated", SIMULATED), ("rowell2015-real", REAL), ("rowell2015-real-context", REAL)],
)
def test_values_are_those_of_the_paper(name, expected):
    values = {(v.measure, v.stage, v.statistic): v.value for v in load_published(name).values}
    assert values == pytest.approx(expected)


@pytest.mark.parametrize(("name", "stage_rule"), [("rowell2015-simulated", 0.15), ("rowell2015-real", 0.15)])
def test_tolerances_follow_the_stated_rule(name, stage_rule):
    for value in load_published(name).values:
        if value.tolerance is not None:
            share = stage_rule if value.stage == "recognition" else 0.10
            assert value.tolerance == pytest.approx(share * value.value, rel=0.1)


def test_names_are_listed_and_an_unknown_one_is_refused_with_them():
    assert published_names() == ["rowell2015-real", "rowell2015-real-context", "rowell2015-simulated"]
    with pytest.raises(BoresightError, match=r"'rowell2016'.*rowell2015-simulated"):
        load_published("rowell2016")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("printed: 0.58 deg", "printed: 0.58 m", "does not fit attitude_error_deg"),
        ("measure: n_landmarks", "measure: n_landmark", "n_landmark"),
        ("place: section 4.2.2}", "place: section 4.2.2, page: 7}", "page"),
        ("tolerance: 0.087", "tolerance: -0.1", "tolerance"),
        ("printed: 0.58 deg", "printed: .58deg", "printed"),
        ("statistic: mean, printed", "statistic: median, printed", "given twice"),
        ("source: >-", "source: [", "not YAML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_place(old, new, message):
    text = resources.files("reports.published").joinpath("rowell2015.yaml").read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(BoresightError, match=message):
        parse(text.replace(old, new, 1), "rowell2015.yaml")


VALUE = PublishedValue(
    measure="position_error_m", stage="recognition", statistic="median", printed="20.0 m", tolerance=3.0,
    better="lower", place="section 4.2.1",
)  # fmt: skip
OURS = Record("s", "e", "recognition", "", "position_error_m", "m", "median", 20.0, 19.0, 21.0, 10, 10)


@pytest.mark.parametrize(
    ("value", "low", "high", "verdict"),
    [
        (22.9, 22.0, 24.0, "reproduced"),
        (17.1, 15.0, 18.0, "reproduced"),
        (14.0, 13.0, 16.9, "better"),
        (26.0, 23.1, 28.0, "differs"),
        (26.0, 22.9, 28.0, "undecided"),  # the interval reaches the tolerance
        (16.0, 15.0, 17.1, "undecided"),
        (20.0, 13.9, 26.1, "undecided"),  # wider than four tolerances
        (20.0, None, None, "undecided"),
        (None, None, None, "not measured"),
    ],
)
def test_verdict_rule(value, low, high, verdict):
    assert judge(replace(OURS, value=value, low=low, high=high), VALUE) == verdict


def test_verdict_needs_a_direction_to_be_better():
    neither = VALUE.model_copy(update={"better": "neither"})
    assert judge(replace(OURS, value=14.0, low=13.0, high=15.0), neither) == "differs"
    higher = VALUE.model_copy(update={"better": "higher"})
    assert judge(replace(OURS, value=26.0, low=25.0, high=27.0), higher) == "better"


def test_no_verdict_without_a_tolerance_or_across_conditions():
    assert judge(OURS, VALUE.model_copy(update={"tolerance": None})) == "context"
    prior = replace(OURS, stage="prior", statistic="RMS")
    compared = compare((prior, OURS), load_published("rowell2015-real-context"))
    assert {c.verdict for c in compared} == {"context"}
    assert sum(c.ours is OURS for c in compared) == 1
