"""State of EKF-SLAM: camera position and anchored inverse-depth landmarks (section 3.3), with their joint covariance.

A landmark is a pixel, an inverse distance and the camera position of its first frame, the anchor, equation (8):
``l = [u, v, rho, T0]``. The 10 elements of equation (9), ``[u, v, rho, T]``, have the attitude of the anchor as well, a
quaternion with three degrees of freedom. With known attitudes it is a constant, and 6 elements are enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from boresight.estimators.slam.adjustment.track_errors import common_steps
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, cross_matrix
from boresight.scenarios.observation import TrackFrame

SIZE = 6


def common_count(frame: TrackFrame) -> int:
    """Return the number of elements of the errors common to all tracks: none if none are declared."""
    return 3 if frame.contraction or frame.drift_px else 0


def landmark_points(camera: Camera, landmarks: FloatArray, R_cam_body: FloatArray) -> FloatArray:
    """(n, 3) points in the body frame of landmarks (n, 6) with the attitudes (n, 3, 3) of their anchors, m."""
    # p = T0 + R_cam_body' m(u, v) / rho, with the unit direction m of the pixel; rho is the inverse of the distance,
    # not of the depth along the boresight.
    rays = np.einsum("kji,kj->ki", R_cam_body, camera.unproject(landmarks[:, :2]))
    return np.asarray(landmarks[:, 3:] + rays / landmarks[:, 2:3], dtype=np.float64)


def landmark_jacobians(camera: Camera, landmarks: FloatArray, R_cam_body: FloatArray) -> FloatArray:
    """(n, 3, 6) of `landmark_points` by the landmark's elements."""
    rays = camera.unproject(landmarks[:, :2])
    inverse = landmarks[:, 2][:, None, None]
    # n = ((u - cx) / fx, (v - cy) / fy, 1) and m = n / |n|: dm = (I - m m') dn / |n|, and 1 / |n| is the third
    # coordinate of m. The lens has no distortion.
    slopes = np.zeros((len(landmarks), 3, 2))
    slopes[:, 0, 0] = rays[:, 2] / camera.fx_px
    slopes[:, 1, 1] = rays[:, 2] / camera.fy_px
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    by_pixel = across @ slopes / inverse
    # d(1 / rho) = -d rho / rho^2.
    by_inverse = -rays[:, :, None] / inverse**2
    turned = np.swapaxes(R_cam_body, 1, 2) @ np.concatenate([by_pixel, by_inverse], axis=2)
    # A displacement of the anchor moves the point by as much.
    ones = np.broadcast_to(np.eye(3), (len(landmarks), 3, 3))
    return np.concatenate([turned, ones], axis=2)


