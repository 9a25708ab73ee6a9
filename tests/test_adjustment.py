"""The joint adjustment behind the reference of navcam67p-views, next to a dense one with OpenCV's projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from adjustment.bundle import SIGMA_PX, Block, Model, Surface, resect, step, triangulate
from adjustment.tracks import Tracks
from scipy.spatial.transform import Rotation

FOCAL_PX, CENTRE_PX = 500.0, 64.0
MATRIX = np.array([[FOCAL_PX, 0.0, CENTRE_PX], [0.0, FOCAL_PX, CENTRE_PX], [0.0, 0.0, 1.0]])
IMAGES, LANDMARKS, PLANE_M = 5, 12, 3.0


def places(rotations, translations_m, points_m):
    """(IMAGES, LANDMARKS, 2) by OpenCV."""
    views = zip(rotations, translations_m, strict=True)
    return np.stack([cv2.projectPoints(points_m, cv2.Rodrigues(r)[0], t, MATRIX, None)[0][:, 0] for r, t in views])


@pytest.fixture
def world():
    """Poses, landmarks, and what is seen of them, all of all."""
    rng = np.random.default_rng(3)
    points_m = rng.normal(0.0, 40.0, (LANDMARKS, 3))
    rotations = Rotation.from_euler("xyz", np.c_[40.0 * np.arange(IMAGES), rng.normal(0, 5, (IMAGES, 2))], degrees=True)
    translations_m = np.array([0.0, 0.0, 2000.0]) + rng.normal(0.0, 20.0, (IMAGES, 3))
    block = Block(rotations.as_matrix(), translations_m, points_m)
    uv_px = places(block.rotations, translations_m, points_m).reshape(-1, 2)
    image, landmark = np.divmod(np.arange(IMAGES * LANDMARKS), LANDMARKS)
    return block, Tracks(image, landmark, uv_px, LANDMARKS)


def model_of(block, start, design, weight):
    """A model that ties poses to those of ``start``, moved by ``design z``."""
    turn = Rotation.from_matrix(block.rotations @ start.rotations.transpose(0, 2, 1)).as_rotvec()
    residual = np.concatenate([turn, block.translations_m - start.translations_m], axis=1).ravel()
    return Model(residual, weight, design, np.full(2, 4.0), np.zeros(2))


def surface_of(block, scale):
    """A plane z = PLANE_M of the body, 1 + scale farther out."""
    n = len(block.landmarks_m)
    z = block.landmarks_m[:, 2]
    return Surface(z / (1.0 + scale) - PLANE_M, np.tile([0.0, 0.0, 1.0], (n, 1)), np.full(n, 0.5**-2), -z)


def test_the_covariance_is_that_of_a_dense_adjustment(world):
    """The Jacobian of all observations by all unknowns is taken by central differences of OpenCV's projection."""
    block, tracks = world
    rng = np.random.default_rng(4)
    design = rng.normal(size=(6 * IMAGES, 2))
    weight = np.tile(np.repeat([0.01**-2, 5.0**-2], 3), IMAGES)
    p, k = 6 * IMAGES, 3 * LANDMARKS

    def whitened(x):
        poses, scale, z, points = x[:p].reshape(-1, 6), x[p], x[p + 1 : p + 3], x[p + 3 :].reshape(-1, 3)
        rotations = Rotation.from_rotvec(poses[:, :3]).as_matrix() @ block.rotations
        landmarks_m = block.landmarks_m + points
        seen = places(rotations, block.translations_m + poses[:, 3:], landmarks_m).ravel() / SIGMA_PX
        # To first order about a scale of 0, as a scaled normal is not turned.
        off = (landmarks_m[:, 2] - scale * block.landmarks_m[:, 2] - PLANE_M) / 0.5
        return np.concatenate([seen, off, np.sqrt(weight) * (poses.ravel() - design @ z), 2.0 * z])

    steps = np.concatenate([np.tile(np.repeat([1e-5, 1e-2], 3), IMAGES), [1e-4, 1e-3, 1e-3], np.full(k, 1e-2)])
    columns = [(whitened(h * e) - whitened(-h * e)) / (2.0 * h) for h, e in zip(steps, np.eye(p + 3 + k), strict=True)]
    jacobian = np.stack(columns, axis=1)
    expected = np.linalg.inv(jacobian.T @ jacobian)[: p + 3, : p + 3]
    found = step(block, tracks, FOCAL_PX, CENTRE_PX, model_of(block, block, design, weight), surface_of(block, 0.0))
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-4)


def test_steps_lead_to_the_true_poses(world):
    block, tracks = world
    rng = np.random.default_rng(5)
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.02, (IMAGES, 3))).as_matrix() @ block.rotations
    moved_m = block.translations_m + rng.normal(0.0, 10.0, (IMAGES, 3))
    # Two poses are held, so that nothing is free.
    turned[:2], moved_m[:2] = block.rotations[:2], block.translations_m[:2]
    start = Block(turned, moved_m, triangulate(tracks, turned, moved_m, FOCAL_PX, CENTRE_PX))
    weight = np.repeat([1e10, 1e10, 0.0, 0.0, 0.0], 6)
    found = start
    for _ in range(12):
        model = model_of(found, block, np.zeros((6 * IMAGES, 2)), weight)
        found = step(found, tracks, FOCAL_PX, CENTRE_PX, model).block
    np.testing.assert_allclose(found.rotations, block.rotations, atol=1e-6)
    np.testing.assert_allclose(found.translations_m, block.translations_m, atol=1e-3)
    np.testing.assert_allclose(found.landmarks_m, block.landmarks_m, atol=1e-3)


def test_an_image_is_resected_from_landmarks(world):
    """OpenCV's solvePnP is the other way to the pose."""
    block, tracks = world
    rng = np.random.default_rng(6)
    noisy = Tracks(tracks.image, tracks.landmark, tracks.uv_px + rng.normal(0.0, 0.05, tracks.uv_px.shape), tracks.n)
    seen = noisy.uv_px[noisy.image == 3]
    _, rotation, translation = cv2.solvePnP(block.landmarks_m, seen, MATRIX, None)
    off_m = block.translations_m + np.where(np.arange(IMAGES) == 3, 8.0, 0.0)[:, None]
    found, covariance = resect(Block(block.rotations, off_m, block.landmarks_m), noisy, 3, FOCAL_PX, CENTRE_PX)
    sigma = np.sqrt(np.diag(covariance))
    turn = Rotation.from_matrix(found.rotations[3] @ cv2.Rodrigues(rotation)[0].T).as_rotvec()
    # Weights of outliers move the pose by a small part of its uncertainty.
    assert np.all(np.abs(turn) < 0.1 * sigma[:3])
    assert np.all(np.abs(found.translations_m[3] - translation[:, 0]) < 0.1 * sigma[3:])
