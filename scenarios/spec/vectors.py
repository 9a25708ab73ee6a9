"""Distributions of vectors in scenario files, each named by its key."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, Tag, field_validator

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.spec.base import SpecModel, optional, rule
from boresight.scenarios.spec.distribution import Bounds, NonNegative, Number, OneOf, Row3, check_order, either


class Law3(SpecModel):
    """Distribution of a vector of three components."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw (3,) values."""

    @property
    @abstractmethod
    def second_moment(self) -> FloatArray:
        """(3, 3) mean of the outer product of a vector with itself."""


class Uniform3(Law3):
    """Three independent uniform components: ``{uniform: [[low, high], [low, high], [low, high]]}``."""

    uniform: tuple[Bounds, Bounds, Bounds] = Field(description="[low, high] of x, y and z")

    @rule
    def _check(self) -> None:
        for bounds in self.uniform:
            check_order(*bounds)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        bounds = np.array(self.uniform, dtype=np.float64)
        return rng.uniform(bounds[:, 0], bounds[:, 1])

    @property
    def second_moment(self) -> FloatArray:
        low, high = np.array(self.uniform).T
        means = 0.5 * (low + high)
        moments = np.outer(means, means)
        np.fill_diagonal(moments, (low * low + low * high + high * high) / 3.0)
        return np.asarray(moments, dtype=np.float64)


Row6 = tuple[Number, Number, Number, Number, Number, Number]


class _NormalVector(Law3):
    """Normal components about zero or a ``mean``; with ``student_t`` of heavier tails and the same covariance."""

    mean: tuple[float, ...] | None = optional("Mean; zero if left out")
    student_t: float | None = optional("Degrees of freedom of Student's t, with this covariance", gt=2, le=1e6)

    @property
    @abstractmethod
    def covariance_matrix(self) -> FloatArray:
        """(n, n) covariance."""

    @abstractmethod
    def _deviation(self, rng: np.random.Generator) -> FloatArray:
        """Draw a normal deviation, (n,), from the mean."""

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw one vector, (n,)."""
        value = self._deviation(rng)
        if self.student_t is not None:
            # t = z sqrt(f / W), W of a chi-square law of f degrees of freedom, has f / (f - 2) times the covariance.
            value = value * math.sqrt((self.student_t - 2.0) / rng.chisquare(self.student_t))
        return value if self.mean is None else np.array(self.mean) + value

    @property
    def second_moment(self) -> FloatArray:
        """(n, n) covariance plus the outer product of the mean with itself."""
        return self.covariance_matrix if self.mean is None else self.covariance_matrix + np.outer(self.mean, self.mean)


class Normal3(_NormalVector):
    """Three independent normal components about zero or a ``mean``: ``{normal: [sx, sy, sz]}``."""

    normal: tuple[NonNegative, NonNegative, NonNegative] = Field(description="Standard deviations of x, y and z")
    mean: Row3 | None = optional("Mean; zero if left out")

    @property
    def covariance_matrix(self) -> FloatArray:
        return np.diag(np.square(np.array(self.normal, dtype=np.float64)))

    def _deviation(self, rng: np.random.Generator) -> FloatArray:
        return rng.normal(0.0, self.normal)


def check_semidefinite(name: str, matrix: FloatArray) -> None:
    """Refuse a matrix (n, n) that is no covariance."""
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise ValueError(f"{name} is not symmetric")
    # Of the correlations, as components may differ in unit; one without variance is left as it is.
    sigmas = np.sqrt(np.abs(np.diag(matrix)))
    sigmas[sigmas == 0.0] = 1.0
    least = float(np.linalg.eigvalsh(matrix / np.outer(sigmas, sigmas))[0])
    if least < -1e-9:
        raise ValueError(f"{name} is not positive semidefinite: its correlations have the eigenvalue {least:.3g}")


def draw_normals(covariance: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw (n,) normal numbers of a covariance (n, n), by its eigenvectors: it may have no Cholesky factor."""
    values, vectors = np.linalg.eigh(covariance)
    normal = rng.standard_normal(len(values))
    return np.asarray(vectors @ (np.sqrt(np.maximum(values, 0.0)) * normal), dtype=np.float64)


