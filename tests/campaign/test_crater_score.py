"""Detections against true craters: matches, duplicates, false alarms and errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from boresight.campaign.trial.score import NONE, check_detections, ellipse_errors, match_detections
from boresight.estimators.craters.contract import CraterDetections
from boresight.scenarios.geometry import Ellipses


def circles(*circle: tuple[float, float, float]) -> Ellipses:
    u, v, r = np.array(circle, dtype=float).reshape(-1, 3).T
    return Ellipses(np.stack([u, v], axis=1), np.stack([r, r], axis=1), np.zeros(len(u)))


def test_a_match_is_near_and_of_about_the_size() -> None:
    true = circles((100, 100, 10))
    assert match_detections(circles((102.9, 100, 10)), true).crater.tolist() == [0]
    assert match_detections(circles((103.1, 100, 10)), true).crater.tolist() == [NONE]
    assert match_detections(circles((100, 100, 10 * np.exp(0.35))), true).crater.tolist() == [0]
    assert match_detections(circles((100, 100, 10 * np.exp(-0.37))), true).crater.tolist() == [NONE]
    small = circles((50, 50, 3))
    assert match_detections(circles((51.4, 50, 3)), small).crater.tolist() == [0]
    assert match_detections(circles((51.6, 50, 3)), small).crater.tolist() == [NONE]


def test_the_radius_of_an_ellipse_is_that_of_equal_area() -> None:
    true = Ellipses(np.array([[60.0, 60.0]]), np.array([[16.0, 4.0]]), np.array([0.3]))
    assert match_detections(circles((60, 60, 8)), true).crater.tolist() == [0]


def test_duplicates_are_false_alarms_and_the_confident_choose_first() -> None:
    true = circles((100, 100, 10), (106, 100, 10))
    found = circles((100.5, 100, 10), (100, 100, 10), (99.5, 100.0, 10), (300, 300, 10))
    matches = match_detections(found, true)
    assert matches.crater.tolist() == [0, NONE, NONE, NONE]
    assert matches.duplicate.tolist() == [False, True, True, False]
    two = circles((100, 100, 10), (105, 100, 10))
    between = match_detections(circles((102.5, 100, 10), (102, 100, 10), (104, 100, 10)), two)
    assert between.crater.tolist() == [0, 1, NONE]
    assert between.duplicate.tolist() == [False, False, True]


def test_what_is_above_a_threshold_does_not_depend_on_what_is_below() -> None:
    rng = np.random.default_rng(3)
    true = circles(*rng.uniform([0, 0, 5], [200, 200, 20], (40, 3)))
    found = circles(*rng.uniform([0, 0, 5], [200, 200, 20], (80, 3)))
    every = match_detections(found, true)
    for count in (1, 10, 40):
        part = match_detections(found[slice(0, count)], true)
        assert np.array_equal(part.crater, every.crater[:count])
        assert np.array_equal(part.duplicate, every.duplicate[:count])
    matched = every.crater[every.crater != NONE]
    assert len(set(matched.tolist())) == len(matched)


def test_greedy_matching_loses_little_against_the_best_assignment() -> None:
    rng = np.random.default_rng(4)
    true = circles(*rng.uniform([0, 0, 5], [400, 400, 20], (60, 3)))
    found = Ellipses(true.centre_px + rng.normal(0, 0.8, (60, 2)), true.semi_axes_px * 1.05, true.angle_rad)
    matches = match_detections(found, true)
    apart = np.linalg.norm(found.centre_px[:, None] - true.centre_px, axis=2)
    fits = (apart <= np.maximum(0.3 * true.radius_px, 1.5)) & (
        np.abs(np.log(found.radius_px[:, None] / true.radius_px)) < 0.36
    )
    rows, columns = linear_sum_assignment(fits, maximize=True)
    assert (matches.crater != NONE).sum() >= fits[rows, columns].sum() - 1


def test_errors_have_their_signs() -> None:
    found = Ellipses(np.array([[10.0, 20.0]]), np.array([[8.0, 5.0]]), np.array([0.1]))
    true = Ellipses(np.array([[13.0, 16.0]]), np.array([[7.0, 5.5]]), np.array([0.2]))
    errors = {name: float(value[0]) for name, value in ellipse_errors(found, true).items()}
    expected = {"centre_error_px": 5.0, "centre_error_u_px": -3.0, "centre_error_v_px": 4.0}
    assert errors == pytest.approx({**expected, "major_error_px": 1.0, "minor_error_px": -0.5})


def test_nothing_found_and_nothing_there() -> None:
    none = Ellipses.none()
    assert len(match_detections(none, circles((1, 1, 5))).crater) == 0
    assert match_detections(circles((1, 1, 5)), none).crater.tolist() == [NONE]


@pytest.mark.parametrize(
    ("ellipses", "confidence", "words"),
    [
        (circles((1, 1, 5)), np.array([1.0, 0.5]), "confidence of detections of shape"),
        (circles((1, np.nan, 5)), np.array([1.0]), "centres"),
        (circles((1, 1, 5), (2, 2, 5)), np.array([0.5, 1.0]), "order"),
        (Ellipses(np.zeros((1, 2)), np.array([[3.0, 4.0]]), np.zeros(1)), np.array([0.5]), "longer"),
        (circles((1, 1, 0)), np.array([0.5]), "positive"),
    ],
)
def test_rubbish_is_refused(ellipses: Ellipses, confidence: np.ndarray, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_detections(CraterDetections(ellipses, confidence))
