"""Images of a revolution or a trajectory, what is found in them, and the vision layer of a trial that tracks it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Self, cast

import numpy as np
from scipy.spatial import cKDTree

from boresight.campaign.handles import Handle, own_copy, target_of
from boresight.campaign.imaging.image_store import Imager
from boresight.campaign.pool.steps import report_progress
from boresight.campaign.trial.kind import Record
from boresight.estimators.slam.vision.matching import ImageFeatures, find_features, match_descriptors
from boresight.estimators.slam.vision.point_trackers import MatchedImage
from boresight.estimators.slam.vision.tracker import TrackedFrame, Tracker
from boresight.renderers.rectify import rectify
from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray
from boresight.scenarios.bodies import load_body
from boresight.scenarios.draw import Stream, estimator_generator, generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import LandmarkPredictor, Prediction, TrackFrame, TrackRange, TrackSequence
from boresight.scenarios.sequences import (
    CameraTrajectory,
    FrameTracks,
    MeshGround,
    SequenceTruth,
    camera_trajectory,
    measured_ranges,
    nominal_trajectory,
    onboard_sequence,
)
from boresight.scenarios.sequences.track_table import WRONG_PX
from boresight.scenarios.spec.sequence import SequenceSpec
from boresight.scenarios.spec.vision import ImageVisionSpec

REPEATED_PX = 2.0
_SAME_POINT = 1e-3  # of the distance: a point that the next camera sees too is met within this
_NOTHING = FrameTracks(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Features of an image, their true surface points (M, 3) (NaN off the body), and the computing time."""

    features: ImageFeatures
    points_m: FloatArray
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Matches of two images: (K, 2) rows of their features, (K,) which are right in truth, and the time it took."""

    rows: IndexArray
    right: BoolArray
    seconds: float


@dataclass(slots=True, eq=False)
class OrbitImages:
    """Images every step of one revolution about a body at rest, the Sun along the orbit's normal, or of a trajectory.

    The exposures of one realisation at a time are held, with their features. ``views`` are those of the images by their
    slot, with the camera's lens; images are resampled to the pinhole ``camera``. ``seed`` is that of the detector's
    noise. ``spec`` is the vision layer of the ``section`` of the scenario, with one start on a trajectory.
    """

    section: SequenceSpec
    ground: MeshGround
    spec: ImageVisionSpec
    views: tuple[View, ...]
    camera: Camera
    imager: Imager
    seed: int
    _realisation: int = -1
    _images: dict[int, Image] = field(default_factory=dict)
    _found: dict[int, Found] = field(default_factory=dict)
    _pairs: dict[tuple[int, int], Pairs] = field(default_factory=dict)
    _repeated: dict[tuple[int, int], float] = field(default_factory=dict)

    @classmethod
    def open(cls, scenario: LoadedScenario, variant: str, seed: int) -> OrbitImages:
        """Build the body and its renderer; images are made when they are asked for."""
        spec, section = scenario.spec, scenario.spec.sequence
        if section is None or section.images is None:
            raise BoresightError(f"{scenario.path}: sequence.images: missing, so there is no image to render")
        ground, camera = MeshGround(load_body(spec.body, scenario.search_dirs).mesh), spec.camera.camera()
        if section.trajectory is not None:
            path = nominal_trajectory(section, ground)
            imager = Imager.open(scenario, variant, Stream.TRUTH, section.trajectory)
            alike = section.images.model_copy(update={"starts": 1})  # every trial begins at the first state
            return cls(section, ground, alike, path.views(camera), camera.pinhole, imager, seed)
        circle = section.orbit.model_copy(update={"revolutions": 1.0})
        path = camera_trajectory(section.model_copy(update={"orbit": circle}), ground, np.zeros((circle.frames - 1, 3)))
        imager = Imager.open(scenario, variant, Stream.TRUTH, circle)
        return cls(section, ground, section.images, path.views(camera)[:-1], camera.pinhole, imager, seed)

    def path(self, start: int) -> CameraTrajectory:
        """Return the way of the camera from a start."""
        if self.section.trajectory is not None:
            return nominal_trajectory(self.section, self.ground)
        orbit = self.section.orbit
        turned = orbit.model_copy(update={"start_deg": orbit.start_deg + 360.0 * start / self.spec.starts})
        still = np.zeros((orbit.frames - 1, 3))
        return camera_trajectory(self.section.model_copy(update={"orbit": turned}), self.ground, still)

    def image(self, realisation: int, slot: int) -> Image:
        """(H, W) exposure of a slot, resampled to the pinhole."""
        self._turn_to(realisation)
        if slot not in self._images:
            view = self.views[slot]
            noise = generator(self.seed, Stream.DETECTOR, realisation * len(self.views) + slot)
            exposed, _ = self.imager.image(view, 0, slot, noise)
            self._images[slot] = rectify(exposed, view.camera)
        return self._images[slot]

    def found(self, realisation: int, slot: int) -> Found:
        """Find the features of a slot."""
        self._turn_to(realisation)
        if slot not in self._found:
            image = self.image(realisation, slot)
            started = time.perf_counter()
            features = find_features(image, self.spec.detector, self.spec.features)
            seconds = time.perf_counter() - started
            self._found[slot] = Found(features, self.points_m(slot, features.uv_px), seconds)
        return self._found[slot]

    def pairs(self, realisation: int, before: int, after: int) -> Pairs:
        """Match the features of two slots by their descriptors."""
        first, second = self.found(realisation, before), self.found(realisation, after)
        if (before, after) not in self._pairs:
            started = time.perf_counter()
            rows = match_descriptors(first.features, second.features, self.spec.ratio_max)
            seconds = time.perf_counter() - started
            places = self.places_px(after, first.points_m[rows[:, 0]])
            right = np.linalg.norm(places - second.features.uv_px[rows[:, 1]], axis=1) <= WRONG_PX
            self._pairs[before, after] = Pairs(rows, right, seconds)
        return self._pairs[before, after]

    def points_m(self, slot: int, uv_px: FloatArray) -> FloatArray:
        """(n, 3) true surface points at pixels of the pinhole; NaN off the body."""
        view = self.views[slot]
        return self.imager.renderer.surface(view, view.camera.distorted(uv_px)).points_body_m

    def places_px(self, slot: int, points_m: FloatArray) -> FloatArray:
        """(n, 2) where the pinhole of a slot has points."""
        return self.camera.project(self.views[slot].T_cam_body.transform(points_m))

    def repeatability(self, realisation: int, before: int, after: int) -> float:
        """Share of the features of a slot, of those in sight from another, that are found there within 2 px."""
        first, second = self.found(realisation, before), self.found(realisation, after)
        if (before, after) not in self._repeated:
            places, share = self.places_px(after, first.points_m), 0.0
            seen = self._in_sight(after, first.points_m, places)
            if seen.any() and len(second.features):
                apart, _ = cKDTree(second.features.uv_px).query(places[seen])
                share = float(np.mean(apart <= REPEATED_PX))
            self._repeated[before, after] = share
        return self._repeated[before, after]

    def flush(self) -> None:
        """Keep what was rendered."""
        self.imager.flush()

    def _in_sight(self, slot: int, points_m: FloatArray, places_px: FloatArray) -> BoolArray:
        seen = self.camera.contains(places_px) & np.isfinite(points_m).all(axis=1)
        met = self.points_m(slot, places_px[seen])
        distance = np.linalg.norm(points_m[seen] - self.views[slot].T_cam_body.camera_position_m, axis=1)
        seen[seen] = np.linalg.norm(met - points_m[seen], axis=1) < _SAME_POINT * distance
        return seen

    def _turn_to(self, realisation: int) -> None:
        if realisation != self._realisation:
            self._realisation = realisation
            self._images.clear()
            self._found.clear()
            self._pairs.clear()
            self._repeated.clear()


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

    def expose(self) -> None:
        """Make the images of all frames, which may raise `UndrawableError`, before any is asked for."""
        for slot in self._slots:
            self._images.image(self._realisation, slot)

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
