"""Errors of a real tracker that accumulate along a track: a random walk, and a field common to all landmarks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.sequences.track_simulation import SimulatedTracks
from boresight.scenarios.spec.sequence import TrackErrorsSpec


def accumulated_errors_px(
    errors: TrackErrorsSpec, simulated: SimulatedTracks, poses: Sequence[Pose], camera: Camera, rng: np.random.Generator
) -> Iterator[FloatArray]:
    """Yield for each frame, (n, 2), the walk and the field of its tracks; both are zero where a track begins.

    From frame to frame a pixel takes a random step. The point that a track follows moves by ``a (s . n) n``, n its
    outward unit normal in camera axes; the vector ``a s``, fixed in camera axes, is drawn for the sequence with a
    standard deviation of ``field_m`` along each axis.
    """
    field_m = errors.field_m * rng.normal(size=3)
    walk, moved_m = np.zeros((len(simulated.points_m), 2)), np.zeros_like(simulated.points_m)
    previous = np.empty(0, dtype=np.int64)
    for tracks, pose in zip(simulated.seen, poses, strict=True):
        # Drawn for all tracks, so that it does not matter which go on.
        steps = errors.walk_px * noise(errors.student_t, (len(tracks), 2), rng)
        old = np.isin(tracks, previous)
        walk[tracks[old]] += steps[old]
        normals = simulated.normals[tracks[old]]
        moved_m[tracks[old]] += ((normals @ pose.rotation.T) @ field_m)[:, None] * normals
        points = simulated.points_m[tracks]
        seen, true = (camera.project(pose.transform(place)) for place in (points + moved_m[tracks], points))
        yield walk[tracks] + seen - true
        previous = tracks


def noise(student_t: float | None, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Draw errors of unit standard deviation: normal, or Student's t of so many degrees of freedom, scaled."""
    if student_t is None:
        return rng.normal(size=shape)
    return np.asarray(rng.standard_t(student_t, size=shape) * np.sqrt(1.0 - 2.0 / student_t), dtype=np.float64)
