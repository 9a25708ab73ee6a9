"""Figures of reports, drawn from plain tables and arrays.

In all of them ``title`` is printed above the panels, and ``credit_lines``, the credits of real images, below them.
"""

from boresight.reports.figures.comparison import MOST_CURVES, RocCurve, TradeOffPoint, draw_roc, draw_trade_off
from boresight.reports.figures.landmark_database import ClusterView, SurfaceView, draw_clusters, draw_triangulation
from boresight.reports.figures.landmarks import (
    draw_centroid_offsets,
    draw_count_comparison,
    draw_landmark_counts,
    draw_landmark_errors,
)
from boresight.reports.figures.pose import draw_cumulative_errors, draw_method_errors, draw_pose_errors
from boresight.reports.figures.recognition import FitPanels, Overlay, draw_alignment_panels, draw_fit_panels
from boresight.reports.figures.sequences import draw_sightings
from boresight.reports.figures.style import save_figure

__all__ = [
    "MOST_CURVES",
    "ClusterView",
    "FitPanels",
    "Overlay",
    "RocCurve",
    "SurfaceView",
    "TradeOffPoint",
    "draw_alignment_panels",
    "draw_centroid_offsets",
    "draw_clusters",
    "draw_count_comparison",
    "draw_cumulative_errors",
    "draw_fit_panels",
    "draw_landmark_counts",
    "draw_landmark_errors",
    "draw_method_errors",
    "draw_pose_errors",
    "draw_roc",
    "draw_sightings",
    "draw_trade_off",
    "draw_triangulation",
    "save_figure",
]
