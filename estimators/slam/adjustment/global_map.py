"""Map of all frames of a sequence, with the adjustment of all of them and the covariance at planned values."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from boresight.estimators.slam.adjustment.problem import Adjustment, Motions, QuadraticPrior
from boresight.estimators.slam.adjustment.slam_map import SlamMap, lookup
from boresight.estimators.slam.adjustment.solver import view_covariance
from boresight.estimators.slam.adjustment.track_errors import COMMON, TrackErrors
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import TrackFrame, TrackSequence


class GlobalMap:
    """Map of all frames, whose tracks are renumbered to landmarks: a landmark has the number of its oldest track.

    ``landmark`` has the landmark of each track that was merged into another one, ``members`` the tracks of each
    landmark with more than one, and ``seen`` the frames of each landmark.
    """

    def __init__(self, sequence: TrackSequence, errors: TrackErrors | None = None, *, motion: bool) -> None:
        self.slam_map = SlamMap(sequence.camera)
        if errors is not None:
            self.slam_map.errors = errors
        self.first_m = sequence.position_m
        self.first_covariance_m2 = sequence.position_covariance_m2
        self.motion = motion
        self.landmark: dict[int, int] = {}
        self.members: dict[int, set[int]] = {}
        self.seen: dict[int, set[int]] = {}

    def add(self, number: int, frame: TrackFrame) -> None:
        """Add a frame, or replace it if its pixels have changed."""
        # A gate may have refused pixels since the frame was added.
        if number in self.slam_map.frames:
            for landmark in self.slam_map.frames[number].tracks.tolist():
                self.seen[landmark].discard(number)
        self.slam_map.frames[number] = self._renamed(frame)
        for landmark in self.slam_map.frames[number].tracks.tolist():
            self.seen.setdefault(landmark, set()).add(number)

    def plan(self, frame: TrackFrame, position_m: FloatArray) -> None:
        """Add the next frame at a planned position (3,)."""
        number = len(self.slam_map.frames)
        self.slam_map.errors.add(frame)
        self.add(number, frame)
        self.slam_map.positions_m[number] = position_m

    def of(self, track: int) -> int:
        """Return the landmark of a track."""
        return self.landmark.get(track, track)

    def may_merge(self, first: int, second: int) -> bool:
        """Return whether two landmarks have different numbers and never appear in one frame."""
        return first != second and not self.seen.get(first, set()) & self.seen.get(second, set())

    def ripe(self, pairs: Collection[tuple[int, int]]) -> list[tuple[int, int]]:
        """List the pairs of tracks, sorted, whose landmarks were both seen twice."""
        # A landmark seen once has no covariance along its line of sight.
        return [pair for pair in sorted(pairs) if all(len(self.seen.get(self.of(t), ())) >= 2 for t in pair)]

    def merge(self, pairs: Iterable[tuple[int, int]]) -> int:
        """Merge the landmarks of pairs of tracks, new and old, into one with the number of the old; return how many."""
        merged, changed = 0, set[int]()
        for new, old in ((self.of(a), self.of(b)) for a, b in pairs):
            # Merges before this one may have brought both into one landmark or one frame.
            if not self.may_merge(new, old):
                continue
            members = self.members.pop(new, {new})
            self.members[old] = self.members.pop(old, {old}) | members
            self.landmark.update(dict.fromkeys(members, old))
            numbers = self.seen.pop(new)
            self.seen[old] |= numbers
            merged, changed = merged + 1, changed | numbers
        for number in changed:
            self.slam_map.frames[number] = self._renamed(self.slam_map.frames[number])
        return merged

    def problem(self, kept: Collection[int] = ()) -> tuple[Adjustment, list[int]]:
        """Return the adjustment of all frames and its landmarks; those in ``kept`` stay in the reduced system."""
        slam_map = self.slam_map
        views = sorted(slam_map.frames)
        tracks, seen = slam_map.determined(views, set(), set())
        for track in tracks:
            slam_map.triangulate_new([track], seen)
        free = np.ones(len(views), dtype=np.bool_)
        # A first position without error is fixed, and has no prior.
        free[0] = bool(np.any(self.first_covariance_m2))
        first = QuadraticPrior.of_first_position(self.first_m, self.first_covariance_m2) if free[0] else None
        prior, names = slam_map.errors.prior(first), slam_map.errors.views(views)
        slam_map.positions_m.setdefault(COMMON, np.zeros(3))
        problem = replace(
            slam_map.problem(views, tracks),
            free_views=free,
            motions=slam_map.motions(views) if self.motion else Motions(),
            prior=None if prior is None else replace(prior, views=lookup(names, prior.views)),
            kept_points=np.isin(tracks, sorted(kept)),
        )
        return slam_map.errors.extended(problem, views, tracks, self.members), tracks

    def covariance(self, points_m: FloatArray) -> FloatArray | None:
        """(3, 3) covariance of the last position, m^2, at the present ones and landmarks (T, 3) by track.

        No pixel is used: the derivatives are those at the given values, and no measurement is refused. None if it is
        not determined.
        """
        slam_map = self.slam_map
        slam_map.points_m = {landmark: points_m[landmark] for landmark in self.seen}
        problem, tracks = self.problem()
        views = sorted(slam_map.frames)
        try:
            return view_covariance(problem, slam_map.state(slam_map.errors.views(views), tracks), len(views) - 1)
        except np.linalg.LinAlgError:
            return None

    def _renamed(self, frame: TrackFrame) -> TrackFrame:
        """Renumber the tracks of a frame to their landmarks."""
        if not self.landmark:
            return frame
        tracks = np.array([self.of(track) for track in frame.tracks.tolist()], dtype=np.int64)
        ranges = tuple(replace(item, track=self.of(item.track)) for item in frame.ranges)
        return replace(frame, tracks=tracks, ranges=ranges)


def planned_covariance(
    sequence: TrackSequence, positions_m: FloatArray, points_m: FloatArray, *, motion: bool = True
) -> FloatArray | None:
    """(3, 3) covariance of the last position by all frames of a sequence, m^2; None if it is not determined.

    ``positions_m`` (F, 3) and ``points_m`` (T, 3) are the planned camera positions and landmarks, body frame, at which
    derivatives are taken. Pixels, ranges, errors that add up along tracks, and with ``motion`` predicted motions are
    measurements; attitudes are exact.
    """
    known = GlobalMap(sequence, motion=motion)
    for frame, position_m in zip(sequence.frames, positions_m, strict=True):
        if frame.contraction:  # the only use of a pixel
            seen_m = np.array([points_m[track] for track in frame.tracks.tolist()]).reshape(-1, 3)
            frame = replace(frame, uv_px=sequence.camera.project((seen_m - position_m) @ frame.R_cam_body.T))
        known.plan(frame, position_m)
    return known.covariance(points_m)
