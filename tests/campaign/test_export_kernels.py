"""`boresight export --to spice` and ``--to sum``: SPICE and the reader of SUM files get back what the run holds."""

from __future__ import annotations

import contextlib

import numpy as np
import pandas as pd
import pytest
import spiceypy
from scipy.spatial.transform import Rotation
from tiny_campaign import compute

from boresight.campaign.cli import main
from boresight.campaign.export.kernels import BODY_AXES, Origin, flights_of, write_definitions, write_kernels
from boresight.campaign.export.sumfiles import sigma_km_rad, write_sumfiles
from boresight.campaign.inspection.recompute import Case, recompute, reopened
from boresight.campaign.inspection.show import PosedFrame, PosedFrames
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.score import pose_of
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.spc import read_sumfile

CAMERA, TRUE = "BORESIGHT_CAMERA", "BORESIGHT_TRUE_CAMERA"
SEQUENCE = """\
extends: apophis-sphere-sequence
sequence:
  orbit: {revolutions: 0.25}
  body_motion: {kind: spin, period_h: 30.4, axis_body: [0, 0.2, 1]}
"""
ORBIT = "extends: eros-like-orbit\norbit: {arc: {days: 2, predicted_days: 1}, sightings: {images: 40, craters: 600}}\n"
CAMPAIGN = "title: T\nexperiment: {0}\nscenarios: [scene.yaml]\nestimators: [{1}]\ntrials: 1\nseed: 20030300\n"


def run_of(folder, scene, experiment, estimator):
    (folder / "scene.yaml").write_text(scene, encoding="utf-8")
    (folder / "campaign.yaml").write_text(CAMPAIGN.format(experiment, estimator), encoding="utf-8")
    compute(folder / "campaign.yaml", folder / "run", trials=1)
    return folder / "run"


@pytest.fixture(scope="module")
def sequence(cache, tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("sequence"), SEQUENCE, "sequence", "fixed-lag")


@pytest.fixture(scope="module")
def orbit(cache, tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("orbit"), ORBIT, "orbit-determination", "batch-filter")


def export(run, *arguments):
    return main(["export", str(run), "--out", *map(str, arguments)])


@contextlib.contextmanager
def kernels(folder):
    """Load all kernels of a folder."""
    try:
        spiceypy.furnsh([str(path) for path in sorted(folder.iterdir())])
        yield
    finally:
        spiceypy.kclear()


def state_m(name, et, centre="BORESIGHT_BODY"):
    return 1e3 * np.array(spiceypy.spkezr(name, et, "J2000", "NONE", centre)[0])


def test_spice_finds_the_stored_positions_and_attitudes_of_a_sequence(sequence, tmp_path):
    assert export(sequence, tmp_path / "spice", "--to", "spice") == 0
    assert export(sequence, tmp_path / "tum", "--to", "tum") == 0
    stem = "scene_fixed-lag_0000000"
    expected = {"boresight.tf", *(f"{stem}.{which}.{end}" for which in ("truth", "estimate") for end in ("bsp", "bc"))}
    assert {path.name for path in (tmp_path / "spice").iterdir()} == expected
    epochs = pd.read_parquet(sequence / "epochs").to_dict("records")
    poses = {w: np.loadtxt(tmp_path / "tum" / f"{stem}.{w}.tum") for w in ("truth", "estimate")}
    with kernels(tmp_path / "spice"):
        for row, *lines in zip(epochs, poses["truth"], poses["estimate"], strict=True):
            for name, prefix, line in ((TRUE, "true_", lines[0]), (CAMERA, "", lines[1])):
                place = state_m(name, row["time_s"])[:3]
                # Of the interpolation at a node and of kilometres the last bits may differ.
                np.testing.assert_allclose(place, [row[f"{prefix}{axis}_m"] for axis in "xyz"], atol=2e-12)
                turn = spiceypy.pxform(name, "J2000", row["time_s"])
                np.testing.assert_allclose(turn, Rotation.from_quat(line[4:]).as_matrix(), atol=1e-14)
            difference = np.linalg.norm(state_m(CAMERA, row["time_s"], TRUE)[:3])
            assert difference == pytest.approx(row["position_error_m"], abs=1e-6)


