"""The scenario: one world, one camera, one way of being wrong about the pose."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from scenarios.spec.base import SpecModel
from scenarios.spec.body import BodySpec
from scenarios.spec.brdf import BrdfSpec, LambertSpec
from scenarios.spec.camera import CameraSpec, DetectorSpec, RenderingSpec
from scenarios.spec.world import PAPER_POSE_ERROR, LightingSpec, PoseErrorSpec, ViewpointSpec


class ImageSetSpec(SpecModel):
    """Real images with a table of poses, camera and Sun in place of rendered ones."""

    folder: str = Field(description="Folder of the images (beside the scenario file, or under BORESIGHT_DATA)")
    table: str = Field("poses.csv", description="Table of poses in that folder")
    truth: str = Field("ref", description="Prefix of the columns that are scored against")
    also_score: tuple[str, ...] = Field((), description="Prefixes of further poses to score against")
    noise_realisations: int = Field(1, ge=1, description="Pose errors drawn for each image")
    credit: str = Field("", description="Credit line that every figure with these images carries")


class ScenarioSpec(SpecModel):
    """What the YAML says. Its digest is part of every result's key."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9._-]*$")
    description: str = ""
    body: BodySpec = BodySpec()
    camera: CameraSpec
    rendering: RenderingSpec = RenderingSpec()
    detector: DetectorSpec | None = None
    brdf: BrdfSpec = LambertSpec()
    viewpoint: ViewpointSpec | None = None
    lighting: LightingSpec = LightingSpec()
    images: ImageSetSpec | None = None
    pose_error: PoseErrorSpec = PAPER_POSE_ERROR

    @model_validator(mode="after")
    def _source(self) -> Self:
        if (self.viewpoint is None) == (self.images is None):
            raise ValueError("give either viewpoint (images are rendered) or images (real images are read)")
        return self
