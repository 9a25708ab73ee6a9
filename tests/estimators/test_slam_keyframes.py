"""The views of BA-SLAM's window, worked out by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from slam_sequences import Recipe, make_sequence

from boresight.estimators.registry import sequence_estimator_class
from boresight.estimators.slam.contract import LostError
from boresight.estimators.slam.keyframes.bundle import DepthGauge, hand_over_gauge, trailing_views
from boresight.estimators.slam.options import BundleOptions
from boresight.scenarios.observation import TrackRange


class Overlap:
    """Two frames share ten landmarks, less two for each frame between them: three, at most three frames apart."""

    def shared(self, first, second):
        return max(0, 10 - 2 * abs(second - first))


STANDING = SimpleNamespace(positions_m={i: np.array([790.0, 0.0, 0.0]) for i in range(40)})
WINDOWS = {
    "last-two": {3: [0, 2], 4: [0, 2], 5: [0, 2], 6: [5], 7: [5], 8: [5, 7], 9: [5, 7], 10: [5, 7], 11: [10]},
    "whole-window": {3: [0, 2], 4: [2, 3], 5: [2, 3], 6: [3, 5], 7: [5, 6], 8: [5, 6], 9: [6, 8]},
}


@pytest.mark.parametrize("connected", WINDOWS)
def test_windows_are_those_that_come_out_by_hand(connected):
    options = BundleOptions(views=3, connectivity=3, connected=connected)
    views, found = [0], {}
    for lead in range(1, 12):
        found[lead] = views = trailing_views(STANDING, Overlap(), views, lead, options)
    assert found[1] == found[2] == [0]
    assert {lead: found[lead] for lead in WINDOWS[connected]} == WINDOWS[connected]


def test_the_rule_of_the_paper_is_the_default():
    assert BundleOptions().connected == "last-two"


@pytest.mark.parametrize("connected", WINDOWS)
def test_a_turn_beyond_the_largest_angle_shifts_the_window(connected):
    turned = {i: 790.0 * np.array([np.cos(0.1 * i), np.sin(0.1 * i), 0.0]) for i in range(40)}
    slam_map = SimpleNamespace(positions_m=turned)
    views = [
        trailing_views(slam_map, Overlap(), [1, 2], 4, BundleOptions(views=3, connected=connected, angle_max_deg=a))
        for a in (12, 11)
    ]
    assert views == [[1, 2], [2, 3]]  # 11.5 deg between the last two


def gauged(connected, seen, ranges=()):
    """The landmark of the depth gauge for views 2, 4 and 6, after landmark 7 since view 2."""
    points = {track: np.array([0.0, 0.0, float(track)]) for track in (7, 8, 9)}
    frame = SimpleNamespace(tracks=np.array(sorted(seen)), ranges=ranges)
    slam_map = SimpleNamespace(frames={2: frame}, points_m=points, guessed={9}, positions_m={2: np.zeros(3)})
    return hand_over_gauge(slam_map, DepthGauge(2, 7, 6.5, 0.1), [2, 4, 6], seen, BundleOptions(connected=connected))


def test_the_gauge_of_the_paper_serves_while_the_last_acquired_view_sees_its_landmark():
    seen = {7: [2, 4], 8: [2, 4, 6]}
    assert gauged("last-two", seen) == DepthGauge(2, 8, 8.0, 0.01)
    assert gauged("whole-window", seen) == DepthGauge(2, 7, 6.5, 0.1)
    assert gauged("last-two", {7: [2, 6], 8: [2, 4, 6]}) == DepthGauge(2, 7, 6.5, 0.1)


@pytest.mark.parametrize("connected", WINDOWS)
def test_a_landmark_of_one_accepted_pixel_does_not_keep_the_gauge(connected):
    assert gauged(connected, {7: [6], 8: [2, 4, 6]}) == DepthGauge(2, 8, 8.0, 0.01)


def test_a_distance_that_was_measured_takes_the_gauge_over_before_an_estimated_one():
    seen = {7: [2, 4], 8: [2, 4, 6], 9: [2, 6]}
    assert gauged("last-two", seen, [TrackRange(9, 9.3, 0.2)]) == DepthGauge(2, 9, 9.3, 0.2)
    with pytest.raises(LostError, match="no landmark can take the depth gauge over"):
        gauged("last-two", {7: [2, 4], 9: [2, 6]})


def test_without_landmarks_in_common_the_tracks_are_lost():
    alone = SimpleNamespace(shared=lambda first, second: 5 if first == second else 2)
    with pytest.raises(LostError, match="2 landmarks are shared with the frame before, 3 are needed"):
        trailing_views(STANDING, alone, [0, 2], 3, BundleOptions(views=3))


@pytest.mark.parametrize("connected", WINDOWS)
def test_both_rules_follow_an_orbit(connected):
    sequence, truth = make_sequence(np.random.default_rng(3), Recipe(frames=60, landmarks=20))
    found = sequence_estimator_class("ba-slam").from_options({"connected": connected}).follow(sequence)
    assert found.status == "ok"
    errors = [np.linalg.norm(f.position_m - p) for f, p in zip(found.frames, truth.positions_m, strict=True)]
    assert max(errors) < 40.0
