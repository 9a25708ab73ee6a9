"""What all estimators of sequences share: frame after frame, checked input, and an end with a reason."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from estimators.slam.contract import FrameEstimate, SequenceEstimate
from scenarios.tracks import LandmarkPredictor, Prediction, TrackFrame, TrackSequence

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class LostError(Exception):
    """The sequence cannot be followed beyond this frame; the message says why."""


class Follower(Protocol):
    """An estimator at work on one sequence."""

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        """Take the next frame in; its ``seconds`` are filled in by the caller. Raises LostError."""
        ...

    def diagnostics(self) -> dict[str, float]:
        """Scalars about the whole sequence so far."""
        ...


@runtime_checkable
class Foresight(Protocol):
    """A follower that can tell where its landmarks will be."""

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Tell where the landmarks of the frame before will be in the next one, whose tracks are not known yet."""
        ...


@dataclass(slots=True)
class FrameCheck:
    """Refuses frames that no estimator can use."""

    time_s: float = -np.inf
    gone: set[int] = field(default_factory=set)
    held: set[int] = field(default_factory=set)

    def check(self, frame: TrackFrame) -> None:
        """Raise LostError where the frame is empty, not finite, out of order, or holds a track twice or again."""
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
        self.gone |= self.held - tracks
        self.held = tracks


def follow(sequence: TrackSequence, follower: Follower) -> SequenceEstimate:
    """Feed the frames to ``follower`` until the end or until it is lost."""
    done: list[FrameEstimate] = []
    check = FrameCheck()
    reason = "" if sequence.frames else "the sequence has no frame"
    for number, frame in enumerate(frames_of(sequence, partial(foreseen, follower))):
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
    """Return the frames as they are, or as the sequence's eye makes them."""
    return sequence.frames if sequence.front_end is None else sequence.front_end.frames(predict)


def foreseen(follower: Follower, frame: TrackFrame) -> Prediction | None:
    """Ask a follower where its landmarks will be in a frame; None from one that cannot tell, and before the start."""
    return follower.predict(frame) if isinstance(follower, Foresight) else None


def check_scale(covariance_m2: FloatArray, points_m: FloatArray, position_m: FloatArray, limit: float) -> None:
    """Raise LostError where the position is uncertain by more than ``limit`` of the distance to the landmarks."""
    sigma = float(np.sqrt(max(np.linalg.eigvalsh(covariance_m2)[-1], 0.0)))
    distance = median_distance(points_m, position_m)
    if sigma > limit * distance:
        raise LostError(
            f"the scale is no longer observable: the position is uncertain by {sigma:.3g} m"
            f" at {distance:.3g} m from the landmarks"
        )


def median_distance(points_m: FloatArray, position_m: FloatArray) -> float:
    """Return the median distance (m) of points (n, 3) from a position."""
    squares = np.sort(((points_m - position_m) ** 2).sum(axis=1))
    return float(np.sqrt(squares[(len(squares) - 1) // 2 : len(squares) // 2 + 1]).mean())


def lookup(keys: Sequence[int] | IndexArray, wanted: IndexArray) -> IndexArray:
    """(n,) where each of ``wanted`` stands in the sorted ``keys``; -1 where it does not."""
    table = np.asarray(keys, dtype=np.int64)
    if len(table) == 0:
        return np.full(len(wanted), -1, dtype=np.int64)
    place = np.searchsorted(table, wanted)
    found = table[np.minimum(place, len(table) - 1)] == wanted
    return np.where(found, place, -1).astype(np.int64)


def _check_estimate(estimate: FrameEstimate) -> None:
    finite = np.isfinite(estimate.position_m).all() and np.isfinite(estimate.points_m).all()
    if not finite:
        raise LostError("the estimate is not finite")