def test_between_frames_spice_finds_the_circle_and_its_speed(sequence, tmp_path):
    assert export(sequence, tmp_path, "--to", "spice") == 0
    times_s = pd.read_parquet(sequence / "epochs")["time_s"].to_numpy()
    with kernels(tmp_path):
        first = state_m(TRUE, times_s[0])
        radius_m, speed_m_s = np.linalg.norm(first[:3]), np.linalg.norm(first[3:])
        for et in (times_s[3:-4] + times_s[4:-3]) / 2.0:
            state, turn = state_m(TRUE, et), np.array(spiceypy.pxform("J2000", TRUE, et))
            assert np.linalg.norm(state[:3]) == pytest.approx(radius_m, rel=1e-6)
            assert np.linalg.norm(state[3:]) == pytest.approx(speed_m_s, rel=1e-2)
            assert abs(state[:3] @ state[3:]) < 1e-3 * radius_m * speed_m_s
            # The camera looks at the centre.
            np.testing.assert_allclose(turn @ state[:3], [0.0, 0.0, -radius_m], atol=1e-4 * radius_m)


def test_body_and_time_are_those_that_are_asked_for(sequence, tmp_path):
    assert export(sequence, tmp_path, "--to", "spice", "--body-id", 2000433, "--start-et", 6e8) == 0
    row = pd.read_parquet(sequence / "epochs").to_dict("records")[7]
    with kernels(tmp_path):
        place = state_m(CAMERA, 6e8 + row["time_s"], "2000433")[:3]
        np.testing.assert_allclose(place, [row[f"{axis}_m"] for axis in "xyz"], rtol=1e-9)
        assert spiceypy.sce2c(-999, 6e8 + 1.0) == 65536.0
        assert spiceypy.pxform("J2000", CAMERA, 6e8 + row["time_s"]).shape == (3, 3)


def test_spice_finds_the_determined_orbit(orbit, tmp_path):
    assert export(orbit, tmp_path, "--to", "spice") == 0
    stem = "scene_batch-filter_0000000"
    names = {"boresight.tf", f"{stem}.truth.bsp", f"{stem}.estimate.bsp", f"{stem}.estimate.bc"}
    assert {path.name for path in tmp_path.iterdir()} == names
    folder = RunFolder(orbit)
    shown = recompute(reopened(folder), folder, Case("scene", "batch-filter", 0)).shown
    found, pictures = shown.estimate.orbit, shown.observation.pictures
    errors = pd.read_parquet(orbit / "orbit_errors").to_dict("records")
    with kernels(tmp_path):
        for i, (et, row) in enumerate(zip(shown.observation.wanted_s, errors, strict=True)):
            state = state_m(CAMERA, et)
            np.testing.assert_allclose(state[:3], found.positions_m[i], rtol=1e-14)
            np.testing.assert_allclose(state[3:], found.velocities_m_s[i], rtol=1e-14)
            difference = np.linalg.norm(state_m(CAMERA, et, TRUE)[:3])
            assert difference == pytest.approx(row["position_error_m"], rel=1e-9)
        for et, matrix in zip(pictures.times_s, pictures.R_cam_inertial, strict=True):
            np.testing.assert_allclose(spiceypy.pxform("J2000", CAMERA, et), matrix, atol=1e-9)


STATES = """\
extends: apophis-sphere-sequence
sequence:
  trajectory: {table: way.csv}
  body_motion: {kind: spin, period_h: 30.4, axis_body: [0, 0.2, 1]}
"""


