"""Distributions of numbers in scenario files, each named by its key; a number is a constant.

Each law draws values and knows their second moment, so that a prior's covariance follows from the law of its errors.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from statistics import NormalDist
from typing import Annotated, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, ValidationInfo, field_validator

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import LARGEST_NUMBER
from boresight.scenarios.spec.base import SpecModel, optional, rule
from boresight.scenarios.spec.tables import columns_of, read_table

Value = TypeVar("Value")
# Every number of a law: squares of it, and logarithms and their exponentials, are finite.
Number = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST_NUMBER)]
Positive = Annotated[float, Field(ge=1e-100, le=LARGEST_NUMBER)]
Bounds = tuple[Number, Number]
Row3 = tuple[Number, Number, Number]


def _not_zero(value: Row3, info: ValidationInfo) -> Row3:
    if math.hypot(*value) < 1e-100:
        raise ValueError(f"{info.field_name} is zero: give a direction")
    return value


Direction = Annotated[Row3, AfterValidator(_not_zero)]
Spread = Annotated[float, Field(ge=0, le=10)]

_STANDARD = NormalDist()
_EVERYWHERE = (-math.inf, math.inf)
_REACH, _NODES = 12.0, 200  # of the quadrature of a truncated law, in standard deviations from its mode


def check_order(low: float, high: float) -> None:
    """Refuse bounds of which the lower is above the upper."""
    if low > high:
        raise ValueError(f"the lower bound {low:g} is above the upper bound {high:g}")


def _log_share(low: float, high: float) -> float:
    """Return the logarithm of the probability of [low, high] under the standard normal law, in its tails too."""
    from scipy.special import log_ndtr  # 0.3 s, which most commands do without

    if low > 0.0:  # the lower tail has the digits
        low, high = -high, -low
    upper, lower = float(log_ndtr(high)), float(log_ndtr(low))
    return upper + math.log1p(-math.exp(lower - upper))


class Law(SpecModel):
    """Distribution of one number."""

    @rule
    def _check_bounds(self) -> None:
        check_order(*self.support)

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> float:
        """Draw one value."""

    @property
    @abstractmethod
    def support(self) -> Bounds:
        """Least and largest value, infinite where there is none."""

    @abstractmethod
    def quantile(self, share: float) -> float:
        """Return the value that this share of all values, in (0, 1), is below."""

    @property
    def median(self) -> float:
        """The median."""
        return self.quantile(0.5)

    @property
    @abstractmethod
    def second_moment(self) -> float:
        """Mean of the square."""

    @abstractmethod
    def text(self, unit: str) -> str:
        """Return the law in words, with the unit of its values."""


class Uniform(Law):
    """Uniform between two bounds: ``{uniform: [low, high]}``; equal bounds make a constant."""

    uniform: Bounds = Field(description="[low, high]")

    def draw(self, rng: np.random.Generator) -> float:
        return float(rng.uniform(*self.uniform))

    @property
    def support(self) -> Bounds:
        return self.uniform

    def quantile(self, share: float) -> float:
        return (1.0 - share) * self.uniform[0] + share * self.uniform[1]

    @property
    def second_moment(self) -> float:
        # E[x^2] = (high^3 - low^3) / (3 (high - low)), without the division by an empty interval.
        low, high = self.uniform
        return (low * low + low * high + high * high) / 3.0

    def text(self, unit: str) -> str:
        low, high = self.uniform
        return f"{low:g} {unit}" if low == high else f"{low:g} to {high:g} {unit}"


def constant(value: float) -> Uniform:
    """Return the law of one value, which is not checked."""
    return Uniform.model_construct(uniform=(value, value))


class _Gaussian(Law):
    """Normal in some scale, between bounds if ``within`` is given: then drawn by the inverse distribution function."""

    within: Bounds | None = optional("[low, high] that values are drawn within")

    @rule
    def _check_within(self) -> None:
        if self.within is None:
            return
        check_order(*self.within)
        (low, high), (mean, sigma) = self._limits, self._normal
        if not (low <= mean <= high if sigma == 0.0 else _STANDARD.cdf(high) - _STANDARD.cdf(low) > 1e-9):
            raise ValueError(f"next to no value is within {list(self.within)}")

    @property
    @abstractmethod
    def _normal(self) -> tuple[float, float]:
        """Mean and standard deviation in the scale that is normal."""

    def _scaled(self, value: float) -> float:
        """Return a value in the scale that is normal."""
        return value

    def _unscaled(self, value: float) -> float:
        """Return a value of the scale that is normal as one of the law."""
        return value

    @property
    def _limits(self) -> Bounds:
        """Bounds in that scale, in standard deviations from the mean; as they are if the deviation is 0."""
        if self.within is None:
            return _EVERYWHERE
        mean, sigma = self._normal
        low, high = (self._scaled(bound) for bound in self.within)
        return (low, high) if sigma == 0.0 else ((low - mean) / sigma, (high - mean) / sigma)

    def draw(self, rng: np.random.Generator) -> float:
        mean, sigma = self._normal
        if self.within is None or sigma == 0.0:
            return self._clipped(self._unscaled(float(rng.normal(mean, sigma))))
        low, high = map(_STANDARD.cdf, self._limits)
        return self._at(rng.uniform(low, high))

    def quantile(self, share: float) -> float:
        low, high = map(_STANDARD.cdf, self._limits)
        return self._at((1.0 - share) * low + share * high)

    def _at(self, share: float) -> float:
        """Return the value that a share of the values of the law without bounds is below."""
        mean, sigma = self._normal
        # Neither 0 nor 1, which have no quantile.
        scale = _STANDARD.inv_cdf(min(max(share, 5e-324), 1.0 - 2**-53))
        return self._clipped(self._unscaled(mean + sigma * scale))

    def _clipped(self, value: float) -> float:
        least, most = self.support
        return min(max(value, least), most)

    def _within_text(self, unit: str) -> str:
        return f" within {self.within[0]:g} to {self.within[1]:g} {unit}" if self.within else ""


class Normal(_Gaussian):
    """Normal about zero or a mean: ``{normal: sigma}``, ``{normal: [mean, sigma]}``; truncated by ``within``."""

    normal: Annotated[
        Annotated[NonNegative, Tag("sigma")] | Annotated[tuple[float, NonNegative], Tag("mean and sigma")],
        Discriminator(lambda value: "mean and sigma" if isinstance(value, list | tuple) else "sigma"),
    ] = Field(description="Standard deviation, or [mean, sigma]")

    @property
    def _normal(self) -> tuple[float, float]:
        return self.normal if isinstance(self.normal, tuple) else (0.0, self.normal)

    @property
    def support(self) -> Bounds:
        """The bounds ``within``; the mean alone if the standard deviation is 0."""
        mean, sigma = self._normal
        return (mean, mean) if sigma == 0.0 else self.within or _EVERYWHERE

    @property
    def second_moment(self) -> float:
        mean, sigma = self._normal
        if self.within is None or sigma == 0.0:
            return mean * mean + sigma * sigma  # not **, which raises where these are infinite
        # By quadrature over the part of the bounds where the density is not negligible: the closed form cancels for
        # narrow bounds and in the tails.
        low, high = self._limits
        mode = min(max(0.0, low), high)
        low, high = max(low, mode - _REACH), min(high, mode + _REACH)
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        z = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        density = weights * np.exp(0.5 * (mode - z) * (mode + z))
        return float(np.sum(density * (mean + sigma * z) ** 2) / np.sum(density))

    def text(self, unit: str) -> str:
        mean, sigma = self._normal
        return f"{sigma:g} {unit}, 1 sigma" + (f" about {mean:g} {unit}" if mean else "") + self._within_text(unit)


class LogNormal(_Gaussian):
    """Log-normal: ``{log_normal: [median, sigma]}``, sigma of the natural logarithm; truncated by ``within``."""

    log_normal: tuple[Positive, Spread] = Field(description="[median, sigma of ln]")

    @rule
    def _check_positive(self) -> None:
        if self.within is not None and self.within[0] < 0.0:
            raise ValueError(f"within {list(self.within)} begins below 0, where there is no value")

    @property
    def _normal(self) -> tuple[float, float]:
        return math.log(self.log_normal[0]), self.log_normal[1]

    def _scaled(self, value: float) -> float:
        return math.log(value) if value > 0.0 else -math.inf

    def _unscaled(self, value: float) -> float:
        return math.exp(value)

    @property
    def support(self) -> Bounds:
        """The bounds ``within``; from 0 without them."""
        median, sigma = self.log_normal
        return (median, median) if sigma == 0.0 else self.within or (0.0, math.inf)

    @property
    def second_moment(self) -> float:
        mean, sigma = self._normal
        logarithm = 2.0 * (mean + sigma * sigma)
        if self.within is not None and sigma > 0.0:
            # x^2 times the density is the density of the law whose mean is larger by 2 sigma^2.
            low, high = self._limits
            logarithm += _log_share(low - 2.0 * sigma, high - 2.0 * sigma) - _log_share(low, high)
        return math.exp(logarithm)

    def text(self, unit: str) -> str:
        """Return median, factor of one sigma and bounds with the unit."""
        median, sigma = self.log_normal
        return f"{median:g} {unit} times or over {math.exp(sigma):.3g}, 1 sigma" + self._within_text(unit)


class LogUniform(Law):
    """Uniform in the logarithm: ``{log_uniform: [low, high]}``, both above zero."""

    log_uniform: tuple[Positive, Positive] = Field(description="[low, high]")

    def draw(self, rng: np.random.Generator) -> float:
        low, high = self.log_uniform
        return min(max(float(low * (high / low) ** rng.uniform()), low), high)

    @property
    def support(self) -> Bounds:
        return self.log_uniform

    def quantile(self, share: float) -> float:
        low, high = self.log_uniform
        return float(low * (high / low) ** share)

    @property
    def median(self) -> float:
        """The geometric mean of the bounds."""
        return math.sqrt(self.log_uniform[0] * self.log_uniform[1])

    @property
    def second_moment(self) -> float:
        low, high = self.log_uniform
        return low**2 if low == high else 0.5 * (high**2 - low**2) / math.log(high / low)

    def text(self, unit: str) -> str:
        return f"{self.log_uniform[0]:g} to {self.log_uniform[1]:g} {unit}, uniform in the logarithm"


class OneOf(SpecModel, Generic[Value]):
    """One of some values, all equally probable, written out or from the columns of a CSV or Parquet file."""

    width: ClassVar[int] = 1

    choice: tuple[Value, ...] = Field(
        min_length=1, max_length=100_000, description="The values, or the columns of a table"
    )

    @field_validator("choice", mode="before")
    @classmethod
    def _tabled(cls, value: object, info: ValidationInfo) -> object:
        """Read ``{table: FILE, columns: NAMES}`` in place of values that are written out.

        The values, each of ``width`` numbers, become part of the scenario and of its digest; the file is looked for as
        the scenario's other files are.
        """
        # Tuples: what comes from here is checked strictly, and only JSON may have a list for a tuple.
        if isinstance(value, list):
            return tuple(tuple(item) if isinstance(item, list) else item for item in value)
        if not isinstance(value, dict):
            return value
        if value.keys() != {"table", "columns"} or not isinstance(value["table"], str):
            raise ValueError("is not a list, nor {table: FILE, columns: NAMES}")
        names = value["columns"] if isinstance(value["columns"], list) else [value["columns"]]
        if len(names) != cls.width or not all(isinstance(name, str) for name in names):
            raise ValueError(f"columns: name {'one' if cls.width == 1 else cls.width}")
        try:
            rows = columns_of(read_table(value["table"], (info.context or {}).get("folders", ())), names)
        except (BoresightError, OSError, ValueError, TypeError) as error:
            raise ValueError(f"{value['table']} cannot be used: {error}") from None
        return tuple(rows[:, 0].tolist()) if cls.width == 1 else tuple(map(tuple, rows.tolist()))

    def pick(self, rng: np.random.Generator) -> Value:
        """Return one of the values, drawn at random."""
        return self.choice[int(rng.integers(len(self.choice)))]


class Choice(OneOf[float], Law):
    """One of some values, all equally probable: ``{choice: [1, 2, 2, 5]}``; a repeated value is drawn as often.

    ``{choice: {table: FILE, columns: NAME}}`` takes them from a column of a CSV or Parquet file.
    """

    def draw(self, rng: np.random.Generator) -> float:
        return self.pick(rng)

    @property
    def support(self) -> Bounds:
        return min(self.choice), max(self.choice)

    def quantile(self, share: float) -> float:
        return sorted(self.choice)[min(int(share * len(self.choice)), len(self.choice) - 1)]

    @property
    def median(self) -> float:
        """The median, between the two middle values of an even number."""
        return float(np.median(self.choice))

    @property
    def second_moment(self) -> float:
        return float(np.mean(np.square(self.choice)))

    def text(self, unit: str) -> str:
        low, high = self.support
        return f"one of {len(self.choice)} values from {low:g} to {high:g} {unit}"


def _law(value: object) -> str | None:
    """Return the kind of distribution of a value, by its key."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return "number"
    keys = value if isinstance(value, dict) else type(value).model_fields if isinstance(value, SpecModel) else {}
    laws = ("normal", "uniform", "log_normal", "log_uniform", "choice", "covariance", "mixture")
    return next((law for law in laws if law in keys), None)


