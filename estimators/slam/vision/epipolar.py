"""Which matches agree with one motion of the camera: epipolar geometry with the attitude known or not."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_FUNDAMENTAL_LEAST = 8
_CONFIDENCE = 0.999
_MOST_ITERATIONS = 10_000
_SAMPLES = 300
_REFITS = 3


def agree_with_fundamental(before_px: FloatArray, after_px: FloatArray, limit_px: float) -> BoolArray:
    """(K,) which matches (K, 2) and (K, 2) agree with the best fundamental matrix: RANSAC by OpenCV (MAGSAC)."""
    if len(before_px) < _FUNDAMENTAL_LEAST:
        return np.zeros(len(before_px), dtype=np.bool_)
    matrix, mask = cv2.findFundamentalMat(before_px, after_px, cv2.USAC_MAGSAC, limit_px, _CONFIDENCE, _MOST_ITERATIONS)
    if matrix is None or mask is None:
        return np.zeros(len(before_px), dtype=np.bool_)
    return np.asarray(mask).ravel().astype(np.bool_)


def agree_with_direction(
    before: FloatArray, after: FloatArray, limit_rad: float, rng: np.random.Generator
) -> BoolArray:
    """(K,) which matches agree with the best direction of motion, where the attitude is known.

    Two rays to one point and the motion between their origins lie in a plane: ``t . (r1 x r2) = 0``. Two matches give
    t, so that a few hundred samples are enough for any share of wrong ones that leaves matching a sense.

    Parameters
    ----------
    before, after
        (K, 3) unit directions from the camera in axes that do not turn.
    limit_rad
        Angle of the second ray from its epipolar plane at most.
    rng
        Draws the samples.
    """
    if len(before) < 3:
        return np.zeros(len(before), dtype=np.bool_)
    pairs = np.array([rng.choice(len(before), 2, replace=False) for _ in range(_SAMPLES)])
    planes = np.cross(before, after)
    directions = np.cross(planes[pairs[:, 0]], planes[pairs[:, 1]])
    lengths = np.linalg.norm(directions, axis=1)
    directions = directions[lengths > 0.0] / lengths[lengths > 0.0, None]
    if len(directions) == 0:
        return np.zeros(len(before), dtype=np.bool_)
    counts = [int(np.sum(np.abs(off_plane(before, after, d)) < limit_rad)) for d in directions]
    inlier = np.abs(off_plane(before, after, directions[int(np.argmax(counts))])) < limit_rad
    for _ in range(_REFITS):
        if inlier.sum() < 2:
            break
        inlier = np.abs(off_plane(before, after, fitted_direction(before[inlier], after[inlier]))) < limit_rad
    return inlier


def fitted_direction(before: FloatArray, after: FloatArray) -> FloatArray:
    """(3,) direction of motion, up to its sign, that brings the matches nearest to their epipolar planes."""
    planes = np.cross(before, after)
    direction = np.linalg.eigh(planes.T @ planes)[1][:, 0]
    for _ in range(_REFITS):  # weights turn the product into the angle off the plane
        weights = 1.0 / np.maximum(np.linalg.norm(np.cross(before, direction), axis=1), 1e-9)
        weighted = planes * weights[:, None]
        direction = np.linalg.eigh(weighted.T @ weighted)[1][:, 0]
    return np.asarray(direction, dtype=np.float64)


def off_plane(before: FloatArray, after: FloatArray, direction: FloatArray) -> FloatArray:
    """(K,) signed angle, rad, of the second rays from their epipolar planes."""
    normals = np.cross(direction, before)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.arcsin(np.clip(np.einsum("ki,ki->k", normals, after), -1.0, 1.0)), dtype=np.float64)
