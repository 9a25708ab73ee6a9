"""Options of the batch filter."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from scenarios.spec.base import SpecModel


class OrbitOptions(SpecModel):
    """Options of ``batch-filter``."""

    solar_pressure: Literal["estimated", "held"] = Field("estimated", description="Whether its size is an unknown")
    accelerations: Literal["estimated", "none"] = Field(
        "estimated", description="Whether what is not modelled is an unknown, in pieces, where it is told of"
    )
    piece_share: float = Field(
        0.5, gt=0, le=4, description="Length of a piece, in the times over which what is not modelled changes"
    )
    gravity_degree: int = Field(3, ge=0, le=6, description="Coefficients of degree 2 up to this one are unknowns")
    landmarks: Literal["free", "prior"] = Field(
        "free", description="Landmarks without a prior, or with that of the landmark file"
    )
    radiometry: Literal["used", "ignored"] = Field("used", description="Whether ranges and Doppler are used")
    first_days: float = Field(1.0, gt=0, le=30, description="Length of the arc that the solution begins with")
    growth: float = Field(3.0, gt=1, le=20, description="By which an arc is longer than the one before")
    edit_sigma: float = Field(4.0, gt=1, le=20, description="Sightings farther off than this are left out")
    huber_sigma: float = Field(2.0, gt=0, le=10, description="Before that, sightings farther off weigh less")
    iterations: int = Field(12, ge=1, le=100, description="Steps for one arc at most")
    split: bool = Field(True, description="Look for numbers that stand for two places, and split them")
    chi_square_max: float = Field(1.5, gt=1, description="Of each degree of freedom; above, a solution is rejected")
    edited_max: float = Field(0.4, gt=0, lt=1, description="Share of edited sightings; above, a solution is rejected")