def either(pattern: str) -> Discriminator:
    """Return what chooses a law by its key; ``pattern`` is what a file may write, for the message."""
    return Discriminator(_law, custom_error_type="no_law", custom_error_message=f"is no distribution: write {pattern}")


_SCALAR = (
    "a number, uniform: [low, high], normal: sigma or [mean, sigma], log_uniform: [low, high],"
    " log_normal: [median, sigma of ln] or choice: [a, b, ...]"
)

_Laws = (
    Annotated[Uniform, Tag("uniform")]
    | Annotated[Normal, Tag("normal")]
    | Annotated[LogNormal, Tag("log_normal")]
    | Annotated[LogUniform, Tag("log_uniform")]
    | Annotated[Choice, Tag("choice")]
)

# A tuple: what is read is checked strictly, and only JSON may have a list here.
_AsUniform = BeforeValidator(
    lambda value: {"uniform": (value, value)} if _law(value) == "number" else value, json_schema_input_type=float
)
Scalar = Annotated[
    Annotated[Uniform, _AsUniform, Tag("number")] | _Laws,
    either(_SCALAR),
]

PositiveScalar = Annotated[
    Annotated[float, Field(gt=0), Tag("number")] | _Laws,
    either(_SCALAR),
]
"""A number, or a distribution whose values the limits of its key hold to be above zero; see `drawn`."""


