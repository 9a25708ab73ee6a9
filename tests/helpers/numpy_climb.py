"""The refinement of rims by conjugate gradients in NumPy: the reference of the compiled one."""

from __future__ import annotations

import numpy as np

from boresight.estimators.craters.detection.refinement import side_merits
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Ellipses

_HALVINGS = 5
_ARMIJO = 0.1
_CONVERGED_PX = 2e-3


def merit(ellipses: Ellipses, field: FloatArray, sun_px: FloatArray, gap: float) -> tuple[FloatArray, FloatArray]:
    """Return the merits (n,) of rims and their derivatives (n, 5)."""
    value, by = side_merits(ellipses, field, sun_px, gap)
    return value.mean(axis=1), by.mean(axis=1)


def numpy_climb(start: FloatArray, field: FloatArray, sun_px: FloatArray, gap: float, rounds: int) -> FloatArray:
    """Maximise the merits of all rows (n, 5) at once; return them.

    The parameters are scaled so that a unit of each moves the rim by about a pixel: the angle by the difference of the
    axes.
    """
    radius = np.sqrt(start[:, 2] * start[:, 3])
    unit = np.ones_like(start)
    unit[:, 4] = 1.0 / np.maximum(start[:, 2] - start[:, 3], 0.1 * radius)
    step = np.zeros_like(start)

    def evaluate(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        moved = start + at * unit
        # A collapsed rim is not evaluated; the merit is at least -1, so that -2 is refused by the line search.
        small = moved[:, 2:4].min(axis=1) < 0.3 * radius
        moved = np.where(small[:, None], start, moved)
        value, by = merit(Ellipses(moved[:, :2], moved[:, 2:4], moved[:, 4]), field, sun_px, gap)
        return np.where(small, -2.0, value), by * unit

    value, slope = evaluate(step)
    direction = slope
    step_length = 0.3 / np.maximum(np.linalg.norm(direction, axis=1), 1e-9)  # the first step is of 0.3 px
    for _ in range(rounds):
        slope_along = np.einsum("ni,ni->n", direction, slope)
        # Restart with the gradient where the conjugate direction has lost the ascent.
        direction = np.where((slope_along > 0.0)[:, None], direction, slope)
        slope_along = np.einsum("ni,ni->n", direction, slope)
        # Backtracking until Armijo's condition holds, each rim with its own step; those that never reach it stay.
        taken, new_value, new_slope = step, value, slope
        open_rows = np.ones(len(start), dtype=bool)
        for _ in range(_HALVINGS):
            trial = np.where(open_rows[:, None], step + step_length[:, None] * direction, taken)
            trial_value, trial_slope = evaluate(trial)
            enough = open_rows & (trial_value >= value + _ARMIJO * step_length * slope_along)
            taken = np.where(enough[:, None], trial, taken)
            new_value = np.where(enough, trial_value, new_value)
            new_slope = np.where(enough[:, None], trial_slope, new_slope)
            open_rows &= ~enough
            step_length = np.where(open_rows, 0.4 * step_length, step_length)
            if not open_rows.any():
                break
        if np.abs(taken - step).max(initial=0.0) < _CONVERGED_PX:
            break
        beta = np.einsum("ni,ni->n", new_slope - slope, new_slope)
        # Polak and Ribiere, floored at 0: a negative value would reverse the old direction; 0 restarts with the
        # gradient.
        beta = np.maximum(beta / np.maximum(np.einsum("ni,ni->n", slope, slope), 1e-30), 0.0)
        old_gain = np.linalg.norm(direction, axis=1)
        direction = new_slope + beta[:, None] * direction
        # The first trial is somewhat longer than the last accepted step, and moves the rim by a tenth of its radius at
        # most.
        step_length = 1.8 * step_length * old_gain / np.maximum(np.linalg.norm(direction, axis=1), 1e-30)
        step_length = np.minimum(step_length, 0.1 * radius / np.maximum(np.linalg.norm(direction, axis=1), 1e-30))
        step, value, slope = taken, new_value, new_slope
    return start + step * unit