def test_a_sequence_along_a_table_has_its_epochs(cache, tmp_path):
    times_s = [-600.25, -300.0, 0.0, 150.5, 400.0]
    lines = ["time_s,x_m,y_m,z_m", *(f"{time_s},790,{0.1 * time_s},5" for time_s in times_s)]
    (tmp_path / "way.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    run = run_of(tmp_path, STATES, "sequence", "dead-reckoning")
    assert export(run, tmp_path / "tum", "--to", "tum") == 0
    lines = np.loadtxt(tmp_path / "tum" / "scene_dead-reckoning_0000000.truth.tum")
    assert lines[:, 0].tolist() == times_s
    for number, start_et in enumerate((0.0, 6e8)):
        out = tmp_path / f"spice{number}"
        assert export(run, out, "--to", "spice", "--start-et", start_et) == 0
        with kernels(out):
            cover = spiceypy.spkcov(str(out / "scene_dead-reckoning_0000000.truth.bsp"), -998)
            assert list(spiceypy.wnfetd(cover, 0)) == [start_et - 600.25, start_et + 400.0]
            for line in lines:
                np.testing.assert_allclose(state_m(TRUE, start_et + line[0])[:3], line[1:4], atol=1e-9)
                turn = spiceypy.pxform(TRUE, "J2000", start_et + line[0])
                np.testing.assert_allclose(turn, Rotation.from_quat(line[4:]).as_matrix(), atol=1e-10)


def frames(times_s):
    rng = np.random.default_rng(4)
    none = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    poses = [
        [Pose(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3), from_frame="inertial") for _ in range(2)]
        for _ in times_s
    ]
    return [PosedFrame("", time_s, *both, *none) for time_s, both in zip(times_s, poses, strict=True)]


def test_one_frame_has_an_attitude_and_no_trajectory_and_none_has_no_files(tmp_path):
    written = write_kernels("a", flights_of(frames([5.0])), Origin(), tmp_path)
    assert [path.name for path in written] == ["a.truth.bc", "a.estimate.bc"]
    assert write_kernels("b", flights_of([]), Origin(), tmp_path) == []


@pytest.mark.parametrize("count", [2, 3, 4, 9])
def test_few_states_and_any_names_are_written(tmp_path, count):
    path, seen = frames(np.arange(count) + 0.1), write_definitions(Origin(), tmp_path)
    written = write_kernels("long name, \u00e4 " * 5, flights_of(path), Origin(), tmp_path)
    assert seen.exists()
    assert len(written) == 4
    with kernels(tmp_path):
        for frame in path:
            np.testing.assert_allclose(state_m(CAMERA, frame.time_s)[:3], frame.estimated.camera_position_m, rtol=4e-15)


def test_times_that_do_not_ascend_are_refused_and_leave_no_file(tmp_path):
    flights = flights_of(frames([0.0, 1.0, 1.0, 2.0]))
    with pytest.raises(BoresightError, match="an SPK needs times that ascend"):
        write_kernels("a", flights, Origin(), tmp_path)
    with pytest.raises(BoresightError, match="an SPK needs times that ascend"):
        write_kernels("a", flights_of(frames([0.0, 1e-7])), Origin(et=1e10), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_spice_refuses_is_one_line_and_leaves_no_file(tmp_path):
    for _ in range(2):  # the first file is closed
        with pytest.raises(BoresightError, match=r"INVALIDSCLKTIME.* is negative") as refused:
            write_kernels("a", flights_of(frames([-1.0])), Origin(), tmp_path)
    assert "\n" not in str(refused.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--to", "spice"), "images have no epochs, or one, and make no trajectory: export them with --to tum"),
        (("--to", "tum", "--start-et", "5"), "--body-id, --start-et: of SPICE kernels alone"),
        (("--to", "spice", "--start-et", "nan"), "nan is not from"),
        (("--to", "spice", "--body-id", "99999999999"), "99999999999 is no number of NAIF"),
    ],
)
def test_what_kernels_cannot_have_is_refused(tiny_run, tmp_path, capsys, arguments, message):
    try:
        code = export(tiny_run.folder, tmp_path / "out", *arguments)
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_sequences_and_orbits_name_the_formats_that_they_have(sequence, orbit, tmp_path, capsys):
    for run, kind, message in (
        (sequence, "sum", "sequence have no SUM files: export them with --to tum, colmap or spice"),
        (orbit, "tum", "have no poses of images: export them with --to spice, csv, parquet or latex"),
    ):
        assert export(run, tmp_path, "--to", kind) == 2
        assert message in " ".join(capsys.readouterr().err.split())


