"""What moves the camera and the body of a sequence: forces on the one, the rotation of the other."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from scenarios.spec.base import SpecModel


class ForcesSpec(SpecModel):
    """Forces on a spacecraft about a small body: equation (6) of Delpech et al. (2015)."""

    gravity: Literal["point-mass", "polyhedral"] = Field(
        "point-mass", description="Of a point at the origin, or of the scenario's body with one density throughout"
    )
    area_to_mass_m2_kg: float = Field(
        0.0, ge=0, description="Of the spacecraft as a ball, for solar radiation pressure; 0 for none"
    )
    reflectivity: float = Field(1.3, ge=1, le=2, description="1 where all light is absorbed, 2 where it is thrown back")
    sun_distance_au: float = Field(1.0, gt=0, description="0.746 to 1.099 for Apophis")
    noise_m_s2: float = Field(
        0.0, ge=0, description="Standard deviation of each coordinate of what is left, drawn anew between two frames"
    )


class BodyMotionSpec(SpecModel):
    """How the body turns; its axes are those of inertial space at the first frame.

    Tumbling is free of torques: the angular velocity of the first frame is that of a spin, and the inertia, in the
    body's axes, changes it from then on by Euler's equations.
    """

    kind: Literal["none", "spin", "tumbling"] = "none"
    period_h: float = Field(30.4, gt=0, description="Of the rotation at the first frame; 30.4 h for Apophis")
    axis_body: tuple[float, float, float] = Field((0.0, 0.0, 1.0), description="Its direction, body axes")
    inertia: tuple[float, float, float] = Field(
        (0.61, 0.965, 1.0),
        description="Principal moments about the body's x, y, z, in any unit; only tumbling depends on them",
    )

    @model_validator(mode="after")
    def _is_a_rotation(self) -> Self:
        if not any(self.axis_body):
            raise ValueError("axis_body is zero: give the direction of the angular velocity")
        if min(self.inertia) <= 0 or 2 * max(self.inertia) > sum(self.inertia):
            raise ValueError(f"inertia {list(self.inertia)}: no moment may exceed the sum of the other two, or be zero")
        if self.kind != "tumbling" and self.inertia != type(self).model_fields["inertia"].default:
            raise ValueError("inertia has no part in a body that does not tumble: leave it out, or say kind: tumbling")
        return self

    @model_validator(mode="after")
    def _tumbles(self) -> Self:
        moments = [moment for moment, part in zip(self.inertia, self.axis_body, strict=True) if part]
        if self.kind == "tumbling" and len(set(moments)) < 2:
            raise ValueError("axis_body is a principal axis, about which no body tumbles: tilt it, or say kind: spin")
        return self
