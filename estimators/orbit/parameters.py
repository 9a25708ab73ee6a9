"""The unknowns that all images share, each in units of its standard deviation before the data."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from estimators.orbit.options import OrbitOptions
from scenarios.dynamics.field import HarmonicField
from scenarios.dynamics.propagation import PiecewiseAcceleration
from scenarios.dynamics.variational import OrbitPartials
from scenarios.orbits.data import Knowledge, OrbitData

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each shared unknown stands in the vector ``x``: a value is what is known before plus sigma times x.

    What is certain before (sigma 0) has no place. In order: state at the epoch, forces (ratio of GM, factor on
    sunlight, coefficients), mounting, focal length, range bias, pushes.

    Parameters
    ----------
    knowledge
        What is known before.
    field
        Forces as they are known, with derivatives by the coefficients that are unknown.
    edges_s
        (P + 1,) of the pieces in which what is not modelled is held constant; (0,) for none.
    force_sigma
        (2 + K,) of the field's parameters.
    bias_sigma_m
        Of the range bias; 0 where there is none.
    flights
        The last orbits that were followed, by unknowns and times: steps of the filter ask for the same again.
    """

    knowledge: Knowledge
    field: HarmonicField
    edges_s: FloatArray
    force_sigma: FloatArray
    bias_sigma_m: float
    flights: dict[tuple[bytes, bytes], OrbitPartials] = dataclasses.field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, data: OrbitData, options: OrbitOptions) -> Layout:
        """Choose the unknowns by what is uncertain."""
        known = data.knowledge
        field = HarmonicField(
            known.field.harmonics, known.field.rotation, known.field.light_m_s2, options.gravity_degree
        )
        light = known.light_sigma if options.solar_pressure == "estimated" and np.any(field.light_m_s2) else 0.0
        sigma = np.r_[known.gm_sigma, light, np.full(field.parameters - 2, known.coefficient_sigma)]
        edges: FloatArray = np.zeros(0, dtype=np.float64)
        if options.accelerations == "estimated" and known.noise_m_s2 > 0.0:
            last = [data.wanted_s[-1:], data.pictures.times_s[-1:]]
            end = float(np.concatenate(last).max(initial=1.0))
            step = known.noise_time_s * options.piece_share
            edges = np.asarray(step * np.arange(int(np.ceil(end / step)) + 1), dtype=np.float64)
        bias = 0.0 if data.radiometry is None else data.radiometry.range_bias_sigma_m
        return cls(known, field, edges, sigma, bias)

    @cached_property
    def pieces(self) -> int:
        """Count the pieces."""
        return max(0, len(self.edges_s) - 1)

    @cached_property
    def forces(self) -> NDArray[np.int64]:
        """Return which of the field's parameters are unknown."""
        return np.flatnonzero(self.force_sigma > 0.0)

    @cached_property
    def starts(self) -> dict[str, int]:
        """Return where each group begins."""
        counts = {
            "state": 6,
            "forces": len(self.forces),
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
        """Count the unknowns."""
        return self.starts["end"]

    def part(self, name: str) -> slice:
        """Return the places of a group."""
        names = list(self.starts)
        return slice(self.starts[name], self.starts[names[names.index(name) + 1]])

    def force_scale(self, x: FloatArray) -> FloatArray:
        """Return what makes derivatives by the parameters of the field at ``x`` derivatives by ``x``, (forces,).

        Those by GM and sunlight are by ratios to what they are at ``x``.
        """
        scale = self.force_sigma.copy()
        scale[:2] /= 1.0 + self._added(x)[:2]
        return np.asarray(scale[self.forces])

    def _added(self, x: FloatArray) -> FloatArray:
        added = np.zeros(self.field.parameters)
        added[self.forces] = self.force_sigma[self.forces] * x[self.part("forces")]
        return added

    @cached_property
    def state_sigma(self) -> FloatArray:
        """(6,) m and m/s."""
        return np.repeat([self.knowledge.position_sigma_m, self.knowledge.velocity_sigma_m_s], 3)

    def state(self, x: FloatArray) -> FloatArray:
        """(6,) at the epoch."""
        return np.asarray(self.knowledge.state + self.state_sigma * x[self.part("state")])

    def field_at(self, x: FloatArray) -> HarmonicField:
        """Return the forces with their estimated parameters."""
        added = self._added(x)
        return self.field.changed(1.0 + added[0], 1.0 + added[1], added[2:])

    def mounting(self, x: FloatArray) -> FloatArray:
        """(3,) rotation vector of the camera's mounting, rad."""
        part = x[self.part("mounting")]
        return self.knowledge.misalignment_sigma_rad * (part if len(part) else np.zeros(3))

    def focal(self, x: FloatArray) -> float:
        """Relative error of the focal length."""
        return self.knowledge.focal_sigma * float(x[self.part("focal")].sum())

    def bias_m(self, x: FloatArray) -> float:
        """Bias of the ranges."""
        return self.bias_sigma_m * float(x[self.part("bias")].sum())

    def pushes(self, x: FloatArray, end_s: float) -> PiecewiseAcceleration:
        """Return the pieces of what is not modelled."""
        if not self.pieces:
            return PiecewiseAcceleration.none(end_s)
        return PiecewiseAcceleration(self.edges_s, self.knowledge.noise_m_s2 * x[self.part("pushes")].reshape(-1, 3))

    @cached_property
    def information(self) -> FloatArray:
        """(n, n) before the data: the identity, but for pushes, whose pieces go with each other."""
        found = np.eye(self.size)
        if self.pieces:
            pushes = self.part("pushes")
            found[pushes, pushes] = np.kron(np.linalg.inv(self._push_correlation()), np.eye(3))
        return found

    def _push_correlation(self) -> FloatArray:
        """(P, P) covariance of the means over pieces of a Gauss-Markov process of variance 1.

        With ``d`` the length of a piece in correlation times: ``2 (d - 1 + e^-d) / d^2`` for one piece, and
        ``(1 - e^-d)^2 e^-((k - 1) d) / d^2`` for two that are k pieces apart.
        """
        d = float(self.edges_s[1] - self.edges_s[0]) / self.knowledge.noise_time_s
        apart = np.arange(self.pieces)
        lagged = (1.0 - np.exp(-d)) ** 2 * np.exp(-(apart - 1) * d) / d**2
        lagged[0] = 2.0 * (d - 1.0 + np.exp(-d)) / d**2
        return np.asarray(toeplitz(lagged))
