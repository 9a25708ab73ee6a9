"""Which pixels of a new frame fit what is expected of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.slam.expected import DEPTH_SIGMA, Expected
from estimators.slam.gating import believed, mahalanobis_squares
from scenarios.geometry import Camera
from scenarios.tracks import TrackFrame

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_FEWEST_KNOWN = 3


def fitting(camera: Camera, frame: TrackFrame, seen: Expected, false_alarm: float, limit: float) -> BoolArray:
    """(n,) pixels that fit.

    Landmarks of the map agree among themselves first, by one-point RANSAC. Those whose distance is a guess are judged
    one by one from where that puts the camera: what the prediction alone says of them is vague and not linear. Where
    nearly nothing is mapped, all agree together.
    """
    sound = np.asarray((seen.lines_m @ frame.R_cam_body.T)[:, 2] > 0.0, dtype=np.bool_)
    first = sound & seen.known
    if np.count_nonzero(first) < _FEWEST_KNOWN:
        first = sound
    if not first.any():
        return sound
    residual, by_line = _pixels(camera, frame, seen, seen.lines_m)
    H = by_line[first] @ seen.by_all[first]
    rows = H.reshape(-1, H.shape[2])
    own = _own(frame, seen.some(first), by_line[first], seen.covariance)
    spread = rows @ seen.covariance @ rows.T + _block_diagonal(own)
    fit = np.zeros(len(sound), dtype=np.bool_)
    fit[first] = believed(residual[first], spread, "one-point", false_alarm)
    others = sound & ~first
    if others.any() and fit.any():
        inside = np.repeat(fit[first], 2)
        gain = np.linalg.solve(spread[np.ix_(inside, inside)], rows[inside] @ seen.covariance).T
        shift = gain @ residual[fit].ravel()
        left = seen.covariance - gain @ (rows[inside] @ seen.covariance)
        fit[others] = _alone(camera, frame, seen.some(others), shift, left) <= limit
    return fit


def _alone(camera: Camera, frame: TrackFrame, seen: Expected, shift: FloatArray, left: FloatArray) -> FloatArray:
    """(n,) squared distances of single pixels, what is common having moved by ``shift`` with ``left`` as covariance."""
    residual, by_line = _pixels(camera, frame, seen, seen.lines_m + seen.by_all @ shift)
    rows = by_line @ seen.by_all
    return mahalanobis_squares(residual, _own_blocks(rows, left) + _own(frame, seen, by_line, left))


def _own_blocks(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """(n, k, k) blocks of ``rows covariance rows'`` for rows (n, k, m), the first product being one for all."""
    n, k, m = rows.shape
    half = (rows.reshape(n * k, m) @ covariance).reshape(n, k, m)
    return np.asarray(half @ np.swapaxes(rows, 1, 2), dtype=np.float64)


def _pixels(camera: Camera, frame: TrackFrame, seen: Expected, lines_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measured less expected pixels (n, 2), and derivatives (n, 2, 3) of these by the lines; anything where behind."""
    in_camera = lines_m @ frame.R_cam_body.T
    in_camera = np.where(in_camera[:, 2:] > 0.0, in_camera, [0.0, 0.0, 1.0])
    return frame.uv_px[seen.rows] - camera.project(in_camera), camera.jacobian(in_camera) @ frame.R_cam_body


def _own(frame: TrackFrame, seen: Expected, by_line: FloatArray, covariance: FloatArray) -> FloatArray:
    """(n, 2, 2) what a pixel shares with no other.

    Where the distance is a guess there is a term of second order: a pixel goes with the way of the camera over the
    distance, and both are uncertain.
    """
    own_m2, guessed = seen.own_m2.copy(), ~seen.known
    own_m2[guessed] += DEPTH_SIGMA**2 * _own_blocks(seen.by_all[guessed], covariance)
    own = by_line @ own_m2 @ np.swapaxes(by_line, 1, 2)
    return np.asarray(own + frame.sigma_px**2 * np.eye(2), dtype=np.float64)


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    """(2 n, 2 n) of (n, 2, 2)."""
    k = np.arange(len(blocks))
    wide = np.zeros((len(k), 2, len(k), 2))
    wide[k, :, k] = blocks
    return wide.reshape(2 * len(k), 2 * len(k))
