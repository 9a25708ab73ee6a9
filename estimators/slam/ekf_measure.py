"""What EKF-SLAM compares with its state: pixels and distances of landmarks, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.ekf_state import FilterState
from scenarios.geometry import Camera
from scenarios.tracks import TrackFrame

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """Measured less predicted (m,), its derivative by the state (m, n), and the variances (m,) of the measurements."""

    residual: FloatArray
    jacobian: FloatArray
    variance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What a frame tells of the landmarks of a state.

    Parameters
    ----------
    rows, uv_px, sigma_px
        (k,) landmarks by their place in the state, (k, 2) where they are seen, and the standard deviation.
    range_rows, range_m, range_sigma_m
        (r,) landmarks whose distances are measured, those distances, and their standard deviations.
    """

    camera: Camera
    rows: IndexArray
    uv_px: FloatArray
    sigma_px: float
    range_rows: IndexArray
    range_m: FloatArray
    range_sigma_m: FloatArray

    @classmethod
    def of(cls, camera: Camera, state: FilterState, frame: TrackFrame) -> Sight:
        """Match the tracks of a frame with the landmarks of the state."""
        rows, seen = _matched(state.tracks, frame.tracks)
        ranged, which = _matched(state.tracks, np.array([item.track for item in frame.ranges], dtype=np.int64))
        ranges = [frame.ranges[i] for i in which.tolist()]
        return cls(
            camera,
            rows,
            frame.uv_px[seen],
            frame.sigma_px,
            ranged,
            np.array([item.range_m for item in ranges], dtype=np.float64),
            np.array([item.sigma_m for item in ranges], dtype=np.float64),
        )

    def only(self, kept: BoolArray) -> Sight:
        """Leave out the pixels, and the distances, of the landmarks that (k,) does not mark."""
        near = np.isin(self.range_rows, self.rows[kept])
        return replace(
            self,
            rows=self.rows[kept],
            uv_px=self.uv_px[kept],
            range_rows=self.range_rows[near],
            range_m=self.range_m[near],
            range_sigma_m=self.range_sigma_m[near],
        )

    @property
    def variance(self) -> FloatArray:
        """(2 k + r,) of the measurements."""
        return np.concatenate([np.full(self.uv_px.size, self.sigma_px**2), self.range_sigma_m**2])

    def residual(self, state: FilterState) -> FloatArray:
        """(2 k + r,) measured less predicted; NaN where a landmark is behind the camera."""
        lines = state.points(self.camera) - state.position_m
        pixels = self.uv_px - self.camera.project(lines[self.rows] @ state.attitude.T)
        lengths = np.linalg.norm(lines[self.range_rows], axis=1)
        return np.concatenate([pixels.ravel(), self.range_m - lengths])

    def innovation(self, state: FilterState) -> Innovation:
        """Compare with the state; derivatives are taken where it says.

        That of a bearing does not change where camera, anchors and distances grow together about any point, as long as
        it is taken at one and the same inverse distance and anchor of each landmark: nothing is learnt of the scale.
        """
        lines = state.lines(self.camera)
        seen, ranged = lines[self.rows], lines[self.range_rows]
        by_line = self.camera.jacobian(seen @ state.attitude.T) @ state.attitude
        by_range = (ranged / np.linalg.norm(ranged, axis=1)[:, None])[:, None, :]
        by_landmark = state.landmark_jacobians(self.camera)
        pixels = _by_state(state.camera_jacobians(by_line, seen), by_line, by_landmark, self.rows)
        ranges = _by_state(state.camera_jacobians(by_range, ranged), by_range, by_landmark, self.range_rows)
        return Innovation(self.residual(state), np.concatenate([pixels, ranges]), self.variance)

    def second_order(self, state: FilterState) -> FloatArray:
        """(2 k, 2 k) what an innovation's covariance lacks where both a distance and the camera are uncertain.

        A pixel goes with the inverse distance times the camera's way, and the error of a product is what its
        derivatives say and the product of both errors, which is independent from landmark to landmark.
        """
        points = state.points(self.camera)[self.rows] - state.position_m
        by_camera = self.camera.jacobian(points @ state.attitude.T) @ state.attitude
        own = by_camera @ state.covariance[:3, :3] @ np.swapaxes(by_camera, 1, 2)
        own *= (state.inverse_sigmas[self.rows] ** 2)[:, None, None]
        k = np.arange(len(own))
        wide = np.zeros((len(own), 2, len(own), 2))
        wide[k, :, k] = own
        return wide.reshape(2 * len(own), 2 * len(own))


def _by_state(by_camera: FloatArray, by_line: FloatArray, by_landmark: FloatArray, rows: IndexArray) -> FloatArray:
    """(k r, C + L n) derivative by the whole state of measurements of the landmarks (k,) that ``rows`` tells.

    They have the derivatives (k, r, C) by the camera and (k, r, 3) by the line, and points (n, 3, L) by the landmarks.
    """
    count, height, first = by_camera.shape
    size = by_landmark.shape[2]
    jacobian = np.zeros((count, height, first + size * len(by_landmark)))
    jacobian[:, :, :first] = by_camera
    columns = first + size * rows[:, None] + np.arange(size)
    jacobian[np.arange(count)[:, None], :, columns] = np.swapaxes(by_line @ by_landmark[rows], 1, 2)
    return jacobian.reshape(count * height, jacobian.shape[2])


def _matched(held: IndexArray, seen: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Rows of ``held`` and of ``seen`` that are the same track."""
    _, rows, columns = np.intersect1d(held, seen, assume_unique=True, return_indices=True)
    return rows.astype(np.int64), columns.astype(np.int64)
