"""EKF-SLAM of Delpech et al. (2015), section 3.3."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from estimators.options import parse_options
from estimators.slam.contract import FrameEstimate, SequenceEstimate
from estimators.slam.ekf_state import FilterState, Innovation, bearing_innovation, range_innovation, updated
from estimators.slam.following import LostError, check_scale, follow
from estimators.slam.options import FilterOptions
from scenarios.tracks import TrackFrame, TrackSequence

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class EkfSlam:
    """An extended Kalman filter of the camera position and of the landmarks in view, which are anchored."""

    name: ClassVar[str] = "ekf-slam"
    version: ClassVar[int] = 1

    def __init__(self, options: FilterOptions) -> None:
        self.options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one."""
        return cls(parse_options(FilterOptions, options, cls.name))

    def follow(self, sequence: TrackSequence) -> SequenceEstimate:
        """Estimate the camera position at every frame from the frames up to it."""
        return follow(sequence, _Filter(sequence, self.options))


class _Filter:
    """The filter at work on one sequence."""

    def __init__(self, sequence: TrackSequence, options: FilterOptions) -> None:
        self.options = options
        self.camera = sequence.camera
        self.state = FilterState(
            sequence.position_m.copy(),
            sequence.position_covariance_m2.copy(),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, 3, 3)),
        )
        self.started = False
        self.recent: deque[tuple[float, int]] = deque(maxlen=options.innovation_frames)
        self.total = 0.0
        self.measurements = 0

    def diagnostics(self) -> dict[str, float]:
        return {"innovation": self.total / self.measurements} if self.measurements else {}

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        if self.started:
            self.state = self.state.predicted(frame.motion_m, frame.motion_covariance_m2)
            self._drop_lost(frame)
            self._update(frame)
        self._take_new(frame)
        self.started = True
        position, covariance = self.state.position_m.copy(), self.state.covariance[:3, :3].copy()
        points = self.state.points(self.camera)
        check_scale(covariance, points, position, self.options.uncertainty_max)
        return FrameEstimate(position, covariance, self.state.tracks, points, 0.0)

    def _drop_lost(self, frame: TrackFrame) -> None:
        """Drop landmarks that are not seen any more."""
        lost = ~np.isin(self.state.tracks, frame.tracks)
        kept = int(np.count_nonzero(~lost))
        if kept < self.options.connectivity:
            raise LostError(f"tracks are lost: {kept} landmarks are left, {self.options.connectivity} are needed")
        self.state = self.state.without(lost)

    def _update(self, frame: TrackFrame) -> None:
        """Update by all landmarks of the state, and test the innovation."""
        rows, seen = _matched(self.state.tracks, frame.tracks)
        innovation = bearing_innovation(
            self.state, self.camera, frame.R_cam_body, rows, frame.uv_px[seen], frame.sigma_px
        )
        ranges = self._range_innovation(frame)
        innovation = innovation if ranges is None else innovation.joined(ranges)
        if not np.isfinite(innovation.residual).all():
            raise LostError("the filter diverges: a landmark is behind the camera that sees it")
        try:
            self.state, squared = updated(self.state, innovation)
        except np.linalg.LinAlgError as error:
            raise LostError("the filter diverges: the innovation has no positive definite covariance") from error
        self._test(squared, len(innovation.residual))

    def _range_innovation(self, frame: TrackFrame) -> Innovation | None:
        """Compare the ranges of this frame with landmarks that the state holds already."""
        rows, which = _matched(self.state.tracks, np.array([item.track for item in frame.ranges], dtype=np.int64))
        if len(rows) == 0:
            return None
        measured = np.array([[frame.ranges[i].range_m, frame.ranges[i].sigma_m] for i in which.tolist()])
        return range_innovation(self.state, self.camera, rows, measured[:, 0], measured[:, 1])

    def _test(self, squared: float, count: int) -> None:
        """Declare divergence where the squared normalised innovation stays far above its expectation of 1."""
        self.total += squared
        self.measurements += count
        self.recent.append((squared, count))
        mean = sum(item[0] for item in self.recent) / sum(item[1] for item in self.recent)
        full = len(self.recent) == self.recent.maxlen
        if full and mean > self.options.innovation_max:
            raise LostError(
                f"the filter diverges: the squared normalised innovation of {len(self.recent)} frames is {mean:.3g}"
            )
        if np.any(self.state.landmarks[:, 2] <= 0.0):
            raise LostError("the filter diverges: an inverse distance is not positive")

    def _take_new(self, frame: TrackFrame) -> None:
        """Take in tracks that the state does not hold: at their measured range, or at a guess."""
        fresh = ~np.isin(frame.tracks, self.state.tracks)
        if not fresh.any():
            return
        tracks = frame.tracks[fresh]
        guess = self._inverse_guess(frame)
        elements = np.column_stack([frame.uv_px[fresh], np.full(len(tracks), guess)])
        noise = np.tile(
            [frame.sigma_px**2, frame.sigma_px**2, (self.options.depth_sigma * guess) ** 2], (len(tracks), 1)
        )
        for item in frame.ranges:
            row = tracks == item.track
            elements[row, 2] = 1.0 / item.range_m
            noise[row, 2] = (item.sigma_m / item.range_m**2) ** 2
        self.state = self.state.joined(tracks, elements, noise, frame.R_cam_body)

    def _inverse_guess(self, frame: TrackFrame) -> float:
        """Guess the inverse distance of a new landmark: the mean of those in view, or of the first ranges."""
        if len(self.state.tracks):
            lines = self.state.points(self.camera) - self.state.position_m
            return float(np.mean(1.0 / np.linalg.norm(lines, axis=1)))
        if not frame.ranges:
            raise LostError("no range is measured at the first frame: the scale is unobservable")
        return float(np.mean([1.0 / item.range_m for item in frame.ranges]))


def _matched(held: IndexArray, seen: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Rows of ``held`` and of ``seen`` that are the same track."""
    _, rows, columns = np.intersect1d(held, seen, assume_unique=True, return_indices=True)
    return rows.astype(np.int64), columns.astype(np.int64)
