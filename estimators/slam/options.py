"""Options of the estimators of sequences."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from scenarios.spec.base import SpecModel

Gate = Literal["none", "individual", "one-point"]


class LossOptions(SpecModel):
    """Of every estimator but the control: when it gives up a sequence."""

    connectivity: int = Field(3, ge=1, le=100, description="Landmarks that two frames must share")
    uncertainty_max: float = Field(
        0.25,
        gt=0,
        description="The scale counts as lost when the position is uncertain by this part of the distance",
    )


class InnovationOptions(SpecModel):
    """Of every estimator that holds a new frame against what was known before it."""

    innovation_frames: int = Field(10, ge=1, le=1000, description="Frames over which innovations are averaged")
    innovation_max: float = Field(
        5.0,
        gt=1,
        description="Mean squared normalised innovation at which the estimator counts as diverging; 1 is expected",
    )


class SolverOptions(LossOptions):
    """Of every estimator that minimises."""

    tolerance: float = Field(
        1e-8, gt=0, le=1e-2, description="A minimisation ends when no step is longer than this part of the distance"
    )
    iterations: int = Field(50, ge=1, le=1000, description="Steps of a minimisation at most")
    connectivity: int = Field(3, ge=2, le=100, description="Landmarks that two views must share")


class AssociationOptions(SolverOptions):
    """Of every estimator that adjusts a window: wrong associations."""

    associations: Literal["all", "consensus"] = Field(
        "all",
        description="Believe all, or leave out pixels that disagree with the largest set that one of them explains, and"
        " those that an adjustment leaves too far off",
    )
    false_alarm: float = Field(
        0.001, gt=0, le=0.1, description="Probability that a right pixel is refused when it comes"
    )


class BundleOptions(AssociationOptions):
    """Options of ``ba-slam``."""

    views: int = Field(5, ge=2, le=100, description="Views of the window, the leading one included")
    strategy: Literal["trailing", "offset"] = Field(
        "trailing",
        description="Trailing views that stay while they are connected with the leading one, or a constant offset",
    )
    connected: Literal["last-two", "whole-window"] = Field(
        "last-two",
        description="Trailing views stay while the leading view shares landmarks with the last of them, as in the"
        " paper, or with the oldest, so that the whole window does",
    )
    offset_frames: int = Field(4, ge=1, le=1000, description="Frames between views of the constant offset")
    angle_max_deg: float = Field(
        30.0, gt=0, le=360, description="Largest angle at the body's centre between consecutive views"
    )
    steps: Literal["full", "motion-structure-full"] = Field(
        "motion-structure-full", description="Adjust motion only and structure only before the full adjustment, or not"
    )
    gauge_sigma_m: float = Field(0.01, gt=0, description="Standard deviation given to a gauge that was handed over")
    motion: Literal["given", "constant-gain"] = Field(
        "given",
        description="Predict the next position by the displacement that comes with it, or by forces and a filter of"
        " position and velocity with a constant gain",
    )
    motion_position_sigma_m: float = Field(
        1.0, gt=0, description="Standard deviation of an adjusted position that the constant gain is made of"
    )
    motion_noise_m_s2: float | None = Field(
        None,
        gt=0,
        description="Unmodelled acceleration that the constant gain is made of; left out: what the forces say",
    )


class FilterOptions(InnovationOptions, LossOptions):
    """Options of ``ekf-slam``."""

    camera: Literal["position", "pose"] = Field(
        "position",
        description="State of the camera: the position, with attitude taken for known, or all 13 elements of the"
        " paper, with the star tracker's attitude for a measurement",
    )
    turn_noise_deg: float = Field(
        1.0,
        gt=0,
        le=30,
        description="With camera: pose, standard deviation, about each axis, of the turn between two frames that the"
        " angular rate of the frame before does not foretell",
    )
    depth_sigma: float = Field(
        0.3, gt=0, le=2, description="Standard deviation of a new landmark's inverse distance, relative to its guess"
    )
    innovation_max: float = Field(
        25.0,
        gt=1,
        description="Mean squared normalised innovation at which the filter counts as diverging; 1 is expected, and an"
        " overconfident filter that still follows its path comes to 5 or 10",
    )
    gate: Gate = Field(
        "none",
        description="Which pixels are left out: none, those whose own innovation is too large, or those that disagree"
        " with the largest set that fits one of them taken for right (one-point RANSAC)",
    )
    false_alarm: float = Field(0.001, gt=0, le=0.1, description="Probability that a gate refuses a right pixel")
    refusals_max: int = Field(
        2, ge=1, le=1000, description="Frames in a row that refuse a landmark before it is taken in anew"
    )


class IteratedFilterOptions(FilterOptions):
    """Options of ``iterated-ekf-slam``."""

    iterations: int = Field(10, ge=1, le=100, description="Gauss-Newton steps of an update at most")


class ConsistentFilterOptions(IteratedFilterOptions):
    """Options of ``consistent-ekf-slam``."""

    settled_sigma: float = Field(
        0.05,
        gt=0,
        le=1,
        description="Relative standard deviation of an inverse distance at which its derivatives are kept for good",
    )


class SmootherOptions(AssociationOptions):
    """Options of ``fixed-lag``."""

    associations: Literal["all", "consensus"] = Field(
        "consensus",
        description="Believe all, or leave out pixels that disagree with the largest set that one of them explains, and"
        " those that an adjustment leaves too far off",
    )
    lag: int = Field(10, ge=2, le=1000, description="Frames of the window")
    first_estimates: bool = Field(
        True, description="Take derivatives by variables of the prior where they were when they entered it"
    )
    motion: bool = Field(True, description="Count predicted motions as measurements")
    attitude: Literal["known", "noisy"] = Field(
        "known",
        description="Take the star tracker's attitude for true, or count what it has wrong in a frame alone as noise of"
        " each pixel",
    )
    prior_landmarks: int = Field(
        200,
        ge=0,
        description="Landmarks that the prior holds at most; what older frames tell of others joins their views alone",
    )


class BatchOptions(AssociationOptions):
    """Options of ``batch``."""

    motion: bool = Field(True, description="Count predicted motions as measurements")


class DynamicOptions(InnovationOptions, SolverOptions):
    """Options of ``dynamic-smoother``."""

    lag: int = Field(10, ge=2, le=1000, description="Frames of the window")
    first_estimates: bool = Field(
        True, description="Take derivatives by variables of the prior where they were when they entered it"
    )


class LoopOptions(SmootherOptions):
    """Options of ``loop-smoother``."""

    closure_frames: int = Field(15, ge=1, le=10000, description="Frames between adjustments of all frames, at least")
    closure_pairs: int = Field(3, ge=1, le=1000, description="Landmarks seen again that must agree")
    closure_tolerance_m: float = Field(
        1e-4, gt=0, description="An adjustment of all frames ends when no step is longer"
    )
    recognition: float = Field(0.999, gt=0, lt=1, description="Probability with which a right recognition passes")


class GtsamOptions(SolverOptions):
    """Options of ``gtsam-isam2``; tolerance and iterations are those of a new view's first placing."""

    motion: bool = Field(True, description="Count predicted motions as measurements")
    relinearize_m: float = Field(
        0.01, gt=0, description="A variable is linearised anew where it has moved by more (relinearizeThreshold)"
    )
    rounds: int = Field(
        2, ge=1, le=100, description="Updates of the tree at each frame, the one with its factors included"
    )


class GtsamFixedLagOptions(GtsamOptions):
    """Options of ``gtsam-fixed-lag``."""

    lag: int = Field(10, ge=2, le=1000, description="Frames of the window")
