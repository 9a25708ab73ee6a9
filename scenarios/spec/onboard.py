"""What the spacecraft believes, where it differs from the truth."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from scenarios.spec.base import SpecModel, is_none
from scenarios.spec.body import BodySpec, HeightErrorSpec, RedrawnSpec
from scenarios.spec.brdf import BrdfSpec
from scenarios.spec.distribution import Scalar


class OnboardSpec(SpecModel):
    """Knowledge on board: what is left out is known as it is.

    Everything that an estimator is lent is made from it: data bases, shapes, renderings, the camera. The image
    alone comes from the truth. Errors that are drawn are drawn anew in each trial, and nothing tells the
    spacecraft of them: they are not in the prior's covariance.
    """

    brdf: BrdfSpec | None = Field(None, description="Reflectance that the spacecraft believes in")
    body: BodySpec | None = Field(None, description="Another shape altogether, in the same frame")
    facets: int | None = Field(
        None, ge=4, le=13_000_000, description="Resolution of the shape: facets of the body's detail stage"
    )
    relief: RedrawnSpec | None = Field(
        None,
        exclude_if=is_none,
        description="Small relief that nobody has seen: other boulders, craters and roughness",
    )
    height_error: HeightErrorSpec | None = Field(None, description="Error of the shape's heights")
    albedo: Literal["as-truth", "uniform"] = Field("as-truth", description="Whether its variation is known")
    focal_error: float = Field(0.0, gt=-0.5, lt=0.5, description="Relative error of the focal length")
    principal_point_error_px: tuple[float, float] = Field((0.0, 0.0), description="Error of the principal point")
    distortion_error: float = Field(
        0.0, ge=-2, le=2, description="Relative error of the lens's distortion; -1 knows of none"
    )
    sun_error_deg: Scalar | None = Field(None, description="Angle by which the Sun's direction is wrong")
    pole_error_deg: Scalar | None = Field(None, description="Tilt of the spin axis, about a random equatorial axis")
    rotation_error_deg: Scalar | None = Field(None, description="Error of the rotation phase about the spin axis")
