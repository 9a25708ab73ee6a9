"""Innovation gates: reject pixels that do not fit a prediction of known covariance.

An individual gate ignores the error that all pixels share: an error of the predicted position moves all pixels
together, and each gate must be as wide as that. One-point RANSAC (Civera et al. 2010) removes the shared error: with
one landmark taken as correct, the others are predicted much more closely.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from boresight.estimators.slam.association.prediction import DEPTH_SIGMA, PredictedLines
from boresight.estimators.slam.options import Gate
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackFrame

_MOST_HYPOTHESES = 64
"""Landmarks at most that are taken as correct in turn."""

_LEAST_KNOWN = 3
"""Mapped landmarks below which they are gated together with those at a guessed distance."""


def gate_pixels(residual_px: FloatArray, covariance_px2: FloatArray, gate: Gate, false_alarm: float) -> BoolArray:
    """(n,) which pixels pass the gate, by their innovation (n, 2), px, and its joint covariance (2 n, 2 n), px^2.

    The gate is ``none``, ``individual`` (chi-square of each pixel) or ``one-point`` (RANSAC); ``false_alarm`` is the
    probability that a correct pixel is refused.
    """
    n = len(residual_px)
    if gate == "none" or n == 0:
        return np.ones(n, dtype=np.bool_)
    # A pixel has two coordinates: chi-square of 2 degrees of freedom.
    limit = float(chdtri(2, false_alarm))
    joint = covariance_px2.reshape(n, 2, n, 2).transpose(0, 2, 1, 3)  # (n, n, 2, 2) blocks
    alone = mahalanobis_squares(residual_px, diagonal_blocks(covariance_px2)) <= limit
    if gate == "individual" or not alone.any():
        return alone
    # The usual case: no pixel contradicts the others, and no hypothesis has to be tried.
    together = np.ones(n, dtype=np.bool_)
    if _contradiction_squares(residual_px, covariance_px2, together).max() <= limit:
        return together
    core = _consensus(residual_px, joint, alone, limit)
    return _readmitted(residual_px, covariance_px2, snooped(residual_px, covariance_px2, core, limit), limit)


def _consensus(residual_px: FloatArray, joint: FloatArray, alone: BoolArray, limit: float) -> BoolArray:
    """(n,) largest set that fits with one of its members taken as correct; of equal ones the best fit."""
    own = joint[np.arange(len(joint)), np.arange(len(joint))]
    # A hypothesis must be within its own ellipse.
    candidates = np.flatnonzero(alone)
    # Evenly spaced instead of random: every landmark is tried where there are few, and no random numbers are used.
    some = candidates[np.linspace(0, len(candidates) - 1, min(len(candidates), _MOST_HYPOTHESES)).astype(np.int64)]
    best, best_key = alone, (-1, -np.inf)
    for one in some.tolist():
        # Conditional distribution of all pixels given one, S_j1 S_11^-1: a Kalman update by this pixel alone.
        gain = joint[:, one] @ np.linalg.inv(own[one])
        left = np.asarray(residual_px - gain @ residual_px[one], dtype=np.float64)
        squares = mahalanobis_squares(left, np.asarray(own - gain @ joint[one], dtype=np.float64))
        # Its own conditional covariance is zero: rounding errors would decide.
        squares[one] = 0.0
        fit = squares <= limit
        key = (int(fit.sum()), -float(squares[fit].sum()))
        if key > best_key:
            best, best_key = fit, key
    return best


def snooped(residual_px: FloatArray, covariance_px2: FloatArray, core: BoolArray, limit: float) -> BoolArray:
    """(n,) the core without the pixels that the rest of it contradicts, the worst first (Baarda's data snooping)."""
    left = core.copy()
    # Of two that contradict each other none can be called the wrong one.
    while np.count_nonzero(left) > 2:
        squares = _contradiction_squares(residual_px, covariance_px2, left)
        if squares.max() <= limit:
            break
        # One at a time: a wrong pixel makes correct ones look wrong.
        left[np.flatnonzero(left)[squares.argmax()]] = False
    return left


def _contradiction_squares(residual_px: FloatArray, covariance_px2: FloatArray, among: BoolArray) -> FloatArray:
    """(k,) squared Mahalanobis distance of each marked pixel from its prediction by all other marked ones.

    With L the inverse of their joint covariance, the residual of pixel j against the others is ``L_jj^-1 (L r)_j``, of
    covariance ``L_jj^-1``.
    """
    inside = np.repeat(among, 2)
    inverse = np.asarray(np.linalg.inv(covariance_px2[np.ix_(inside, inside)]), dtype=np.float64)
    pull = (inverse @ residual_px[among].ravel()).reshape(-1, 2)
    return mahalanobis_squares(pull, diagonal_blocks(inverse))


def _readmitted(residual_px: FloatArray, covariance_px2: FloatArray, core: BoolArray, limit: float) -> BoolArray:
    """(n,) the core, and the pixels that fit their prediction by the whole core."""
    inside = np.repeat(core, 2)
    # Conditioned on the whole core, the ellipses are smaller than after the one pixel of the hypothesis: a better
    # centre, and correct pixels that the first test missed pass.
    gain = np.linalg.solve(covariance_px2[np.ix_(inside, inside)], covariance_px2[inside]).T
    left = residual_px - (gain @ residual_px[core].ravel()).reshape(-1, 2)
    blocks = diagonal_blocks(covariance_px2 - gain @ covariance_px2[inside])
    outside = ~core
    rescued = core.copy()
    rescued[outside] = mahalanobis_squares(left[outside], blocks[outside]) <= limit
    return rescued


def mahalanobis_squares(residual_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """(n,) squared Mahalanobis distances of residuals (n, 2) with covariances (n, 2, 2), in closed form."""
    a, b, c = covariance_px2[:, 0, 0], covariance_px2[:, 0, 1], covariance_px2[:, 1, 1]
    x, y = residual_px[:, 0], residual_px[:, 1]
    determinant = np.maximum(a * c - b**2, 1e-18)  # 0 for the pixel taken as correct
    return np.asarray((c * x**2 - 2.0 * b * x * y + a * y**2) / determinant, dtype=np.float64)


def diagonal_blocks(matrix: FloatArray, size: int = 2) -> FloatArray:
    """(n, size, size) blocks on the diagonal of a matrix (n size, n size)."""
    k = np.arange(len(matrix) // size)
    return np.asarray(matrix.reshape(len(k), size, len(k), size)[k, :, k], dtype=np.float64)


def block_diagonal(blocks: FloatArray) -> FloatArray:
    """(2 n, 2 n) block-diagonal matrix of blocks (n, 2, 2)."""
    k = np.arange(len(blocks))
    wide = np.zeros((len(k), 2, len(k), 2))
    wide[k, :, k] = blocks
    return wide.reshape(2 * len(k), 2 * len(k))


def pixel_squares(
    camera: Camera,
    frame: TrackFrame,
    rows: IndexArray,
    lines_m: FloatArray,
    own_m2: FloatArray,
    noise_px2: FloatArray,
) -> FloatArray:
    """(n,) squared Mahalanobis distances of measured from predicted pixels of some rows of a frame.

    ``lines_m`` (n, 3) are landmark minus camera position, body frame, m, and ``own_m2`` (n, 3, 3) the covariances of
    their errors. The noise of the pixels, of variance ``noise_px2`` (n,), is added to the covariance of the prediction.
    NaN where a landmark is behind the camera.
    """
    residual, by_line = _linearised_pixels(camera, frame, rows, lines_m)
    spread = by_line @ own_m2 @ np.swapaxes(by_line, 1, 2) + noise_px2[:, None, None] * np.eye(2)
    squares = mahalanobis_squares(residual, spread)
    return np.where(lines_m @ frame.R_cam_body[2] > 0.0, squares, np.nan)


def gate_frame(
    camera: Camera, frame: TrackFrame, seen: PredictedLines, noise_px2: FloatArray, false_alarm: float, limit: float
) -> BoolArray:
    """(n,) which pixels of a new frame, of variances ``noise_px2`` (n,), pass the gate.

    The mapped landmarks are gated first, by one-point RANSAC, and update the camera position. Landmarks at a guessed
    distance are then gated one by one from there: their prediction before the update is uncertain and nonlinear. With
    fewer than 3 mapped landmarks, all are gated together.
    """
    # In front of the camera.
    sound = np.asarray((seen.lines_m @ frame.R_cam_body.T)[:, 2] > 0.0, dtype=np.bool_)
    first = sound & seen.known
    if np.count_nonzero(first) < _LEAST_KNOWN:
        first = sound
    if not first.any():
        return sound
    residual, by_line = _linearised_pixels(camera, frame, seen.rows, seen.lines_m)
    # S = H P H' + the block-diagonal covariance of the independent errors.
    H = by_line[first] @ seen.by_shared[first]
    rows = H.reshape(-1, H.shape[2])
    own = _individual_covariance(noise_px2[first], seen.subset(first), by_line[first], seen.covariance)
    spread = rows @ seen.covariance @ rows.T + block_diagonal(own)
    fit = np.zeros(len(sound), dtype=np.bool_)
    fit[first] = gate_pixels(residual[first], spread, "one-point", false_alarm)
    others = sound & ~first
    if others.any() and fit.any():  # Kalman update of the shared variables by the accepted pixels
        inside = np.repeat(fit[first], 2)
        gain = np.linalg.solve(spread[np.ix_(inside, inside)], rows[inside] @ seen.covariance).T
        # ``fit`` holds pixels of ``first`` alone so far, in the order of ``inside``.
        shift = gain @ residual[fit].ravel()
        left = seen.covariance - gain @ (rows[inside] @ seen.covariance)
        single = seen.subset(others)
        # Derivatives anew, at the shifted lines of sight.
        residual, by_line = _linearised_pixels(camera, frame, single.rows, single.lines_m + single.by_shared @ shift)
        own = _individual_covariance(noise_px2[others], single, by_line, left)
        alone = _own_blocks(by_line @ single.by_shared, left) + own
        fit[others] = mahalanobis_squares(residual, alone) <= limit
    return fit


def _own_blocks(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """(n, k, k) diagonal blocks of ``rows covariance rows'`` for rows (n, k, m)."""
    n, k, m = rows.shape
    half = (rows.reshape(n * k, m) @ covariance).reshape(n, k, m)
    return np.asarray(half @ np.swapaxes(rows, 1, 2), dtype=np.float64)


def _linearised_pixels(
    camera: Camera, frame: TrackFrame, rows: IndexArray, lines_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Measured minus predicted pixels (n, 2), and derivatives (n, 2, 3) of the prediction by the lines of sight.

    The values of landmarks behind the camera have no meaning.
    """
    in_camera = lines_m @ frame.R_cam_body.T
    # Any point in front of the camera will do: it avoids a division by zero.
    in_camera = np.where(in_camera[:, 2:] > 0.0, in_camera, [0.0, 0.0, 1.0])
    return frame.uv_px[rows] - camera.project(in_camera), camera.jacobian(in_camera) @ frame.R_cam_body


def _individual_covariance(
    noise_px2: FloatArray, seen: PredictedLines, by_line: FloatArray, covariance: FloatArray
) -> FloatArray:
    """(n, 2, 2) covariance of the independent error of each pixel.

    A guessed distance adds a second-order term: the pixel depends on the camera's displacement divided by the distance,
    and both are uncertain.
    """
    own_m2, guessed = seen.own_m2.copy(), ~seen.known
    # With distance d (1 + e) and displacement t + dt, the pixel moves by (t + dt) / (d (1 + e)): the product e dt has
    # variance DEPTH_SIGMA^2 times that of dt.
    own_m2[guessed] += DEPTH_SIGMA**2 * _own_blocks(seen.by_shared[guessed], covariance)
    # From lines of sight (m^2) to pixels (px^2).
    own = by_line @ own_m2 @ np.swapaxes(by_line, 1, 2)
    return np.asarray(own + noise_px2[:, None, None] * np.eye(2), dtype=np.float64)
