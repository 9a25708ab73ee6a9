"""The image vision layer of a sequence: rendered images in, tracks out (Delpech et al. 2015, section 5)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from scenarios.spec.base import SpecModel


class ImageVisionSpec(SpecModel):
    """Features of the scenario's rendered images, matched from frame to frame.

    The body stands still, so that the images of one revolution serve all others. Trials begin at ``starts`` places
    around the orbit with the same images; every ``starts`` trials the detector exposes them anew.
    """

    starts: int = Field(6, ge=1, le=360, description="Places around the orbit where trials begin, evenly spaced")
    detector: Literal["surf", "sift", "orb"] = Field("surf", description="What finds and describes features")
    features: int = Field(3000, ge=8, le=20_000, description="Features of an image at most, the strongest first")
    ratio_max: float = Field(
        0.8, gt=0, le=1, description="Distance of a descriptor to the best over that to the second best, at most"
    )
    epipolar: Literal["fundamental", "known-attitude"] = Field(
        "fundamental",
        description="What RANSAC fits to the matches: the fundamental matrix, or the direction of motion alone",
    )
    epipolar_max_px: float = Field(2.0, gt=0, description="Distance of a match from its epipolar line at most")
    carry: Literal["feature", "patch"] = Field(
        "feature",
        description="A track goes on where its feature is matched, or where its first patch is registered",
    )
    guided: bool = Field(
        False,
        description="Seek features where an estimator expects them; each estimator has its own tracks",
    )
    tracks: int = Field(30, ge=3, le=5000, description="Features tracked in each frame, the strongest first")
    growth_max: float = Field(
        1.08,
        gt=1,
        description="A track begins where areas grow or shrink by this factor at most from frame to frame",
    )
    spacing_px: float = Field(0.0, ge=0, description="Distance of a new track from all others at least")
    sigma_px: float = Field(0.5, gt=0, description="Standard deviation of a coordinate that estimators are told")
