"""Random numbers as a scenario writes them: a constant, a uniform range or a normal law."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scenarios.spec.base import SpecModel


def _ordered(low: float, high: float) -> None:
    if low > high:
        raise ValueError(f"the lower bound {low} is above the upper bound {high}")


class Uniform(SpecModel):
    """Uniform between two bounds: ``{uniform: [low, high]}``."""

    uniform: tuple[float, float]

    @model_validator(mode="after")
    def _check(self) -> Self:
        _ordered(*self.uniform)
        return self

    def draw(self, rng: np.random.Generator) -> float:
        """Draw one value."""
        return float(rng.uniform(*self.uniform))

    @property
    def second_moment(self) -> float:
        """Return the mean of the square."""
        low, high = self.uniform
        return (low * low + low * high + high * high) / 3.0


class Normal(SpecModel):
    """Gaussian about zero: ``{normal: sigma}``."""

    normal: float = Field(ge=0)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw one value."""
        return float(rng.normal(0.0, self.normal))

    @property
    def second_moment(self) -> float:
        """Return the mean of the square."""
        return self.normal**2


Scalar = Uniform | Normal


class Uniform3(SpecModel):
    """Three independent uniform components: ``{uniform: [[low, high], [low, high], [low, high]]}``."""

    uniform: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

    @model_validator(mode="after")
    def _check(self) -> Self:
        for bounds in self.uniform:
            _ordered(*bounds)
        return self

    def draw(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw (3,) values."""
        bounds = np.array(self.uniform)
        return rng.uniform(bounds[:, 0], bounds[:, 1])

    @property
    def second_moments(self) -> NDArray[np.float64]:
        """Return the (3,) mean squares."""
        low, high = np.array(self.uniform).T
        moments: NDArray[np.float64] = (low * low + low * high + high * high) / 3.0
        return moments


class Normal3(SpecModel):
    """Three independent Gaussian components about zero: ``{normal: [sx, sy, sz]}``."""

    normal: tuple[float, float, float]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if min(self.normal) < 0:
            raise ValueError(f"a standard deviation cannot be negative: {list(self.normal)}")
        return self

    def draw(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw (3,) values."""
        return rng.normal(0.0, self.normal)

    @property
    def second_moments(self) -> NDArray[np.float64]:
        """Return the (3,) mean squares."""
        return np.array(self.normal) ** 2


Vector3 = Uniform3 | Normal3
