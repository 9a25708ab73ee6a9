"""Code shared by all sequence estimators: the loop over the frames, checks of input and result, divergence tests.

Dead reckoning, their control, is the sum of the predicted motions and is here too.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from boresight.estimators.options import Configured, Model
from boresight.estimators.slam.adjustment.slam_map import median_distance
from boresight.estimators.slam.contract import FrameEstimate, LostError, SequenceEstimate
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import LandmarkPredictor, Prediction, TrackFrame, TrackSequence
from boresight.scenarios.spec.base import SpecModel


class Follower(Protocol):
    """An estimator at work on one sequence."""

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        """Process the next frame; the caller fills in ``seconds``. Raises LostError."""
        ...

    def diagnostics(self) -> dict[str, float]:
        """Scalars about the whole sequence so far."""
        ...


@runtime_checkable
class PixelPredictor(Protocol):
    """A follower that predicts the pixels of its landmarks in the next frame, for guided matching."""

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Predict the pixels of the landmarks in ``frame``, whose tracks are not known yet."""
        ...


@dataclass(slots=True)
class FrameCheck:
    """Check of each frame against those before it; refuses frames that no estimator can use."""

    time_s: float = -np.inf
    gone: set[int] = field(default_factory=set)
    held: set[int] = field(default_factory=set)

    def check(self, frame: TrackFrame) -> None:
        """Raise LostError if the frame is empty, not finite or out of order, or holds a track twice or a lost one."""
        tracks = set(frame.tracks.tolist())
        if not np.isfinite(frame.time_s) or frame.time_s <= self.time_s:
            raise LostError(f"time {frame.time_s} s does not come after {self.time_s} s: frames must be in order")
        if not tracks:
            raise LostError("the frame is empty: no track is seen")
        if len(tracks) != len(frame.tracks):
            raise LostError("a track is seen twice in one frame")
        if not (np.isfinite(frame.uv_px).all() and np.isfinite(frame.motion_m).all()):
            raise LostError("a pixel or the predicted motion is not finite")
        if tracks & self.gone:
            raise LostError(f"track {min(tracks & self.gone)} was lost and returns under its number")
        self.time_s = frame.time_s
        # A number that returns could be another landmark: tracks are not used again once lost.
        self.gone |= self.held - tracks
        self.held = tracks


class ConfiguredEstimator(Configured[Model], ABC):
    """Base of the sequence estimators with options; a subclass makes a follower."""

    @abstractmethod
    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""

    def follow(self, sequence: TrackSequence) -> SequenceEstimate:
        """Estimate the camera position at every frame from the frames up to it."""
        return follow(sequence, self.follower(sequence))


class InnovationTest:
    """Divergence test: squared normalised innovation (NIS) per degree of freedom over the last frames; 1 is expected.

    The mean is taken over ``frames`` frames; a mean above ``limit`` is divergence. ``method`` and ``cause`` are words
    of the failure's reason: what diverges, and why it may.
    """

    def __init__(self, frames: int, limit: float, method: str, cause: str = "") -> None:
        self.limit, self.method, self.cause = limit, method, cause
        self.recent: deque[tuple[float, int]] = deque(maxlen=frames)
        self.total = 0.0
        self.measurements = 0

    def diagnostics(self) -> dict[str, float]:
        """Return the mean over all frames so far, and its degrees of freedom."""
        if not self.measurements:
            return {}
        return {"innovation": self.total / self.measurements, "innovation_degrees": float(self.measurements)}

    def add(self, squared: float, measurements: int) -> None:
        """Add a frame's squared innovation and its degrees of freedom; raise LostError on divergence."""
        self.total += squared
        self.measurements += measurements
        self.recent.append((squared, measurements))
        count = sum(item[1] for item in self.recent)
        # Not before all frames of the mean are there: few measurements scatter too much. A smoother's count of degrees
        # of freedom may be 0.
        if len(self.recent) < (self.recent.maxlen or 0) or count <= 0:
            return
        mean = sum(item[0] for item in self.recent) / count
        if mean > self.limit:
            raise LostError(
                f"the {self.method} diverges: the squared normalised innovation of {len(self.recent)} frames is"
                f" {mean:.3g}{self.cause}"
            )


