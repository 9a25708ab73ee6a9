"""State of EKF-SLAM: the camera position, then six elements for each landmark, and their joint covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.inverse_depth import SIZE, landmark_points
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
    settled
        (n, 4) inverse distance and anchor where derivatives by a landmark are taken for good (first-estimates
        Jacobians); NaN where they are taken at the present estimate.
    """

    x: FloatArray
    covariance: FloatArray
    tracks: IndexArray
    R_cam_body: FloatArray
    settled: FloatArray

    @classmethod
    def of_camera(cls, position_m: FloatArray, covariance_m2: FloatArray) -> FilterState:
        """Begin without a landmark."""
        none = np.zeros(0, dtype=np.int64)
        return cls(position_m.copy(), covariance_m2.copy(), none, np.zeros((0, 3, 3)), np.zeros((0, 4)))

    @property
    def position_m(self) -> FloatArray:
        """(3,) camera position."""
        return self.x[:3]

    @property
    def landmarks(self) -> FloatArray:
        """(n, 6) elements of equation (8)."""
        return self.x[3:].reshape(-1, SIZE)

    @property
    def linearisation_landmarks(self) -> FloatArray:
        """(n, 6) landmarks at which derivatives are taken."""
        landmarks = self.landmarks.copy()
        landmarks[:, 2:] = np.where(np.isnan(self.settled), landmarks[:, 2:], self.settled)
        return landmarks

    @property
    def inverse_sigmas(self) -> FloatArray:
        """(n,) standard deviations of the inverse distances, relative."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[5::SIZE]) / self.landmarks[:, 2], dtype=np.float64)

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
            self.x[rows],
            self.covariance[np.ix_(rows, rows)],
            self.tracks[~lost],
            self.R_cam_body[~lost],
            self.settled[~lost],
        )

    def settling(self, sigma: float) -> FilterState:
        """Keep the derivatives of landmarks whose inverse distance is known to ``sigma``, relative, as they are now."""
        now = np.isnan(self.settled[:, 0]) & (self.inverse_sigmas < sigma)
        return replace(self, settled=np.where(now[:, None], self.landmarks[:, 2:], self.settled))

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
            np.concatenate([self.settled, np.full((new, 4), np.nan)]),
        )
