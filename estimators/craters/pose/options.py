"""Options of the pose by craters, and of the data base that it needs."""

from __future__ import annotations

from pydantic import Field

from estimators.craters.matching.association import AssociationOptions
from scenarios.spec.base import SpecModel

PRODUCT = "crater-database"


class CraterDatabaseOptions(SpecModel):
    """From how many images a data base is made, and by which detector."""

    images: int = Field(150, ge=2, description="Rendered images of the body as the spacecraft knows it")
    seed: int = Field(0, ge=0, description="Of their views")
    phase_deg: tuple[float, float] = Field((20.0, 80.0), description="Range of their phase angles")
    detector: str = Field("crater-classic", description="Name of the detector of craters")
    most_detections: int = Field(20, ge=1, description="Of an image, the most confident ones")
    association: AssociationOptions = Field(
        AssociationOptions(), description="How well its detections are known: for matches and lines of sight"
    )
    height_sigma_m: float = Field(30.0, gt=0, description="Of the height of the a priori shape under a crater")


class CraterPoseOptions(SpecModel):
    """Options of the pose by craters."""

    database: CraterDatabaseOptions = CraterDatabaseOptions()
    association: AssociationOptions = AssociationOptions(redetected=0.3)
    most_detections: int = Field(60, ge=1, description="Of the image, the most confident ones")
    emission_deg: float = Field(65.0, gt=0.0, lt=90.0, description="Of the landmarks that are looked for, at the most")
    incidence_deg: float = Field(80.0, gt=0.0, lt=90.0, description="The same of their incidence")
    least: int = Field(4, ge=1, description="Landmarks that a pose needs: fewer hardly contradict each other")
