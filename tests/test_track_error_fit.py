"""The fit of the errors of tracks, on tracks that are simulated with known ones."""

from __future__ import annotations

import numpy as np
import pytest
from adjustment.track_errors import Runs, common_steps, fit_common, fit_random, jackknife, mean_drifts
from scipy.spatial.transform import Rotation

from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import load_scenario
from boresight.scenarios.sequences import SphereGround, draw_sequence
from boresight.scenarios.sequences.track_table import TrackTable
from boresight.scenarios.spec.trajectory import StatesSpec

CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))


def table_of(errors):
    """Tracks of 31 frames as they are read from files; landmarks are 2 m off."""
    vision = f"{{landmarks_per_frame: 300, repeatability: 0.95, noise_px: 0.5, track_errors: {errors}}}"
    stated = (f"sequence.vision={vision}", "sequence.orbit.step_deg=3", "sequence.orbit.revolutions=0.25")
    spec = load_scenario("apophis-sphere-sequence", stated).spec.sequence
    truth, sequence = draw_sequence(spec, CAMERA, SphereGround(190.0), 5, 0)
    states = StatesSpec(
        time_s=tuple(map(float, range(len(truth.poses)))),
        position_m=tuple(tuple(pose.camera_position_m.tolist()) for pose in truth.poses),
        attitude=tuple(
            tuple(Rotation.from_matrix(pose.rotation).as_quat(scalar_first=True).tolist()) for pose in truth.poses
        ),
    )
    frames = sequence.frames
    tracks = np.concatenate([frame.tracks for frame in frames])
    numbers = np.repeat(np.arange(len(frames)), [len(frame.tracks) for frame in frames])
    rays = (np.concatenate([frame.uv_px for frame in frames]) - 512.0) / CAMERA.fx_px
    order = np.lexsort((numbers, tracks))
    off_m = np.random.default_rng(1).normal(0.0, 2.0, truth.points_m.shape)
    return TrackTable(states, tracks[order], numbers[order], rays[order], truth.points_m + off_m)


def test_the_fit_finds_the_errors_that_tracks_were_simulated_with():
    table = table_of("{walk_px: 0.3, student_t: 4, contraction: 1.0e-3}")
    runs = Runs.of(table, CAMERA, 0, len(table.states))
    found, sigma = jackknife(runs, fit_common)
    assert sigma[0] < 3e-4
    assert np.all(np.abs(found - [1e-3, 0.0, 0.0]) < 4.0 * sigma)
    noise_px, walk_px, student_t = fit_random(runs, found)
    assert noise_px == pytest.approx(0.5, rel=0.1)
    assert walk_px == pytest.approx(0.3, rel=0.2)
    assert 3.0 < student_t < 6.0


def test_tracks_without_common_errors_have_none():
    table = table_of("{walk_px: 0.3}")
    found, sigma = jackknife(Runs.of(table, CAMERA, 0, len(table.states)), fit_common)
    assert np.all(np.abs(found) < 4.0 * sigma)


def test_runs_end_where_a_frame_is_missing_and_where_the_view_hardly_changes():
    table = table_of("{}")
    runs = Runs.of(table, CAMERA, 4, 20)
    assert runs.frame.min() == 4
    assert runs.frame.max() == 19
    assert np.bincount(runs.run).min() == 3
    assert (np.diff(runs.frame)[~runs.starts[1:]] == 1).all()
    position_m = list(table.states.position_m)
    position_m[10] = tuple(np.add(position_m[9], 0.1))
    close = TrackTable(
        table.states.model_copy(update={"position_m": tuple(position_m)}),
        table.tracks,
        table.frames,
        table.rays,
        table.points_m,
    )
    split = Runs.of(close, CAMERA, 4, 20)
    same_run = split.run[1:] == split.run[:-1]
    assert not (same_run & (split.frame[1:] == 10)).any()
    with pytest.raises(ValueError, match="no track is seen in three"):
        Runs.of(table, CAMERA, 4, 6)


def test_mean_drifts_are_outward_and_across_by_place():
    table = table_of("{}")
    runs = Runs.of(table, CAMERA, 0, len(table.states))
    means = mean_drifts(runs, common_steps(runs)[:, :, 0] * 1e-3, 1, 512.0)
    assert (means[:, 0] < 0.0).all(), "a contraction moves inward everywhere"
    assert np.abs(means[1:, 1]).max() < np.abs(means[1:, 0]).min()
