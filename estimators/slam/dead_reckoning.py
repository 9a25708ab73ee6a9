"""Dead reckoning, the control of the sequence estimators: the sum of the predicted motions."""

from __future__ import annotations

import time
from typing import ClassVar

import numpy as np

from boresight.estimators.options import Configured
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate
from boresight.estimators.slam.following import frames_of
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.tracks import TrackSequence


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
