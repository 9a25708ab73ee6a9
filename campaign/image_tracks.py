"""Tracks of images: a trial of a sequence whose vision layer sees rendered images."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from campaign.experiments.registry import Record
from campaign.orbit_images import WRONG_PX, OrbitImages
from estimators.slam.vision.carriers import Look
from estimators.slam.vision.tracker import Tracked, Tracker
from scenarios.draw import Stream, generator
from scenarios.geometry import Pose
from scenarios.sequences import (
    Ground,
    Path,
    SequenceTruth,
    Sighting,
    known_sequence,
    measured_ranges,
    travel,
)
from scenarios.sequences.orbit import anomalies_deg
from scenarios.spec.sequence import SequenceSpec
from scenarios.tracks import TrackFrame, TrackRange, TrackSequence

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


_NOTHING = Sighting(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A trial of a sequence on images: truth, tracks, and what its vision layer was like, frame by frame."""

    truth: SequenceTruth
    sequence: TrackSequence
    vision: list[Record]
    seconds: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class ImageTracks:
    """Draws trials: trial t begins at start t modulo the number of starts, on exposures t // that number."""

    spec: SequenceSpec
    ground: Ground
    images: OrbitImages

    def see(self, seed: int, trial: int) -> Seen:
        """Let the vision layer track the images of a trial."""
        realisation, start = divmod(trial, self.images.spec.starts)
        turn = len(self.images.views)
        slots = [(start * turn // self.images.spec.starts + i) % turn for i in range(self.spec.orbit.frames)]
        path = self._path(start)
        rng = generator(seed, Stream.RANGES, trial)
        tracker = Tracker(self.images.camera, self.images.spec, generator(seed, Stream.ESTIMATOR, trial))
        blind = known_sequence(self.spec, self.images.camera, path, [_NOTHING] * len(slots), (seed, trial))
        tracked: list[Tracked] = []
        frames: list[TrackFrame] = []
        points = np.empty((0, 3))
        for i, (slot, frame) in enumerate(zip(slots, blind.frames, strict=True)):
            seen = tracker.advance(self._look(realisation, slots, i), frame.R_cam_body)
            # Where the line of sight of a first sighting meets the body; its origin if it does not.
            fresh = self.images.points_m(slot, seen.uv_px[seen.tracks >= len(points)])
            points = np.concatenate([points, np.nan_to_num(fresh)])
            ranges = self._ranges(i, Sighting(seen.tracks, seen.uv_px, points[seen.tracks]), path.poses[i], rng)
            tracked.append(seen)
            frames.append(replace(frame, tracks=seen.tracks, uv_px=seen.uv_px, ranges=ranges))
        errors = [
            self.images.places_px(slot, points[seen.tracks]) - seen.uv_px
            for slot, seen in zip(slots, tracked, strict=True)
        ]
        wrong = tuple(~(np.linalg.norm(error, axis=1) <= WRONG_PX) for error in errors)
        truth = SequenceTruth(path.poses, anomalies_deg(self.spec.orbit), points, wrong, path, self.spec.orbit.gm_m3_s2)
        return Seen(
            truth,
            replace(blind, frames=tuple(frames)),
            [self._record(realisation, slots, i, tracked[i], errors[i], wrong[i]) for i in range(len(slots))],
            self._seconds(realisation, slots, tracked),
        )

    def _path(self, start: int) -> Path:
        orbit = self.spec.orbit
        turned = orbit.model_copy(update={"start_deg": orbit.start_deg + 360.0 * start / self.images.spec.starts})
        still = np.zeros((orbit.frames - 1, 3))
        return travel(self.spec.model_copy(update={"orbit": turned}), self.ground, still)

    def _ranges(self, index: int, here: Sighting, pose: Pose, rng: np.random.Generator) -> tuple[TrackRange, ...]:
        knowledge = self.spec.knowledge
        if index and (not knowledge.range_every or index % knowledge.range_every):
            return ()
        return measured_ranges([here], pose, self.images.camera, knowledge, rng)

    def _look(self, realisation: int, slots: Sequence[int], index: int) -> Look:
        slot = slots[index]
        pairs = self.images.pairs(realisation, slots[index - 1], slot).rows if index else np.empty((0, 2), np.int64)
        return Look(self.images.image(realisation, slot), self.images.found(realisation, slot).features, pairs)

    def _record(
        self, realisation: int, slots: Sequence[int], index: int, tracked: Tracked, error: FloatArray, wrong: BoolArray
    ) -> Record:
        """Describe a frame's vision: the columns of the table ``vision`` without its key."""
        found = self.images.found(realisation, slots[index])
        record: Record = {
            "frame": index,
            "n_features": len(found.features),
            "n_tracks": len(tracked.tracks),
            "n_wrong": int(wrong.sum()),
            "error_px": _root_mean(error[~wrong]),
            "sigma_px": self.images.spec.sigma_px,
            **dict.fromkeys(("repeatability", "n_matches", "n_kept", "right_share", "kept_right_share")),
        }
        if index == 0:
            return record
        pairs = self.images.pairs(realisation, slots[index - 1], slots[index])
        return {
            **record,
            "repeatability": self.images.repeatability(realisation, slots[index - 1], slots[index]),
            "n_matches": len(pairs.rows),
            "n_kept": int(tracked.kept.sum()),
            "right_share": _share(pairs.right),
            "kept_right_share": _share(pairs.right[tracked.kept]),
        }

    def _seconds(self, realisation: int, slots: Sequence[int], tracked: Sequence[Tracked]) -> dict[str, float]:
        """Mean time of an image; features and their matches are worked out once for all trials."""
        detection = [self.images.found(realisation, slot).seconds for slot in slots]
        matching = [self.images.pairs(realisation, *pair).seconds for pair in itertools.pairwise(slots)]
        return {
            "detection": float(np.mean(detection)),
            "matching": float(np.mean(matching)),
            "tracking": float(np.mean([frame.seconds for frame in tracked])),
        }


def _root_mean(errors_px: FloatArray) -> float | None:
    """RMS of a coordinate."""
    return float(np.sqrt(np.mean(errors_px**2))) if errors_px.size else None


def _share(flags: BoolArray) -> float | None:
    return float(flags.mean()) if len(flags) else None
