"""Options of registration, and of photometric alignment that is nothing else."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from estimators.landmark.build import DatabaseOptions
from estimators.landmark.centroid import AlignmentOptions
from scenarios.spec.base import SpecModel


class LevelOptions(SpecModel):
    """One level of the pyramid, from coarse to fine."""

    reduction: Literal[1, 2, 4, 8, 16] = Field(1, description="Side of the square of pixels that are averaged into one")
    blur_px: float = Field(1.0, ge=0, le=20, description="Blur of both images, in pixels of this level")
    background_px: float = Field(
        0.0, ge=0, le=100, description="What is smoother than this is taken out, in pixels of this level; 0 keeps all"
    )
    iterations: int = Field(6, ge=1, le=200, description="Steps at most")


class RegistrationOptions(SpecModel):
    """From the prior to the pose at which the rendering of a shape is the image."""

    alignment_loop: AlignmentOptions = AlignmentOptions()
    levels: tuple[LevelOptions, ...] = Field(
        (
            LevelOptions(reduction=4, blur_px=1.0, iterations=8),
            LevelOptions(reduction=2, blur_px=0.7, background_px=3.0, iterations=4),
            LevelOptions(reduction=1, blur_px=1.0, background_px=4.0, iterations=4),
        ),
        min_length=1,
    )
    gradient: Literal["autodiff", "differences"] | None = Field(
        None,
        description="Derivatives through the renderer, or from twelve renderings; left out: the first where the Mitsuba"
        " variant has it",
    )
    difference_px: float = Field(
        0.5, gt=0, le=10, description="Motion by which differences are taken, pixels of a level"
    )
    huber_sigma: float = Field(1.5, gt=0, description="Residuals beyond this many robust sigmas count linearly")
    independent_px: float = Field(
        100.0, gt=0, description="Pixels that go together as one: residuals are those of the model and not white noise"
    )
    tolerance_px: float = Field(0.01, gt=0, description="A level ends when a step moves the body by less than this")
    correlation_min: float = Field(0.5, ge=-1, le=1, description="A worse final correlation is a failure")


class PhotometricOptions(RegistrationOptions):
    """Options of ``photometric``."""

    shape: Literal["onboard", "landmark-mesh"] = Field(
        "onboard", description="The full shape that the spacecraft carries, or the mesh of its landmark data base"
    )
    database: DatabaseOptions = DatabaseOptions()
    samples_per_pixel: Literal[1, 4, 9, 16] = Field(4, description="Samples of the renderings: a regular grid")
