"""Marks of whole revolutions on an axis of anomaly."""

from __future__ import annotations

from matplotlib.axes import Axes

_FULL_TURN_DEG = 360.0


def mark_turns(axes: Axes, last_deg: float) -> None:
    """Draw a dotted line at every whole revolution up to ``last_deg`` of anomaly."""
    for turn in range(1, int(last_deg / _FULL_TURN_DEG) + 1):
        axes.axvline(turn * _FULL_TURN_DEG, color="black", linewidth=0.6, linestyle=":")
