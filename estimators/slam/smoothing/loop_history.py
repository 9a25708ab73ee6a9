"""Map of all frames of a sequence so far, in which the tracks of one landmark are merged."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from boresight.estimators.slam.adjustment.problem import Adjustment, Motions, QuadraticPrior
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.scenarios.tracks import TrackFrame, TrackSequence


class GlobalMap:
    """Map of all frames, whose tracks are renumbered to landmarks: a landmark has the number of its oldest track.

    Attributes
    ----------
    landmark
        Landmark of each track that was merged into another one.
    members
        Tracks of each landmark with more than one.
    seen
        Frames of each landmark.
    track_in_frame
        For each frame, the track of each landmark.
    """

    def __init__(self, sequence: TrackSequence, *, motion: bool) -> None:
        self.slam_map = SlamMap(sequence.camera)
        self.first_m = sequence.position_m
        self.first_covariance_m2 = sequence.position_covariance_m2
        self.motion = motion
        self.landmark: dict[int, int] = {}
        self.members: dict[int, set[int]] = {}
        self.seen: dict[int, set[int]] = {}
        self.track_in_frame: dict[int, dict[int, int]] = {}

    def add(self, number: int, frame: TrackFrame) -> None:
        """Add a frame, or replace it if its pixels have changed."""
        # A gate may have refused pixels since the frame was added.
        for landmark in self.track_in_frame.pop(number, {}):
            self.seen[landmark].discard(number)
        self.slam_map.frames[number] = self._renamed(frame)
        self.track_in_frame[number] = {self.of(track): track for track in frame.tracks.tolist()}
        for landmark in self.track_in_frame[number]:
            self.seen.setdefault(landmark, set()).add(number)

    def of(self, track: int) -> int:
        """Return the landmark of a track."""
        return self.landmark.get(track, track)

    def may_merge(self, first: int, second: int) -> bool:
        """Return whether two landmarks have different numbers and never appear in one frame."""
        return first != second and not self.seen.get(first, set()) & self.seen.get(second, set())

    def merge(self, new: int, old: int) -> None:
        """Merge two landmarks into one with the number of ``old``."""
        members = self.members.pop(new, {new})
        self.members[old] = self.members.pop(old, {old}) | members
        self.landmark.update(dict.fromkeys(members, old))
        numbers = self.seen.pop(new)
        self.seen[old] |= numbers
        for number in numbers:
            self.track_in_frame[number][old] = self.track_in_frame[number].pop(new)
            self.slam_map.frames[number] = self._renamed(self.slam_map.frames[number])

    def problem(self, kept: Collection[int] = ()) -> tuple[Adjustment, list[int]]:
        """Return the adjustment of all frames and its landmarks; those in ``kept`` stay in the reduced system."""
        slam_map = self.slam_map
        views = sorted(slam_map.frames)
        ranged = {item.track for frame in slam_map.frames.values() for item in frame.ranges}
        # As in a window: two bearings, or one and a range, determine a landmark.
        tracks = sorted(track for track, by in self.seen.items() if len(by) >= 2 or track in ranged)
        for track in tracks:
            if track not in slam_map.points_m:
                slam_map.points_m[track] = slam_map.triangulate(track, sorted(self.seen[track]))
        free = np.ones(len(views), dtype=np.bool_)
        # A first position without error is fixed, and has no prior.
        free[0] = bool(np.any(self.first_covariance_m2))
        problem = Adjustment(
            camera=slam_map.camera,
            R_cam_body=slam_map.attitudes(views),
            pixels=slam_map.pixels(views, tracks),
            free_views=free,
            free_points=np.ones(len(tracks), dtype=np.bool_),
            distances=slam_map.distances(views, tracks),
            motions=slam_map.motions(views) if self.motion else Motions(),
            prior=QuadraticPrior.of_first_position(self.first_m, self.first_covariance_m2) if free[0] else None,
            kept_points=np.isin(tracks, sorted(kept)),
        )
        return problem, tracks

    def _renamed(self, frame: TrackFrame) -> TrackFrame:
        """Renumber the tracks of a frame to their landmarks."""
        tracks = np.array([self.of(track) for track in frame.tracks.tolist()], dtype=np.int64)
        ranges = tuple(replace(item, track=self.of(item.track)) for item in frame.ranges)
        return replace(frame, tracks=tracks, ranges=ranges)
