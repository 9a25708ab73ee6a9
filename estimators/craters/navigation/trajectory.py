"""Where the spacecraft is thought to be: by the a priori orbit, or by one that was determined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.orbit.contract import Orbit
from scenarios.dynamics.propagation import PiecewiseAcceleration
from scenarios.dynamics.variational import propagate_partials
from scenarios.orbits.data import Knowledge

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Places at n times, about the centre of mass, inertial axes.

    Parameters
    ----------
    times_s
        (n,) ascending.
    positions_m, covariances_m2
        (n, 3) and (n, 3, 3).
    by_common_m
        (n, 3, s) what s errors of unit variance, the same at all times, do to the places: the part of their
        covariances by which they go together.
    """

    times_s: FloatArray
    positions_m: FloatArray
    covariances_m2: FloatArray
    by_common_m: FloatArray

    @classmethod
    def known_before(cls, knowledge: Knowledge, times_s: FloatArray) -> Trajectory:
        """Map the a priori orbit forward, with the errors of the state at the epoch, of GM and of the Sun's pressure.

        Raises
        ------
        OrbitLostError
            If the a priori orbit leads into the body.
        """
        flown = propagate_partials(
            knowledge.field, knowledge.state, times_s, PiecewiseAcceleration.none(float(times_s[-1]))
        )
        sigma = np.repeat([knowledge.position_sigma_m, knowledge.velocity_sigma_m_s], 3)
        forces = flown.by_parameters[:, :3, :2] * [knowledge.gm_sigma, knowledge.light_sigma]
        spread = np.concatenate([flown.by_state[:, :3] * sigma, forces], axis=2)
        return cls(times_s, flown.states[:, :3], np.asarray(spread @ np.swapaxes(spread, 1, 2)), spread)

    @classmethod
    def determined(cls, orbit: Orbit, times_s: FloatArray, wanted_s: FloatArray, inflation: float) -> Trajectory:
        """Take the places of an orbit at ``times_s``, which are among the times ``wanted_s`` that it was asked for.

        ``inflation`` multiplies its covariance: the chi-square of each degree of freedom of a solution whose residuals
        are larger than they should be.
        """
        rows = np.searchsorted(wanted_s, times_s)
        covariances = inflation * orbit.position_covariances_m2[rows]
        return cls(times_s, orbit.positions_m[rows], covariances, np.zeros((len(rows), 3, 0)))
