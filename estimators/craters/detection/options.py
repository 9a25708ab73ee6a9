"""Options of the detector after Cheng et al. (2003)."""

from __future__ import annotations

from pydantic import Field

from scenarios.spec.base import SpecModel


class ClassicOptions(SpecModel):
    """What the paper leaves open, with units."""

    window_px: float = Field(
        default=20.0, gt=2.0, description="Standard deviation of the window that evens contrast out."
    )
    small_kernel_px: int = Field(
        default=3, ge=3, le=5, multiple_of=1, description="Width of the first Canny pass's kernel."
    )
    large_kernel_px: int = Field(default=9, ge=7, le=15, description="Width of the second Canny pass's kernel.")
    strong_share: float = Field(
        default=0.15, gt=0.0, lt=1.0, description="Share of the ground above Canny's upper threshold."
    )
    weak_ratio: float = Field(default=0.5, gt=0.0, le=1.0, description="Canny's lower threshold over the upper one.")
    sunward_deg: float = Field(
        default=75.0, gt=10.0, lt=90.0, description="Largest angle of a rim's gradient from the Sun."
    )
    bend_deg: float = Field(default=35.0, gt=5.0, lt=90.0, description="Largest turn between neighbours of one edge.")
    turn_deg: float = Field(default=25.0, gt=5.0, lt=120.0, description="Least turn of the normal along a rim edge.")
    arc_points: int = Field(default=5, ge=3, description="Least pixels of a rim edge.")
    radius_min_px: float = Field(default=5.0, gt=1.0, description="Least mean radius of a crater.")
    radius_max_px: float = Field(default=150.0, gt=1.0, description="Largest mean radius of a crater.")
    axis_ratio_min: float = Field(default=0.35, gt=0.0, lt=1.0, description="Least ratio of the axes.")
    transition_deg: float = Field(
        default=30.0, ge=0.0, lt=80.0, description="Arc left out on each side of the lit and shaded ends."
    )
    softness: float = Field(
        default=3.0, ge=0.0, description="Gradients that count half in refinement, over the median one."
    )
    rounds: int = Field(default=25, ge=0, description="Of conjugate gradients, at most; 0 leaves the fit as it is.")
    crest_scale: float = Field(
        default=1.06, gt=0.5, lt=2.0, description="Crest's radius over that of the steepest gradient."
    )
    confidence_min: float = Field(
        default=0.9317,
        ge=-1.0,
        lt=1.0,
        description="Least confidence, equation (4): that with 4 % of false alarms in tests/training/thresholds.py.",
    )
