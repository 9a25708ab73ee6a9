"""`boresight export` of trials that share an image or an epoch, or have a lens: nothing is lost or distorted."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest
from tiny_campaign import compute, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.score import pose_of
from boresight.scenarios.spc import read_sumfile

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
