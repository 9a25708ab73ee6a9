"""Adjustment with orbital dynamics: state, arcs of free motion between views, and prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.estimators.slam.adjustment.problem import Adjustment, State
from boresight.estimators.slam.force_model import ForceModel, propagate, propagate_with_derivatives
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray

_WHITE_SHARE = 0.05
"""White noise of position and velocity, as part of their sigmas by the unknown acceleration."""

_WHITE_FLOOR = 1e-8
"""Least white noise, L."""


@dataclass(frozen=True, slots=True, eq=False)
class DynamicState:
    """Positions and landmarks in the body frame, velocities (V, 3) in inertial axes, parameters (2,); all in m.

    Velocities and parameters are in the units of a `ForceModel`.
    """

    vision: State
    velocities_m: FloatArray
    parameters_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
    """Free motion (k,) from view to view, its durations (k,) in T, and the inverse covariances (k, 6, 6)."""

    start: IndexArray
    end: IndexArray
    duration: FloatArray
    information: FloatArray

    def of_view(self, view: int) -> Arcs:
        """Return the arcs that begin or end at a view."""
        rows = (self.start == view) | (self.end == view)
        return Arcs(self.start[rows], self.end[rows], self.duration[rows], self.information[rows])


@dataclass(frozen=True, slots=True, eq=False)
class DynamicPrior:
    """A quadratic ``(x - x0)' H (x - x0) / 2 + g' (x - x0)`` of some views, the parameters, and some landmarks.

    ``views`` (a,) and ``points`` (b,) are their numbers in the problem. ``origin_m`` (n,), ``information`` (n, n) and
    ``gradient`` (n,), with n = 6 a + 2 + 3 b, are of all positions, all velocities, the parameters, the landmarks.
    """

    views: IndexArray
    points: IndexArray
    origin_m: FloatArray
    information: FloatArray
    gradient: FloatArray

    def offset(self, state: DynamicState) -> FloatArray:
        """(n,) x - x0 at ``state``."""
        return gather(state, self.views, self.points) - self.origin_m


@dataclass(frozen=True, slots=True, eq=False)
class DynamicAdjustment:
    """Least-squares problem of views that are coupled by their orbital motion.

    ``vision`` has pixels and distances, without motions or a prior; its ``kept_points`` are those of `prior`, and its
    ``frozen`` are the first estimates of positions and landmarks. ``R_body_inertial`` (V, 3, 3) is that of each view.
    ``free_velocities`` (V,) and ``free_parameters`` (2,) are what is solved for. ``frozen_velocities_m`` (V, 3) and
    ``frozen_parameters_m`` (2,) are first estimates of the variables in the prior, where derivatives are taken; NaN
    elsewhere.
    """

    vision: Adjustment
    R_body_inertial: FloatArray
    field: ForceModel
    arcs: Arcs
    free_velocities: BoolArray
    free_parameters: BoolArray
    frozen_velocities_m: FloatArray
    frozen_parameters_m: FloatArray
    prior: DynamicPrior | None = None

    def linearisation_point(self, state: DynamicState) -> DynamicState:
        """Return ``state`` with the frozen variables at their first estimates."""
        v, p = self.frozen_velocities_m, self.frozen_parameters_m
        return DynamicState(
            self.vision.linearisation_point(state.vision),
            np.where(np.isnan(v), state.velocities_m, v),
            np.where(np.isnan(p), state.parameters_m, p),
        )

    def inertial(self, state: DynamicState) -> FloatArray:
        """(V, 6) positions and velocities in inertial axes."""
        # Landmarks are fixed in the body, orbits are smooth in inertial axes: positions are unknowns in body axes (for
        # the pixels) and rotated for the arcs.
        positions = np.einsum("vji,vj->vi", self.R_body_inertial, state.vision.positions_m)
        return np.concatenate([positions, state.velocities_m], axis=1)

    def arc_residuals(self, state: DynamicState) -> FloatArray:
        """(k, 6) state at the end of each arc minus the propagated one, inertial axes, not whitened."""
        at, arcs = self.inertial(state), self.arcs
        return np.asarray(
            at[arcs.end] - propagate(self.field, at[arcs.start], state.parameters_m, arcs.duration), dtype=np.float64
        )

    def arc_jacobians(self, state: DynamicState) -> FloatArray:
        """(k, 6, 14) of `arc_residuals` by positions of start and end (body), their velocities, and the parameters."""
        # First-estimates Jacobians, as for pixels: derivatives at the frozen point, residuals at the present state.
        where, arcs = self.linearisation_point(state), self.arcs
        start = self.inertial(where)[arcs.start]
        _, moved = propagate_with_derivatives(self.field, start, where.parameters_m, arcs.duration)
        turned = np.swapaxes(self.R_body_inertial, 1, 2)
        rows = np.zeros((len(arcs.start), 6, 14))
        # End minus propagated start: minus the state transition matrix for the start, the identity for the end;
        # positions through R_inertial_body of their view.
        rows[:, :, 0:3] = -moved[:, :, 0:3] @ turned[arcs.start]
        rows[:, :3, 3:6] = turned[arcs.end]
        rows[:, :, 6:9] = -moved[:, :, 3:6]
        rows[:, 3:, 9:12] = np.eye(3)
        rows[:, :, 12:14] = -moved[:, :, 6:8]
        return rows


def gather(state: DynamicState, views: IndexArray, points: IndexArray) -> FloatArray:
    """(6 a + 2 + 3 b,) the values of some views, the parameters, and some landmarks, in the order of a prior."""
    vision = state.vision
    return np.concatenate(
        [
            vision.positions_m[views].ravel(),
            state.velocities_m[views].ravel(),
            state.parameters_m,
            vision.points_m[points].ravel(),
        ]
    )


def arc_information(durations: FloatArray, acceleration_m: float, length_m: float) -> FloatArray:
    """(k, 6, 6) inverse covariances of the state at the end of an arc, due to a constant unknown acceleration.

    This is the discrete covariance of piecewise constant acceleration (Bar-Shalom et al. 2001, section 6.3.2); the
    gravity gradient changes it by less than 0.1 % over 2 deg of an orbit. It has rank 3 of 6, since the errors of
    position and velocity are fully correlated. White noise of 5 % of each sigma, at least 1e-8 of the distance, makes
    it invertible.

    ``durations`` (k,) are in T, ``acceleration_m`` is the standard deviation of a coordinate, m per T^2, and
    ``length_m`` is L.
    """
    # An acceleration a over dt displaces by a dt^2 / 2 and changes the velocity by a dt: the covariance is gain gain'.
    gain = acceleration_m * np.stack([0.5 * durations**2, durations], axis=1)
    covariance = gain[:, :, None] * gain[:, None, :]
    white = np.maximum(_WHITE_SHARE * gain, _WHITE_FLOOR * length_m)
    covariance[:, [0, 1], [0, 1]] += white**2
    # The axes are independent and alike: a 2 x 2 inverse for [position, velocity] serves all three.
    return np.asarray(np.kron(np.linalg.inv(covariance), np.eye(3)), dtype=np.float64)
