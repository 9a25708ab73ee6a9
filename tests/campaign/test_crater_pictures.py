"""Craters in pictures: tables of labels, their scores by hand and by another matcher, and the Sun of a drawn scene."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from boresight.campaign.cli import main
from boresight.campaign.data.crater_pictures import open_picture, read_labels
from boresight.campaign.data.label_score import LabelMatches, label_quality, match_labels, recall_at, score_table
from boresight.estimators.craters.contract import CraterDetections
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses


def circles(rows):
    rows = np.asarray(rows, dtype=float)
    return Ellipses(rows[:, :2], rows[:, [2, 2]], np.zeros(len(rows)))


@pytest.mark.parametrize(
    ("text", "columns", "expected"),
    [
        ("ID,X,Y,W,H,C_X,CY\n7,10,20,8,6,14,23\n", "", [14, 23, 4, 3, 0]),
        ("ID\tX\tY\tW\tH\n7\t10\t20\t6\t8\n", "", [13, 24, 4, 3, np.pi / 2]),
        ("x;y;diameter\n10.5;20;9\n", "", [10.5, 20, 4.5, 4.5, 0]),
        ("# from a survey\nu_px,v_px,radius_px\n1,2,3\n", "", [1, 2, 3, 3, 0]),
        ("1,2,6\n", "x,y,diameter", [1, 2, 3, 3, 0]),
        ("u_px,v_px,a_px,b_px,angle_deg,confidence\n1,2,5,4,90,1\n", "", [1, 2, 5, 4, np.pi / 2]),
    ],
)
def test_boxes_circles_and_ellipses_are_read(text, columns, expected, tmp_path):
    (tmp_path / "labels.csv").write_text(text)
    rim = read_labels(tmp_path / "labels.csv", columns)
    assert len(rim) == 1
    np.testing.assert_allclose([*rim.centre_px[0], *rim.semi_axes_px[0], rim.angle_rad[0]], expected)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "line 1: columns none"),
        ("1,2,6\n", "line 1: columns 1, 2, 6 are no boxes"),
        ("x,X,y,radius\n1,2,3,4\n", "line 1: two columns are x: leave one out"),
        ("x,y,radius\n", "no craters"),
        ("x,y,radius\n\n1,2,three\n", "line 3: .* not all numbers"),
        ("x,y,radius\n1,2\n", "line 2: .* not all numbers"),
        ("x,y,radius\n1,2,-3\n", "line 2: x 1, y 2, radius -3 cannot be"),
        ("x,y,radius\n1,nan,3\n", "line 2: .* cannot be"),
    ],
)
def test_a_bad_table_is_one_line_and_exit_code_2(text, fault, tmp_path, capsys):
    (tmp_path / "labels.csv").write_text(text)
    with pytest.raises(BoresightError, match=fault):
        read_labels(tmp_path / "labels.csv")
    cv2.imwrite(str(tmp_path / "a.png"), np.arange(64 * 64, dtype=np.uint8).reshape(64, 64))
    told = ["craters", str(tmp_path / "a.png"), "--truth", str(tmp_path / "labels.csv"), "--out", str(tmp_path / "out")]
    assert main(told) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.parametrize("content", [b"", b"no image"])
def test_a_picture_that_is_none_is_named(content, tmp_path):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(BoresightError, match=r"a.png: no image"):
        open_picture(tmp_path / "a.png")


def test_a_picture_of_16_bits_keeps_its_numbers(tmp_path):
    stored = np.arange(100, dtype=np.uint16).reshape(10, 10) * 600
    cv2.imwrite(str(tmp_path / "a.png"), stored)
    np.testing.assert_array_equal(open_picture(tmp_path / "a.png"), stored)


def test_scores_are_those_counted_by_hand():
    """Four labels, one below the least radius; right, repeated, false, of the small label, false, right."""
    labels = circles([[20, 20, 8], [60, 20, 10], [20, 60, 3], [60, 60, 6]])
    found = circles([[21, 20, 7], [20, 22, 9], [90, 90, 6], [20, 61, 4], [60, 30, 5], [61, 60, 6]])
    sure = np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.4])
    image = np.ones((100, 100), dtype=np.float32)
    matches = match_labels(CraterDetections(found, sure), labels, image, 4.0)
    assert matches.label.tolist() == [0, -2, -1, -2, -1, 2]
    # All six detections have the least size of labels: false is one of three, of four, of five, of six.
    assert recall_at(matches, 0.34) == (pytest.approx(2 / 3), 0.4)
    assert recall_at(matches, 0.25) == (pytest.approx(1 / 3), 0.6)
    assert np.isnan(recall_at(matches, -0.1)[0])
    both = LabelMatches.joined([matches, matches])
    assert both.label.tolist() == [0, -2, -1, -2, -1, 2, 3, -2, -1, -2, -1, 5]
    assert recall_at(both, 0.34)[0] == pytest.approx(2 / 3)
    table = score_table(matches).set_index("labels")
    assert table.loc["radius 8 to 16 px", "n"] == 2
    assert table.loc["radius 4 to 8 px", "recall_2"] == 0.0
    assert "labels are 1.07 times as large as the 2 rims for them" in label_quality(matches)


def test_a_label_that_is_not_wanted_makes_a_detection_right_and_has_no_recall():
    labels, image = circles([[20, 20, 6], [60, 60, 6], [90, 20, 6]]), np.ones((100, 100), np.float32)
    found = CraterDetections(circles([[20, 20, 6], [60, 60, 6], [20, 90, 6]]), np.array([0.9, 0.8, 0.7]))
    matches = match_labels(found, labels, image, 4.0, np.array([True, False, True]))
    np.testing.assert_array_equal(matches.label, [0, -2, -1])
    assert recall_at(matches, 0.0) == (0.5, 0.8)


def test_as_many_labels_are_found_as_an_optimal_assignment_pairs():
    """Of craters far apart the order of choice cannot matter: scipy's assignment is the reference."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(20, 400, 40), np.arange(20, 400, 40)), -1).reshape(-1, 2)
    labels = circles(np.column_stack([grid, rng.uniform(5, 12, len(grid))]))
    moved = grid + rng.normal(0, 4, grid.shape)
    found = circles(np.column_stack([moved, labels.radius_px * np.exp(rng.normal(0, 0.4, len(grid)))]))
    image = rng.uniform(1, 2, (400, 400)).astype(np.float32)
    matches = match_labels(CraterDetections(found, np.linspace(1, 0, len(grid))), labels, image, 4.0)
    apart = np.linalg.norm(found.centre_px[:, None] - labels.centre_px, axis=2) / labels.radius_px
    right = (apart < 0.5) & (np.abs(np.log(found.radius_px[:, None] / labels.radius_px)) < 0.5)
    rows, columns = linear_sum_assignment(-right.astype(float))
    assert np.sum(matches.label >= 0) == right[rows, columns].sum()
    assert 20 < right[rows, columns].sum() < 100
