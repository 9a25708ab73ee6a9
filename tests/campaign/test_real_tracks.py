"""Real tracks from the files to the report: followed, scored, inspected, and refused in one line."""

from __future__ import annotations

import pandas as pd
import pytest
from spc_folders import write_spc
from track_tables import make_world

from boresight.campaign.cli import main

CAMPAIGN = """\
title: Tracks of a file
experiment: sequence
scenarios: [scene.yaml]
estimators: [dead-reckoning, fixed-lag, loop-smoother]
trials: 3
seed: 5
"""


def write(folder, **changed):
    make_world(frames=9, landmarks=120).write(folder)
    scene = (folder / "scene.yaml").read_text().replace("per_frame: 12", "per_frame: 30, loops: true")
    (folder / "scene.yaml").write_text(scene)
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    for name, content in changed.items():
        (folder / f"{name}.csv").write_text(content)
    return folder / "campaign.yaml"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracks")
    out = folder / "out"
    assert main(["run", str(write(folder)), "--jobs", "1", "--worst", "1", "--out", str(out)]) == 0
    return out


def test_exact_tracks_are_followed_to_the_error_of_the_range(run):
    rows = pd.read_parquet(run / "rows")
    assert (rows["status"] == "ok").all()
    error = rows.groupby("estimator")["position_error_m"].max()
    # One range with 0.5 m; dead reckoning has half of each displacement of 69 m.
    assert (error.drop("dead-reckoning") < 3.0).all()
    assert error["dead-reckoning"] > 10.0
    assert rows["settled_landmark_rmse_m"].dropna().lt(3.0).all()


def test_the_report_says_that_the_truth_is_a_reference(run):
    page = (run / "report" / "report.html").read_text()
    assert "errors are against reference poses, which are not exact" in page
    assert "Errors along the trajectory" in page


def test_a_case_is_worked_out_again_to_the_last_bit(run, tmp_path, capsys):
    assert main(["inspect", str(run), "--trial", "1", "--estimator", "fixed-lag", "--out", str(tmp_path / "case")]) == 0
    assert "Traceback" not in capsys.readouterr().err
    assert list((tmp_path / "case").rglob("*tracks*"))


def write_folder(folder):
    write(folder)
    scene = write_spc(make_world(frames=9, landmarks=120), folder / "spc")
    scene.write_text(scene.read_text().replace("per_frame: 12", "per_frame: 30"))
    campaign = (folder / "campaign.yaml").read_text().replace("loop-smoother", "ba-slam").replace("3\nseed", "1\nseed")
    (folder / "campaign.yaml").write_text(campaign)
    return folder / "campaign.yaml"


def test_landmarks_of_spc_are_followed_to_the_error_of_the_range(tmp_path):
    assert main(["run", str(write_folder(tmp_path)), "--jobs", "1", "--out", str(tmp_path / "out")]) == 0
    rows = pd.read_parquet(tmp_path / "out" / "rows").set_index("estimator")
    assert (rows["status"] == "ok").all()
    assert (rows["position_error_m"].drop("dead-reckoning") < 3.0).all()
    assert rows["position_error_m"]["dead-reckoning"] > 10.0
    assert rows["landmark_rmse_m"].drop("dead-reckoning").lt(3.0).all()


@pytest.mark.parametrize("kind", ["SUM", "LMK"])
def test_bad_files_of_spc_are_refused(tmp_path, refused, kind):
    campaign = str(write_folder(tmp_path))
    path = max((tmp_path / "spc" / f"{kind}FILES").iterdir())
    path.write_text(path.read_text()[:-25])
    for command in (["validate", campaign], ["run", campaign, "--jobs", "1", "--out", tmp_path / "out"]):
        assert f"{path}: " in (said := refused(*command))
        assert "cut short" in said


BAD = {
    "single": ("tracks", "track,frame,u_px,v_px\n1,0,3,4\n", "track 1 has one sighting"),
    "inside": (
        "poses",
        "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n" + "".join(f"{k},{5 * k + 1},2,3,1,0,0,0\n" for k in range(9)),
        "sequence: row 0 (from 0) of the trajectory is inside the body",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_tables_are_refused(tmp_path, refused, name):
    table, content, said = BAD[name]
    campaign = str(write(tmp_path, **{table: content}))
    for command in (["validate", campaign], ["run", campaign, "--jobs", "1", "--out", tmp_path / "out"]):
        assert said in refused(*command)


def test_a_missing_table_is_refused(tmp_path, refused):
    campaign = write(tmp_path)
    (tmp_path / "tracks.csv").unlink()
    assert "sequence.tracks.table: tracks.csv was not found" in refused("validate", campaign)


def test_without_the_data_the_campaign_names_the_fetch_command(tmp_path, refused, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    said = refused("run", "vesta-real-slam", "--out", tmp_path / "out")
    assert "boresight fetch vesta-real-slam brings them" in said