def turn_jacobians(camera: Camera, landmarks: FloatArray, R_cam_body: FloatArray) -> FloatArray:
    """(n, 3, 3) of `landmark_points` by a small rotation of the anchor, R_cam_body = exp(rotation) R."""
    rays = camera.unproject(landmarks[:, :2])
    # R' exp(-[w]) m = R' (m + m x w) to first order: the derivative by w is R' [m].
    across = np.swapaxes(R_cam_body, 1, 2) @ cross_matrix(rays)
    return np.asarray(across / landmarks[:, 2][:, None, None], dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """Equation (7), ``x = [X_C, l_1, ..., l_N]``, with the position alone for the camera.

    The attitude is the measured one, and the motion between frames is an input with covariance instead of a
    propagation. `estimators.slam.filters.ekf_pose.PoseState` has the 13 camera elements of the paper. ``x`` (C + L n,)
    has C elements of the camera and L of each landmark, and ``covariance`` is that of their errors. ``tracks`` (n,) are
    those of the landmarks, in the order of the state, ``R_cam_body`` (n, 3, 3) the attitudes of their anchors.
    ``settled`` (n, 4) has the fixed inverse distance and anchor for the derivatives by a landmark (first-estimates
    Jacobians); NaN if they are taken at the present estimate.

    A landmark is the point that its track follows, which moves from frame to frame where errors of the track add up
    (`TrackFrame`) at random by ``walk_px``. Errors common to all tracks, if they are declared, are three elements after
    those of the camera, each over its standard deviation; ``moved`` (n, 2, 3) are the derivatives of the pixels of the
    landmarks by them, px.
    """

    x: FloatArray
    covariance: FloatArray
    tracks: IndexArray
    R_cam_body: FloatArray
    settled: FloatArray
    frame: TrackFrame
    moved: FloatArray

    CAMERA: ClassVar[int] = 3
    LANDMARK: ClassVar[int] = SIZE
    POSE: ClassVar[tuple[int, ...]] = (0, 1, 2)
    """Camera elements that are copied to the anchor of a new landmark."""

    @classmethod
    def of_camera(cls, position_m: FloatArray, covariance_m2: FloatArray, frame: TrackFrame) -> FilterState:
        """Return a state without landmarks."""
        return FilterState(*cls.without_landmarks(position_m, covariance_m2, frame))

    @staticmethod
    def without_landmarks(
        x: FloatArray, covariance: FloatArray, frame: TrackFrame
    ) -> tuple[FloatArray, FloatArray, IndexArray, FloatArray, FloatArray, TrackFrame, FloatArray]:
        """Return the fields of a state of a camera (C,) with its covariance (C, C), and of the common errors."""
        common, none = common_count(frame), np.zeros(0, dtype=np.int64)
        x, covariance = np.append(x, np.zeros(common)), block_diag(covariance, np.eye(common))
        return x, covariance, none, np.zeros((0, 3, 3)), np.zeros((0, 4)), frame, np.zeros((0, 2, 3))

    @property
    def head(self) -> int:
        """Number of elements before those of the landmarks."""
        return self.CAMERA + common_count(self.frame)

    @property
    def common(self) -> FloatArray:
        """(3,) common errors of the tracks; (0,) if none are declared."""
        return self.x[self.CAMERA : self.head]

    @property
    def position_m(self) -> FloatArray:
        """(3,) camera position."""
        return self.x[:3]

    @property
    def velocity_m_s(self) -> FloatArray | None:
        """(3,) velocity, inertial axes; None if it is not part of the state."""
        return None

    @property
    def attitude(self) -> FloatArray:
        """(3, 3) R_cam_body of the camera."""
        return self.frame.R_cam_body

    @property
    def anchor_attitudes(self) -> FloatArray:
        """(n, 3, 3) R_cam_body of the anchors."""
        return self.R_cam_body

    @property
    def landmarks(self) -> FloatArray:
        """(n, 6) elements of equation (8)."""
        return self.x[self.head :].reshape(-1, self.LANDMARK)[:, :SIZE]

    @property
    def linearisation_landmarks(self) -> FloatArray:
        """(n, 6) landmarks at which derivatives are taken."""
        landmarks = self.landmarks.copy()
        # The pixel is not fixed: only inverse distance and anchor change under a change of scale.
        landmarks[:, 2:] = np.where(np.isnan(self.settled), landmarks[:, 2:], self.settled)
        return landmarks

    @property
    def inverse_sigmas(self) -> FloatArray:
        """(n,) relative standard deviations of the inverse distances."""
        # rho is the third element of each landmark.
        variances = np.diag(self.covariance)[self.head + 2 :: self.LANDMARK]
        return np.asarray(np.sqrt(variances) / self.landmarks[:, 2], dtype=np.float64)

    def points(self, camera: Camera) -> FloatArray:
        """(n, 3) landmarks in the body frame, m."""
        return landmark_points(camera, self.landmarks, self.anchor_attitudes)

    def lines(self, camera: Camera) -> FloatArray:
        """(n, 3) landmarks for the derivatives minus camera position, body axes, m."""
        return landmark_points(camera, self.linearisation_landmarks, self.anchor_attitudes) - self.position_m

    def landmark_jacobians(self, camera: Camera) -> FloatArray:
        """(n, 3, L) of the points by the elements of their landmarks."""
        return landmark_jacobians(camera, self.linearisation_landmarks, self.anchor_attitudes)

    def camera_jacobians(self, by_line: FloatArray, lines: FloatArray) -> FloatArray:
        """(k, r, C) derivatives of measurements by the camera, given those (k, r, 3) by the ``lines`` (k, 3)."""
        del lines
        return -by_line

    def estimate(self, camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the position (3,), its covariance and the points (n, 3) in the axes of the body's known rotation."""
        return self.position_m.copy(), self.covariance[:3, :3].copy(), self.points(camera)

    def predicted(self, camera: Camera, frame: TrackFrame) -> FilterState:
        """Propagate the camera to the next frame by its predicted motion, and landmarks by the errors of tracks."""
        x, covariance = self.x.copy(), self.covariance.copy()
        # The transition matrix is the identity: the cross-covariances with the landmarks do not change.
        x[:3] += frame.motion_m
        covariance[:3, :3] += frame.motion_covariance_m2
        return replace(self, x=x, covariance=covariance, frame=frame).with_moved_landmarks(camera)

    def with_moved_landmarks(self, camera: Camera) -> Self:
        """Add the errors of the tracks since the previous frame: the walk to the covariance, and the common steps."""
        frame, covariance = self.frame, self.covariance
        if frame.walk_px:
            covariance = covariance.copy()
            first = self.head + self.LANDMARK * np.arange(len(self.tracks))
            for row in (first, first + 1):
                # The pixel of the anchor for that of this frame: they differ by the change of view alone.
                covariance[row, row] += frame.walk_px**2
        _, rows, seen = np.intersect1d(self.tracks, frame.tracks, assume_unique=True, return_indices=True)
        moved = self.moved.copy()
        moved[rows] += common_steps(camera, frame)[seen]
        return replace(self, covariance=covariance, moved=moved)

    def with_errors_reset(self) -> Self:
        """Apply the estimated errors in ``x`` to reference values outside of it, if there are any, and reset them."""
        return self

    def without(self, lost: NDArray[np.bool_]) -> Self:
        """Drop the landmarks marked in ``lost`` (n,), with their rows and columns."""
        # Dropping rows and columns of a covariance marginalises: what the landmark has contributed to the camera stays.
        rows = np.concatenate([np.ones(self.head, dtype=np.bool_), np.repeat(~lost, self.LANDMARK)])
        return replace(
            self,
            x=self.x[rows],
            covariance=self.covariance[np.ix_(rows, rows)],
            moved=self.moved[~lost],
            tracks=self.tracks[~lost],
            R_cam_body=self.R_cam_body[~lost],
            settled=self.settled[~lost],
        )

    def with_fixed_linearisation(self, sigma: float) -> Self:
        """Fix the linearisation of landmarks whose inverse distance has a relative error below ``sigma``."""
        # Once fixed, never changed: a second point of linearisation would make the scale seem observable.
        now = np.isnan(self.settled[:, 0]) & (self.inverse_sigmas < sigma)
        return replace(self, settled=np.where(now[:, None], self.landmarks[:, 2:], self.settled))

    def augmented(self, tracks: IndexArray, elements: FloatArray, noise: FloatArray) -> Self:
        """Add landmarks anchored at the present camera: equations (9) to (11).

        ``x_aug = [x, u, v, rho, T]``, with the covariance ``P_ll = dl/dx_c P_XX dl/dx_c' + R_l``. R_l has the variances
        R_y of the pixel and R_rho of the inverse distance, and zeros for the anchor. ``elements`` (m, 3) are pixel and
        inverse distance, ``noise`` (m, 3) the variances of their errors.
        """
        old, new, anchor = len(self.x), len(tracks), len(self.POSE)
        pose = self.x[list(self.POSE)]
        anchored = np.concatenate([elements, np.broadcast_to(pose, (new, anchor))], axis=1)  # eq. (9)
        # The new pixel and inverse distance do not depend on the state; the anchor is a copy of the camera's pose, and
        # so fully correlated with it until the next prediction.
        copy = np.zeros((self.LANDMARK, old))
        copy[np.arange(3, self.LANDMARK), self.POSE] = 1.0
        by_camera = np.tile(copy, (new, 1))
        cross = by_camera @ self.covariance
        own = cross @ by_camera.T  # eq. (10)
        own += np.diag(np.concatenate([noise, np.zeros((new, anchor))], axis=1).ravel())  # eq. (11)
        return replace(
            self,
            x=np.concatenate([self.x, anchored.ravel()]),
            covariance=np.block([[self.covariance, cross.T], [cross, own]]),
            tracks=np.concatenate([self.tracks, tracks]),
            R_cam_body=np.concatenate([self.R_cam_body, np.broadcast_to(self.attitude, (new, 3, 3))]),
            settled=np.concatenate([self.settled, np.full((new, 4), np.nan)]),
            moved=np.concatenate([self.moved, np.zeros((new, 2, 3))]),
        )
