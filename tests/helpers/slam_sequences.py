"""A small world for the tests of SLAM, independent of the product's: a circular orbit above a sphere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from boresight.estimators.slam.contract import SequenceEstimate
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackFrame, TrackRange, TrackSequence

ORBIT_M = 790.0
RADIUS_M = 190.0
STEP_RAD = np.radians(2.0)
CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))


@dataclass(frozen=True)
class Truth:
    """Camera positions (n, 3) and the landmark of each track."""

    positions_m: FloatArray
    points_m: dict[int, FloatArray]


@dataclass(frozen=True)
class Recipe:
    frames: int = 181
    landmarks: float = 15.0
    repeatability: float = 0.9
    noise_px: float = 2.0 / 3.0
    motion_error: float = 0.5
    gauge_life: int = 10
    range_all: bool = False


def position_errors_m(estimate: SequenceEstimate, truth: Truth) -> FloatArray:
    """Return the error of each frame that is estimated, (n,)."""
    found = np.array([frame.position_m for frame in estimate.frames])
    return np.asarray(np.linalg.norm(found - truth.positions_m[: len(found)], axis=1))


def central_differences(function: Callable[[FloatArray], FloatArray], x: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the derivatives of a function by each element of its argument, in the last axis."""
    shifts = np.diag(steps)
    columns = [(function(x + shift) - function(x - shift)) / (2.0 * h) for shift, h in zip(shifts, steps, strict=True)]
    return np.stack(columns, axis=-1)


def look_down(position_m: FloatArray) -> FloatArray:
    """R_cam_body of a camera that looks at the origin, its x axis as near the orbit normal as it may."""
    z = -position_m / np.linalg.norm(position_m)
    x = np.array([0.0, 0.0, 1.0]) - z[2] * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def make_sequence(rng: np.random.Generator, recipe: Recipe = Recipe()) -> tuple[TrackSequence, Truth]:
    angles = STEP_RAD * np.arange(recipe.frames)
    return sequence_along(
        rng, ORBIT_M * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1), recipe
    )


def sequence_along(rng: np.random.Generator, positions: FloatArray, recipe: Recipe) -> tuple[TrackSequence, Truth]:
    seen, points = _tracks(rng, positions, recipe)
    gauge = _gauge(seen, points, positions[0], recipe)
    frames = []
    for number, position in enumerate(positions):
        tracks = np.array(sorted(seen[number]), dtype=np.int64)
        rotation = look_down(position)
        lines = np.array([points[track] for track in tracks.tolist()]) - position
        uv = CAMERA.project(lines @ rotation.T) + recipe.noise_px * rng.standard_normal((len(tracks), 2))
        moved = position - positions[number - 1] if number else np.zeros(3)
        direction = rng.standard_normal(3)
        error = recipe.motion_error * np.linalg.norm(moved) * direction / np.linalg.norm(direction)
        sigma = max(recipe.motion_error, 1e-3) * np.linalg.norm(moved) / np.sqrt(3.0)
        distances = np.linalg.norm(lines, axis=1)
        ranged = (number == 0) & (tracks == gauge) if not recipe.range_all else np.ones(len(tracks), bool)
        pairs = zip(tracks[ranged].tolist(), distances[ranged].tolist(), strict=True)
        ranges = tuple(TrackRange(track, distance, 0.01) for track, distance in pairs)
        frames.append(
            TrackFrame(
                float(480.0 * number), rotation, tracks, uv, max(recipe.noise_px, 1e-2), moved + error,
                sigma**2 * np.eye(3), ranges,
            )
        )  # fmt: skip
    return TrackSequence(CAMERA, tuple(frames), positions[0], np.zeros((3, 3))), Truth(positions, points)


