"""`boresight export` of trials that share an image or an epoch, or have a lens: nothing is lost or distorted."""

from __future__ import annotations

from dataclasses import astuple

import cv2
import numpy as np
import pandas as pd
import pytest
import spiceypy
from scipy.spatial.transform import Rotation
from tiny_campaign import compute, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.export import write_model
from boresight.campaign.export.epochs import converted_s, scale_of
from boresight.campaign.inspection.show import PosedFrame, PosedFrames
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.score import pose_of
from boresight.scenarios.geometry import Camera, OpenCVDistortion, Pose
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spc import read_sumfile
from boresight.scenarios.spec.trajectory import SpiceTrajectorySpec

LENS = """\
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3, distortion: %s}
viewpoint: {range_m: 2000}
onboard: {distortion_error: 0.5}
"""
NAMES = ("near/a.png", "far/a.png", "b.png")
REAL = """\
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
images: {folder: set, noise_realisations: 3}
"""
TABLE = """\
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
viewpoint: {trajectory: {table: way.csv}}
"""
TIMES_S = (-600.25, 0.0, 90.5, 200.0)
CAMPAIGN = "scenarios: [scene]\nestimators: [prior]\ntrials: %d\nseed: 1\n"


def run_of(folder, scene, trials):
    file = write_campaign(folder, CAMPAIGN % trials, scene)
    compute(file, folder / "run", trials)
    return folder / "run"