def follow(sequence: TrackSequence, follower: Follower) -> SequenceEstimate:
    """Process all frames with ``follower``, up to the first LostError."""
    done: list[FrameEstimate] = []
    check = FrameCheck()
    reason = "" if sequence.frames else "the sequence has no frame"
    for number, frame in enumerate(frames_of(sequence, partial(next_pixels, follower))):
        start = time.perf_counter()
        try:
            check.check(frame)
            estimate = follower.advance(frame)
            _check_estimate(estimate)
        except LostError as error:
            reason = f"frame {number}: {error}"
            break
        done.append(replace(estimate, seconds=time.perf_counter() - start))
    return SequenceEstimate("failed" if reason else "ok", tuple(done), reason, follower.diagnostics())


def frames_of(sequence: TrackSequence, predict: LandmarkPredictor) -> Iterable[TrackFrame]:
    """Return the stored frames, or those that the sequence's vision layer makes with the predictions of ``predict``."""
    return sequence.frames if sequence.front_end is None else sequence.front_end.frames(predict)


def next_pixels(follower: Follower, frame: TrackFrame) -> Prediction | None:
    """Predict the pixels of a follower's landmarks in a frame; None if it cannot, and before the first frame."""
    return follower.predict(frame) if isinstance(follower, PixelPredictor) else None


def check_connected(shared: int, needed: int) -> None:
    """Raise LostError where a frame shares fewer than ``needed`` landmarks with the frame before."""
    if shared < needed:
        raise LostError(f"tracks are lost: {shared} landmarks are shared with the frame before, {needed} are needed")


def check_scale(covariance_m2: FloatArray, points_m: FloatArray, position_m: FloatArray, limit: float) -> None:
    """Raise LostError if the position's largest sigma exceeds ``limit`` times the median distance to the landmarks."""
    distance = median_distance(points_m, position_m)
    # An unknown scale is an uncertainty along one direction, whichever it is: the largest eigenvalue. The trace bounds
    # it from above, and nearly always decides.
    if covariance_m2[0, 0] + covariance_m2[1, 1] + covariance_m2[2, 2] < (limit * distance) ** 2:
        return
    sigma = float(np.sqrt(max(np.linalg.eigvalsh(covariance_m2)[-1], 0.0)))
    if sigma > limit * distance:
        raise LostError(
            f"the scale is no longer observable: the position is uncertain by {sigma:.3g} m"
            f" at {distance:.3g} m from the landmarks"
        )


def _check_estimate(estimate: FrameEstimate) -> None:
    finite = np.isfinite(estimate.position_m).all() and np.isfinite(estimate.points_m).all()
    if not finite:
        raise LostError("the estimate is not finite")


class DeadReckoningOptions(SpecModel):
    """Options of ``dead-reckoning``: none."""


class DeadReckoning(Configured[DeadReckoningOptions]):
    """The control of sequences: sums the predicted displacements and their covariances, without any track.

    Use it when
    -----------
    In every campaign of sequences, as the control: an estimator is useful only where its errors are below these.

    It fails when
    -------------
    It does not fail; its error grows with the distance travelled.

    Cost
    ----
    Less than 0.001 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "dead-reckoning"
    version: ClassVar[int] = 1
    options_model = DeadReckoningOptions

    def predict(self, sequence: TrackSequence, positions_m: FloatArray, points_m: FloatArray) -> FloatArray:
        """Add up the covariances of the predicted displacements; see `SequenceEstimator`."""
        del positions_m, points_m
        steps = [frame.motion_covariance_m2 for frame in sequence.frames]
        return np.asarray(sequence.position_covariance_m2 + np.sum(steps, axis=0))

    def follow(self, sequence: TrackSequence) -> SequenceEstimate:
        """Add up the predicted displacements."""
        position, covariance = sequence.position_m, sequence.position_covariance_m2
        nothing, no_points = np.empty(0, dtype=np.int64), np.empty((0, 3))
        frames = []
        for frame in frames_of(sequence, lambda _: None):
            started = time.perf_counter()
            position, covariance = position + frame.motion_m, covariance + frame.motion_covariance_m2
            seconds = time.perf_counter() - started
            frames.append(FrameEstimate(position, covariance, nothing, no_points, seconds))
        return SequenceEstimate("ok", tuple(frames))
