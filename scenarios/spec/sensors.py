"""Sensors-section: what the spacecraft measures beside the image."""

from __future__ import annotations

from pydantic import Field

from scenarios.spec.base import SpecModel


class AltimeterSpec(SpecModel):
    """A laser altimeter along the camera's boresight; its Gaussian error has no part in the prior's."""

    sigma_m: float = Field(gt=0, description="Standard deviation of a range")


class SensorsSpec(SpecModel):
    """Sensors by name; those left out are not aboard."""

    altimeter: AltimeterSpec | None = Field(None, description="Measures the distance to the surface on the boresight")

    @property
    def aboard(self) -> frozenset[str]:
        """Names of the sensors that are there."""
        return frozenset(name for name in type(self).model_fields if getattr(self, name) is not None)
