"""Requirements of a campaign: refused before anything runs, judged at its end, and waited for."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest
from tiny_campaign import CAMPAIGN, run, write_campaign
from tiny_sequences import write_sequences

from boresight.campaign.runs import until as module

MET = "position_error_m < 1e6 in 50 % at 90 %"
MISSED = "position_error_m < 1e-3 in 50 % at 90 %"


def requiring(tiny_run, folder, *asked):
    """Copy a run, and a campaign file that asks for something of it; return both."""
    lines = "".join(f"  - {one}\n" for one in asked)
    file = write_campaign(folder / "campaign", f"{CAMPAIGN}requirements:\n{lines}")
    shutil.copytree(tiny_run.folder, folder / "run")
    return file, folder / "run"


@pytest.mark.parametrize(
    ("asked", "code", "said"),
    [
        ((MET,), 0, ""),
        ((MET, MISSED), 4, f"fail: {MISSED}, landmark-harris, scene"),
        ((f"{{that: {MISSED}, estimators: [prior]}}",), 4, f"fail: {MISSED}, prior, scene"),
        (("position_error_m < 1e6 in 99.73 % at 90 %",), 4, "undecided: position_error_m < 1e6 in 99.73 % at 90 %"),
    ],
)
def test_a_build_server_sees_whether_all_have_passed(tiny_run, tmp_path, capsys, asked, code, said):
    """Requirements are no part of a run's identity: they can be asked of one that is stored."""
    file, folder = requiring(tiny_run, tmp_path, *asked)
    assert run(file, folder) == code
    assert said in capsys.readouterr().out
    assert json.loads((folder / "manifest.json").read_text())["looked"] is False


def test_the_report_begins_with_them(tiny_run, tmp_path, capsys):
    file, folder = requiring(tiny_run, tmp_path, MET)
    assert run(file, folder, "--worst", 0) == 0
    assert capsys.readouterr().out.count("Requirements") == 1
    page = (folder / "report" / "report.md").read_text()
    assert page.index("### Requirements") < page.index("### Pose error")


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ("position_error_m under 3", "is no requirement: write it as"),
        ("velocity < 3 in 95 % at 90 %", "velocity is no measure of single-image"),
        ("error_after_1_m < 30 in 95 % at 90 %", "error_after_1_m is no measure of single-image: choose one of"),
        ("{that: solved in 95 % at 90 %, estimators: [lmaps]}", "estimators: there is no lmaps: choose among prior, "),
        ("{that: solved in 95 % at 90 %, scenarios: [other]}", "scenarios: there is no other: choose among scene"),
        ("{that: solved in 95 % at 90 %, estimators: []}", "tiny.yaml:10: requirements: estimators: [] names none"),
        ("{that: solved in 95 % at 90 %,\n    scenarios: []}", "tiny.yaml:11: requirements: scenarios: [] names none"),
        (f"{MET}\n  - {{that: {MET.replace(' ', '  ')}}}", "tiny.yaml:11: requirements: 'position_error_m"),
        ("{limit: 3}", "requirements[0]: write a requirement as its text, or as {that: text,"),
        ("{that: solved in 95 % at 90 %, estimators: lmaps}", "requirements[0]: write a requirement as its text"),
        ("[solved]", "requirements[0]: write a requirement as its text"),
    ],
)
def test_what_cannot_be_judged_is_refused_with_its_place(cache, tmp_path, refused, asked, why):
    file = write_campaign(tmp_path, f"{CAMPAIGN}requirements:\n  - {asked}\n")
    said = refused("run", file, "--out", tmp_path / "run")
    assert why in said
    assert "tiny.yaml" in said
    assert not (tmp_path / "run").exists()


def test_one_requirement_may_be_asked_of_two_methods_in_turn(tiny_run, tmp_path):
    asked = [f"{{that: {MET}, estimators: [{name}]}}" for name in ("landmark-harris", "prior")]
    assert run(*requiring(tiny_run, tmp_path, *asked)) == 0


