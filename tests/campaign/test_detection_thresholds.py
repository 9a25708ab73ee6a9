"""Thresholds on a detector's confidence, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from training.thresholds import lowest_threshold

from boresight.scenarios.errors import BoresightError


def test_lowest_threshold_lets_the_share_through_and_no_more() -> None:
    confidence = np.array([0.2, 0.9, 0.8, 0.5, 0.7, 0.6])
    false = np.array([True, False, False, False, True, False])
    # From the top: 0, 0, 1/3, 1/4, 1/5, 2/6 are false.
    assert lowest_threshold(confidence, false, 0.2) == 0.5
    assert lowest_threshold(confidence, false, 0.19) == 0.8
    assert lowest_threshold(confidence, false, 0.34) == 0.2


def test_equal_confidences_are_let_through_together() -> None:
    confidence = np.array([0.9, 0.5, 0.5])
    assert lowest_threshold(confidence, np.array([False, False, True]), 0.1) == 0.9
    assert lowest_threshold(confidence, np.array([False, False, True]), 0.4) == 0.5


def test_no_threshold_is_an_error() -> None:
    with pytest.raises(BoresightError, match="no threshold"):
        lowest_threshold(np.array([0.9, 0.5]), np.array([True, False]), 0.1)
