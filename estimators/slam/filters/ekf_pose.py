"""State of EKF-SLAM with the camera's pose, and the star tracker, whose attitudes are measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.estimators.slam.filters.ekf_state import SIZE, FilterState, turn_jacobians
from boresight.estimators.slam.filters.ekf_update import Innovation, kalman_update
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, cross_matrix
from boresight.scenarios.observation import TrackFrame

_POSITION, _VELOCITY, _TURN, _RATE, _LASTING = (slice(3 * i, 3 * i + 3) for i in range(5))
_ANCHOR_TURN = slice(SIZE, SIZE + 3)

# Weak priors: the first interval determines both. No camera near an asteroid moves or turns faster.
_FIRST_VELOCITY_M_S = 10.0
_FIRST_RATE_RAD_S = 0.01
# Least sigma of an attitude, 1e-5 pixels, for exact ones: a variance of zero would be lost in rounding.
_LEAST_ATTITUDE_RAD = 1e-9

# Below it the series is exact to rounding (the next term is a^4 / 120), where the closed forms divide 0 by 0.
_SMALL_RAD = 1e-4


def rotation_of(turns_rad: FloatArray) -> FloatArray:
    """(..., 3, 3) rotation matrices of rotation vectors (..., 3).

    ``exp(t) = I + sin(a) / a [t] + (1 - cos a) / a^2 [t]^2`` with the angle ``a`` (Rodrigues).
    """
    sine, cosine, _ = _series(turns_rad)
    cross = cross_matrix(turns_rad)
    return np.asarray(np.eye(3) + sine * cross + cosine * (cross @ cross), dtype=np.float64)


def left_jacobian(turns_rad: FloatArray) -> FloatArray:
    """(..., 3, 3) J with ``exp(t + d) = exp(J d) exp(t)`` to first order, of rotation vectors (..., 3).

    ``J = I + (1 - cos a) / a^2 [t] + (a - sin a) / a^3 [t]^2``.
    """
    _, cosine, rest = _series(turns_rad)
    cross = cross_matrix(turns_rad)
    return np.asarray(np.eye(3) + cosine * cross + rest * (cross @ cross), dtype=np.float64)


def _series(turns_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(..., 1, 1) sin(a) / a, (1 - cos a) / a^2 and (a - sin a) / a^3; two terms of the series for small angles."""
    squares = (turns_rad**2).sum(axis=-1)[..., None, None]
    if squares.max(initial=0.0) < _SMALL_RAD**2:
        return 1.0 - squares / 6.0, 0.5 - squares / 24.0, 1.0 / 6.0 - squares / 120.0
    # The floor only keeps small angles, which take the series, from dividing by zero.
    angle = np.sqrt(np.maximum(squares, _SMALL_RAD**2))
    sine = np.sin(angle)
    large = squares >= _SMALL_RAD**2
    return (
        np.where(large, sine / angle, 1.0 - squares / 6.0),
        np.where(large, (1.0 - np.cos(angle)) / angle**2, 0.5 - squares / 24.0),
        np.where(large, (angle - sine) / angle**3, 1.0 / 6.0 - squares / 120.0),
    )


