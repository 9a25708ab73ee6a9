"""Distributions in scenario files: uniform or normal; equal bounds of a uniform one make a constant."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, Discriminator, Field, Tag, model_validator

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.spec.base import SpecModel

Bounds = tuple[float, float]
NonNegative = Annotated[float, Field(ge=0)]


def _check_order(low: float, high: float) -> None:
    if low > high:
        raise ValueError(f"the lower bound {low:g} is above the upper bound {high:g}")


def _law(value: object) -> str | None:
    """Return the kind of distribution of a value, by its key."""
    keys = value if isinstance(value, dict) else type(value).model_fields if isinstance(value, BaseModel) else {}
    return next((law for law in ("normal", "uniform") if law in keys), None)


def _either(pattern: str) -> Discriminator:
    return Discriminator(_law, custom_error_type="no_law", custom_error_message=f"is no distribution: write {pattern}")


class Uniform(SpecModel):
    """Uniform between two bounds: ``{uniform: [low, high]}``."""

    uniform: Bounds = Field(description="[low, high]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_order(*self.uniform)
        return self

    def draw(self, rng: np.random.Generator) -> float:
        """Draw one value."""
        return float(rng.uniform(*self.uniform))

    @property
    def second_moment(self) -> float:
        """Mean of the square."""
        # E[x^2] = (high^3 - low^3) / (3 (high - low)), without the division by an empty interval.
        low, high = self.uniform
        return (low * low + low * high + high * high) / 3.0


class Normal(SpecModel):
    """Gaussian about zero: ``{normal: sigma}``."""

    normal: NonNegative = Field(description="Standard deviation")

    def draw(self, rng: np.random.Generator) -> float:
        """Draw one value."""
        return float(rng.normal(0.0, self.normal))

    @property
    def second_moment(self) -> float:
        """Mean of the square."""
        return self.normal**2


Scalar = Annotated[
    Annotated[Uniform, Tag("uniform")] | Annotated[Normal, Tag("normal")],
    _either("uniform: [low, high] or normal: sigma"),
]


class Uniform3(SpecModel):
    """Three independent uniform components: ``{uniform: [[low, high], [low, high], [low, high]]}``."""

    uniform: tuple[Bounds, Bounds, Bounds] = Field(description="[low, high] of x, y and z")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for bounds in self.uniform:
            _check_order(*bounds)
        return self

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw (3,) values."""
        bounds = np.array(self.uniform, dtype=np.float64)
        return rng.uniform(bounds[:, 0], bounds[:, 1])

    @property
    def second_moments(self) -> FloatArray:
        """(3,) mean squares."""
        low, high = np.array(self.uniform).T
        return np.asarray((low * low + low * high + high * high) / 3.0, dtype=np.float64)


class Normal3(SpecModel):
    """Three independent Gaussian components about zero: ``{normal: [sx, sy, sz]}``."""

    normal: tuple[NonNegative, NonNegative, NonNegative] = Field(description="Standard deviations of x, y and z")

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw (3,) values."""
        return rng.normal(0.0, self.normal)

    @property
    def second_moments(self) -> FloatArray:
        """(3,) mean squares."""
        return np.square(np.array(self.normal, dtype=np.float64))


Vector3 = Annotated[
    Annotated[Uniform3, Tag("uniform")] | Annotated[Normal3, Tag("normal")],
    _either("uniform: [[low, high], [low, high], [low, high]] or normal: [sx, sy, sz]"),
]
