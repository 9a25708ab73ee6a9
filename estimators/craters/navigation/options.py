"""Options of the chain."""

from __future__ import annotations

from pydantic import Field

from estimators.craters.matching.preliminary import PreliminaryOptions
from estimators.orbit.options import OrbitOptions
from scenarios.spec.base import SpecModel


class NavigationOptions(SpecModel):
    """Options of ``crater-navigation``."""

    detector: str = Field("crater-classic", description="Name of a detector of craters")
    most_detections: int = Field(20, ge=1, description="Of an image, the most confident ones")
    matcher: str = Field("hybrid", description="Name of a matcher of craters")
    agreeing: int = Field(
        3, ge=1, description="Matches that a pair of images has at the least: one or two alone are no constellation"
    )
    preliminary: PreliminaryOptions = Field(
        PreliminaryOptions(), description="Which images are matched; heights are as uncertain as the a priori shape"
    )
    orbit: OrbitOptions = Field(OrbitOptions(), description="Of the batch filter")
    rounds: int = Field(
        3, ge=1, le=10, description="How often matching and orbit determination are done at most, until one is accepted"
    )
