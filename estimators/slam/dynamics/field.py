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
        pressure = float(np.linalg.norm(forces.radiation_m_s2))
        return self.length_m * np.array(
            [forces.gm_sigma_m3_s2 / forces.gm_m3_s2, forces.radiation_sigma_m_s2 / pressure if pressure else 0.0]
        )

    def acceleration(self, positions_m: FloatArray, parameters_m: FloatArray) -> FloatArray:
        """(k, 3) at positions (k, 3) in inertial axes, m per T^2."""
        light = self.radiation_m * (parameters_m[1] / self.length_m)
        return np.asarray(light - self._weight(positions_m) * positions_m * parameters_m[0], dtype=np.float64)

    def derivatives(self, positions_m: FloatArray, parameters_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3, 3) and (k, 3, 2) derivatives of `acceleration` by position and parameters.

        The former is gm (3 r r' / r^5 - I / r^3).
        """
        weight = self._weight(positions_m)[:, :, None]
        squares = np.einsum("ki,ki->k", positions_m, positions_m)[:, None, None]
        tidal = weight * (3.0 * positions_m[:, :, None] * positions_m[:, None, :] / squares - np.eye(3))
        by_parameters = np.empty((len(positions_m), 3, 2))
        by_parameters[:, :, 0] = -weight[:, 0] * positions_m
        by_parameters[:, :, 1] = self.radiation_m / self.length_m
        return parameters_m[0] * tidal, by_parameters

    def _weight(self, positions_m: FloatArray) -> FloatArray:
        """(k, 1) L^2 / r^3."""
        squares = np.einsum("ki,ki->k", positions_m, positions_m)[:, None]
        return np.asarray(self.length_m**2 * squares**-1.5, dtype=np.float64)