@pytest.fixture(scope="module")
def flyby(cache, tmp_path_factory):
    """Five single images along a flyby and a second pass over the same states, with a prior for each."""
    folder = tmp_path_factory.mktemp("flyby")
    scene = "extends: quickstart\nviewpoint:\n  trajectory:\n    flyby: {periapsis_m: 2000, v_infinity_m_s: 0.1,"
    scene += " gm_m3_s2: 4.9, duration_s: 600, step_s: 200}\n"
    (folder / "scene.yaml").write_text(scene, encoding="utf-8")
    (folder / "campaign.yaml").write_text(CAMPAIGN.format("single-image", "prior"), encoding="utf-8")
    compute(folder / "campaign.yaml", folder / "run", trials=10)
    return folder / "run"


def test_spice_finds_single_images_in_the_axes_of_the_body(flyby, tmp_path):
    assert export(flyby, tmp_path, "--to", "spice", "--trial", 0, 1, 2, 3, 4) == 0
    rows = RunFolder(flyby).table("rows").set_index("trial").loc[:4]
    assert rows["time_s"].tolist() == [-300.0, -150.0, 0.0, 150.0, 300.0]
    with kernels(tmp_path):
        for row in rows.to_dict("records"):
            for name, prefix in ((CAMERA, ""), (TRUE, "true_")):
                pose = pose_of(row, prefix)
                state_km, _ = spiceypy.spkezr(name, row["time_s"], BODY_AXES, "NONE", "BORESIGHT_BODY")
                np.testing.assert_allclose(1e3 * state_km[:3], pose.camera_position_m, rtol=1e-12)
                turn = spiceypy.pxform(BODY_AXES, name, row["time_s"])
                np.testing.assert_allclose(turn, pose.rotation, atol=1e-12)


def test_two_images_of_one_epoch_are_no_trajectory(flyby, tmp_path, capsys):
    assert export(flyby, tmp_path / "out", "--to", "spice") == 2
    assert "trials have one epoch: name one of each epoch by --trial" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


# --- `boresight export --to sum` --------------------------------------------------------------------------------------


def test_the_reader_of_sum_files_gets_the_estimates_back(tiny_run, tmp_path):
    arguments = ("--estimator", "landmark-harris", "--trial", 0, 1, 2)
    assert export(tiny_run.folder, tmp_path, "--to", "sum", *arguments) == 0
    rows = pd.read_parquet(tiny_run.folder / "rows").query("estimator == 'landmark-harris' and trial < 3")
    solved = rows[rows["status"] == "ok"].to_dict("records")
    files = sorted((tmp_path / "scene_landmark-harris").iterdir())
    assert [path.name for path in files] == [f"{row['trial']:07d}.SUM" for row in solved]
    marks, folder = pd.read_parquet(tiny_run.folder / "landmarks"), RunFolder(tiny_run.folder)
    for path, row in zip(files, solved, strict=True):
        found, pose = read_sumfile(path), pose_of(row)
        shown = recompute(reopened(folder), folder, Case("scene", "landmark-harris", row["trial"])).shown
        camera = shown.observation.camera
        np.testing.assert_allclose(found.T_cam_body.rotation, pose.rotation, atol=1e-10)
        np.testing.assert_allclose(found.T_cam_body.translation_m, pose.translation_m, atol=1e-6)
        sun = pose.rotation.T @ shown.observation.frame.sun_dir_cam
        np.testing.assert_allclose(found.sun_dir_body, sun, atol=1e-9)
        assert found.time_s == row["trial"]
        points = np.array([[0.0, 0.0, 0.0], [100.0, -50.0, 80.0]])
        ours, theirs = camera.project(pose.transform(points)), found.camera.project(pose.transform(points))
        np.testing.assert_allclose(theirs, ours, atol=1e-5)
        lines = path.read_text().splitlines()
        own = marks[(marks["estimator"] == "landmark-harris") & (marks["trial"] == row["trial"])]
        table = [line.split() for line in lines[lines.index("LANDMARKS") + 1 : lines.index("LIMB FITS")]]
        assert [int(cells[0]) for cells in table] == sorted(own["landmark"])
        # The centre of the first pixel is (1, 1) there.
        seen = own.sort_values("landmark")[["u_px", "v_px"]].to_numpy() + 0.5
        np.testing.assert_allclose([[float(c) for c in cells[1:]] for cells in table], seen, atol=0.005001)
        sigma = {line.split()[-1]: line.split()[:3] for line in lines if "SIGMA" in line}
        attitude = [float(text.replace("D", "E")) for text in sigma["SIGMA_PTG"]]
        assert np.degrees(np.linalg.norm(attitude)) == pytest.approx(row["attitude_sigma_deg"], rel=1e-9)


