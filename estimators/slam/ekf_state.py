"""State of EKF-SLAM: the camera position, then six elements for each landmark, and their joint covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.inverse_depth import SIZE, landmark_jacobians, landmark_points
from scenarios.geometry import Camera

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """Equation (7), with the position alone for the camera.

    The 13 elements of the paper hold velocity, attitude and rate too: attitude is known here, and the motion between
    frames is handed in with its covariance instead of being propagated.

    Parameters
    ----------
    x, covariance
        (3 + 6 n,) and its covariance.
    tracks
        (n,) whose landmark each six elements are, in the order in which they came.
    R_cam_body
        (n, 3, 3) attitudes of the anchors.
    """

    x: FloatArray
    covariance: FloatArray
    tracks: IndexArray
    R_cam_body: FloatArray

    @property
    def position_m(self) -> FloatArray:
        """(3,) camera position."""
        return self.x[:3]

    @property
    def landmarks(self) -> FloatArray:
        """(n, 6) elements of equation (8)."""
        return self.x[3:].reshape(-1, SIZE)

    def points(self, camera: Camera) -> FloatArray:
        """(n, 3) landmarks in the body frame, m."""
        return landmark_points(camera, self.landmarks, self.R_cam_body)

    def predicted(self, motion_m: FloatArray, covariance_m2: FloatArray) -> FilterState:
        """Move the camera; landmarks stand still."""
        x, covariance = self.x.copy(), self.covariance.copy()
        x[:3] += motion_m
        covariance[:3, :3] += covariance_m2
        return replace(self, x=x, covariance=covariance)

    def without(self, lost: NDArray[np.bool_]) -> FilterState:
        """Drop the landmarks marked in (n,), with their rows and columns."""
        rows = np.concatenate([np.ones(3, dtype=np.bool_), np.repeat(~lost, SIZE)])
        return FilterState(
            self.x[rows], self.covariance[np.ix_(rows, rows)], self.tracks[~lost], self.R_cam_body[~lost]
        )

    def joined(
        self, tracks: IndexArray, elements: FloatArray, noise: FloatArray, R_cam_body: FloatArray
    ) -> FilterState:
        """Append landmarks anchored at the present camera: equations (9) to (11).

        Parameters
        ----------
        elements, noise
            (m, 3) pixel and inverse distance, and the variances of their errors.
        R_cam_body
            (3, 3) present attitude.
        """
        old = len(self.x)
        new = len(tracks)
        anchored = np.concatenate([elements, np.broadcast_to(self.position_m, (new, 3))], axis=1)
        by_camera = np.zeros((new * SIZE, old))
        by_camera[:, :3] = np.tile(np.concatenate([np.zeros((3, 3)), np.eye(3)]), (new, 1))
        cross = by_camera @ self.covariance
        own = cross @ by_camera.T  # eq. (10)
        own += np.diag(np.concatenate([noise, np.zeros((new, 3))], axis=1).ravel())  # eq. (11)
        return FilterState(
            np.concatenate([self.x, anchored.ravel()]),
            np.block([[self.covariance, cross.T], [cross, own]]),
            np.concatenate([self.tracks, tracks]),
            np.concatenate([self.R_cam_body, np.broadcast_to(R_cam_body, (new, 3, 3))]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """Measured less predicted (m,), its derivative by the state (m, n), and the variances (m,) of the measurements."""

    residual: FloatArray
    jacobian: FloatArray
    variance: FloatArray

    def joined(self, other: Innovation) -> Innovation:
        """Stack two sets of measurements."""
        return Innovation(
            np.concatenate([self.residual, other.residual]),
            np.concatenate([self.jacobian, other.jacobian]),
            np.concatenate([self.variance, other.variance]),
        )


def bearing_innovation(
    state: FilterState, camera: Camera, R_cam_body: FloatArray, rows: IndexArray, uv_px: FloatArray, sigma_px: float
) -> Innovation:
    """Compare the landmarks ``rows`` of the state with the pixels (k, 2) at which the present camera sees them."""
    lines = state.points(camera)[rows] - state.position_m
    in_camera = lines @ R_cam_body.T
    by_point = camera.jacobian(in_camera) @ R_cam_body
    residual = uv_px - camera.project(in_camera)
    return Innovation(residual.ravel(), _by_state(state, camera, rows, by_point), np.full(residual.size, sigma_px**2))


def range_innovation(
    state: FilterState, camera: Camera, rows: IndexArray, range_m: FloatArray, sigma_m: FloatArray
) -> Innovation:
    """Compare the distances (k,) of the landmarks ``rows`` from the present camera with those measured."""
    lines = state.points(camera)[rows] - state.position_m
    lengths = np.linalg.norm(lines, axis=1)
    by_point = (lines / lengths[:, None])[:, None, :]
    return Innovation(range_m - lengths, _by_state(state, camera, rows, by_point), sigma_m**2)


def updated(state: FilterState, innovation: Innovation) -> tuple[FilterState, float]:
    """Update by all measurements at once (Joseph's form); return the state and the squared normalised innovation.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance of the innovation is not positive definite.
    """
    H, P = innovation.jacobian, state.covariance
    PHt = P @ H.T
    S = H @ PHt + np.diag(innovation.variance)
    factor = np.linalg.cholesky(0.5 * (S + S.T))
    whitened = np.linalg.solve(factor, np.column_stack([innovation.residual, PHt.T]))
    gain = np.linalg.solve(factor.T, whitened[:, 1:]).T
    x = state.x + gain @ innovation.residual
    left = np.eye(len(x)) - gain @ H
    covariance = left @ P @ left.T + (gain * innovation.variance) @ gain.T
    return replace(state, x=x, covariance=0.5 * (covariance + covariance.T)), float(whitened[:, 0] @ whitened[:, 0])


def _by_state(state: FilterState, camera: Camera, rows: IndexArray, by_point: FloatArray) -> FloatArray:
    """(k r, n) derivative by the whole state of measurements whose derivative by the landmark's point is (k, r, 3)."""
    count, height = by_point.shape[:2]
    by_landmark = by_point @ landmark_jacobians(camera, state.landmarks[rows], state.R_cam_body[rows])
    jacobian = np.zeros((count, height, len(state.x)))
    jacobian[:, :, :3] = -by_point
    columns = 3 + SIZE * rows[:, None] + np.arange(SIZE)
    jacobian[np.arange(count)[:, None], :, columns] = np.swapaxes(by_landmark, 1, 2)
    return jacobian.reshape(count * height, -1)
