"""Contract of sequence estimators: tracks in, camera positions and landmarks out, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol, Self

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.observation import TrackSequence


class LostError(Exception):
    """The estimator fails at this frame; the message is the reason of the failed estimate."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameEstimate:
    """Estimate right after a frame, from that frame and the ones before it.

    ``position_m`` (3,) of the camera is in the body frame, with the covariance (3, 3) of its error, None where the
    method has none. ``tracks`` (n,) and ``points_m`` (n, 3) are the landmarks that the method holds at this frame, body
    frame. ``seconds`` is the computing time of this frame. ``velocity_m_s`` (3,) is relative to the body's centre, in
    inertial axes; None where the method has none.
    """

    position_m: FloatArray
    covariance_m2: FloatArray | None
    tracks: IndexArray
    points_m: FloatArray
    seconds: float
    velocity_m_s: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SequenceEstimate:
    """Estimates of all frames up to the last good one; ``reason`` gives the cause if the estimator stopped there."""

    status: Literal["ok", "failed"]
    frames: Sequence[FrameEstimate]
    reason: str = ""
    diagnostics: Mapping[str, float] = field(default_factory=dict)


class SequenceEstimator(Protocol):
    """Estimator of the camera positions along a sequence of tracks. ``version`` is part of every result's key.

    A method ``predict(sequence, positions_m, points_m) -> FloatArray | None`` is optional: the covariance (3, 3) of the
    last camera position, m^2, in the body frame, by the geometry of the tracks, without their measured pixels.
    ``positions_m`` (F, 3) are the planned camera positions, and ``points_m`` (T, 3) the landmark of each track number.
    """

    name: ClassVar[str]
    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one."""
        ...

    def follow(self, sequence: TrackSequence) -> SequenceEstimate:
        """Estimate the camera position at every frame from the frames up to it. Must not change its input."""
        ...