def _tracks(
    rng: np.random.Generator, positions: FloatArray, recipe: Recipe
) -> tuple[list[set[int]], dict[int, FloatArray]]:
    """Tracks of each frame. A lost track is replaced by a new landmark in view: the density is constant."""
    share = 0.5 * (1.0 - RADIUS_M / ORBIT_M)
    points = dict(enumerate(_on_sphere(rng, round(recipe.landmarks / share))))
    alive, before, frames = set(points), set[int](), []
    for position in positions:
        visible = {track for track in sorted(alive) if _visible(points[track], position)}
        dying = {track for track in sorted(visible & before) if rng.random() > recipe.repeatability}
        alive -= (before - visible) | dying
        visible -= dying
        for _ in dying:
            point = _on_sphere(rng, 1)[0]
            while not _visible(point, position):
                point = _on_sphere(rng, 1)[0]
            points[len(points)] = point
            alive.add(len(points) - 1)
            visible.add(len(points) - 1)
        for track in sorted(before - visible - dying):  # beyond the limb: it returns under another number
            points[len(points)] = points[track]
            alive.add(len(points) - 1)
        frames.append(visible)
        before = visible
    return frames, points


def _gauge(seen: list[set[int]], points: dict[int, FloatArray], position: FloatArray, recipe: Recipe) -> int:
    """The landmark nearest to the camera among those with a long track."""
    life = set.intersection(*seen[: min(recipe.gauge_life, len(seen))]) or seen[0]
    return min(life, key=lambda track: float(np.linalg.norm(points[track] - position)))


def _visible(point: FloatArray, position: FloatArray) -> bool:
    return bool(point @ position > RADIUS_M**2)


def _on_sphere(rng: np.random.Generator, count: int) -> FloatArray:
    points = rng.standard_normal((count, 3))
    return RADIUS_M * points / np.linalg.norm(points, axis=1, keepdims=True)


def with_track_errors(
    rng: np.random.Generator, sequence: TrackSequence, truth: Truth, walk_px: float, common: float
) -> TrackSequence:
    """Add a walk to the tracks of a sequence, and a contraction and drift of 100 px ``common``; all are declared.

    The camera circles about z by equal steps. A point that is found again has the errors of the turn since it was lost
    or, where the view is back, since its first view.
    """
    drift_px = 100.0 * common
    contraction, drift, frames = common * rng.standard_normal(), drift_px * rng.standard_normal(2), []
    added: dict[int, FloatArray] = {}
    angles = np.arctan2(*truth.positions_m.T[1::-1])
    revolution = round(2.0 * np.pi / abs(angles[1] - angles[0]))
    first: dict[tuple[float, ...], int] = {}
    last: dict[tuple[float, ...], tuple[int, FloatArray]] = {}

    def turn(before: int, now: int) -> int:
        return (now - before + revolution // 2) % revolution - revolution // 2

    for k, (position, frame) in enumerate(zip(truth.positions_m, sequence.frames, strict=True)):
        uv = frame.uv_px.copy()
        for row, track in enumerate(frame.tracks.tolist()):
            point = tuple(truth.points_m[track].tolist())
            true = CAMERA.project((truth.points_m[track] - position)[None] @ frame.R_cam_body.T)[0]
            walk = walk_px * rng.standard_normal(2)
            both = drift - contraction * (true - [CAMERA.cx_px, CAMERA.cy_px])
            if track in added:
                added[track] = added[track] + walk + both
            elif point in first:
                seen, error = last[point]
                turned, before = turn(first[point], k), turn(first[point], seen)
                goes_on = turned > before and k - seen < revolution // 2
                start, since = (error, turned - before) if goes_on else (np.zeros(2), turned)
                added[track] = start + np.sqrt(abs(since)) * walk + since * both
            else:
                first[point], added[track] = k, np.zeros(2)
            last[point] = k, added[track]
            uv[row] += added[track]
        frames.append(replace(frame, uv_px=uv, walk_px=walk_px, contraction=common, drift_px=drift_px))
    return replace(sequence, frames=tuple(frames))
