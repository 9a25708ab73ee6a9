"""The accelerations of equation (6) of Delpech et al. (2015), in units in which all unknowns are metres.

With the distance L at the first frame and T = sqrt(L^3 / gm), a velocity is given as v T, the gravity parameter as
L times its ratio to the value that is known before, and the factor on solar radiation pressure as L times it. An error
of one metre in any of them moves an orbit by about a metre within a revolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.tracks import Forces

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Gravity of a point and a constant pressure of light.

    Parameters
    ----------
    length_m, time_s
        L and T.
    gm_m3_s2
        The gravity parameter that `parameters` are relative to.
    radiation_m
        (3,) acceleration by solar radiation pressure times T^2, inertial axes.
    """

    length_m: float
    time_s: float
    gm_m3_s2: float
    radiation_m: FloatArray

    @classmethod
    def of(cls, forces: Forces, distance_m: float) -> Field:
        """Choose the units by the distance from the body's centre."""
        time = float(np.sqrt(distance_m**3 / forces.gm_m3_s2))
        return cls(distance_m, time, forces.gm_m3_s2, np.asarray(forces.radiation_m_s2 * time**2, dtype=np.float64))

    @property
    def known(self) -> FloatArray:
        """(2,) what the parameters are as far as it is known before: ratio and factor are 1."""
        return np.full(2, self.length_m)

    def sigmas(self, forces: Forces) -> FloatArray:
        """(2,) standard deviations of the parameters before, m; the factor is certain where there is no pressure."""
        pressed = bool(np.any(forces.radiation_m_s2))
        return self.length_m * np.array(
            [forces.gm_sigma_m3_s2 / forces.gm_m3_s2, forces.radiation_sigma if pressed else 0.0]
        )

    def acceleration(self, positions_m: FloatArray, parameters_m: FloatArray) -> FloatArray:
        """(k, 3) at positions (k, 3) in inertial axes, m per T^2."""
        return np.asarray(
            self._pull(positions_m) * parameters_m[0] + self.radiation_m * (parameters_m[1] / self.length_m)
        )

    def by_position(self, positions_m: FloatArray, parameters_m: FloatArray) -> FloatArray:
        """(k, 3, 3) derivative of `acceleration` by the position: gm (3 r r' / r^5 - I / r^3)."""
        lengths = np.linalg.norm(positions_m, axis=1)[:, None, None]
        units = positions_m[:, :, None] / lengths
        tidal = (3.0 * units * np.swapaxes(units, 1, 2) - np.eye(3)) / lengths**3
        return np.asarray(self.length_m**2 * parameters_m[0] * tidal, dtype=np.float64)

    def by_parameters(self, positions_m: FloatArray) -> FloatArray:
        """(k, 3, 2) derivative of `acceleration` by the parameters."""
        light = np.broadcast_to(self.radiation_m / self.length_m, positions_m.shape)
        return np.stack([self._pull(positions_m), light], axis=2)

    def _pull(self, positions_m: FloatArray) -> FloatArray:
        lengths = np.linalg.norm(positions_m, axis=1, keepdims=True)
        return np.asarray(-(self.length_m**2) * positions_m / lengths**3, dtype=np.float64)
