"""Tracks of images: a trial of a sequence whose vision layer sees rendered images."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self, cast

import numpy as np

from boresight.campaign.handles import Handle, own_copy, target_of
from boresight.campaign.kinds.sequence.images import OrbitImages
from boresight.campaign.pool.steps import report_progress
from boresight.campaign.trial.kind import Record
from boresight.estimators.slam.vision.point_trackers import MatchedImage
from boresight.estimators.slam.vision.tracker import TrackedFrame, Tracker
from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.draw import Stream, estimator_generator, generator
from boresight.scenarios.sequences import (
    CameraTrajectory,
    FrameTracks,
    SequenceTruth,
    measured_ranges,
    onboard_sequence,
)
from boresight.scenarios.sequences.track_table import WRONG_PX
from boresight.scenarios.tracks import LandmarkPredictor, Prediction, TrackFrame, TrackRange, TrackSequence

_NOTHING = FrameTracks(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A trial of a sequence on images: truth, tracks, and what its vision layer was like, frame by frame."""

    truth: SequenceTruth
    sequence: TrackSequence
    vision: list[Record]
    seconds: dict[str, float]

    @property
    def path(self) -> CameraTrajectory:
        """Motion of camera and body."""
        return self.truth.trajectory

    def seen(self) -> Self:
        """Return itself: tracks of a vision layer that works by itself are complete."""
        return self


class GuidedFrontEnd(Handle):
    """A `VisionFrontEnd`: a handle of the `Watch` that makes its frames and knows the truth."""

    __slots__ = ()

    def frames(self, predict: LandmarkPredictor) -> Iterator[TrackFrame]:
        """Yield the frames in the order of time; those that were made before are the same again."""
        return _GuidedFrames(self, predict)


class _GuidedFrames:
    """Iterator over the frames of a front end, in place of a generator, whose variables could be read."""

    def __init__(self, front_end: GuidedFrontEnd, predict: LandmarkPredictor) -> None:
        self._front_end, self._predict = front_end, predict
        self._next = 0

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> TrackFrame:
        index, self._next = self._next, self._next + 1
        blind = _watch(self._front_end).unmade(index)
        prediction = None if blind is None else self._predict(blind)
        return own_copy(_watch(self._front_end).frame(index, prediction))


def _watch(front_end: GuidedFrontEnd) -> Watch:
    return cast("Watch", target_of(front_end))


