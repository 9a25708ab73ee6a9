"""A trial of a sequence: the truth, and what the spacecraft measures of it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenarios.draw import Stream, draw_direction, generator
from scenarios.geometry import Camera, Pose
from scenarios.sequences.ground import Ground
from scenarios.sequences.lives import Lives, Sightline, live, population
from scenarios.sequences.orbit import anomalies_deg, orbit_axes, poses, times_s
from scenarios.spec.sequence import KnowledgeSpec, SequenceSpec, VisionSpec
from scenarios.tracks import TrackFrame, TrackRange, TrackSequence

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_ALL_LATITUDES_RAD = (-0.5 * np.pi, 0.5 * np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class SequenceTruth:
    """What is true of a sequence; it never reaches an estimator.

    Parameters
    ----------
    poses
        T_cam_body of each frame.
    anomaly_deg
        (F,) anomaly gone through since the first frame.
    points_m
        (T, 3) landmark of each track, body frame.
    wrong
        For each frame, (n,) which of its tracks were seen at a wrong place.
    """

    poses: tuple[Pose, ...]
    anomaly_deg: FloatArray
    points_m: FloatArray
    wrong: tuple[BoolArray, ...]


def draw_sequence(
    spec: SequenceSpec, camera: Camera, ground: Ground, seed: int, trial: int
) -> tuple[SequenceTruth, TrackSequence]:
    """Draw the truth of a trial and the measured sequence, from streams by address.

    Landmarks, noise, motion errors and wrong matches have streams of their own, so that what is changed of one of
    them leaves the others as they were.
    """
    path = poses(spec.orbit)
    sun = _sun(spec)
    field_rng = generator(seed, Stream.TRACK_FIELD, trial)
    lives = live(spec.vision, Sightline(ground, camera, sun), path, _population(spec, camera, ground), field_rng)
    seen = _see(lives, path, camera, spec.vision, seed, trial)
    moves = _predicted_moves(path, spec.knowledge, generator(seed, Stream.MOTION, trial))
    knowledge_rng = generator(seed, Stream.KNOWLEDGE, trial)
    position = path[0].camera_position_m + spec.knowledge.position_sigma_m * knowledge_rng.normal(size=3)
    ranges = _ranges(lives, seen[0][0], path[0], camera, spec.knowledge, knowledge_rng)
    turns = np.radians(spec.knowledge.attitude_sigma_deg) * knowledge_rng.normal(size=(len(path), 3))
    frames = tuple(
        TrackFrame(
            time_s=float(time),
            R_cam_body=Rotation.from_rotvec(turn).as_matrix() @ pose.rotation if turn.any() else pose.rotation,
            tracks=tracks,
            uv_px=uv,
            sigma_px=spec.vision.noise_px,
            motion_m=move,
            motion_covariance_m2=covariance,
            ranges=ranges if i == 0 else (),
        )
        for i, (time, turn, pose, tracks, (uv, _), (move, covariance)) in enumerate(
            zip(times_s(spec.orbit), turns, path, lives.seen, seen, moves, strict=True)
        )
    )
    truth = SequenceTruth(path, anomalies_deg(spec.orbit), lives.points_m, tuple(wrong for _, wrong in seen))
    return truth, TrackSequence(camera, frames, position, np.eye(3) * spec.knowledge.position_sigma_m**2)


def _sun(spec: SequenceSpec) -> FloatArray | None:
    """Direction of the Sun, (3,) body axes: along the orbit's normal, where only lit ground is seen."""
    return orbit_axes(spec.orbit)[2] if spec.vision.lit_only else None


@lru_cache(maxsize=8)
def _population(spec: SequenceSpec, camera: Camera, ground: Ground) -> float:
    """Work out the population once for all trials: on a mesh it costs more than a trial."""
    return population(spec.vision, Sightline(ground, camera, _sun(spec)), poses(spec.orbit))


def _see(
    lives: Lives, path: Sequence[Pose], camera: Camera, vision: VisionSpec, seed: int, trial: int
) -> list[tuple[FloatArray, BoolArray]]:
    """Measure the tracks of each frame: (n, 2) pixels, and (n,) which of them are at a wrong place."""
    noise_rng, wrong_rng = generator(seed, Stream.TRACK_NOISE, trial), generator(seed, Stream.MISMATCH, trial)
    seen = []
    older = np.empty(0, dtype=np.int64)
    for tracks, pose in zip(lives.seen, path, strict=True):
        uv = camera.project(pose.transform(lives.points_m[tracks]))
        placed, wrong = _misplace(uv, np.isin(tracks, older), camera, vision, wrong_rng)
        seen.append((placed + vision.noise_px * noise_rng.normal(size=uv.shape), wrong))
        older = tracks
    return seen


def _misplace(
    uv_px: FloatArray, tracked: BoolArray, camera: Camera, vision: VisionSpec, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """Put some of the tracked points to the nearest other point or anywhere in the image; new ones are right."""
    luck, anywhere = rng.uniform(size=len(uv_px)), rng.uniform(size=uv_px.shape) * [camera.width_px, camera.height_px]
    mismatched = tracked & (luck < vision.mismatch_share) & (len(uv_px) > 1)
    outlying = tracked & ~mismatched & (luck > 1.0 - vision.outlier_share)
    placed = np.where(outlying[:, None], anywhere, uv_px)
    if mismatched.any():
        apart = np.linalg.norm(uv_px[:, None] - uv_px, axis=2)
        np.fill_diagonal(apart, np.inf)
        placed[mismatched] = uv_px[apart.argmin(axis=1)[mismatched]]
    return placed, mismatched | outlying


def _predicted_moves(
    path: Sequence[Pose], knowledge: KnowledgeSpec, rng: np.random.Generator
) -> list[tuple[FloatArray, FloatArray]]:
    """Predict the displacement before each frame, (3,), and the covariance of its error, (3, 3).

    The error has a random direction and the length lambda |displacement|: lambda^2 |d|^2 / 3 on each axis.
    """
    moves = [(np.zeros(3), np.zeros((3, 3)))]
    for before, after in itertools.pairwise(path):
        true = after.camera_position_m - before.camera_position_m
        length = knowledge.motion_error * float(np.linalg.norm(true))
        error = length * draw_direction(_ALL_LATITUDES_RAD, rng)
        moves.append((true + error, np.eye(3) * length**2 / 3.0))
    return moves


def _ranges(
    lives: Lives, uv_px: FloatArray, pose: Pose, camera: Camera, knowledge: KnowledgeSpec, rng: np.random.Generator
) -> tuple[TrackRange, ...]:
    """Measure the distances of some landmarks that are seen in the first frame."""
    off_axis = np.linalg.norm(uv_px - [camera.cx_px, camera.cy_px], axis=1)
    first = lives.seen[0]
    lasting = knowledge.range_to == "lasting"
    last = np.sum([np.isin(first, seen) for seen in lives.seen], axis=0) if lasting else np.zeros(len(first))
    chosen = first[np.lexsort((off_axis, -last))[: knowledge.ranges]]
    true = np.linalg.norm(lives.points_m[chosen] - pose.camera_position_m, axis=1)
    errors = knowledge.range_sigma_m * rng.normal(size=len(chosen))
    return tuple(
        TrackRange(int(track), float(distance), knowledge.range_sigma_m)
        for track, distance in zip(chosen, true + errors, strict=True)
    )
