"""A trial of a sequence: the truth, and what the spacecraft measures of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenarios.draw import Stream, generator
from scenarios.geometry import Camera, Pose
from scenarios.sequences.ground import LandmarkGround
from scenarios.sequences.onboard import FrameTracks, onboard_sequence
from scenarios.sequences.track_simulation import SimulatedTracks, recognise_landmarks, simulate_tracks
from scenarios.sequences.trajectory import (
    CameraTrajectory,
    anomalies_deg,
    camera_trajectory,
    draw_unmodelled_m_s2,
    nominal_trajectory,
)
from scenarios.sequences.visibility import Visibility
from scenarios.spec.sequence import SequenceSpec, VisionSpec
from scenarios.tracks import TrackSequence

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


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
    trajectory
        Motion of camera and body in inertial space.
    gm_m3_s2
        Gravity parameter.
    """

    poses: tuple[Pose, ...]
    anomaly_deg: FloatArray
    points_m: FloatArray
    wrong: tuple[BoolArray, ...]
    trajectory: CameraTrajectory
    gm_m3_s2: float


def draw_sequence(
    spec: SequenceSpec, camera: Camera, ground: LandmarkGround, seed: int, trial: int
) -> tuple[SequenceTruth, TrackSequence]:
    """Draw the truth of a trial and the measured sequence, from streams by address.

    Landmarks, noise, motion errors and wrong matches have streams of their own, so that what is changed of one of
    them leaves the others as they were.
    """
    trajectory = _path(spec, ground, seed, trial)
    visibility = Visibility(ground, spec.vision.lit_only)
    field_rng = generator(seed, Stream.TRACK_FIELD, trial)
    simulated = simulate_tracks(
        spec.vision, visibility, trajectory.views(camera), _population(spec, camera, ground), field_rng
    )
    seen = _see(simulated, trajectory.poses, camera, spec.vision, seed, trial)
    truth = SequenceTruth(
        trajectory.poses,
        anomalies_deg(spec.orbit),
        simulated.points_m,
        tuple(wrong for _, wrong in seen),
        trajectory,
        spec.orbit.gm_m3_s2,
    )
    return truth, onboard_sequence(spec, camera, trajectory, [sighting for sighting, _ in seen], (seed, trial))


def _path(spec: SequenceSpec, ground: LandmarkGround, seed: int, trial: int) -> CameraTrajectory:
    """Move along the orbit; one that chance has no part in is worked out once for all trials."""
    if spec.orbit.forces.noise_m_s2:
        return camera_trajectory(spec, ground, draw_unmodelled_m_s2(spec.orbit, seed, trial))
    return _undisturbed(spec, ground)


@lru_cache(maxsize=8)
def _undisturbed(spec: SequenceSpec, ground: LandmarkGround) -> CameraTrajectory:
    return nominal_trajectory(spec, ground)


@lru_cache(maxsize=8)
def _population(spec: SequenceSpec, camera: Camera, ground: LandmarkGround) -> float:
    """Work out how many tracks the whole ground must have for N in a frame on average, by the undisturbed orbit."""
    share = Visibility(ground, spec.vision.lit_only).share(_undisturbed(spec, ground).views(camera))
    return spec.vision.landmarks_per_frame / share


def _see(
    simulated: SimulatedTracks, poses: Sequence[Pose], camera: Camera, vision: VisionSpec, seed: int, trial: int
) -> list[tuple[FrameTracks, BoolArray]]:
    """Measure the tracks of each frame, and tell, (n,), which of them are at a wrong place."""
    noise_rng, wrong_rng = generator(seed, Stream.TRACK_NOISE, trial), generator(seed, Stream.MISMATCH, trial)
    seen = []
    older = np.empty(0, dtype=np.int64)
    again = recognise_landmarks(simulated, vision, generator(seed, Stream.REVISIT, trial))
    for tracks, pose, pairs in zip(simulated.seen, poses, again, strict=True):
        points = simulated.points_m[tracks]
        uv = camera.project(pose.transform(points))
        placed, wrong = _misplace(uv, np.isin(tracks, older), camera, vision, wrong_rng)
        noisy = placed + vision.noise_px * noise_rng.normal(size=uv.shape)
        seen.append((FrameTracks(tracks, noisy, points, pairs), wrong))
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
