"""The options of the batch filter, and the unknowns shared by all images that they select."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.linalg import toeplitz

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.dynamics.field import HarmonicField, UniformRotation
from boresight.scenarios.dynamics.propagation import OrbitPartials, PiecewiseAcceleration
from boresight.scenarios.orbits.data import Knowledge, OrbitData
from boresight.scenarios.spec.base import SpecModel


class OrbitOptions(SpecModel):
    """Options of ``batch-filter``."""

    solar_pressure: Literal["estimated", "held"] = Field("estimated", description="Whether its factor is an unknown")
    accelerations: Literal["estimated", "none"] = Field(
        "estimated", description="Whether unmodelled accelerations, constant over intervals, are unknowns"
    )
    piece_share: float = Field(
        0.5, gt=0, le=4, description="Length of an interval, in correlation times of the unmodelled acceleration"
    )
    gravity_degree: int = Field(3, ge=0, le=6, description="Coefficients of degree 2 up to this one are unknowns")
    landmarks: Literal["free", "prior"] = Field(
        "free", description="Landmarks without a prior, or with that of the landmark file"
    )
    radiometry: Literal["used", "ignored"] = Field("used", description="Whether ranges and Doppler are used")
    first_days: float = Field(1.0, gt=0, le=30, description="Length of the first arc")
    growth: float = Field(3.0, gt=1, le=20, description="Ratio of the lengths of successive arcs")
    edit_sigma: float = Field(4.0, gt=1, le=20, description="Sightings with larger residuals are edited")
    huber_sigma: float = Field(2.0, gt=0, le=10, description="Limit of Huber's loss before editing")
    iterations: int = Field(12, ge=1, le=100, description="Most steps for one arc")
    split: bool = Field(True, description="Look for numbers given to two craters, and split them")
    chi_square_max: float = Field(1.5, gt=1, description="Per degree of freedom; above, a solution is rejected")
    edited_max: float = Field(0.4, gt=0, lt=1, description="Share of edited sightings; above, a solution is rejected")


@dataclass(frozen=True, eq=False)
class ParameterLayout:
    """The order and scaling of the shared unknowns ``x``: a parameter is its a priori value plus its sigma times x.

    Parameters that are certain a priori (sigma 0) are left out. In order: state at the epoch, forces (ratio of GM,
    factor on solar pressure, gravity coefficients), spin (pole, rate), camera mounting, focal length, range bias,
    accelerations. ``field`` is the a priori force model, with derivatives by the gravity coefficients that are unknown,
    ``force_sigma`` (2 + K,) has the sigmas of its parameters, and ``bias_sigma_m`` is that of the range bias; 0 where
    there is none. ``edges_s`` (P + 1,) are bounds of the intervals in which the unmodelled acceleration is constant;
    (0,) for none. ``flights`` are the last propagated orbits, by unknowns and times: several steps of the filter need
    the same ones.
    """

    knowledge: Knowledge
    field: HarmonicField
    edges_s: FloatArray
    force_sigma: FloatArray
    bias_sigma_m: float
    flights: dict[tuple[bytes, bytes], OrbitPartials] = dataclasses.field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, data: OrbitData, options: OrbitOptions) -> ParameterLayout:
        """Select the unknowns: the parameters that are uncertain a priori and that the options do not hold."""
        known = data.knowledge
        field = HarmonicField(
            known.field.harmonics, known.field.rotation, known.field.light_m_s2, options.gravity_degree
        )
        # Without sunlight the factor has no effect, and would be an unknown that only its prior determines.
        light = known.light_sigma if options.solar_pressure == "estimated" and np.any(field.light_m_s2) else 0.0
        sigma = np.r_[known.gm_sigma, light, np.full(field.parameters - 2, known.coefficient_sigma)]
        edges: FloatArray = np.zeros(0, dtype=np.float64)
        if options.accelerations == "estimated" and known.noise_m_s2 > 0.0:
            last = [data.wanted_s[-1:], data.pictures.times_s[-1:]]
            end = float(np.concatenate(last).max(initial=1.0))
            step = known.noise_time_s * options.piece_share
            # From the epoch to the last time for which the orbit is wanted: a prediction has its own accelerations,
            # known by their correlation with earlier ones.
            edges = np.asarray(step * np.arange(int(np.ceil(end / step)) + 1), dtype=np.float64)
        bias = 0.0 if data.radiometry is None else data.radiometry.range_bias_sigma_m
        return cls(known, field, edges, sigma, bias)

    @cached_property
    def pieces(self) -> int:
        """Return the number of intervals of constant unmodelled acceleration."""
        return max(0, len(self.edges_s) - 1)

    @cached_property
    def forces(self) -> NDArray[np.int64]:
        """Return the rows of the force model's parameters that are unknown."""
        return np.flatnonzero(self.force_sigma > 0.0)

    @cached_property
    def starts(self) -> dict[str, int]:
        """Return the first row of each group of unknowns."""
        counts = {
            "state": 6,
            "forces": len(self.forces),
            "pole": 2 if self.knowledge.pole_sigma_rad > 0.0 else 0,
            "rate": 1 if self.knowledge.spin_sigma > 0.0 else 0,
            "mounting": 3 if self.knowledge.misalignment_sigma_rad > 0.0 else 0,
            "focal": 1 if self.knowledge.focal_sigma > 0.0 else 0,
            "bias": 1 if self.bias_sigma_m > 0.0 else 0,
            "pushes": 3 * self.pieces,
            "end": 0,
        }
        places = np.concatenate([[0], np.cumsum(list(counts.values()))])
        return {name: int(place) for name, place in zip(counts, places, strict=False)}

    @property
    def size(self) -> int:
        """Return the number of unknowns."""
        return self.starts["end"]

    def part(self, name: str) -> slice:
        """Return the rows of a group of unknowns."""
        names = list(self.starts)
        return slice(self.starts[name], self.starts[names[names.index(name) + 1]])

    def force_scale(self, x: FloatArray) -> FloatArray:
        """Return the factors (forces,) from derivatives by the force model's parameters at ``x`` to those by ``x``.

        The force model differentiates by the ratios of GM and solar pressure to their values at ``x``, not a priori.
        """
        scale = self.force_sigma.copy()
        # The ratio to the value at x changes by sigma / (1 + correction) per unit of x.
        scale[:2] /= 1.0 + self._corrections(x)[:2]
        return np.asarray(scale[self.forces])

    def _corrections(self, x: FloatArray) -> FloatArray:
        """Return the corrections of all parameters of the force model, 0 for those that are not unknowns."""
        added = np.zeros(self.field.parameters)
        added[self.forces] = self.force_sigma[self.forces] * x[self.part("forces")]
        return added

    @cached_property
    def state_sigma(self) -> FloatArray:
        """Return (6,) standard deviations of the state at the epoch, m and m/s."""
        return np.repeat([self.knowledge.position_sigma_m, self.knowledge.velocity_sigma_m_s], 3)

    def state(self, x: FloatArray) -> FloatArray:
        """Return the state (6,) at the epoch, m and m/s."""
        return np.asarray(self.knowledge.state + self.state_sigma * x[self.part("state")])

    def field_at(self, x: FloatArray) -> HarmonicField:
        """Return the force model with the estimated parameters."""
        added = self._corrections(x)
        field = self.field.changed(1.0 + added[0], 1.0 + added[1], added[2:])
        return field if self.spin_is_known else dataclasses.replace(field, rotation=self.rotation(x))

    @property
    def spin_is_known(self) -> bool:
        """Return whether neither the pole nor the spin rate is an unknown."""
        return bool(self.spin.start == self.spin.stop)

    @property
    def spin(self) -> slice:
        """Return the rows of the pole and of the rate."""
        return slice(self.part("pole").start, self.part("rate").stop)

    def rotation(self, x: FloatArray) -> UniformRotation:
        """Return the rotation of the body with the estimated pole and rate."""
        if self.spin_is_known:
            return self.field.rotation
        pole = x[self.part("pole")]
        across = self.knowledge.pole_sigma_rad * (pole if len(pole) else np.zeros(2))
        return self.field.rotation.changed(across, 1.0 + self.knowledge.spin_sigma * float(x[self.part("rate")].sum()))

    def mounting(self, x: FloatArray) -> FloatArray:
        """Return the rotation vector (3,) of the camera's misalignment, rad."""
        part = x[self.part("mounting")]
        return self.knowledge.misalignment_sigma_rad * (part if len(part) else np.zeros(3))

    def focal(self, x: FloatArray) -> float:
        """Return the relative error of the focal length."""
        return self.knowledge.focal_sigma * float(x[self.part("focal")].sum())

    def bias_m(self, x: FloatArray) -> float:
        """Return the range bias, m."""
        return self.bias_sigma_m * float(x[self.part("bias")].sum())

    def pushes(self, x: FloatArray, end_s: float) -> PiecewiseAcceleration:
        """Return the estimated piecewise-constant unmodelled acceleration."""
        if not self.pieces:
            return PiecewiseAcceleration.none(end_s)
        return PiecewiseAcceleration(self.edges_s, self.knowledge.noise_m_s2 * x[self.part("pushes")].reshape(-1, 3))

    @cached_property
    def information(self) -> FloatArray:
        """Return the (n, n) a priori information of ``x``.

        It is the identity but for the accelerations: consecutive intervals of the Gauss-Markov process are correlated.
        """
        found = np.eye(self.size)
        if self.pieces:
            pushes = self.part("pushes")
            # The three axes are independent and alike; unknowns are ordered by interval, then axis.
            found[pushes, pushes] = np.kron(np.linalg.inv(self._push_correlation()), np.eye(3))
        return found

    def _push_correlation(self) -> FloatArray:
        """Return the (P, P) covariance of the interval means of a Gauss-Markov process of variance 1.

        With ``d`` the length of an interval in correlation times: ``2 (d - 1 + e^-d) / d^2`` on the diagonal, and
        ``(1 - e^-d)^2 e^-((k - 1) d) / d^2`` for two intervals that are k intervals apart.
        """
        d = float(self.edges_s[1] - self.edges_s[0]) / self.knowledge.noise_time_s
        apart = np.arange(self.pieces)
        lagged = (1.0 - np.exp(-d)) ** 2 * np.exp(-(apart - 1) * d) / d**2
        lagged[0] = 2.0 * (d - 1.0 + np.exp(-d)) / d**2
        return np.asarray(toeplitz(lagged))