def test_sigmas_of_a_sum_file_are_the_spread_of_drawn_poses():
    rng = np.random.default_rng(7)
    pose = Pose(Rotation.random(rng=rng).as_matrix(), np.array([30.0, -20.0, 2000.0]))
    root = rng.normal(size=(6, 6)) * np.array([1e-4, 1e-4, 1e-4, 1.0, 2.0, 3.0])[:, None]
    drawn = rng.normal(size=(20_000, 6)) @ root.T
    vectors = []
    for step in drawn:
        moved = pose.perturbed(step[:3], step[3:])
        vectors.append(moved.rotation.T @ moved.translation_m / 1e3)
    expected = np.concatenate([np.std(vectors, axis=0), np.std(drawn[:, :3], axis=0)])
    # A standard deviation of 20,000 draws is within 0.5 %; four times that.
    np.testing.assert_allclose(sigma_km_rad(pose, root @ root.T), expected, rtol=0.02)


def test_a_camera_of_two_focal_lengths_and_an_epoch_are_kept(tmp_path):
    pose = Pose(Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(), np.array([0.0, 1.0, 500.0]))
    camera = Camera(1024, 512, 4321.0, 4123.4, 510.2, 250.7)
    frame = PosedFrame(
        "../b.c.fits", 606_000_083.9614, pose, pose, np.array([3]), np.array([[0.5, 9.25]]), np.array([0.0, 0.0, -1.0])
    )
    nameless = PosedFrame("a.png", 0.0, pose, pose, np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    (path,) = write_sumfiles(PosedFrames(camera, [frame, nameless], {}), tmp_path)
    assert path == tmp_path / "b.c.SUM"
    found = read_sumfile(path)
    assert found.time_s == pytest.approx(606_000_083.961, abs=1e-6)
    np.testing.assert_allclose([found.camera.fx_px, found.camera.fy_px], [4321.0, 4123.4], rtol=1e-7)
    assert (found.camera.cx_px, found.camera.cy_px) == pytest.approx((510.2, 250.7), abs=1e-7)
    assert (found.camera.width_px, found.camera.height_px) == (1024, 512)
    text = path.read_text()
    assert "000003      1.00      9.75\n" in text
    assert all(line.split()[:3] == ["0.0000000000D+00"] * 3 for line in text.splitlines() if "SIGMA" in line)
    late = PosedFrame("a.png", 1e13, pose, pose, frame.landmarks, frame.uv_px, frame.sun_dir_cam)
    with pytest.raises(BoresightError, match="is no time of a SUM file"):
        write_sumfiles(PosedFrames(camera, [late], {}), tmp_path)
