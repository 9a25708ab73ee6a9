"""Onboard model: what the spacecraft believes, and the errors that a mission declares of it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from boresight.scenarios.spec.base import SpecModel, deviation, optional
from boresight.scenarios.spec.body import MOST_FACETS, BodySpec, DetailSpec, HeightErrorSpec, RedrawnSpec
from boresight.scenarios.spec.brdf import BrdfSpec
from boresight.scenarios.spec.distribution import Scalar
from boresight.scenarios.spec.world import PoseErrorSpec


class CameraSigmaSpec(SpecModel):
    """Standard deviations that the calibration declares of its errors; the errors themselves are stated elsewhere."""

    focal: float = deviation(0.0, "the focal length, relative", ge=0, lt=0.1)
    principal_point_px: float = deviation(0.0, "each coordinate of the principal point", ge=0, le=1000)


def _some(laws: tuple[BrdfSpec, ...]) -> tuple[BrdfSpec, ...]:
    if not laws:
        raise ValueError("has no reflectance: leave it out, or give one")
    return laws


_Reflectances = Annotated[
    tuple[BrdfSpec, ...],
    AfterValidator(_some),
    BeforeValidator(
        lambda value: tuple(value) if isinstance(value, list | tuple) else (value,),
        json_schema_input_type=BrdfSpec | tuple[BrdfSpec, ...],
    ),
]


class DeclaredSpec(SpecModel):
    """Errors that a mission declares its onboard model to have; what is left out is taken as exact."""

    brdf: _Reflectances | None = Field(
        None, description="A reflectance that the surface may have in place of that on board, or a list of them"
    )
    detail: DetailSpec | None = optional("Relief of the surface that the shape on board, which has no detail, lacks")
    facets: int | None = Field(None, ge=4, le=MOST_FACETS, description="Facets of a rehearsed body's detail")
    relief_below_m: float | None = Field(None, gt=0, description="Size below which relief is at unknown places")
    height_error: HeightErrorSpec | None = Field(None, description="Error of the shape's heights")
    sun_error_deg: Scalar | None = Field(None, description="Angle by which the Sun's direction is wrong")


class OnboardSpec(SpecModel):
    """Onboard model; parts that are left out are identical with the truth.

    Data bases, shapes, renderings and the camera of estimators are made from it; only the image comes from the truth.
    Random errors of the Sun and the spin are drawn in each trial and are not included in the prior's covariance.
    """

    brdf: BrdfSpec | None = Field(None, description="Reflectance that the spacecraft believes in")
    body: BodySpec | None = Field(None, description="Another shape altogether, in the same frame")
    facets: int | None = Field(
        None, ge=4, le=MOST_FACETS, description="Resolution of the shape: facets of the body's detail stage"
    )
    relief: RedrawnSpec | None = optional("Small relief that nobody has seen: other boulders, craters and roughness")
    height_error: HeightErrorSpec | None = Field(None, description="Error of the shape's heights")
    albedo: Literal["as-truth", "uniform"] = Field("as-truth", description="Whether its variation is known")
    focal_error: float = Field(0.0, gt=-0.5, lt=0.5, description="Relative error of the focal length")
    principal_point_error_px: tuple[float, float] = Field((0.0, 0.0), description="Error of the principal point")
    camera_sigma: CameraSigmaSpec | None = optional(
        "How wrong the camera may be, as estimators are told: part of the covariances that they state"
    )
    distortion_error: float = Field(
        0.0, ge=-2, le=2, description="Relative error of the lens's distortion; -1 knows of none"
    )
    sun_error_deg: Scalar | None = Field(None, description="Angle by which the Sun's direction is wrong")
    pole_error_deg: Scalar | None = Field(None, description="Tilt of the spin axis, about a random equatorial axis")
    rotation_error_deg: Scalar | None = Field(None, description="Error of the rotation phase about the spin axis")
    declared: DeclaredSpec | None = optional(
        "Errors of all this that the mission declares; ``tuned`` rehearses them, whatever the true ones are"
    )
    pose_error: PoseErrorSpec | None = optional(
        "Distribution of the prior's error that the spacecraft believes in: its covariance is given to"
        " estimators, while errors are drawn from the scenario's pose_error; its attitude, if left out, is that one's"
    )
