"""Guided matching: consensus against a known world, and the predicted covariance against another computation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from slam_sequences import Recipe, make_sequence

from boresight.estimators.slam.adjustment.solver import kept_covariance, view_covariance
from boresight.estimators.slam.options import SmootherOptions
from boresight.estimators.slam.smoothing.smoother import WindowSmoother
from boresight.estimators.slam.vision.matching import ImageFeatures, _conditioned, guided_rows
from boresight.scenarios.observation import Prediction


def smoother_after(frames: int):
    sequence, truth = make_sequence(np.random.default_rng(4), Recipe(frames=frames + 1))
    smoother = WindowSmoother(sequence, SmootherOptions())
    for frame in sequence.frames[:-1]:
        smoother.advance(frame)
    return smoother, sequence, truth


def test_the_joint_covariance_holds_that_of_the_view():
    smoother, _, _ = smoother_after(6)
    problem, state, tracks = smoother.adjusted.problem, smoother.adjusted.state, smoother.adjusted.tracks
    whole = replace(problem, kept_points=np.ones(len(tracks), dtype=bool))
    joint, views, points = kept_covariance(whole, state)
    assert len(joint) == 3 * (np.count_nonzero(views >= 0) + len(tracks))
    assert sorted([*views[views >= 0], *points]) == list(range(len(joint) // 3))
    last = slice(3 * views[-1], 3 * views[-1] + 3)
    np.testing.assert_allclose(joint[last, last], view_covariance(problem, state, len(views) - 1), rtol=1e-6)
    assert np.linalg.eigvalsh(joint)[0] > 0.0


def test_the_next_sightings_lie_in_the_predicted_ellipses():
    squares = []
    for frames in (5, 8, 12):
        smoother, sequence, _ = smoother_after(frames)
        last = sequence.frames[-1]
        expected = smoother.predict(last)
        _, ours, theirs = np.intersect1d(expected.tracks, last.tracks, return_indices=True)
        noisy = expected.covariance_px2 + (2.0 / 3.0) ** 2 * np.eye(2 * len(expected.tracks))
        for a, b in zip(ours, theirs, strict=True):
            error = last.uv_px[b] - expected.uv_px[a]
            squares.append(error @ np.linalg.solve(noisy[2 * a : 2 * a + 2, 2 * a : 2 * a + 2], error))
    assert len(squares) > 20
    # Chi-square of 2 degrees of freedom: 98.9 % lie within 3 sigma.
    assert np.mean(np.array(squares) <= 9.0) > 0.9


def world(rng, n=25, clutter=300):
    """Landmarks shifted by a shared error of 40 px, among random features."""
    expected = rng.uniform(200, 800, (n, 2))
    shared = np.tile(np.eye(2), (n, n)) * 40.0**2 + np.eye(2 * n) * 2.0**2
    shift = np.array([37.0, -51.0])
    seen = expected + shift + 2.0 * rng.standard_normal((n, 2))
    descriptors = rng.standard_normal((n, 64)).astype(np.float32)
    uv = np.concatenate([seen, rng.uniform(0, 1024, (clutter, 2))])
    look = np.concatenate([descriptors + 0.4 * rng.standard_normal((n, 64)), rng.standard_normal((clutter, 64))])
    return (
        Prediction(np.arange(n), expected, shared),
        descriptors,
        ImageFeatures(uv, look.astype(np.float32), np.ones(len(uv))),
    )


def test_landmarks_are_found_though_some_look_more_like_something_else():
    prediction, descriptors, features = world(np.random.default_rng(1))
    # Copies of a fifth of them lie within the ellipses, but not at the shared shift.
    features.descriptors[100:105] = descriptors[:5]
    features.uv_px[100:105] = prediction.uv_px[:5] + np.array([-30.0, 60.0])
    rows = guided_rows(prediction, descriptors, features, 0.5)
    assert np.mean(rows == np.arange(25)) > 0.9
    assert not np.isin(rows, range(100, 105)).any()


def test_what_is_not_there_is_not_found():
    prediction, descriptors, features = world(np.random.default_rng(2))
    gone = ImageFeatures(features.uv_px[10:], features.descriptors[10:], features.strength[10:])
    rows = guided_rows(prediction, descriptors, gone, 0.5)
    assert (rows[:10] == -1).mean() > 0.8
    assert np.mean(rows[10:] == np.arange(15)) > 0.9
    nothing = ImageFeatures(np.empty((0, 2)), np.empty((0, 64), dtype=np.float32), np.empty(0))
    assert (guided_rows(prediction, descriptors, nothing, 0.5) == -1).all()


@pytest.mark.parametrize(("off_sigma", "found"), [(2.9, True), (3.1, False)])
def test_certain_predictions_are_searched_within_the_noise_of_the_features(off_sigma, found):
    """Without an error of the prediction the ellipses are circles of three sigma of a feature's pixel."""
    rng = np.random.default_rng(3)
    expected, descriptors = rng.uniform(200, 800, (8, 2)), rng.standard_normal((8, 64)).astype(np.float32)
    prediction = Prediction(np.arange(8), expected, 1e-9 * np.eye(16))
    # Equal descriptors would be apart by rounding alone, in which three medians leave one out on some processors.
    noisy = descriptors + np.float32(0.1) * rng.standard_normal((8, 64)).astype(np.float32)
    features = ImageFeatures(expected + 0.5 * off_sigma * np.array([0.6, -0.8]), noisy, np.ones(8))
    assert (guided_rows(prediction, descriptors, features, 0.5) == (np.arange(8) if found else -1)).all()


def test_conditioned_prediction_is_that_of_the_joint_distribution():
    """Pixels and noisy features are one Gaussian vector, whose information matrix conditions it."""
    rng = np.random.default_rng(4)
    root, where, sigma_px = rng.standard_normal((8, 8)), rng.uniform(0, 100, (4, 2)), 0.7
    covariance, agree = root @ root.T, np.array([True, False, True, False])
    seen = where[agree] + rng.standard_normal((2, 2))
    found, spread = _conditioned(where, covariance + sigma_px**2 * np.eye(8), agree, seen, sigma_px)
    select = np.eye(8)[np.repeat(agree, 2)]
    information = np.linalg.inv(covariance) + select.T @ select / sigma_px**2
    shift = np.linalg.solve(information, select.T @ (seen - where[agree]).ravel() / sigma_px**2)
    np.testing.assert_allclose(found, where + shift.reshape(4, 2), rtol=1e-9)
    np.testing.assert_allclose(spread, np.linalg.inv(information), rtol=1e-9, atol=1e-12)