@pytest.fixture(scope="module")
def real(cache, tmp_path_factory):
    """Three images, two of them with names that differ in the folder alone, with three trials each."""
    folder = tmp_path_factory.mktemp("real")
    columns = ["qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"]
    rows = [",".join(["file", "time_s", "sun_body_x", "sun_body_y", "sun_body_z", *(f"ref_{one}" for one in columns)])]
    for number, name in enumerate(NAMES):
        (folder / "set" / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / "set" / name), np.zeros((40, 48), dtype=np.uint8))
        rows.append(f"{name},{600 - 100 * number},0.6,0,-0.8,1,0,0,0,{100 * number},20,2000")
    (folder / "set" / "poses.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return run_of(folder, REAL, 9)


def export(run, kind, out, *arguments):
    assert main(["export", str(run), "--to", kind, "--out", str(out), *map(str, arguments)]) == 0


def names_of_model(folder):
    lines = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
    return [line.split()[-1] for line in lines[::2]]


def test_every_trial_of_an_image_has_a_sum_file_with_its_own_pose(real, tmp_path, capsys):
    export(real, "sum", tmp_path)
    rows = RunFolder(real).table("rows").to_dict("records")
    files = {path.name for path in tmp_path.rglob("*.SUM")}
    assert files == {f"{stem}-t{t + 3 * k:04d}{end}" for k in range(3) for t, stem, end in (
        (0, "a", ".SUM"), (1, "a", ".SUM"), (2, "b", ".SUM"),
    )}  # fmt: skip
    for row in rows:
        found = read_sumfile(tmp_path / "scene_prior" / f"{row['image'][-5]}-t{row['trial']:04d}.SUM")
        np.testing.assert_allclose(found.T_cam_body.translation_m, pose_of(row).translation_m, atol=1e-6)
        assert found.time_s == row["time_s"]


def test_one_trial_of_each_image_keeps_the_names_of_the_images(real, tmp_path):
    for kind in ("sum", "colmap"):
        export(real, kind, tmp_path, "--trial", 3, 4, 5)
    folder = tmp_path / "scene_prior"
    assert names_of_model(folder) == list(NAMES)
    assert {path.name for path in folder.glob("*.SUM")} == {"near-a.png.SUM", "far-a.png.SUM", "b.SUM"}


def test_every_trial_of_an_image_is_an_image_of_a_model(real, tmp_path):
    export(real, "colmap", tmp_path)
    expected = [f"{NAMES[t % 3].removesuffix('.png')}-t{t:04d}.png" for t in range(9)]
    assert names_of_model(tmp_path / "scene_prior") == expected


def test_times_of_a_trajectory_are_unique_and_ascend(real, tmp_path):
    for out, trials, times in (("all", range(9), range(9)), ("once", (0, 1, 2), (400, 500, 600))):
        export(real, "tum", tmp_path / out, "--trial", *trials)
        truth, estimate = (np.loadtxt(tmp_path / out / f"scene_prior.{w}.tum") for w in ("truth", "estimate"))
        assert truth[:, 0].tolist() == estimate[:, 0].tolist() == list(times)
        rows = pd.read_parquet(real / "rows").set_index("trial").loc[list(trials)]
        order = range(len(truth)) if out == "all" else np.argsort(rows["time_s"])
        errors = np.linalg.norm(estimate[:, 1:4] - truth[:, 1:4], axis=1)
        np.testing.assert_allclose(errors, rows["position_error_m"].to_numpy()[order], rtol=1e-9)


@pytest.fixture(scope="module")
def passing(cache, tmp_path_factory):
    """Four states of a table, and the first of them again."""
    folder = tmp_path_factory.mktemp("passing")
    lines = ["time_s,x_m,y_m,z_m", *(f"{time_s},{2000 + 10 * k},{k},5" for k, time_s in enumerate(TIMES_S))]
    (folder / "way.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return run_of(folder, TABLE, 5)


def test_images_along_a_table_have_its_epochs(passing, tmp_path):
    for trials in ((0, 1, 2, 3), (1,)):
        for kind in ("tum", "sum"):
            export(passing, kind, tmp_path / f"{len(trials)}", "--trial", *trials)
        out, times = tmp_path / f"{len(trials)}", [TIMES_S[trial] for trial in trials]
        assert np.loadtxt(out / "scene_prior.estimate.tum", ndmin=2)[:, 0].tolist() == times
        files = [out / "scene_prior" / f"{trial:07d}.SUM" for trial in trials]
        assert [read_sumfile(path).time_s for path in files] == times
    export(passing, "tum", tmp_path)
    assert np.loadtxt(tmp_path / "scene_prior.truth.tum")[:, 0].tolist() == [0, 1, 2, 3, 4]


def test_epochs_of_sum_files_are_utc_and_those_of_kernels_tdb(passing, tmp_path):
    """Images of SUM files, whose SPK begins 64.184 s, as of 1999 to 2005, after their UTC; and back as SUM files."""
    export(passing, "sum", tmp_path, "--trial", 0, 1, 2)
    (tmp_path / "scene_prior").rename(tmp_path / "set")
    listed, times = [], []
    for path in sorted((tmp_path / "set").iterdir()):
        cv2.imwrite(str(path.with_suffix(".png")), np.zeros((40, 48), dtype=np.uint8))
        listed.append(f"{{image: {path.stem}.png, sumfile: {path.name}}}")
        times.append(read_sumfile(path).time_s)
    images = f"images: {{folder: set, sumfiles: [{', '.join(listed)}]}}\n"
    run = run_of(tmp_path, TABLE.partition("viewpoint")[0] + images, 3)
    export(run, "spice", tmp_path / "kernels")
    cover = spiceypy.spkcov(str(next((tmp_path / "kernels").glob("*.estimate.bsp"))), -999)
    np.testing.assert_allclose(spiceypy.wnfetd(cover, 0), np.array(times)[[0, -1]] + 64.184, atol=2e-3)
    export(run, "sum", tmp_path / "again")
    assert sorted(read_sumfile(path).time_s for path in (tmp_path / "again").rglob("*.SUM")) == times


def test_epochs_of_kernels_become_utc():
    """ET of NAIF's leap seconds, naif0012.tls, at 2000-02-25 11:39:12.3545 UTC."""
    assert converted_s(4750816.539787157, "tdb", "utc") == pytest.approx(4750752.3545, abs=1e-5)
    spec = load_scenario("near-eros").spec
    assert scale_of(spec) is None
    flown = SpiceTrajectorySpec.model_construct()
    trajectory = spec.viewpoint.trajectory.model_copy(update={"table": None, "spice": flown})
    viewpoint = spec.viewpoint.model_copy(update={"trajectory": trajectory})
    assert scale_of(spec.model_copy(update={"viewpoint": viewpoint})) == "tdb"


# --- lenses -----------------------------------------------------------------------------------------------------------


LENSES = (
    ("OPENCV", OpenCVDistortion(-0.4, 0.9, 0.01, -0.02)),
    ("FULL_OPENCV", OpenCVDistortion(-0.4, 0.9, 0.01, -0.02, 0.3, 0.2, -0.1, 0.4)),
)


@pytest.mark.parametrize(("model", "lens"), LENSES)
def test_a_model_has_the_lens_and_the_pixels_where_opencv_sees_the_points(tmp_path, model, lens):
    rng = np.random.default_rng(3)
    pose = Pose(Rotation.random(rng=rng).as_matrix(), np.array([3.0, -2.0, 50.0]))
    points = dict(enumerate(rng.normal(0.0, 8.0, (20, 3))))
    camera = Camera(1000, 800, 900.0, 910.0, 505.0, 395.0, lens)
    uv = camera.pinhole.project(pose.transform(np.array(list(points.values()))))
    frame = PosedFrame("a.png", 0.0, pose, pose, np.array(list(points)), uv)
    write_model(PosedFrames(camera, [frame], points), tmp_path)
    matrix, coefficients = camera.matrix, np.array(astuple(lens))
    cells = (tmp_path / "cameras.txt").read_text().splitlines()[1].split()
    assert cells[:4] == ["1", model, "1000", "800"]
    written = np.array(cells[4:], dtype=float)
    np.testing.assert_array_equal(written, [900.0, 910.0, 505.0, 395.0, *coefficients[: len(written) - 4]])
    lines = (tmp_path / "images.txt").read_text().splitlines()[2:]
    seen = np.array(lines[1].split(), dtype=float).reshape(-1, 3)[:, :2]
    turn = Rotation.from_quat(np.array(lines[0].split()[1:5], dtype=float), scalar_first=True)
    there, _ = cv2.projectPoints(
        np.array(list(points.values())), turn.as_rotvec(), pose.translation_m, matrix, written[4:]
    )
    np.testing.assert_allclose(seen, there[:, 0], atol=1e-9)
    errors = [float(line.split()[7]) for line in (tmp_path / "points3D.txt").read_text().splitlines()[1:]]
    assert max(errors) < 1e-9
    assert np.abs(seen - uv).max() > 5.0


@pytest.mark.parametrize(
    ("lens", "line"),
    [
        ("{opencv: [-0.2, 0, 0.01, 0]}", "1 OPENCV 48 40 {0} {0} 24 20 -0.3 0 0.015 0"),
        ("{k1: -0.2}", "1 PINHOLE 48 40 {0} {0} 24 20"),
    ],
)
def test_the_lens_is_that_which_is_known_on_board_and_no_sum_file_leaves_it_out(cache, tmp_path, refused, lens, line):
    run = run_of(tmp_path, LENS % lens, 1)
    export(run, "colmap", tmp_path / "out")
    _, *remarks, camera = (tmp_path / "out" / "scene_prior" / "cameras.txt").read_text().splitlines()
    expected = line.format(24.0 / np.tan(np.radians(9.15))).split()
    assert camera.split()[:4] == expected[:4]
    np.testing.assert_allclose(np.array(camera.split()[4:], float), np.array(expected[4:], float), rtol=1e-12)
    assert bool(remarks) == ("k1" in lens)
    said = refused("export", run, "--to", "sum", "--out", tmp_path / "sums")
    assert "scene: camera.distortion: SUM files have a lens for the camera of NEAR alone" in said
    assert not (tmp_path / "sums").exists()