class _Correlated(_NormalVector):
    """Normal components with a covariance."""

    width: ClassVar[int]

    covariance: tuple[tuple[float, ...], ...]

    @field_validator("covariance", mode="before")
    @classmethod
    def _size(cls, rows: object) -> object:
        """Refuse a matrix of another size in one line, in place of one for each value that is missing or too many."""
        if not isinstance(rows, list | tuple):
            return rows
        widths = {len(row) if isinstance(row, list | tuple) else 0 for row in rows}
        if len(rows) != cls.width or widths != {cls.width}:
            size = f", not {len(rows)} x {min(widths)}" if len(widths) == 1 and min(widths) else ""
            raise ValueError(f"{cls.width} x {cls.width} expected{size}")
        return tuple(map(tuple, rows))  # what is validated strictly from here on are Python values, not JSON

    @rule
    def _check(self) -> None:
        check_semidefinite("covariance", np.array(self.covariance, dtype=np.float64))

    @property
    def covariance_matrix(self) -> FloatArray:
        matrix = np.array(self.covariance, dtype=np.float64)
        return 0.5 * (matrix + matrix.T)

    def _deviation(self, rng: np.random.Generator) -> FloatArray:
        scale = self._scale
        return scale * draw_normals(np.array(self.covariance) / np.outer(scale, scale), rng)

    @property
    def _scale(self) -> FloatArray:
        """(n,) units in which the covariance is factorised."""
        return np.ones(len(self.covariance))


class Correlated3(_Correlated):
    """Normal components with a covariance: ``{covariance: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]}``."""

    width: ClassVar[int] = 3

    covariance: tuple[Row3, Row3, Row3] = Field(description="Symmetric, positive semidefinite; squared units")
    mean: Row3 | None = optional("Mean; zero if left out")


class Correlated6(_Correlated):
    """Six normal components with a covariance: ``{covariance: [[...], ...]}``, 6 x 6."""

    width: ClassVar[int] = 6

    covariance: tuple[Row6, Row6, Row6, Row6, Row6, Row6] = Field(description="Symmetric, positive semidefinite")
    mean: Row6 | None = optional("Mean; zero if left out")

    @property
    def _scale(self) -> FloatArray:
        """(6,) standard deviations: components of unlike units may differ by many powers of ten."""
        sigmas = np.sqrt(np.diag(np.array(self.covariance)))
        return np.where(sigmas > 0.0, sigmas, 1.0)


class Choice3(OneOf[Row3], Law3):
    """One of some vectors, all equally probable: ``{choice: [[x, y, z], ...]}``, for example drawn errors.

    ``{choice: {table: FILE, columns: [X, Y, Z]}}`` takes them from three columns of a CSV or Parquet file.
    """

    width: ClassVar[int] = 3

    def draw(self, rng: np.random.Generator) -> FloatArray:
        return np.array(self.pick(rng))

    @property
    def second_moment(self) -> FloatArray:
        values = np.array(self.choice)
        return np.asarray(values.T @ values / len(values), dtype=np.float64)


_VECTOR = (
    "uniform: [[low, high], [low, high], [low, high]], normal: [sx, sy, sz], covariance: 3 x 3"
    " or choice: [[x, y, z], ...]"
)

_Laws = (
    Annotated[Uniform3, Tag("uniform")]
    | Annotated[Normal3, Tag("normal")]
    | Annotated[Correlated3, Tag("covariance")]
    | Annotated[Choice3, Tag("choice")]
)


class Component3(SpecModel):
    """A distribution in a mixture, with its weight."""

    weight: float = Field(gt=0, le=1e6, description="Its share over the sum of all weights is its probability")
    law: Annotated[_Laws, either(_VECTOR)] = Field(description="The distribution")


class Mixture3(Law3):
    """One of several distributions: ``{mixture: [{weight: 0.95, law: {normal: [...]}}, {weight: 0.05, law: ...}]}``."""

    mixture: tuple[Component3, ...] = Field(min_length=2, max_length=100, description="The distributions")

    @property
    def shares(self) -> FloatArray:
        """Probability (n,) of each distribution."""
        weights = np.array([one.weight for one in self.mixture])
        return np.asarray(weights / weights.sum(), dtype=np.float64)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw a distribution, then a vector of it."""
        return self.mixture[int(rng.choice(len(self.mixture), p=self.shares))].law.draw(rng)

    @property
    def second_moment(self) -> FloatArray:
        """(3, 3) weighted mean of those of the distributions."""
        moments = [share * one.law.second_moment for share, one in zip(self.shares, self.mixture, strict=True)]
        return np.asarray(np.sum(moments, axis=0), dtype=np.float64)


Vector3 = Annotated[
    _Laws | Annotated[Mixture3, Tag("mixture")],
    either(f"{_VECTOR}, or mixture: [{{weight: w, law: ...}}, ...]"),
]
