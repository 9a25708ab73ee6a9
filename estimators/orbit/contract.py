"""The contract of orbit determination: `OrbitData` in, an orbit with its covariance out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol, Self

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.orbits.data import Knowledge, LandmarkFile, OrbitData, Pictures, Radiometry

__all__ = [
    "Knowledge",
    "LandmarkFile",
    "Orbit",
    "OrbitData",
    "OrbitEstimate",
    "OrbitEstimator",
    "Pictures",
    "Radiometry",
]


@dataclass(frozen=True, slots=True, eq=False)
class CentreInCamera:
    """Position of the body's centre of mass at the last image of an arc, by the orbit and the reported attitude.

    ``position_m`` (3,) is in the axes of the camera, as it appears with the nominal focal length, and ``mounting``
    (3, 3) the estimated rotation that follows the telemetered attitude. Both covariances (3, 3), m^2 and rad^2, are
    those of all unknowns together, with mounting and focal length, but without the error of the image's own attitude.
    """

    position_m: FloatArray
    covariance_m2: FloatArray
    mounting: FloatArray
    mounting_covariance_rad2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Orbit:
    """A determined orbit, in inertial axes.

    ``state`` (6,) and ``covariance`` (6, 6) are at the epoch: position, m, then velocity, m/s. Positions and velocities
    (E, 3), with ``position_covariances_m2`` (E, 3, 3), are at ``OrbitData.wanted_s``. ``numbers`` (L',) and
    ``points_body_m`` (L', 3) are landmarks; a number that was split appears twice. ``residuals_px`` (K, 2) are observed
    minus predicted, of every sighting; NaN where its landmark has no position. ``used`` (K,) tells which were not
    edited. ``centre`` is where the last image shows the body's centre, with fixes alone.
    """

    state: FloatArray
    covariance: FloatArray
    positions_m: FloatArray
    velocities_m_s: FloatArray
    position_covariances_m2: FloatArray
    numbers: IndexArray
    points_body_m: FloatArray
    residuals_px: FloatArray
    used: BoolArray
    centre: CentreInCamera | None = None


@dataclass(frozen=True, slots=True, eq=False)
class OrbitEstimate:
    """The result of orbit determination.

    ``orbit`` is None if none was found. A rejected solution has the status ``failed``, and ``reason`` gives the cause.
    """

    status: Literal["ok", "failed"]
    orbit: Orbit | None
    reason: str = ""
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0


class OrbitEstimator(Protocol):
    """A method of orbit determination. ``version`` is part of every result's key: raise it when results change.

    A method ``predict(data) -> FloatArray | None`` is optional: the covariance (6, 6) of the state at the epoch that
    the geometry of the data allows, without residuals.
    """

    name: ClassVar[str]
    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError if one is invalid."""
        ...

    def determine(self, data: OrbitData) -> OrbitEstimate:
        """Determine the orbit; must not change its input."""
        ...
