"""Which landmarks are tracked in which frame: births, survival and death of tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.errors import BoresightError
from scenarios.geometry import Pose, View
from scenarios.sequences.ground import Ground
from scenarios.spec.sequence import VisionSpec

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.int64]

_PROBES = 4096
_PROBED_FRAMES = 36
_PROBE_SEED = 0
_MOST_ROUNDS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Sightline:
    """Tells what a camera sees of the ground.

    Parameters
    ----------
    ground
        What hides its own far side.
    lit_only
        Whether only ground that faces the Sun is seen.
    """

    ground: Ground
    lit_only: bool = False

    def visible(self, points_m: FloatArray, normals: FloatArray, view: View) -> BoolArray:
        """(n,): points in the field of view, in sight and, where that is asked for, lit."""
        seen = view.camera.contains(view.camera.project(view.T_cam_body.transform(points_m)))
        if self.lit_only:
            seen &= normals @ view.sun_dir_body > 0.0
        rows = np.flatnonzero(seen)
        seen[rows] = self.ground.in_sight(points_m[rows], normals[rows], view.T_cam_body.camera_position_m)
        return seen


@dataclass(frozen=True, slots=True, eq=False)
class Lives:
    """The true landmark of every track, (T, 3) m in the body frame, and the tracks of every frame, ascending."""

    points_m: FloatArray
    seen: tuple[IndexArray, ...]


def population(vision: VisionSpec, sightline: Sightline, views: Sequence[View]) -> float:
    """Return the expected number of landmarks on the whole ground that puts N into a frame on average.

    N over the visible share of the area, which points drawn once for all tell as the mean over frames of the orbit.
    """
    points, normals = sightline.ground.sample(_PROBES, np.random.default_rng(_PROBE_SEED))
    some = views[:: max(1, len(views) // _PROBED_FRAMES)]
    share = float(np.mean([sightline.visible(points, normals, view).mean() for view in some]))
    if share == 0.0:
        raise BoresightError("sequence: the camera sees none of the body: check orbit, camera, body and lit_only")
    return vision.landmarks_per_frame / share


def live(
    vision: VisionSpec,
    sightline: Sightline,
    views: Sequence[View],
    total: float,
    rng: np.random.Generator,
) -> Lives:
    """Let tracks be born and die along the frames, out of ``total`` landmarks on the whole ground (``population``).

    A track that is visible in the next frame lives on with probability ``k^(change / step)``, the change being the
    angle at the body's origin between the two camera positions; one that is not visible is dead for good. A visible
    place is occupied anew with the probability that it has no live track: 1 where it was not visible before, else
    1 - k. With ``count: average`` the live tracks of each frame are then a Poisson field of one density over all that
    is visible.
    """
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    alive = np.empty(0, dtype=np.int64)
    seen: list[IndexArray] = []
    for i, view in enumerate(views):
        before = views[i - 1] if i else None
        keep = 1.0 if before is None else vision.survival(_change_deg(before.T_cam_body, view.T_cam_body))
        alive = _survivors(alive, sightline.visible(points[alive], normals[alive], view), keep, vision, rng)
        born, born_normals = _births(vision, sightline, (before, view), keep, (total, len(alive)), rng)
        alive = np.concatenate([alive, np.arange(len(points), len(points) + len(born))])
        points, normals = np.concatenate([points, born]), np.concatenate([normals, born_normals])
        seen.append(alive)
    return Lives(points, tuple(seen))


def _change_deg(before: Pose, pose: Pose) -> float:
    """Angle at the body's origin between two camera positions."""
    a, b = before.camera_position_m, pose.camera_position_m
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _survivors(
    alive: IndexArray, visible: BoolArray, keep: float, vision: VisionSpec, rng: np.random.Generator
) -> IndexArray:
    """Choose the tracks that live on; where chance leaves too few, the luckiest of the visible ones do."""
    luck = np.where(visible, rng.uniform(size=len(alive)), np.inf)
    floor = min(vision.min_connection, int(visible.sum()))
    threshold = np.sort(luck)[floor - 1] if floor else -np.inf
    return alive[visible & ((luck < keep) | (luck <= threshold))]


def _births(
    vision: VisionSpec,
    sightline: Sightline,
    around: tuple[View | None, View],
    keep: float,
    numbers: tuple[float, int],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Draw the points of new tracks and their normals, for frames ``around`` and (population, survivors)."""
    total, alive = numbers
    if vision.count == "average":
        return _draw_births(sightline, around, keep, int(rng.poisson(total)), rng)
    missing = max(round(vision.landmarks_per_frame) - alive, 0)
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    for _ in range(_MOST_ROUNDS):
        if len(points) >= missing:
            return points[:missing], normals[:missing]
        more, more_normals = _draw_births(sightline, around, keep, int(np.ceil(total)), rng)
        points, normals = np.concatenate([points, more]), np.concatenate([normals, more_normals])
    raise BoresightError(f"sequence.vision.count: no place for {missing} new landmarks in {_MOST_ROUNDS} draws")


def _draw_births(
    sightline: Sightline, around: tuple[View | None, View], keep: float, n: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    before, view = around
    points, normals = sightline.ground.sample(n, rng)
    luck = rng.uniform(size=n)
    free = sightline.visible(points, normals, view)
    rows = np.flatnonzero(free & (luck < keep))
    if before is not None:
        free[rows] &= ~sightline.visible(points[rows], normals[rows], before)
    return points[free], normals[free]