@dataclass(frozen=True, slots=True, eq=False)
class PoseState(FilterState):
    """Equation (7) with the 13 elements of section 3.3 for the camera, and the 10 of equation (9) for a landmark.

    The camera has its position (body axes), its velocity (inertial axes), its attitude, and its angular rate relative
    to inertial space (camera axes); a landmark has ``[u, v, rho, T]`` with the pose T of its anchor. Instead of the
    paper's quaternions, attitudes are rotation matrices outside ``x``; ``x`` has the three angles of each attitude
    error, applied on the left, which are zero except between an update and `with_errors_reset` (multiplicative filter).
    So the covariance has 12 rows for the camera and 9 for a landmark.

    Three more elements are the lasting error of the star tracker's attitude: its misalignment with the camera, which
    does not average out, and the error of the body's known rotation, which grows from the first frame on (a random walk
    of the same variance). Landmarks are fixed in the true body's axes, and only they make this error observable.

    ``R_camera`` (3, 3) is R_cam_body of the camera, ``turn_noise_rad`` the standard deviation, about each axis, of the
    rotation between two frames that the rate does not predict, and ``misalignment_rad`` that of the misalignment: the
    lasting error at the first frame, which defines the body axes.
    """

    R_camera: FloatArray
    turn_noise_rad: float
    misalignment_rad: float

    CAMERA: ClassVar[int] = 15
    LANDMARK: ClassVar[int] = 9
    POSE: ClassVar[tuple[int, ...]] = (0, 1, 2, 6, 7, 8)

    @classmethod
    def at_first(
        cls, position_m: FloatArray, covariance_m2: FloatArray, frame: TrackFrame, turn_noise_rad: float
    ) -> PoseState:
        """Return a state without landmarks, at the attitude of the star tracker."""
        # Measured R = exp(lasting + noise) true R, and true R = exp(turn) measured R at the start: turn = -(lasting +
        # noise), whence its variance and the negative correlation.
        lasting = frame.attitude_bias_sigma_rad**2 * np.eye(3)
        covariance = np.zeros((cls.CAMERA, cls.CAMERA))
        covariance[_POSITION, _POSITION] = covariance_m2
        covariance[_VELOCITY, _VELOCITY] = _FIRST_VELOCITY_M_S**2 * np.eye(3)
        covariance[_RATE, _RATE] = _FIRST_RATE_RAD_S**2 * np.eye(3)
        covariance[_TURN, _TURN] = lasting + _star_tracker_variance(frame) * np.eye(3)
        covariance[_LASTING, _LASTING] = lasting
        covariance[_TURN, _LASTING] = covariance[_LASTING, _TURN] = -lasting
        x = np.concatenate([position_m, np.zeros(cls.CAMERA - 3)])
        errors = turn_noise_rad, frame.attitude_bias_sigma_rad
        return cls(*cls.without_landmarks(x, covariance, frame), frame.R_cam_body, *errors)

    @property
    def velocity_m_s(self) -> FloatArray:
        """(3,) mean velocity since the previous frame, inertial axes."""
        return self.x[_VELOCITY]

    @property
    def attitude(self) -> FloatArray:
        """(3, 3) R_cam_body of the camera."""
        return np.asarray(rotation_of(self.x[_TURN]) @ self.R_camera, dtype=np.float64)

    @property
    def anchor_turns(self) -> FloatArray:
        """(n, 3) rotation vectors of the anchors' attitude errors."""
        return self.x[self.head :].reshape(-1, self.LANDMARK)[:, _ANCHOR_TURN]

    @property
    def anchor_attitudes(self) -> FloatArray:
        """(n, 3, 3) R_cam_body of the anchors."""
        return np.asarray(rotation_of(self.anchor_turns) @ self.R_cam_body, dtype=np.float64)

    def landmark_jacobians(self, camera: Camera) -> FloatArray:
        """(n, 3, 9) of the points by the elements of their landmarks."""
        by_turn = turn_jacobians(camera, self.linearisation_landmarks, self.anchor_attitudes)
        # The explicit base: a dataclass with slots is another class than the one that super() closes over.
        others = FilterState.landmark_jacobians(self, camera)
        return np.concatenate([others, by_turn @ left_jacobian(self.anchor_turns)], axis=2)

    def camera_jacobians(self, by_line: FloatArray, lines: FloatArray) -> FloatArray:
        """(k, r, 15) derivatives of measurements by the camera, given those (k, r, 3) by the ``lines`` (k, 3).

        A rotation of the camera has the effect of the opposite rotation of the lines of sight.
        """
        by_camera = np.zeros((*by_line.shape[:2], self.CAMERA))
        by_camera[:, :, _POSITION] = -by_line
        # In camera axes exp(w) R l = R l - [R l] w, and R' [R l] = [l] R'; w = J d for the error d of the rotation
        # vector.
        by_camera[:, :, _TURN] = -by_line @ cross_matrix(lines) @ self.attitude.T @ left_jacobian(self.x[_TURN])
        return by_camera

    def estimate(self, camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the position (3,), its covariance and the points (n, 3) in the axes of the body's known rotation.

        The estimated lasting error is split between the body's rotation and the misalignment by their variances.
        """
        position, covariance, points = FilterState.estimate(self, camera)
        grown = max(self.frame.attitude_bias_sigma_rad**2 - self.misalignment_rad**2, 0.0)
        if grown == 0.0:
            return position, covariance, points
        # Two independent errors of which the sum is estimated: the expected part of one is its share of the variance,
        # and grown (1 - share) remains uncertain.
        share = grown / self.frame.attitude_bias_sigma_rad**2
        to_body, lever = self.attitude.T, cross_matrix(position)
        # From true body axes to those of the onboard rotation model: minus the lasting error, as left perturbation in
        # body axes.
        turn = rotation_of(-share * to_body @ self.x[_LASTING])
        # exp(-w) p = p + [p] w to first order.
        J = np.zeros((3, self.CAMERA))
        J[:, _POSITION] = turn
        J[:, _LASTING] = share * turn @ lever @ to_body
        covariance = J @ self.covariance[: self.CAMERA, : self.CAMERA] @ J.T
        covariance += grown * (1.0 - share) * lever @ lever.T
        return turn @ position, covariance, np.asarray(points @ turn.T, dtype=np.float64)

    def predicted(self, camera: Camera, frame: TrackFrame) -> FilterState:
        """Propagate by a frame's displacement and by the angular rate, then update with the star tracker's attitude.

        The velocity is the displacement since the previous frame divided by the time, in inertial axes. The rate
        changes by an angular acceleration that is constant between two frames and independent between intervals.
        """
        moved = self.propagated(frame).with_moved_landmarks(camera)
        # The star tracker measures exp(lasting + noise) R_cam_body. Innovation as a rotation vector: log(measured R,
        # less the lasting error, times predicted R').
        found = rotation_of(-moved.x[_LASTING]) @ frame.R_cam_body @ moved.attitude.T
        turn = np.asarray(Rotation.from_matrix(found).as_rotvec(), dtype=np.float64)
        jacobian = np.zeros((3, len(moved.x)))
        # To first order for small angles; left perturbations add.
        jacobian[:, _TURN] = jacobian[:, _LASTING] = np.eye(3)
        return kalman_update(moved, Innovation(turn, jacobian, np.full(3, _star_tracker_variance(frame))))[0]

    def propagated(self, frame: TrackFrame) -> PoseState:
        """Propagate the camera state, keeping the cross-covariances with the landmarks."""
        F, noise = self._transition(frame)
        x, covariance = self.x.copy(), self.covariance.copy()
        x[_POSITION] += frame.motion_m
        dt = frame.time_s - self.frame.time_s
        # Each position by the rotation of its own epoch.
        x[_VELOCITY] = (frame.R_body_inertial.T @ x[_POSITION] - self.frame.R_body_inertial.T @ self.position_m) / dt
        # F is the identity for landmarks: only the rows and columns of the camera change, at a cost linear in their
        # number.
        C = slice(self.CAMERA)
        covariance[C] = F @ covariance[C]
        covariance[:, C] = covariance[:, C] @ F.T
        covariance[C, C] += noise
        # dR/dt = -[rate] R for R_cam_inertial, with the rate in camera axes.
        turned = rotation_of(-self.x[_RATE] * dt) @ self.R_camera
        # R_cam_body(new) = dR R_cam_body(old) R_body_inertial(old) R_inertial_body(new).
        about = self.frame.R_body_inertial @ frame.R_body_inertial.T
        R_camera = turned @ about
        return replace(self, x=x, covariance=covariance, frame=frame, R_camera=R_camera)

    def with_errors_reset(self) -> Self:
        """Apply the estimated attitude errors to the attitudes and reset them to zero."""
        # The camera first, then the anchors.
        turns = np.concatenate([self.x[None, _TURN], self.anchor_turns])
        rotations = rotation_of(turns) @ np.concatenate([self.R_camera[None], self.R_cam_body])
        first = np.concatenate([[_TURN.start], self.head + self.LANDMARK * np.arange(len(self.tracks)) + SIZE])
        rows = first[:, None] + np.arange(3)
        x, covariance = self.x.copy(), self.covariance.copy()
        x[rows] = 0.0
        # exp(t + d) R = exp(J d) exp(t) R: relative to the new reference the error is J d.
        J = left_jacobian(turns)
        covariance[rows] = J @ covariance[rows]
        # The columns, by a view of the transpose; the blocks on the diagonal get J on both sides.
        covariance.T[rows] = J @ covariance.T[rows]
        reset = replace(self, x=x, covariance=covariance)
        return replace(reset, R_camera=rotations[0], R_cam_body=rotations[1:])

    def _transition(self, frame: TrackFrame) -> tuple[FloatArray, FloatArray]:
        """(15, 15) transition matrix of the camera's errors from the previous frame, and process noise covariance."""
        dt = frame.time_s - self.frame.time_s
        turn = -self.x[_RATE] * dt
        moves, accelerates = np.zeros((self.CAMERA, 3)), np.zeros((self.CAMERA, 3))
        F = np.eye(self.CAMERA)
        # The velocity is not integrated: it is the difference of the two positions over the time, and gets its error
        # from theirs.
        F[_VELOCITY, _VELOCITY] = 0.0
        F[_VELOCITY, _POSITION] = (frame.R_body_inertial - self.frame.R_body_inertial).T / dt
        # exp(t') = exp(turn) exp(t) exp(-turn): the error is rotated with the camera.
        F[_TURN, _TURN] = rotation_of(turn)
        F[_TURN, _RATE] = -left_jacobian(turn) * dt
        # The same error of the displacement is in position and velocity.
        moves[_POSITION] = np.eye(3)
        moves[_VELOCITY] = frame.R_body_inertial.T / dt
        accelerates[_TURN] = -left_jacobian(turn)
        accelerates[_RATE] = 2.0 / dt * np.eye(3)  # angular acceleration a: rotation a dt^2 / 2, rate a dt
        noise = moves @ frame.motion_covariance_m2 @ moves.T
        noise += self.turn_noise_rad**2 * accelerates @ accelerates.T
        # Random walk of the body's rotation: independent increments add their variances.
        grown = max(frame.attitude_bias_sigma_rad**2 - self.frame.attitude_bias_sigma_rad**2, 0.0)
        noise[_LASTING, _LASTING] += grown * np.eye(3)
        return F, noise


def _star_tracker_variance(frame: TrackFrame) -> float:
    """Return the variance of the error that is independent from frame to frame, rad^2."""
    return max(frame.attitude_noise_rad, _LEAST_ATTITUDE_RAD) ** 2
