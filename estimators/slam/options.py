"""Options of the sequence estimators."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.scenarios.spec.base import SpecModel, length

Gate = Literal["none", "individual", "one-point"]


class LossOptions(SpecModel):
    """Options of every estimator but dead reckoning: when a sequence counts as lost."""

    connectivity: int = Field(3, ge=1, le=100, description="Landmarks that two frames must share")
    uncertainty_max: float = Field(
        0.25,
        gt=0,
        description="The scale counts as lost when the position's standard deviation exceeds this part of the distance",
    )


class InnovationOptions(SpecModel):
    """Options of estimators with an innovation test."""

    innovation_frames: int = Field(10, ge=1, le=1000, description="Frames over which innovations are averaged")
    innovation_max: float = Field(
        5.0,
        gt=1,
        description="Mean squared normalised innovation at which the estimator counts as diverging; 1 is expected",
    )


class SolverOptions(LossOptions):
    """Options of estimators with an iterative minimisation."""

    tolerance: float = Field(
        1e-8, gt=0, le=1e-2, description="A minimisation ends when no step is longer than this part of the distance"
    )
    iterations: int = Field(50, ge=1, le=1000, description="Steps of a minimisation at most")
    connectivity: int = Field(3, ge=2, le=100, description="Landmarks that two views must share")


class OutlierOptions(SolverOptions):
    """Options of estimators that adjust a window: outlier rejection."""

    associations: Literal["all", "consensus"] = Field(
        "all",
        description="Use all pixels, or refuse those that disagree with the largest consistent set (one-point RANSAC)"
        " and those with large residuals after an adjustment",
    )
    false_alarm: float = Field(
        0.001, gt=0, le=0.1, description="Probability that a correct pixel of a new frame is refused"
    )


class BundleOptions(OutlierOptions):
    """Options of ``ba-slam``."""

    views: int = Field(5, ge=2, le=100, description="Views of the window, the leading one included")
    strategy: Literal["trailing", "offset"] = Field(
        "trailing",
        description="Trailing views that stay while they are connected with the leading one, or a constant offset",
    )
    connected: Literal["last-two", "whole-window"] = Field(
        "last-two",
        description="Trailing views stay while the leading view shares landmarks with the last of them, as in the"
        " paper, or with the oldest, so that it shares landmarks with the whole window",
    )
    offset_frames: int = Field(4, ge=1, le=1000, description="Frames between views of the constant offset")
    angle_max_deg: float = Field(
        30.0, gt=0, le=360, description="Largest angle at the body's centre between consecutive views"
    )
    steps: Literal["full", "motion-structure-full"] = Field(
        "motion-structure-full", description="Adjust motion only and structure only before the full adjustment, or not"
    )
    gauge_sigma_m: float = length(0.01, "Standard deviation of a gauge after a handover", px=0.024, gt=0)
    motion: Literal["given", "constant-gain"] = Field(
        "given",
        description="Predict the next position by the given displacement, or by forces and a filter of position and"
        " velocity with a constant gain",
    )
    motion_position_sigma_m: float = length(
        1.0, "Standard deviation of an adjusted position, for the constant gain", px=2.4, gt=0
    )
    motion_noise_m_s2: float | None = Field(
        None,
        gt=0,
        description="Unmodelled acceleration for the constant gain; left out: that of the known forces",
    )


class FilterOptions(InnovationOptions, LossOptions):
    """Options of ``ekf-slam``."""

    camera: Literal["position", "pose"] = Field(
        "position",
        description="State of the camera: the position, with known attitude, or all 13 elements of the paper, with the"
        " star tracker's attitude as a measurement",
    )
    turn_noise_deg: float = Field(
        1.0,
        gt=0,
        le=30,
        description="With camera: pose, standard deviation, about each axis, of the rotation between two frames that"
        " the angular rate of the previous frame does not predict",
    )
    depth_sigma: float = Field(
        0.3, gt=0, le=2, description="Standard deviation of a new landmark's inverse distance, relative to its guess"
    )
    innovation_max: float = Field(
        25.0,
        gt=1,
        description="Mean squared normalised innovation at which the filter counts as diverging; 1 is expected, and an"
        " overconfident filter that still follows the path reaches 5 or 10",
    )
    gate: Gate = Field(
        "none",
        description="Outlier gate: none, on the innovation of each pixel, or one-point RANSAC, which refuses the pixels"
        " outside the largest set that fits with one of its members taken as correct",
    )
    false_alarm: float = Field(0.001, gt=0, le=0.1, description="Probability that a gate refuses a correct pixel")
    refusals_max: int = Field(
        2, ge=1, le=1000, description="Refusals of a landmark in consecutive frames before it is initialised again"
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
        description="Relative standard deviation of an inverse distance at which its linearisation is fixed",
    )


class SmootherOptions(OutlierOptions):
    """Options of ``fixed-lag``."""

    associations: Literal["all", "consensus"] = Field(
        "consensus",
        description="Use all pixels, or refuse those that disagree with the largest consistent set (one-point RANSAC)"
        " and those with large residuals after an adjustment",
    )
    lag: int = Field(10, ge=2, le=1000, description="Frames of the window")
    first_estimates: bool = Field(
        True, description="Take derivatives by variables of the prior at their estimates when they entered it"
    )
    motion: bool = Field(True, description="Use predicted motions as measurements")
    attitude: Literal["known", "noisy"] = Field(
        "known",
        description="Take the star tracker's attitude as exact, or add its error that is independent from frame to"
        " frame to the noise of each pixel",
    )
    prior_landmarks: int = Field(
        200,
        ge=0,
        description="Largest number of landmarks in the prior; older measurements of others constrain only their views",
    )


class BatchOptions(OutlierOptions):
    """Options of ``batch``."""

    motion: bool = Field(True, description="Use predicted motions as measurements")


class DynamicOptions(InnovationOptions, SolverOptions):
    """Options of ``dynamic-smoother``."""

    lag: int = Field(10, ge=2, le=1000, description="Frames of the window")
    first_estimates: bool = Field(
        True, description="Take derivatives by variables of the prior at their estimates when they entered it"
    )


class LoopOptions(SmootherOptions):
    """Options of ``loop-smoother``."""

    closure_frames: int = Field(
        15, ge=1, le=10000, description="Least number of frames between adjustments of all frames"
    )
    closure_pairs: int = Field(
        3, ge=1, le=1000, description="Least number of recognised landmarks that agree, for a loop closure"
    )
    closure_tolerance_m: float = length(
        0.0001, "An adjustment of all frames ends when no step is longer", px=0.00024, gt=0
    )
    recognition: float = Field(0.999, gt=0, lt=1, description="Probability that a correct recognition passes the test")


class GtsamOptions(SolverOptions):
    """Options of ``gtsam-isam2``; tolerance and iterations are those of a new view's motion-only adjustment."""

    motion: bool = Field(True, description="Use predicted motions as measurements")
    relinearize_m: float = length(
        0.01, "A variable is linearised anew where it has moved by more (relinearizeThreshold)", px=0.024, gt=0
    )
    rounds: int = Field(
        2, ge=1, le=100, description="Updates of the tree at each frame, including the one with the new factors"
    )


class GtsamFixedLagOptions(GtsamOptions):
    """Options of ``gtsam-fixed-lag``."""

    lag: int = Field(10, ge=2, le=1000, description="Frames of the window")
