"""Marks of whole revolutions on an axis of anomaly."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

_FULL_TURN_DEG = 360.0


def mark_revolutions(axes: Axes, anomaly_deg: ArrayLike) -> None:
    """Draw a dotted line at every whole revolution up to the largest anomaly; none where no frame was estimated."""
    last_deg = np.max(np.asarray(anomaly_deg, dtype=np.float64), initial=0.0)
    for turn in range(1, int(last_deg / _FULL_TURN_DEG) + 1):
        axes.axvline(turn * _FULL_TURN_DEG, color="black", linewidth=0.6, linestyle=":")