def drawn(value: Law | float, rng: np.random.Generator) -> float:
    """Return a number as it is, or draw one from a stream of its own, so that nothing else depends on the law."""
    own = rng.spawn(1)[0]
    return value if isinstance(value, float) else value.draw(own)


class Limits(NamedTuple):
    """Limits of a key: of its values, and of their root mean square, for laws that need no bounds."""

    low: float
    high: float = math.inf
    rms: float = math.inf


class DrawnModel(SpecModel):
    """Section with keys that may be drawn; ``limits`` are those of numbers and laws alike."""

    limits: ClassVar[Mapping[str, Limits]] = {}

    @rule
    def _within_limits(self) -> None:
        for key, limits in self.limits.items():
            value = getattr(self, key)
            if value is not None:
                _check_limits(key, value if isinstance(value, Law) else constant(value), limits)


def _check_limits(key: str, law: Law, limits: Limits) -> None:
    """Raise ValueError for a law that leaves the limits of its key, with the law's own bounds and what to do."""
    (least, most), (low, high, largest) = law.support, limits
    if least < low or most > high:
        allowed = f"within [{low:g}, {high:g}]" if math.isfinite(high) else f"of {low:g} and more"
        hint = "" if math.isfinite(least) and math.isfinite(most) else "; bound it by within: [low, high]"
        raise ValueError(f"{key} [{least:g}, {most:g}] is not {allowed}{hint}")
    if math.isfinite(largest) and math.sqrt(law.second_moment) > largest:
        raise ValueError(f"{key} has a root mean square of {math.sqrt(law.second_moment):.3g}, above {largest:g}")
