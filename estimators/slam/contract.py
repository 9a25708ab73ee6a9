"""The contract of estimators of sequences: tracks in, camera positions and a map out, one frame after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from scenarios.tracks import TrackSequence

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class FrameEstimate:
    """What is known right after a frame; nothing of later frames enters.

    Parameters
    ----------
    position_m
        (3,) camera position, body frame.
    covariance_m2
        (3, 3) of its error; None where the method has none.
    tracks, points_m
        (n,) and (n, 3): the landmarks that the method holds at this frame, body frame.
    seconds
        Time that this frame took.
    velocity_m_s
        (3,) velocity relative to the body's centre, inertial axes; None where the method has none.
    """

    position_m: FloatArray
    covariance_m2: FloatArray | None
    tracks: IndexArray
    points_m: FloatArray
    seconds: float
    velocity_m_s: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SequenceEstimate:
    """One entry for each frame up to the last good one; ``reason`` says why it stopped there, if it did."""

    status: Literal["ok", "failed"]
    frames: Sequence[FrameEstimate]
    reason: str = ""
    diagnostics: Mapping[str, float] = field(default_factory=dict)


class SequenceEstimator(Protocol):
    """Anything that follows a camera along a sequence of tracks. ``version`` is part of every result's key."""

    name: ClassVar[str]
    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one."""
        ...

    def follow(self, sequence: TrackSequence) -> SequenceEstimate:
        """Estimate the camera position at every frame from the frames up to it. Must not change its input."""
        ...
