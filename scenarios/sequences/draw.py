"""Simulate a trial of a sequence: the truth, and the measured tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.observation import TrackSequence
from boresight.scenarios.sequences.ground import LandmarkGround
from boresight.scenarios.sequences.onboard import FrameTracks, onboard_sequence
from boresight.scenarios.sequences.track_simulation import (
    SimulatedTracks,
    Visibility,
    accumulated_errors_px,
    noise,
    recognise_landmarks,
    simulate_tracks,
)
from boresight.scenarios.sequences.trajectory import (
    CameraTrajectory,
    camera_trajectory,
    draw_unmodelled_m_s2,
    nominal_trajectory,
)
from boresight.scenarios.spec.sequence import SequenceSpec
from boresight.scenarios.spec.vision import TrackErrorsSpec, VisionSpec


@dataclass(frozen=True, slots=True, eq=False)
class SequenceTruth:
    """True values of a sequence, for scoring only.

    ``poses`` are T_cam_body of each frame, ``points_m`` (T, 3) the landmark of each track, body frame, ``wrong`` for
    each frame, (n,) which of its tracks are outliers, ``trajectory`` the motion of camera and body in inertial space.
    """

    poses: tuple[Pose, ...]
    points_m: FloatArray
    wrong: tuple[BoolArray, ...]
    trajectory: CameraTrajectory
    gm_m3_s2: float

    @property
    def anomaly_deg(self) -> FloatArray:
        """(F,) anomaly since the first frame; NaN along given states."""
        return self.trajectory.anomaly_deg


def draw_sequence(
    spec: SequenceSpec, camera: Camera, ground: LandmarkGround, seed: int, trial: int
) -> tuple[SequenceTruth, TrackSequence]:
    """Draw the truth of a trial and the measured sequence, from streams by address.

    Landmarks, noise, motion errors and wrong matches have separate streams, so that a change of one leaves the
    draws of the others unchanged.
    """
    # A trajectory without random acceleration is computed once for all trials.
    trajectory = _undisturbed(spec, ground)
    if spec.orbit.forces.noise_m_s2:
        trajectory = camera_trajectory(spec, ground, draw_unmodelled_m_s2(spec.orbit, seed, trial))
    visibility = Visibility(ground, spec.vision.lit_only)
    field_rng = generator(seed, Stream.TRACK_FIELD, trial)
    simulated = simulate_tracks(
        spec.vision,
        visibility,
        trajectory.views(camera),
        _population(spec, camera, ground),
        field_rng,
        by_scale=spec.trajectory is not None,
    )
    seen = _measure_tracks(simulated, trajectory.poses, camera, spec.vision, seed, trial)
    truth = SequenceTruth(
        trajectory.poses,
        simulated.points_m,
        tuple(wrong for _, wrong in seen),
        trajectory,
        spec.gm_m3_s2,
    )
    return truth, onboard_sequence(spec, camera, trajectory, [sighting for sighting, _ in seen], (seed, trial))


@lru_cache(maxsize=8)
def _undisturbed(spec: SequenceSpec, ground: LandmarkGround) -> CameraTrajectory:
    return nominal_trajectory(spec, ground)


@lru_cache(maxsize=8)
def _population(spec: SequenceSpec, camera: Camera, ground: LandmarkGround) -> float:
    """Return the number of tracks on the whole surface for N in a frame on average, on the nominal orbit."""
    share = Visibility(ground, spec.vision.lit_only).share(_undisturbed(spec, ground).views(camera))
    return spec.vision.landmarks_per_frame / share


def _measure_tracks(
    simulated: SimulatedTracks, poses: Sequence[Pose], camera: Camera, vision: VisionSpec, seed: int, trial: int
) -> list[tuple[FrameTracks, BoolArray]]:
    """Simulate the measurements of each frame; also return, (n,), which tracks are outliers."""
    noise_rng, wrong_rng = generator(seed, Stream.TRACK_NOISE, trial), generator(seed, Stream.MISMATCH, trial)
    seen = []
    previous = np.empty(0, dtype=np.int64)
    again = recognise_landmarks(simulated, vision, generator(seed, Stream.REVISIT, trial))
    errors = vision.track_errors or TrackErrorsSpec()
    drifts = accumulated_errors_px(errors, simulated, poses, camera, generator(seed, Stream.TRACK_ERRORS, trial))
    for tracks, pose, pairs, drift in zip(simulated.seen, poses, again, drifts, strict=True):
        points = simulated.points_m[tracks]
        uv = camera.project(pose.transform(points))
        placed, wrong = _displace_outliers(uv, np.isin(tracks, previous), camera, vision, wrong_rng)
        noisy = placed + vision.noise_px * noise(errors.student_t, uv.shape, noise_rng) + drift
        seen.append((FrameTracks(tracks, noisy, points, pairs), wrong))
        previous = tracks
    return seen


def _displace_outliers(
    uv_px: FloatArray, tracked: BoolArray, camera: Camera, vision: VisionSpec, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """Move some tracked points to the nearest other point or anywhere in the image; new tracks are not changed."""
    # Drawn for all tracks, so that the shares do not shift the stream.
    luck, anywhere = rng.uniform(size=len(uv_px)), rng.uniform(size=uv_px.shape) * [camera.width_px, camera.height_px]
    # One number decides both: mismatches at its low end, outliers at its high end.
    mismatched = tracked & (luck < vision.mismatch_share) & (len(uv_px) > 1)
    outlying = tracked & ~mismatched & (luck > 1.0 - vision.outlier_share)
    placed = np.where(outlying[:, None], anywhere, uv_px)
    if mismatched.any():
        apart = np.linalg.norm(uv_px[:, None] - uv_px, axis=2)
        # Not the point itself.
        np.fill_diagonal(apart, np.inf)
        placed[mismatched] = uv_px[apart.argmin(axis=1)[mismatched]]
    return placed, mismatched | outlying
