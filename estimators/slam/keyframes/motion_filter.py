"""Motion propagator of BA-SLAM, section 3.2 of Delpech et al. (2015): a constant-gain filter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_discrete_are

from boresight.estimators.slam.contract import LostError
from boresight.estimators.slam.force_model import ForceModel, propagate
from boresight.estimators.slam.options import BundleOptions
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import TrackFrame, TrackSequence


@dataclass(frozen=True, slots=True)
class SteadyGain:
    """Steady-state Kalman gain of one axis: for position (-) and velocity (1/s), and the innovation variance, m^2."""

    position: float
    velocity_s: float
    innovation_m2: float


@lru_cache(maxsize=64)
def steady_gain(duration_s: float, acceleration_m_s2: float, position_m: float) -> SteadyGain:
    """Return the steady-state Kalman gain of one axis, by the discrete algebraic Riccati equation.

    The axes are treated as independent: the gravity gradient gm / r^3 times duration^2 is about 0.001 for frames 2 deg
    of the orbit apart. ``duration_s`` is the time between two frames, ``acceleration_m_s2`` the standard deviation of
    the unmodelled acceleration, zeta of equation (6), constant in each interval, and ``position_m`` that of a measured
    position.
    """
    # A double integrator: eq. (6) without the forces, which the propagation of the state has.
    move = np.array([[1.0, duration_s], [0.0, 1.0]])
    push = acceleration_m_s2 * np.array([[0.5 * duration_s**2], [duration_s]])
    seen = np.array([[1.0, 0.0]])
    # Transposed: the Riccati equation of the filter is the dual of that of the regulator, which scipy solves. The
    # solution is the covariance before an update.
    predicted = solve_discrete_are(move.T, seen.T, push @ push.T, np.array([[position_m**2]]))
    # K = P H' / (H P H' + R), the same in each axis.
    variance = float(predicted[0, 0] + position_m**2)
    return SteadyGain(float(predicted[0, 0]) / variance, float(predicted[1, 0]) / variance, variance)


@dataclass(frozen=True, slots=True, eq=False)
class MotionFilter:
    """Position and velocity in inertial axes about the body's centre, propagated by equation (6).

    Equation (6) is printed as ``mu / r^3 r``, which would repel: gravity is ``-mu / r^3 r``. ``time_s`` is the epoch of
    ``position_m`` (3,) and ``velocity_m_s`` (3,).
    """

    field: ForceModel
    time_s: float
    position_m: FloatArray
    velocity_m_s: FloatArray

    def predicted(self, time_s: float) -> MotionFilter:
        """Propagate to a later epoch."""
        # The force model measures time in T, so velocities in m per T.
        unit = self.field.time_s
        start = np.concatenate([self.position_m, self.velocity_m_s * unit])[None]
        end = propagate(self.field, start, self.field.known, np.array([(time_s - self.time_s) / unit]))[0]
        return replace(self, time_s=time_s, position_m=end[:3], velocity_m_s=end[3:] / unit)


class Propagator:
    """Motion filter coupled with an adjustment: predicts each displacement, and is corrected by the adjusted position.

    Raises LostError if the forces are unknown, or the unmodelled acceleration is zero, which would make the gain zero.
    """

    def __init__(self, sequence: TrackSequence, options: BundleOptions) -> None:
        self.sequence = sequence
        self.options = options
        self.filter: MotionFilter | None = None
        self.noise_m_s2 = 0.0
        self.adjusted_m = sequence.position_m
        self.R_body_inertial: FloatArray = np.eye(3)
        self.gain: SteadyGain | None = None

    def predict(self, frame: TrackFrame) -> TrackFrame:
        """Replace a frame's displacement and its covariance by the filter's prediction."""
        self.R_body_inertial = frame.R_body_inertial
        if self.filter is None:
            forces, position_m = self.sequence.forces, frame.R_body_inertial.T @ self.sequence.position_m
            if forces is None:
                raise LostError("the sequence tells no forces: motion: constant-gain needs knowledge.dynamics: true")
            noise = self.options.motion_noise_m_s2 or forces.noise_m_s2
            if not noise > 0.0:
                raise LostError("the unmodelled acceleration is zero, and so would be the gain: set motion_noise_m_s2")
            field = ForceModel.of(forces, float(np.linalg.norm(position_m)))
            self.noise_m_s2 = noise
            self.filter = MotionFilter(field, frame.time_s, position_m, forces.velocity_m_s.copy())
            return frame
        # "Considering the high cost of computing the camera position uncertainty" the gain is constant (section 3.2):
        # it depends on the interval alone, whatever the covariance of the adjustment.
        duration_s = frame.time_s - self.filter.time_s
        self.gain = steady_gain(duration_s, self.noise_m_s2, self.options.motion_position_sigma_m)
        self.filter = self.filter.predicted(frame.time_s)
        # From the adjusted position of the last frame, from which the map adds it, so that the new position starts at
        # the filter's.
        moved = frame.R_body_inertial @ self.filter.position_m - self.adjusted_m
        return replace(frame, motion_m=moved, motion_covariance_m2=np.eye(3) * self.gain.innovation_m2)

    def correct(self, position_m: FloatArray) -> FloatArray:
        """Correct with the adjusted position (3,), body axes; return the velocity (3,), inertial axes, m/s."""
        self.adjusted_m = position_m
        if self.filter is None:
            raise LostError("a position is corrected before it is predicted")
        # The first position and velocity are known: nothing to correct.
        if self.gain is not None:
            innovation = self.R_body_inertial.T @ position_m - self.filter.position_m
            self.filter = replace(
                self.filter,
                position_m=self.filter.position_m + self.gain.position * innovation,
                velocity_m_s=self.filter.velocity_m_s + self.gain.velocity_s * innovation,
            )
        return self.filter.velocity_m_s
