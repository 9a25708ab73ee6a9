"""Real tracks of files: what is read, what a trial draws of it, what is refused; and the tracks of Dawn at Vesta."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from mission_data import data_file, needs_data
from scipy.io import savemat
from slam_sequences import CAMERA
from track_tables import make_world

from boresight.campaign.imaging.real_images import images_digest, open_tracks
from boresight.campaign.kinds.sequence import ground_of
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import digest, load_scenario
from boresight.scenarios.sequences import draw_real_sequence
from boresight.scenarios.spec.tables import read_table

WORLD = make_world()


def drawn(scene, trial=0, *overrides):
    loaded = load_scenario(str(scene), overrides)
    camera = loaded.spec.camera.camera().pinhole
    return draw_real_sequence(loaded.spec.sequence, open_tracks(loaded), camera, ground_of(loaded), (3, trial))


def of_file(uv_px):
    """Return track and frame in the file of sightings that are known by their pixels."""
    file = WORLD.sightings
    rows = [int(np.abs(file[["u_px", "v_px"]].to_numpy() - uv).sum(axis=1).argmin()) for uv in uv_px]
    return file["track"].to_numpy()[rows], file["frame"].to_numpy()[rows]


def test_landmarks_of_exact_sightings_are_where_they_were_made(tmp_path):
    table = open_tracks(load_scenario(str(WORLD.write(tmp_path))))
    seen = np.unique(WORLD.sightings["track"])
    np.testing.assert_allclose(table.points_m, WORLD.points_m[seen], atol=1e-7)
    np.testing.assert_array_equal(table.frames, WORLD.sightings["frame"])


def test_a_trial_has_sightings_of_the_file_and_a_lost_number_never_comes_back(tmp_path):
    scene = WORLD.write(tmp_path)
    truth, sequence = drawn(scene)
    assert len(sequence.frames) == len(WORLD.positions_m)
    known, lost, files = set(), set(), {}
    for index, (pose, frame) in enumerate(zip(truth.poses, sequence.frames, strict=True)):
        np.testing.assert_allclose(pose.camera_position_m, WORLD.positions_m[index], atol=1e-9)
        np.testing.assert_allclose(frame.R_cam_body, WORLD.rotations[index], atol=1e-12)
        tracks, frames = of_file(frame.uv_px)
        assert (frames == index).all()
        assert len(frame.tracks) <= 12
        assert (np.diff(frame.tracks) > 0).all()
        here = set(frame.tracks.tolist())
        assert not here & lost
        lost |= known - here
        known |= here
        for number, track in zip(frame.tracks.tolist(), tracks.tolist(), strict=True):
            assert files.setdefault(number, track) == track
        np.testing.assert_allclose(truth.points_m[frame.tracks], WORLD.points_m[tracks], atol=1e-7)
        assert not truth.wrong[index].any()
        assert not len(frame.again)
    assert {number for frame in sequence.frames for number in frame.tracks.tolist()} == set(range(len(truth.points_m)))
    other = drawn(scene, 1)[1]
    assert not np.array_equal(other.frames[0].uv_px, sequence.frames[0].uv_px), "another trial has other tracks"
    np.testing.assert_array_equal(drawn(scene)[1].frames[3].uv_px, sequence.frames[3].uv_px)


def test_a_new_track_is_seen_in_the_next_frame_too(tmp_path):
    sequence = drawn(WORLD.write(tmp_path))[1]
    before = set()
    for one, other in pairwise(sequence.frames):
        new = set(one.tracks.tolist()) - before
        assert new <= set(other.tracks.tolist())
        before |= new


def test_a_track_that_comes_back_is_a_new_one_and_recognised_if_wanted(tmp_path):
    scene = WORLD.write(tmp_path)
    truth, sequence = drawn(scene, 0, "sequence.tracks.loops=true", "sequence.tracks.per_frame=60")
    pairs = np.concatenate([frame.again for frame in sequence.frames])
    assert len(pairs) > 3
    np.testing.assert_array_equal(truth.points_m[pairs[:, 0]], truth.points_m[pairs[:, 1]])
    assert all(len(frame.again) == 0 for index, frame in enumerate(sequence.frames) if index != 5)


def test_a_wrong_sighting_is_marked_for_scores(tmp_path):
    world = make_world()
    # In a long track, whose other sightings hold the landmark in place.
    longest = world.sightings["track"].value_counts().idxmax()
    row = world.sightings.index[world.sightings["track"] == longest][3]
    world.sightings.loc[row, "u_px"] += 20.0
    truth, sequence = drawn(world.write(tmp_path), 0, "sequence.tracks.per_frame=60")
    wrong = [
        (index, float(frame.uv_px[k, 0]))
        for index, frame in enumerate(sequence.frames)
        for k in np.flatnonzero(truth.wrong[index])
    ]
    assert (int(world.sightings["frame"][row]), pytest.approx(world.sightings["u_px"][row])) in wrong


def test_frames_are_a_window_that_is_drawn_or_given(tmp_path):
    scene = WORLD.write(tmp_path)
    starts = set()
    for trial in range(30):
        truth, sequence = drawn(scene, trial, "sequence.tracks.frames=7")
        assert len(sequence.frames) == 7
        gaps = np.linalg.norm(WORLD.positions_m - truth.poses[0].camera_position_m, axis=1)
        starts.add(int(gaps.argmin()))
        np.testing.assert_allclose(sequence.position_m, truth.poses[0].camera_position_m)
    assert starts == {0, 1, 2}
    truth, sequence = drawn(scene, 5, "sequence.tracks.first_frame=6")
    np.testing.assert_allclose(truth.poses[0].camera_position_m, WORLD.positions_m[6], atol=1e-9)
    assert len(sequence.frames) == 3
    assert truth.trajectory.times_s.tolist() == [0.0, 60.0, 120.0]


def test_ranges_are_to_the_shape_and_sigmas_are_told(tmp_path):
    scene = WORLD.write(tmp_path)
    exact = (
        "sequence.knowledge.range_sigma_m=1e-6",
        "sequence.knowledge.range_every=4",
        "sequence.tracks.sigma_px=0.7",
    )
    truth, sequence = drawn(scene, 0, *exact)
    for index, frame in enumerate(sequence.frames):
        assert len(frame.ranges) == (index % 4 == 0)
        assert frame.sigma_px == 0.7
        for measured in frame.ranges:
            apart = np.linalg.norm(truth.points_m[measured.track] - truth.poses[index].camera_position_m)
            # The shape is a sphere of facets, below the landmarks by less than this.
            assert 0.0 <= measured.range_m - apart < 1.0


def test_pixels_normalised_coordinates_parquet_and_matlab_are_the_same(tmp_path):
    scene = WORLD.write(tmp_path)
    wanted = open_tracks(load_scenario(str(scene)))
    rays = (WORLD.sightings[["u_px", "v_px"]] - [CAMERA.cx_px, CAMERA.cy_px]) / [CAMERA.fx_px, CAMERA.fy_px]
    normalised = WORLD.sightings[["track", "frame"]].assign(x_normalised=rays["u_px"], y_normalised=rays["v_px"])
    normalised.sample(frac=1.0, random_state=1).sort_values("frame").to_parquet(tmp_path / "rays.parquet")
    WORLD.poses.to_parquet(tmp_path / "poses.parquet")
    WORLD.write_matlab(tmp_path)
    for table, poses in (("rays.parquet", "poses.parquet"), ("tracks.mat", "poses.mat")):
        other = load_scenario(str(scene), (f"sequence.tracks.table={table}", f"sequence.tracks.poses={poses}"))
        found = open_tracks(other)
        np.testing.assert_array_equal(found.tracks, wanted.tracks)
        np.testing.assert_array_equal(found.frames, wanted.frames)
        np.testing.assert_allclose(found.rays, wanted.rays, atol=1e-13)
        np.testing.assert_allclose(found.points_m, wanted.points_m, atol=1e-6)
        np.testing.assert_allclose(found.states.position_m, wanted.states.position_m, atol=1e-9)
        np.testing.assert_allclose(np.abs(np.sum(np.multiply(found.states.attitude, wanted.states.attitude), 1)), 1.0)


def test_content_and_not_the_name_decides_about_the_digest(tmp_path):
    scene = WORLD.write(tmp_path)
    before = images_digest(load_scenario(str(scene)))
    (tmp_path / "more.csv").write_text((tmp_path / "tracks.csv").read_text())
    assert images_digest(load_scenario(str(scene), ("sequence.tracks.table=more.csv",))) == before
    make_world(frames=8).write(tmp_path)
    assert images_digest(load_scenario(str(scene))) != before
    assert len(open_tracks(load_scenario(str(scene))).states) == 8


def test_scenarios_without_real_tracks_have_the_digest_of_before():
    assert "tracks" not in load_scenario("apophis-sphere-sequence").spec.sequence.model_dump()
    assert len(digest(load_scenario("apophis-sphere-sequence").spec)) == 64


TABLES = {
    "track": ("track,u_px,v_px\n1,2,3\n", "no column frame; it has track, u_px, v_px"),
    "column": ("track,frame,u_px\n1,0,3\n1,1,4\n", "no column v_px; it has track, frame, u_px"),
    "nan": ("track,frame,u_px,v_px\n1,0,3,4\n1,1,nan,4\n", r"row 1 \(from 0\) of u_px, v_px is not all numbers"),
    "text": ("track,frame,u_px,v_px\n1,0,3,4\n1,1,x,4\n", "could not convert string to float: 'x'"),
    "empty": ("track,frame,u_px,v_px\n", "it has no sightings"),
    "half": ("track,frame,u_px,v_px\n1,0,3,4\n1,0.5,5,4\n", r"row 1 \(from 0\): track and frame must be whole numbers"),
    "huge": (
        "track,frame,u_px,v_px\n1e25,0,3,4\n1,1,5,4\n",
        r"row 0 \(from 0\): track and frame must be whole numbers",
    ),
    "negative": ("track,frame,u_px,v_px\n1,-1,3,4\n1,1,5,4\n", r"row 0 \(from 0\): frame -1 is none of the 9 poses"),
    "late": ("track,frame,u_px,v_px\n1,0,3,4\n1,9,5,4\n", r"row 1 \(from 0\): frame 9 is none of the 9 poses, from 0"),
    "unsorted": (
        "track,frame,u_px,v_px\n1,3,3,4\n2,0,1,1\n1,2,5,4\n",
        r"row 2 \(from 0\): track 1 is in frame 2 after frame 3: sort the table by frame",
    ),
    "doubled": (
        "track,frame,u_px,v_px\n4,3,3,4\n2,0,1,1\n4,3,5,4\n",
        r"row 2 \(from 0\): track 4 is in frame 3 after frame 3: .* one row for each sighting",
    ),
    "single": ("track,frame,u_px,v_px\n1,0,3,4\n1,2,5,4\n7,3,8,9\n", "track 7 has one sighting: leave such tracks out"),
    "both": ("track,frame,u_px,v_px,x_normalised\n1,0,3,4,0\n", "sightings are given in pixels and normalised"),
}


@pytest.mark.parametrize("name", TABLES)
def test_wrong_tables_of_tracks_are_one_line(tmp_path, name):
    content, said = TABLES[name]
    scene = WORLD.write(tmp_path)
    (tmp_path / "tracks.csv").write_text(content)
    with pytest.raises(
        BoresightError, match=r"scene.yaml: sequence.tracks.table: tracks.csv cannot .*" + said
    ) as error:
        open_tracks(load_scenario(str(scene)))
    assert "\n" not in str(error.value)


POSES = {
    "unsorted": (lambda poses: poses.iloc[[0, 2, 1]], r"time_s 60 of row 2 \(from 0\) is not after the one before"),
    "doubled": (lambda poses: poses.iloc[[0, 1, 1]], r"time_s 60 of row 2 \(from 0\) is not after the one before"),
    "nan": (lambda poses: poses.replace(120.0, np.nan), "is not all numbers"),
    "no attitude": (lambda poses: poses[["time_s", "x_m", "y_m", "z_m"]], "no columns qw, qx, qy, qz"),
    "one": (lambda poses: poses.iloc[:1], "a sequence needs two poses at least"),
}


@pytest.mark.parametrize("name", POSES)
def test_wrong_tables_of_poses_are_one_line(tmp_path, name):
    change, said = POSES[name]
    scene = WORLD.write(tmp_path)
    change(WORLD.poses).to_csv(tmp_path / "poses.csv", index=False)
    with pytest.raises(BoresightError, match=r"scene.yaml: sequence.tracks.poses: poses.csv cannot .*" + said) as error:
        open_tracks(load_scenario(str(scene)))
    assert "\n" not in str(error.value)


def test_a_camera_that_stays_gives_no_landmark(tmp_path):
    world = make_world()
    scene = world.write(tmp_path)
    world.poses.assign(x_m=790.0, y_m=0.0, z_m=0.0).to_csv(tmp_path / "poses.csv", index=False)
    world.sightings.assign(u_px=500.0, v_px=500.0).to_csv(tmp_path / "tracks.csv", index=False)
    poses = pd.read_csv(tmp_path / "poses.csv")
    poses[["qw", "qx", "qy", "qz"]] = poses[["qw", "qx", "qy", "qz"]].iloc[0].to_numpy()
    poses.to_csv(tmp_path / "poses.csv", index=False)
    with pytest.raises(BoresightError, match=r"\d+ tracks have no parallax, the first in frame 0"):
        open_tracks(load_scenario(str(scene)))


SPECS = {
    "sequence.vision.noise_px=1": "vision has no part where tracks have path and sightings",
    "sequence.images={}": "images has no part where tracks have path and sightings",
    "sequence.body_motion.kind=spin": "body_motion has no part where tracks have path and sightings",
    "sequence.knowledge.dynamics=true": "knowledge.dynamics has no part where tracks have path and sightings",
    "sequence.sphere_radius_m=190": "sphere_radius_m: real tracks are of a body",
    "sequence.tracks.sigma_px=-1": "sigma_px",
    "sequence.tracks.per_frame=2": "per_frame",
}


@pytest.mark.parametrize("override", SPECS)
def test_keys_that_tracks_leave_no_part_for_are_refused(tmp_path, override):
    scene = WORLD.write(tmp_path)
    with pytest.raises(BoresightError, match=SPECS[override]):
        load_scenario(str(scene), (override,))


@pytest.mark.parametrize("other", ["orbit: {step_deg: 4}", "trajectory: {table: poses.csv}"])
def test_tracks_have_the_path_alone(tmp_path, other):
    scene = WORLD.write(tmp_path)
    scene.write_text(scene.read_text() + f"  {other}\n")
    with pytest.raises(BoresightError, match=f"sequence: give either {other.split(':')[0]} or tracks, not both"):
        load_scenario(str(scene))


def test_more_frames_than_there_are_are_refused(tmp_path):
    scene = WORLD.write(tmp_path)
    for override, said in (("frames=10", "10 frames from frame 0 on"), ("first_frame=8", "2 frames from frame 8 on")):
        with pytest.raises(BoresightError, match=rf"scene.yaml: sequence.tracks: {said} are more than the 9 of poses"):
            open_tracks(load_scenario(str(scene), (f"sequence.tracks.{override}",)))


@pytest.mark.parametrize("content", [b"", b"MATLAB 5.0", b"x" * 300, b"\0" * 128 + b"\x0f\0\0\0\xff\xff\xff\x7f"])
def test_damaged_matlab_files_are_one_line(tmp_path, content):
    (tmp_path / "x.mat").write_bytes(content)
    with pytest.raises(ValueError, match="not readable as a MATLAB file of poses or tracks") as error:
        read_table("x.mat", [tmp_path])
    assert "\n" not in str(error.value)


def test_other_matlab_files_are_refused(tmp_path):
    savemat(tmp_path / "x.mat", {"cam_positions": np.ones((3, 4)), "cam_rots": np.ones((3, 3, 5))})
    savemat(tmp_path / "y.mat", {"other": 1.0})
    for name in ("x.mat", "y.mat"):
        with pytest.raises(ValueError, match="not readable as a MATLAB file of poses or tracks"):
            read_table(name, [tmp_path])


@needs_data()
def test_the_tracks_of_dawn_fit_their_reference_and_the_shape():
    """The conventions of the files: other readings of their signs give residuals of hundreds of pixels."""
    for name in ("vesta_points.mat", "vesta_cam_poses.mat"):
        data_file(f"sequences/dawn_vesta_rc3b/{name}")
    data_file("images/dawn_fc_vesta/vesta_5002.ply")
    loaded = load_scenario("vesta-real-tracks")
    table = open_tracks(loaded)
    assert len(table.states) == 65
    assert len(table.tracks) == 202_082, "208,234 sightings less 6,152 tracks of one"
    truth, sequence = drawn_of(loaded, table)
    residuals = [
        np.linalg.norm(
            loaded.spec.camera.camera().project(pose.transform(truth.points_m[frame.tracks])) - frame.uv_px, axis=1
        )
        for pose, frame in zip(truth.poses, sequence.frames, strict=True)
    ]
    assert np.median(np.concatenate(residuals)) < 1.0
    heights_m = ground_of(loaded).heights_m(table.points_m[:4000])
    assert np.median(np.abs(np.linalg.norm(table.points_m, axis=1) - 265e3)) < 15e3
    assert np.median(np.abs(heights_m)) < 1500.0


def drawn_of(loaded, table):
    spec = loaded.spec
    return draw_real_sequence(spec.sequence, table, spec.camera.camera().pinhole, ground_of(loaded), (3, 0))
