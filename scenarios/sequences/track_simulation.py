"""Simulated tracks: visibility of landmarks, birth, survival and death of tracks, and errors that accumulate."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, angle_between
from boresight.scenarios.sequences.ground import LandmarkGround, SphereGround
from boresight.scenarios.spec.vision import TrackErrorsSpec, VisionSpec

_PROBES = 16384  # points spread over a mesh
_PROBED_FRAMES = 36  # of an orbit, at most twice as many
_NODES = 20000  # circles about the nadir, from the limb inward
_CENTRED_PX = 1e-6  # of the body's origin from the principal point


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """Visibility test of points on a surface, with its occlusion.

    With ``lit_only`` points that do not face the Sun are invisible.
    """

    ground: LandmarkGround
    lit_only: bool = False

    def visible(self, points_m: FloatArray, normals: FloatArray, view: View) -> BoolArray:
        """(n,) whether points are in the field of view, not occluded and, with ``lit_only``, lit."""
        # The cheap tests first: rays are traced to points in the image alone.
        seen = view.camera.contains(view.camera.project(view.T_cam_body.transform(points_m)))
        if self.lit_only:
            seen &= normals @ view.sun_dir_body > 0.0
        rows = np.flatnonzero(seen)
        seen[rows] = self.ground.in_sight(points_m[rows], normals[rows], view.T_cam_body.camera_position_m)
        return seen

    def share(self, views: Sequence[View]) -> float:
        """Return the share of the area that is visible, as the mean over the views of an orbit.

        Raise BoresightError if nothing is visible from any of them.
        """
        some = views[:: max(1, len(views) // _PROBED_FRAMES)]
        if isinstance(self.ground, SphereGround) and all(_is_centred(view) for view in some):
            shares = [sphere_share(self.ground.radius_m, view, self.lit_only) for view in some]
        else:
            points, normals = self.ground.spread(_PROBES)
            shares = [float(self.visible(points, normals, view).mean()) for view in some]
        if not any(shares):
            raise BoresightError("sequence: the camera sees none of the body: check orbit, camera, body and lit_only")
        return float(np.mean(shares))


def _is_centred(view: View) -> bool:
    """Return whether the boresight passes through the body's origin and the principal point is in the image."""
    camera = view.camera
    centre = np.array([camera.cx_px, camera.cy_px])
    off = camera.project(view.T_cam_body.translation_m) - centre
    return bool(np.abs(off).max() < _CENTRED_PX and camera.contains(centre))


def sphere_share(radius_m: float, view: View, lit_only: bool) -> float:
    """Return the visible share of a sphere whose centre is on the boresight.

    On a circle at the angle theta from the nadir, the points in the image (and in sunlight) are arcs of the azimuth
    phi, known in closed form. Their lengths are summed over cos(theta) from the limb, at R / r, to 1.
    """
    limb = radius_m / float(np.linalg.norm(view.T_cam_body.translation_m))
    if limb >= 1.0:
        return 0.0
    # Midpoint rule in cos(theta), to which the area is proportional.
    cosine = limb + (1.0 - limb) * (np.arange(_NODES) + 0.5) / _NODES
    sine = np.sqrt(1.0 - cosine**2)
    # tan of the angle from the boresight: R sin / (r - R cos).
    slope = limb * sine / (1.0 - limb * cosine)
    arcs = _arcs_in_image(slope, view)
    centre, half = _arc_in_light(cosine, sine, view) if lit_only else (0.0, np.full(_NODES, np.pi))
    # Arcs are limits on a circle: their overlap is that of all copies a turn apart.
    turns = 2.0 * np.pi * np.arange(-2, 3)[:, None]
    length = sum(
        np.clip(np.minimum(high + turns, centre + half) - np.maximum(low + turns, centre - half), 0.0, None).sum(axis=0)
        for low, high in arcs
    )
    # The cap from the limb to the nadir has the share (1 - R / r) / 2 of the sphere.
    return float(np.mean(length) / (2.0 * np.pi) * (1.0 - limb) / 2.0)


def _arcs_in_image(slope: FloatArray, view: View) -> list[tuple[FloatArray, FloatArray]]:
    """Return the azimuth limits, by quadrant, within which a cone of this slope about the boresight is in the image."""
    camera = view.camera
    right, left = (x / (camera.fx_px * slope) for x in (camera.width_px - camera.cx_px, camera.cx_px))
    down, up = (y / (camera.fy_px * slope) for y in (camera.height_px - camera.cy_px, camera.cy_px))
    quadrants = (0.0, 1, right, down), (np.pi, -1, left, down), (np.pi, 1, left, up), (2.0 * np.pi, -1, right, up)
    return [_quadrant(*quadrant) for quadrant in quadrants]