class Watch:
    """A vision layer at work on the images of a trial.

    Trial t begins at start t modulo the number of starts, on exposures t // that number.
    """

    def __init__(self, images: OrbitImages, seed: int, trial: int) -> None:
        self._images = images
        self._realisation, start = divmod(trial, images.spec.starts)
        turn = len(images.views)
        first = start * turn // images.spec.starts
        self._slots = [(first + i) % turn for i in range(images.section.frames)]
        self._address = (seed, trial)
        self.path = images.path(start)
        blind = [_NOTHING] * len(self._slots)
        self._blind = onboard_sequence(images.section, images.camera, self.path, blind, self._address)
        self._rng = generator(seed, Stream.RANGES, trial)
        self._tracker = Tracker(images.camera, images.spec, estimator_generator(seed, trial))
        self._made: list[TrackFrame] = []
        self._tracked: list[TrackedFrame] = []
        self._points_m = np.empty((0, 3))
        self._seen: Seen | None = None

    def anew(self) -> Watch:
        """Return another vision layer on the same images, of which no frame is made yet."""
        return Watch(self._images, *self._address)

    @property
    def sequence(self) -> TrackSequence:
        """Frames without tracks, and a front end that makes them."""
        return replace(self._blind, front_end=GuidedFrontEnd(self))

    def unmade(self, index: int) -> TrackFrame | None:
        """Return a copy of a frame without its tracks if a prediction is needed to make it."""
        if index < max(len(self._made), 1) or index >= len(self._slots) or not self._images.spec.guided:
            return None
        return own_copy(self._blind.frames[index])

    def frame(self, index: int, prediction: Prediction | None) -> TrackFrame:
        """Return a frame; it is made when it is asked for first, after the one before.

        Raise `StopIteration` after the last.
        """
        if index >= len(self._slots):
            raise StopIteration
        if index == len(self._made):
            self._make(prediction)
        return self._made[index]

    def _make(self, prediction: Prediction | None) -> None:
        index, self._seen = len(self._made), None
        report_progress("frames of a trial", index, len(self._slots))
        slot, frame = self._slots[index], self._blind.frames[index]
        seen = self._tracker.advance(self._look(index), frame.R_cam_body, prediction)
        # Where the line of sight of a first sighting meets the body; its origin if it does not.
        fresh = self._images.points_m(slot, seen.uv_px[seen.tracks >= len(self._points_m)])
        self._points_m = np.concatenate([self._points_m, np.nan_to_num(fresh)])
        here = FrameTracks(seen.tracks, seen.uv_px, self._points_m[seen.tracks])
        knowledge = self._images.section.knowledge
        ranges: tuple[TrackRange, ...] = ()
        if index == 0 or (knowledge.range_every and index % knowledge.range_every == 0):
            ranges = measured_ranges([here], self.path.poses[index], self._images.camera, knowledge, self._rng)
        self._tracked.append(seen)
        self._made.append(replace(frame, tracks=seen.tracks, uv_px=seen.uv_px, ranges=ranges))

    def whole(self) -> Seen:
        """Let the vision layer track all images by itself."""
        for index in range(len(self._slots)):
            self.frame(index, None)
        return self.seen()

    def seen(self) -> Seen:
        """Return what was seen of the frames so far, collected once for the last of them."""
        if self._seen is not None:
            return self._seen
        slots, points = self._slots[: len(self._made)], self._points_m
        errors = [
            self._images.places_px(slot, points[seen.tracks]) - seen.uv_px
            for slot, seen in zip(slots, self._tracked, strict=True)
        ]
        wrong = tuple(~(np.linalg.norm(error, axis=1) <= WRONG_PX) for error in errors)
        truth = SequenceTruth(self.path.poses, points, wrong, self.path, self._images.section.gm_m3_s2)
        records = [self._record(i, errors[i], wrong[i]) for i in range(len(slots))]
        self._seen = Seen(truth, replace(self._blind, frames=tuple(self._made)), records, self._seconds())
        return self._seen

    def _look(self, index: int) -> MatchedImage:
        slot = self._slots[index]
        pairs = np.empty((0, 2), dtype=np.int64)
        if index:
            pairs = self._images.pairs(self._realisation, self._slots[index - 1], slot).rows
        return MatchedImage(
            self._images.image(self._realisation, slot), self._images.found(self._realisation, slot).features, pairs
        )

    def _record(self, index: int, error: FloatArray, wrong: BoolArray) -> Record:
        """Describe a frame's vision: the columns of the table ``vision`` without its key."""
        images, tracked, here = self._images, self._tracked[index], self._slots[index]
        found = images.found(self._realisation, here)
        record: Record = {
            "frame": index,
            "n_features": len(found.features),
            "n_tracks": len(tracked.tracks),
            "n_wrong": int(wrong.sum()),
            "error_px": float(np.sqrt(np.mean(error[~wrong] ** 2))) if error[~wrong].size else None,
            "sigma_px": images.spec.sigma_px,
            **dict.fromkeys(("repeatability", "n_matches", "n_kept", "right_share", "kept_right_share", "survival")),
        }
        if index == 0:
            return record
        before = self._slots[index - 1]
        pairs = images.pairs(self._realisation, before, here)
        return {
            **record,
            "repeatability": images.repeatability(self._realisation, before, here),
            "n_matches": len(pairs.rows),
            "n_kept": int(tracked.kept.sum()),
            "right_share": _share(pairs.right),
            "kept_right_share": _share(pairs.right[tracked.kept]),
            "survival": _share(np.isin(self._tracked[index - 1].tracks, tracked.tracks)),
        }

    def _seconds(self) -> dict[str, float]:
        """Mean time of an image; features and their matches are worked out once for all trials."""
        slots = self._slots[: len(self._made)]
        detection = [self._images.found(self._realisation, slot).seconds for slot in slots]
        matching = [self._images.pairs(self._realisation, *pair).seconds for pair in itertools.pairwise(slots)]
        return {
            "detection": float(np.mean(detection)),
            "matching": float(np.mean(matching)) if matching else 0.0,
            "tracking": float(np.mean([frame.seconds for frame in self._tracked])),
        }


def _share(flags: BoolArray) -> float | None:
    return float(flags.mean()) if len(flags) else None
