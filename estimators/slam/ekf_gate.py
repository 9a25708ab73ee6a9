"""Which pixels of a frame EKF-SLAM takes in: a gate on all, then a closer one on landmarks of a guessed distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from estimators.slam.ekf_measure import Sight
from estimators.slam.ekf_state import FilterState
from estimators.slam.ekf_update import innovation_covariance
from estimators.slam.gating import Gate, believed
from estimators.slam.options import FilterOptions

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

Update = Callable[[FilterState, Sight], tuple[FilterState, float]]

_KNOWN = 0.1
_FEWEST = 3


def gated(state: FilterState, sight: Sight, update: Update, options: FilterOptions) -> BoolArray:
    """(k,) pixels that are believed.

    Where the prediction is poor, what it says of a landmark whose distance is a guess is vague and not linear. As in
    one-point RANSAC (Civera et al. 2010), the landmarks that are known move the camera first, and the others are judged
    from there.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance of an innovation is not positive definite.
    """
    fit = _believed(state, sight, options.gate, options.false_alarm)
    known = state.inverse_sigmas[sight.rows] < _KNOWN
    first = fit & known
    if options.gate != "one-point" or known.all() or np.count_nonzero(first) < _FEWEST:
        return fit
    moved, _ = update(state, sight.only(first))
    fit[~known] = _believed(moved, sight.only(~known), "individual", options.false_alarm)
    return fit


def _believed(state: FilterState, sight: Sight, gate: Gate, false_alarm: float) -> BoolArray:
    innovation = sight.innovation(state)
    size = sight.uv_px.size
    residual = innovation.residual[:size].reshape(-1, 2)
    covariance = innovation_covariance(state, innovation)[:size, :size] + sight.second_order(state)
    fit = np.asarray(np.isfinite(residual).all(axis=1), dtype=np.bool_)
    both = np.repeat(fit, 2)
    fit[fit] = believed(residual[fit], covariance[np.ix_(both, both)], gate, false_alarm)
    return fit