def _quadrant(start: float, sign: int, across: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve cos(psi) <= across and sin(psi) <= along for psi from 0 to 90 deg, with phi = start + sign psi."""
    nearest, farthest = np.arccos(np.minimum(across, 1.0)), np.arcsin(np.minimum(along, 1.0))
    # An empty arc rather than one of negative length.
    farthest = np.maximum(nearest, farthest)
    ends = start + sign * nearest, start + sign * farthest
    return (ends[0], ends[1]) if sign > 0 else (ends[1], ends[0])


def _arc_in_light(cosine: FloatArray, sine: FloatArray, view: View) -> tuple[float, FloatArray]:
    """Return centre and half width of the azimuth arc on which the surface is sunlit."""
    sun = view.T_cam_body.rotate(view.sun_dir_body)
    across = float(np.hypot(sun[0], sun[1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        # Lit where s . n > 0: sin(theta) across cos(phi - phi_sun) > cos(theta) s_z, as the normal at the nadir is -z.
        least = np.nan_to_num(cosine * sun[2] / (sine * across), posinf=1.0, neginf=-1.0)
    return float(np.arctan2(sun[1], sun[0])), np.arccos(np.clip(least, -1.0, 1.0))


_MOST_ROUNDS = 1000  # of draws to fill a frame


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedTracks:
    """Simulated landmarks and their tracks.

    Each of T tracks has its true point, (T, 3) in the body frame, and the number of its landmark. ``seen`` are the
    track numbers of every frame, ascending.
    """

    points_m: FloatArray
    landmarks: IndexArray
    seen: tuple[IndexArray, ...]


def simulate_tracks(
    vision: VisionSpec,
    visibility: Visibility,
    views: Sequence[View],
    total: float,
    rng: np.random.Generator,
    *,
    by_scale: bool = False,
) -> SimulatedTracks:
    """Simulate tracks along the frames; ``total`` is the expected number if the whole surface were in view.

    With ``by_scale`` tracks are lost by the change of scale too, as a camera sees it that comes nearer.
    """
    simulate = _renewed_tracks if vision.field == "renewed" else _fixed_field_tracks
    places = [view.T_cam_body.camera_position_m for view in views]
    # Angles at the body's origin.
    changes = np.array([0.0, *(np.degrees(angle_between(*pair)) for pair in itertools.pairwise(places))])
    if by_scale:
        heights = visibility.ground.heights_m(np.array(places))
        # A shift along the line of sight changes the view as one across it of the same share of the distance.
        changes[1:] = np.hypot(changes[1:], np.degrees(np.diff(np.log(heights))))
    keeps = [vision.survival(change) for change in changes.tolist()]
    if vision.field == "fixed" and (1.0 - min(keeps)) * vision.tracked_share > 1.0 - vision.tracked_share:
        raise BoresightError(
            f"sequence.vision.tracked_share {vision.tracked_share:g} cannot be kept up where {1.0 - min(keeps):.2g} of"
            f" the tracks are lost from frame to frame: at most {1.0 / (2.0 - min(keeps)):.3g}, or take shorter steps"
        )
    return simulate(vision, visibility, views, keeps, total, rng)


def _renewed_tracks(
    vision: VisionSpec,
    visibility: Visibility,
    views: Sequence[View],
    keeps: Sequence[float],
    total: float,
    rng: np.random.Generator,
) -> SimulatedTracks:
    """Simulate a renewed field: every track has a new landmark.

    A track that is visible in the next frame continues with probability ``k^(change / step)``, the change being the
    angle at the body's origin between the two camera positions, and along given states with the change of the height
    above the ground; one that is not visible ends. A visible place gets a new track with the probability that it
    has none: 1 if it was not visible before, else 1 - k. With ``count: average`` the tracks of each frame are then a
    Poisson field of constant density over the visible surface.
    """
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    alive = np.empty(0, dtype=np.int64)
    seen: list[IndexArray] = []
    for i, view in enumerate(views):
        before = views[i - 1] if i else None
        keep = keeps[i]
        alive = _survivors(alive, visibility.visible(points[alive], normals[alive], view), keep, vision, rng)
        born, born_normals = _births(vision, visibility, (before, view), keep, (total, len(alive)), rng)
        alive = np.concatenate([alive, np.arange(len(points), len(points) + len(born))])
        points, normals = np.concatenate([points, born]), np.concatenate([normals, born_normals])
        seen.append(alive)
    return SimulatedTracks(points, np.arange(len(points)), tuple(seen))


def _fixed_field_tracks(
    vision: VisionSpec,
    visibility: Visibility,
    views: Sequence[View],
    keeps: Sequence[float],
    total: float,
    rng: np.random.Generator,
) -> SimulatedTracks:
    """Simulate a fixed field: a landmark whose track is lost can be tracked again later, as another track.

    A landmark in view is tracked or not, a Markov chain of two states: a track continues with the repeatability k, and
    an untracked one is found with the probability (1 - k) f / (1 - f), so that the stationary share of tracked
    landmarks in view is f, ``tracked_share``. Of the landmarks that come into view, f are tracked at once.
    """
    share = vision.tracked_share
    # Only the share f of the landmarks in view is tracked.
    points, normals = visibility.ground.sample(int(rng.poisson(total / share)), rng)
    track = np.full(len(points), -1)
    landmarks: list[int] = []
    seen: list[IndexArray] = []
    older = np.zeros(len(points), dtype=bool)
    for i, view in enumerate(views):
        keep = keeps[i]
        visible, luck = visibility.visible(points, normals, view), rng.uniform(size=len(points))
        alive = np.flatnonzero(track >= 0)
        stayed = _survivors(alive, visible[alive], keep, vision, rng)
        # In balance (1 - f) chance = f (1 - k): as many tracks are found as are lost.
        chance = np.where(older, (1.0 - keep) * share / (1.0 - share), share)
        found = np.flatnonzero(visible & (track < 0) & (luck < chance))
        track[np.setdiff1d(alive, stayed)] = -1
        track[found] = len(landmarks) + np.arange(len(found))
        landmarks += found.tolist()
        seen.append(np.sort(track[track >= 0]))
        older = visible
    numbers = np.array(landmarks, dtype=np.int64)
    return SimulatedTracks(points[numbers], numbers, tuple(seen))


def recognise_landmarks(simulated: SimulatedTracks, vision: VisionSpec, rng: np.random.Generator) -> list[IndexArray]:
    """Simulate loop closures: for each frame, (k, 2) new tracks and lost ones identified as the same landmark.

    A landmark that was tracked before is recognised with the probability ``recognised``, by its last track. With the
    probability ``mistaken`` a new track is identified with that of the nearest other lost landmark.
    """
    if not vision.recognised and not vision.mistaken:
        return [np.zeros((0, 2), dtype=np.int64) for _ in simulated.seen]
    last: dict[int, int] = {}
    pairs: list[IndexArray] = []
    before = np.empty(0, dtype=np.int64)
    for tracks in simulated.seen:
        # The last track of each landmark, unless it goes on in this frame.
        lost = np.array(sorted(set(last.values()) - set(tracks.tolist())), dtype=np.int64)
        new = np.setdiff1d(tracks, before)
        found = [_identified_with(int(one), lost, last, simulated, vision, float(rng.uniform())) for one in new]
        pairs.append(np.array([p for p in found if p is not None], dtype=np.int64).reshape(-1, 2))
        last.update(zip(simulated.landmarks[new].tolist(), new.tolist(), strict=True))
        before = tracks
    return pairs


def _identified_with(
    track: int, lost: IndexArray, last: Mapping[int, int], simulated: SimulatedTracks, vision: VisionSpec, luck: float
) -> tuple[int, int] | None:
    """Return a new track and the lost one that it is identified with; None if it has none."""
    landmark = int(simulated.landmarks[track])
    others = lost[simulated.landmarks[lost] != landmark]
    # One number decides both: mistakes at its low end, recognition at its high end.
    if luck < vision.mistaken and len(others):
        apart = np.linalg.norm(simulated.points_m[others] - simulated.points_m[track], axis=1)
        return track, int(others[apart.argmin()])
    if landmark in last and luck > 1.0 - vision.recognised:
        return track, last[landmark]
    return None


def _survivors(
    alive: IndexArray, visible: BoolArray, keep: float, vision: VisionSpec, rng: np.random.Generator
) -> IndexArray:
    """Choose the surviving tracks; at least ``min_connection`` of the visible ones, those with the smallest draws."""
    # Tracks that are not visible never survive.
    luck = np.where(visible, rng.uniform(size=len(alive)), np.inf)
    floor = min(vision.min_connection, int(visible.sum()))
    threshold = np.sort(luck)[floor - 1] if floor else -np.inf
    return alive[visible & ((luck < keep) | (luck <= threshold))]


def _births(
    vision: VisionSpec,
    visibility: Visibility,
    around: tuple[View | None, View],
    keep: float,
    numbers: tuple[float, int],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Draw points and normals of new tracks; ``around`` are two frames, ``numbers`` (population, survivors)."""
    total, alive = numbers
    if vision.count == "average":
        # A Poisson field over the whole surface, thinned by visibility and chance, is one of lower density.
        return _draw_births(visibility, around, keep, int(rng.poisson(total)), rng)
    missing = max(round(vision.landmarks_per_frame) - alive, 0)
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    for _ in range(_MOST_ROUNDS):
        if len(points) >= missing:
            return points[:missing], normals[:missing]
        more, more_normals = _draw_births(visibility, around, keep, int(np.ceil(total)), rng)
        points, normals = np.concatenate([points, more]), np.concatenate([normals, more_normals])
    raise BoresightError(f"sequence.vision.count: no place for {missing} new landmarks in {_MOST_ROUNDS} draws")


def _draw_births(
    visibility: Visibility, around: tuple[View | None, View], keep: float, n: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    before, view = around
    points, normals = visibility.ground.sample(n, rng)
    luck = rng.uniform(size=n)
    free = visibility.visible(points, normals, view)
    # With the probability k a place that was visible before is taken by a track; with 1 - k it is free.
    rows = np.flatnonzero(free & (luck < keep))
    if before is not None:
        free[rows] &= ~visibility.visible(points[rows], normals[rows], before)
    return points[free], normals[free]


def accumulated_errors_px(
    errors: TrackErrorsSpec, simulated: SimulatedTracks, poses: Sequence[Pose], camera: Camera, rng: np.random.Generator
) -> Iterator[FloatArray]:
    """Yield for each frame, (n, 2), the errors of its tracks that accumulate; they are zero where a landmark is new.

    From frame to frame a pixel takes a random step of its own. Common to all tracks are a step of ``drift_px``, drawn
    for the sequence, and a step towards the principal point, by the share ``contraction`` of the distance of the true
    point from it. On real tracks these grow with the change of the view: where a landmark is found again, they are
    those of the turn since the track was lost, or, where the view is back, of the turn from its first view.
    """
    # From a stream of its own, so that the other draws do not depend on it.
    drift_px = errors.drift_px * rng.spawn(1)[0].normal(size=2)
    rng.normal(size=3)  # so that walks are those of the rows that were made so far
    turns = _Turns(poses)
    moved_px = np.zeros((len(simulated.points_m), 2))
    previous = np.empty(0, dtype=np.int64)
    first: dict[int, int] = {}
    last: dict[int, tuple[int, int]] = {}
    for number, (tracks, pose) in enumerate(zip(simulated.seen, poses, strict=True)):
        # Drawn for all tracks, so that it does not matter which go on.
        steps = errors.walk_px * noise(errors.student_t, (len(tracks), 2), rng)
        old = np.isin(tracks, previous)
        true = camera.project(pose.transform(simulated.points_m[tracks]))
        common = drift_px - errors.contraction * (true - [camera.cx_px, camera.cy_px])
        moved_px[tracks[old]] += (steps + common)[old]
        landmarks = simulated.landmarks[tracks].tolist()
        for row in np.flatnonzero(~old):
            began = first.setdefault(landmarks[row], number)
            if began == number:
                continue
            track, seen = last[landmarks[row]]
            turn, before = turns.between(began, number), turns.between(began, seen)
            goes_on = turn > before and not turns.goes_round(seen, number)
            start_px, since = (moved_px[track], turn - before) if goes_on else (np.zeros(2), turn)
            moved_px[tracks[row]] = start_px + np.sqrt(abs(since)) * steps[row] + since * common[row]
        last.update(zip(landmarks, zip(tracks.tolist(), itertools.repeat(number)), strict=True))
        yield moved_px[tracks]
        previous = tracks


class _Turns:
    """Turns of the camera about the body's origin, in mean steps."""

    def __init__(self, poses: Sequence[Pose]) -> None:
        self._places = np.array([pose.camera_position_m for pose in poses])
        steps = [angle_between(*pair) for pair in itertools.pairwise(self._places)]
        self._path_rad = np.cumsum([0.0, *steps])
        self._step_rad = float(np.mean(steps or [0.0]))

    def between(self, one: int, other: int) -> float:
        """Return the turn from a frame to a later one, negative if that is where the camera came from."""
        if not self._step_rad:
            return float(other - one)
        before, after = self._places[one], self._places[other]
        ahead = np.cross(before, self._places[min(one + 1, other)])
        return float(np.copysign(angle_between(before, after), ahead @ np.cross(before, after))) / self._step_rad

    def goes_round(self, one: int, other: int) -> bool:
        """Return whether the camera turns by more than half a revolution from one frame to another."""
        return bool(self._path_rad[other] - self._path_rad[one] > np.pi)


def noise(student_t: float | None, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Draw errors of unit standard deviation: normal, or Student's t of so many degrees of freedom, scaled."""
    if student_t is None:
        return rng.normal(size=shape)
    return np.asarray(rng.standard_t(student_t, size=shape) * np.sqrt(1.0 - 2.0 / student_t), dtype=np.float64)
