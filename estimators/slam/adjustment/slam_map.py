"""Map of an estimator that adjusts views: frames, estimated camera positions and landmarks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np

from boresight.estimators.slam.adjustment.compiled import tracks as kernels
from boresight.estimators.slam.adjustment.compiled.problem import floats
from boresight.estimators.slam.adjustment.problem import Adjustment, Distances, Motions, PixelMeasurements, State
from boresight.estimators.slam.adjustment.solver import AdjustmentSolution, StoppingRule, minimise, place_view
from boresight.estimators.slam.adjustment.track_errors import TrackErrors
from boresight.estimators.slam.contract import FrameEstimate, LostError
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackFrame


@dataclass(frozen=True, slots=True, eq=False)
class _FrameIndex:
    """Look-up table of a frame: the row of each track, and (n, 3) unit direction from the camera, body axes."""

    frame: TrackFrame
    rows: dict[int, int]
    rays: FloatArray

    @classmethod
    def of(cls, frame: TrackFrame, camera: Camera) -> _FrameIndex:
        rows = {track: row for row, track in enumerate(frame.tracks.tolist())}
        # Row vectors times R_cam_body: its transpose takes camera to body axes.
        return cls(frame, rows, camera.unproject(frame.uv_px) @ frame.R_cam_body)


class SlamMap:
    """Frames by number, a camera position for each, and a point for each landmark by its track (m, body frame).

    ``errors`` are those that add up along tracks. Tracks in ``guessed`` have points at a guessed distance. With
    ``gated``, pixels may be refused, so that a frame may be left without a mapped landmark for a while.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.frames: dict[int, TrackFrame] = {}
        self.positions_m: dict[int, FloatArray] = {}
        self.points_m: dict[int, FloatArray] = {}
        self.errors = TrackErrors(camera)
        self.guessed: set[int] = set()
        self.gated = False
        self.last_depth_m: float | None = None
        self._indices: dict[int, _FrameIndex] = {}

    def pixels(self, views: Sequence[int], tracks: Sequence[int]) -> PixelMeasurements:
        """Collect the pixels of ``tracks`` (sorted) in ``views``, numbered by their indices in the two lists."""
        frames = [self.frames[view] for view in views]
        view, point, uv_px, sigma_px = kernels.select_pixels(
            np.array(tracks, dtype=np.int64),
            np.array([len(frame.tracks) for frame in frames]),
            np.array([frame.sigma_px for frame in frames], dtype=np.float64),
            np.concatenate([frame.tracks for frame in frames]),
            np.concatenate([frame.uv_px for frame in frames]),
        )
        return PixelMeasurements(view, point, uv_px, sigma_px)

    def noise_px2(self, view: int, rows: Sequence[int] | IndexArray) -> FloatArray:
        """(n,) variance of a coordinate of some rows of a frame, px^2, with what has added up along their tracks."""
        frame = self.frames[view]
        return frame.sigma_px**2 + self.errors.walk_px2(view, frame.tracks[rows].tolist())

    def distances(self, views: Sequence[int], tracks: Sequence[int]) -> Distances:
        """Collect the distances that were measured from ``views`` to ``tracks`` (sorted)."""
        rows = [(slot, item) for slot, view in enumerate(views) for item in self.frames[view].ranges]
        if not rows:
            return Distances()
        point = lookup(tracks, np.array([item.track for _, item in rows], dtype=np.int64))
        kept = point >= 0
        return Distances(
            view=np.array([slot for slot, _ in rows], dtype=np.int64)[kept],
            point=point[kept],
            range_m=np.array([item.range_m for _, item in rows], dtype=np.float64)[kept],
            sigma_m=np.array([item.sigma_m for _, item in rows], dtype=np.float64)[kept],
        )

    def motions(self, views: Sequence[int]) -> Motions:
        """Collect the predicted motions between consecutive frames that are both among ``views`` (sorted)."""
        slots = {view: slot for slot, view in enumerate(views)}
        # A motion is predicted from frame to frame only: views with a gap between them are not coupled.
        ends = [view for view in views if view - 1 in slots]
        if not ends:
            return Motions()
        return Motions(
            start=np.array([slots[view - 1] for view in ends], dtype=np.int64),
            end=np.array([slots[view] for view in ends], dtype=np.int64),
            displacement_m=rows_of_3([self.frames[view].motion_m for view in ends]),
            information=np.linalg.inv(
                np.array([self.frames[view].motion_covariance_m2 for view in ends]).reshape(-1, 3, 3)
            ),
        )

    def state(self, views: Sequence[int], tracks: Sequence[int]) -> State:
        """Collect the present estimates of ``views`` and ``tracks``."""
        positions, points = [self.positions_m[view] for view in views], [self.points_m[track] for track in tracks]
        return State(rows_of_3(positions), rows_of_3(points))

    def keep(self, state: State, views: Sequence[int], tracks: Sequence[int]) -> None:
        """Store the estimates of ``state``."""
        self.positions_m.update(zip(views, state.positions_m, strict=True))
        self.points_m.update(zip(tracks, state.points_m, strict=True))
        # An adjustment has determined their distances.
        self.guessed.difference_update(tracks)

    def problem(self, views: Sequence[int], tracks: Sequence[int]) -> Adjustment:
        """Return the adjustment of ``views`` and ``tracks`` (sorted) by pixels and distances, in which all are free."""
        return Adjustment(
            camera=self.camera,
            R_cam_body=self.attitudes(views),
            pixels=self.pixels(views, tracks),
            free_views=np.ones(len(views), dtype=np.bool_),
            free_points=np.ones(len(tracks), dtype=np.bool_),
            distances=self.distances(views, tracks),
        )

    def adjust(
        self, problem: Adjustment, views: Sequence[int], tracks: Sequence[int], rule: StoppingRule
    ) -> AdjustmentSolution:
        """Minimise an adjustment of ``views`` and ``tracks`` from the present estimates, and keep its estimates.

        Raise LostError if a landmark is behind its camera.
        """
        solution = minimise(problem, self.state(views, tracks), rule)
        # The solver never steps to an infinite cost, so that the start had one.
        if not np.isfinite(solution.cost):
            raise LostError("a landmark is behind a camera that sees it")
        self.keep(solution.state, views, tracks)
        return solution

    def first_estimate(self, covariance_m2: FloatArray) -> FrameEstimate:
        """Place the landmarks of view 0 provisionally at the measured distance; return those with a range."""
        self.guess(0, self.median_depth(0))
        ranged = sorted(item.track for item in self.frames[0].ranges if item.track in self.points_m)
        tracks, points = np.array(ranged, dtype=np.int64), self.state((), ranged).points_m
        return FrameEstimate(self.positions_m[0].copy(), covariance_m2.copy(), tracks, points, 0.0)

    def guess(self, view: int, depth_m: float) -> None:
        """Place all landmarks of a view provisionally at one distance from it."""
        for track in self.frames[view].tracks.tolist():
            self.points_m[track] = self.positions_m[view] + depth_m * self.ray(view, track)
            self.guessed.add(track)

    def attitudes(self, views: Sequence[int]) -> FloatArray:
        """(V, 3, 3) R_cam_body of ``views``."""
        return rows_of_3([self.frames[view].R_cam_body for view in views]).reshape(-1, 3, 3)

    def seen_by(self, views: Sequence[int]) -> dict[int, list[int]]:
        """List for each track the views among ``views`` that saw it."""
        seen: defaultdict[int, list[int]] = defaultdict(list)
        for view in views:
            for track in self.frames[view].tracks.tolist():
                seen[track].append(view)
        return dict(seen)

    def seeing(self, track: int, views: Sequence[int]) -> list[int]:
        """List those of ``views`` that saw a track."""
        return [view for view in views if track in self._index(view).rows]

    def shared(self, first: int, second: int) -> int:
        """Count the landmarks that two views share."""
        return len(self._index(first).rows.keys() & self._index(second).rows.keys())

    def ray(self, view: int, track: int) -> FloatArray:
        """(3,) unit direction from the camera to a landmark, body frame."""
        index = self._index(view)
        ray: FloatArray = index.rays[index.rows[track]]
        return ray

    def median_depth(self, view: int) -> float:
        """Return the median distance from a view to its mapped landmarks, or else of its measured ranges, m.

        Raise LostError if no distance is known in this view.
        """
        frame = self.frames[view]
        known = [self.points_m[track] for track in self._index(view).rows if track in self.points_m]
        if known:
            self.last_depth_m = median_distance(rows_of_3(known), self.positions_m[view])
            return self.last_depth_m
        # A gate may have refused all mapped landmarks of a frame: the last depth is near enough for tolerances and
        # guesses.
        if self.last_depth_m is not None and self.gated:
            return self.last_depth_m
        if frame.ranges:
            return float(np.median([item.range_m for item in frame.ranges]))
        raise LostError("no landmark of known distance is in view: the scale is unobservable")

    def place(self, view: int, rule: StoppingRule) -> None:
        """Motion-only adjustment: estimate a new view's position from its mapped landmarks and its predicted motion.

        Step 1 of the BA-SLAM steps in section 3.2 of Delpech et al. (2015). The landmarks are fixed, and so is the view
        before; the predicted motion is a measurement, which the paper uses as the initial position only.
        """
        before_m, frame = self.positions_m[view - 1], self.frames[view]
        mapped = [(row, track) for track, row in self._index(view).rows.items() if track in self.points_m]
        # Both positions are in body axes, each of its own epoch: the displacement includes the rotation of the body.
        self.positions_m[view] = before_m + frame.motion_m
        # No landmark of known position: the predicted position is all there is.
        if not mapped:
            return
        rows, points_m = [row for row, _ in mapped], rows_of_3([self.points_m[track] for _, track in mapped])
        before = before_m, np.asarray(np.linalg.inv(frame.motion_covariance_m2), dtype=np.float64)
        self.positions_m[view] = place_view(self.camera, frame, rows, points_m, before, rule)

    def determined(
        self, views: Sequence[int], absorbed: Set[int], joined: Set[int]
    ) -> tuple[list[int], dict[int, list[int]]]:
        """List the tracks that ``views`` determine or that are ``joined``, sorted, and the views that saw each track.

        A single bearing leaves the distance undetermined, unless a range is measured. Pixels of ``absorbed`` landmarks
        would need the variable that was marginalised.
        """
        seen = self.seen_by(views)
        ranged = {item.track for view in views for item in self.frames[view].ranges}
        found = {track for track, by in seen.items() if track not in absorbed and (len(by) >= 2 or track in ranged)}
        return sorted(found | joined), seen

    def triangulate_new(self, tracks: Sequence[int], seen: Mapping[int, Sequence[int]]) -> None:
        """Triangulate those of ``tracks`` that have no point; ``seen`` lists the views of each track."""
        depths_m: dict[int, float] = {}
        for track in tracks:
            if track not in self.points_m:
                last = seen[track][-1]
                if last not in depths_m:
                    # The points so far count for the depth of another view.
                    depths_m[last] = self.median_depth(last)
                self.points_m[track] = self.triangulate(track, seen[track], depths_m[last])

    def triangulate(self, track: int, views: Sequence[int], depth_m: float | None = None) -> FloatArray:
        """(3,) midpoint triangulation: the point nearest to the lines of sight of ``views``, least squares.

        If the lines are parallel, or if a depth is not within a factor of about 3 of ``depth_m``, by default the median
        depth of the last view, the point is at that depth on the last line of sight.
        """
        depth_m = self.median_depth(views[-1]) if depth_m is None else depth_m
        rays = rows_of_3([self.ray(view, track) for view in views])
        origins = rows_of_3([self.positions_m[view] for view in views])
        point: FloatArray = kernels.triangulate(origins, rays, np.array([0, len(views)]), np.array([depth_m]))[0]
        return point

    def _index(self, view: int) -> _FrameIndex:
        kept = self._indices.get(view)
        # By identity: an outlier gate replaces a frame when it refuses pixels.
        if kept is None or kept.frame is not self.frames[view]:
            kept = self._indices[view] = _FrameIndex.of(self.frames[view], self.camera)
        return kept


def rows_of_3(values: Sequence[FloatArray]) -> FloatArray:
    """(n, 3) arrays of three numbers, or of rows of three, below each other."""
    return np.concatenate(values).reshape(-1, 3) if values else np.zeros((0, 3))


def values_or_nan(values: Mapping[int, FloatArray], wanted: Sequence[int]) -> FloatArray:
    """(n, 3) values of the views or tracks ``wanted``; NaN where there is none."""
    nowhere = np.full(3, np.nan)
    return rows_of_3([values.get(key, nowhere) for key in wanted])


def median_distance(points_m: FloatArray, position_m: FloatArray) -> float:
    """Return the median distance (m) of points (n, 3) from a position."""
    return kernels.median_distance(floats(points_m), floats(position_m))


def lookup(keys: Sequence[int] | IndexArray, wanted: IndexArray) -> IndexArray:
    """(n,) index of each of ``wanted`` in the sorted ``keys``; -1 if it is not there."""
    return kernels.lookup(np.array(keys, dtype=np.int64), np.array(wanted, dtype=np.int64))
