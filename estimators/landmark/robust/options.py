"""Options of recognition by consensus."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from estimators.landmark.build import DatabaseOptions
from estimators.landmark.centroid import AlignmentOptions
from estimators.landmark.corners import CornerOptions
from scenarios.spec.base import SpecModel


class MixtureOptions(SpecModel):
    """Where corners are expected about a landmark that is seen."""

    detection_probability: float = Field(
        0.02, gt=0, lt=1, description="Weight of a landmark's own corner against clutter; small is robust"
    )
    covariance_scale: float = Field(2.5, gt=0, description="Factor on the landmarks' covariances as stored")
    corner_sigma_px: float = Field(0.3, gt=0, le=10, description="Error of a corner's position in the image")
    max_candidates: int = Field(6, ge=1, le=64, description="Nearest corners that may be a landmark's")


class SearchOptions(SpecModel):
    """Hypotheses, of which the best are refined.

    Either turns about the body's origin over the whole prior, each with shifts across the line of sight, or the poses
    of random minimal sets of landmarks and corners, as in RANSAC.
    """

    hypotheses: Literal["prior", "minimal-sets"] = Field("prior", description="Where hypotheses come from")
    draws: int = Field(20_000, ge=1, le=1_000_000, description="Minimal sets that are drawn")
    reach_sigma: float = Field(3.45, gt=0, le=10, description="Radius of the ball of turns, in the prior's sigmas")
    step_px: float = Field(1.7, gt=0, le=20, description="Step of a turn at the farthest landmark, in pixel sizes")
    max_turns: int = Field(4000, ge=1, le=100_000, description="The step grows until there are no more turns than this")
    shift_px: int = Field(2, ge=0, le=20, description="Shifts up to this many pixels along rows and columns")
    blur_px: float = Field(1.8, gt=0, le=20, description="Blur of the corner map on which hypotheses are scored")
    refined: int = Field(25, ge=1, le=1000, description="Best hypotheses that are refined")
    anneal_px: tuple[Annotated[float, Field(gt=0, le=20)], ...] = Field(
        (1.5, 0.8), min_length=1, description="Corner errors that the refinement goes through"
    )
    iterations: int = Field(4, ge=1, le=100, description="Steps at each of them")
    finalists: int = Field(4, ge=1, le=100, description="Hypotheses that are brought to convergence")
    max_iterations: int = Field(30, ge=1, le=1000, description="Steps to convergence at most")


class ConsensusOptions(SpecModel):
    """Options of ``landmark-ransac``."""

    database: DatabaseOptions = DatabaseOptions()
    corners: CornerOptions = Field(
        CornerOptions(count=250, min_relative_strength=1e-5), description="Corners of the observed image"
    )
    alignment: Literal["centroid", "image"] = Field("image", description="What finds the first shift")
    alignment_loop: AlignmentOptions = AlignmentOptions()
    alignment_sigma_px: float = Field(3.6, gt=0, description="Error of that shift, along rows and columns each")
    mixture: MixtureOptions = MixtureOptions()
    search: SearchOptions = SearchOptions()
    covariance_scale: float = Field(
        1.8, gt=0, description="Factor on the covariance of the result: errors of neighbouring landmarks go together"
    )
    consistency_max_px: float | None = Field(
        None, gt=0, description="A solution whose mesh, rendered, has its brightness centroid farther off fails"
    )