def test_a_run_stops_when_all_are_decided(tiny_run, tmp_path, monkeypatch):
    """Twelve of twelve trials pass 50 % at 90 %; the same when it is begun anew, and by what the run now says."""
    monkeypatch.setattr(module, "_FIRST_LOOK", 10)
    file, folder = requiring(tiny_run, tmp_path, MET)
    for block in sorted((folder / "rows").glob("*.parquet"))[1:]:
        block.unlink()
    assert run(file, folder, "--until", "requirements") == 0
    assert pd.read_parquet(folder / "rows")["trial"].max() == 9
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["looked"] is True
    assert "Requirements were decided by a test that holds at every look" in manifest["notes"][-1]
    assert "after 10 trials and stopped at the first at which" in manifest["notes"][-1]


def test_a_run_that_goes_on_after_its_end_was_looked_at(tiny_run, tmp_path):
    file, folder = requiring(tiny_run, tmp_path, MISSED)
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "trials": 10}))
    assert run(file, folder) == 4
    assert json.loads((folder / "manifest.json").read_text())["looked"] is True


def test_there_is_nothing_to_wait_for_without_requirements(tiny_file, tmp_path, refused):
    assert "has no requirements: give it some" in refused(
        "run", tiny_file, "--out", tmp_path / "run", "--until", "requirements"
    )


def test_real_images_are_not_waited_for(tmp_path, refused):
    (tmp_path / "set").mkdir()
    cv2.imwrite(str(tmp_path / "set" / "0.png"), np.zeros((40, 48), dtype=np.uint8))
    poses = "file,time_s,sun_body_x,sun_body_y,sun_body_z,ref_qw,ref_qx,ref_qy,ref_qz,ref_tx_m,ref_ty_m,ref_tz_m"
    (tmp_path / "set" / "poses.csv").write_text(f"{poses}\n0.png,0,0,0,-1,1,0,0,0,0,0,2000\n")
    scene = "body: {shape: sphere}\ncamera: {width_px: 48, height_px: 40, fov_deg: 18.3}\nimages: {folder: set}\n"
    campaign = f"scenarios: [scene]\nestimators: [centroid]\ntrials: 1\nseed: 1\nrequirements: [{MET}]\n"
    file = write_campaign(tmp_path, campaign, scene)
    said = refused("run", file, "--out", tmp_path / "run", "--until", "requirements")
    assert "trials share images, more of them are no new ones: give --trials" in said


def test_a_requirement_that_nobody_answers_is_refused(cache, tmp_path, refused):
    campaign = f"scenarios: [scene]\nestimators: [prior]\ntrials: 1\nseed: 1\nrequirements: [{MET}]\n"
    said = refused("run", write_campaign(tmp_path, campaign), "--out", tmp_path / "run")
    assert "is asked of no estimator: name some, or add one" in said


@pytest.mark.parametrize(
    ("written", "asked", "why"),
    [
        (
            "step_deg: 6, revolutions: 1",
            "error_after_99_m < 3",
            "no frame of orbit ends revolution 99: choose error_after_1_m",
        ),
        (
            "step_deg: 6, revolutions: 2.5",
            "error_after_3_m < 3",
            "ends revolution 3: choose error_after_1_m, error_after_2_m",
        ),
        (
            "step_deg: 7, revolutions: 1",
            "error_after_1_m < 3",
            "no frame of orbit ends revolution 1: choose position_error_m",
        ),
    ],
)
def test_an_error_after_a_revolution_is_of_one_that_a_frame_ends(tmp_path, refused, written, asked, why):
    file = write_sequences(tmp_path, 2)
    orbit = file.parent / "orbit.yaml"
    orbit.write_text(orbit.read_text().replace("step_deg: 6, revolutions: 0.1", written))
    file.write_text(f"{file.read_text()}requirements:\n  - {asked} in 95 % at 90 %\n")
    for command in (("validate", file), ("run", file, "--out", tmp_path / "run")):
        assert why in refused(*command)
    assert not (tmp_path / "run").exists()
