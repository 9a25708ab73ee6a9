"""`boresight inspect` on small real runs: the same bits again, what is kept and drawn, and what it refuses."""

from __future__ import annotations

import json
import re
import shutil

import cv2
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from browser import needs_chromium, opened
from scipy.spatial.transform import Rotation
from stored_runs import RunBuilder, seal
from tiny_campaign import CAMPAIGN, compute, write_campaign
from undrawn import undrawn

from boresight.campaign.cli import main
from boresight.campaign.inspection.recompute import Case, Choice, recompute, reopened, worst_cases
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import kind_named, kind_names
from boresight.estimators.landmark.recognizer import LandmarkRecognizer
from boresight.reports.run.data import read_run
from boresight.reports.schema.kinds import SCHEMAS
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.known import known_on_board
from boresight.scenarios.load import load_scenario


@pytest.fixture
def copied(tiny_run, tmp_path):
    """A run of the test's own."""
    shutil.copytree(tiny_run.folder, tmp_path / "run")
    return tmp_path / "run"


def test_the_worst_trial_comes_out_the_same_and_is_kept_whole(copied, capsys):
    with undrawn("png", "pdf"):
        assert main(["inspect", str(copied), "--worst", "1", "--pdf"]) == 0
    said = capsys.readouterr().out
    assert "the same as stored, bit for bit" in said
    rows = pd.read_parquet(copied / "rows")
    own = rows[rows["estimator"] == "landmark-harris"]
    failed = own[own["status"] != "ok"]
    by, pool = ("prior_position_error_m", failed) if len(failed) else ("position_error_m", own)
    worst = pool.loc[pool[by].idxmax()]
    folder = copied / "inspect" / f"scene_landmark-harris_{worst['trial']:07d}"
    assert f"trial {worst['trial']} of scene / landmark-harris" in said
    assert {"index.html", "poses.png", "poses.pdf", "image.tiff", "estimate.json"} <= {p.name for p in folder.iterdir()}
    kept = pq.read_table(folder / "tables" / "rows.parquet").to_pylist()[0]
    assert kept["prior_position_error_m"] == worst["prior_position_error_m"]


def test_what_is_kept_is_what_the_estimator_saw_and_said(copied):
    rows = pd.read_parquet(copied / "rows")
    trial = int(rows[(rows["estimator"] == "landmark-harris") & (rows["status"] == "ok")]["trial"].iloc[0])
    with undrawn("png"):
        assert main(["inspect", str(copied), "--trial", str(trial), "--estimator", "landmark-harris"]) == 0
    folder = copied / "inspect" / f"scene_landmark-harris_{trial:07d}"
    campaign = reopened(RunFolder(copied))
    again = recompute(campaign, RunFolder(copied), Case("scene", "landmark-harris", trial))
    truth = again.shown.truth.T_cam_body
    pose = json.loads((folder / "estimate.json").read_text())["pose"]
    R = Rotation.from_quat(pose["T_cam_body_quat_wxyz"], scalar_first=True).as_matrix()
    c = -R.T @ pose["T_cam_body_translation_m"]
    stored = rows.query("estimator == 'landmark-harris' and trial == @trial").iloc[0]
    assert np.linalg.norm(c - truth.camera_position_m) == pytest.approx(stored["position_error_m"], rel=1e-9)
    image = cv2.imread(str(folder / "image.tiff"), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, again.shown.observation.frame.image)
    drawn = {path.name for path in folder.iterdir()}
    assert {"fit.png", "matches.png"} <= drawn
    assert "matches.pdf" not in drawn, "only with --pdf"


def test_one_changed_bit_is_told(copied, capsys):
    path = next(path for path in sorted((copied / "rows").glob("*.parquet")))
    table = pq.read_table(path)
    row = next(i for i, r in enumerate(table.to_pylist()) if r["estimator"] == "landmark-harris")
    values = table["range_m"].to_pylist()
    values[row] = float(np.nextafter(values[row], np.inf))
    at = table.column_names.index("range_m")
    pq.write_table(table.set_column(at, table.schema.field("range_m"), [values]), path)
    seal(copied)
    trial = table["trial"][row].as_py()
    assert main(["inspect", str(copied), "--trial", str(trial), "--estimator", "landmark-harris"]) == 1
    assert "NOT the same as stored: rows.range_m in 1 of 1 rows" in capsys.readouterr().out


def test_failures_are_worse_than_errors_and_controls_are_left_out(tmp_path):
    run = RunBuilder(tmp_path / "run")
    far, near = (np.array([length, 0.0, 0.0]) for length in (50.0, 5.0))
    run.trial(0, (near, 1.0), (near, 0.1))
    run.trial(1, (near, 1.0), None, reason="dark")
    run.trial(2, (near, 1.0), (far, 0.1))
    run.trial(3, (far, 1.0), None, reason="dark")
    run.trial(2, (far, 1.0), (far, 1.0), estimator="prior")
    data = read_run(run.write())
    cases, name = worst_cases(data, 9, Choice(), None)
    assert [(case.estimator, case.trial) for case in cases] == [("landmark-harris", t) for t in (3, 1, 2, 0)]
    assert name == "position_error_m"
    assert [c.trial for c in worst_cases(data, 1, Choice(estimator="prior"), "attitude_error_deg")[0]] == [2]


def test_a_trial_that_raised_and_one_that_failed_are_shown_as_far_as_they_came(tmp_path, monkeypatch, capsys):
    strict = CAMPAIGN.replace("landmark-harris:\n", "landmark-harris:\n      consistency_max_px: 1.0e-6\n")
    file = write_campaign(tmp_path / "strict", strict)
    compute(file, tmp_path / "failed", trials=1)
    assert main(["inspect", str(tmp_path / "failed"), "--worst", "1"]) == 0
    said = capsys.readouterr().out
    assert ": failed (" in said
    page = (tmp_path / "failed" / "inspect" / "scene_landmark-harris_0000000" / "index.html").read_text()
    reason = pd.read_parquet(tmp_path / "failed" / "rows").query("estimator == 'landmark-harris'")["reason"].item()
    assert reason.replace("'", "&#39;") in page
    assert page.count("data:image/png") >= 2

    def boom(self, observation, *, rng):
        raise ZeroDivisionError("a fault of <this> test")

    monkeypatch.setattr(LandmarkRecognizer, "estimate", boom)
    compute(file, tmp_path / "raised", trials=1)
    assert main(["inspect", str(tmp_path / "raised"), "--worst", "1"]) == 0
    assert "error (the estimator raised" in capsys.readouterr().out
    page = (tmp_path / "raised" / "inspect" / "scene_landmark-harris_0000000" / "index.html").read_text()
    assert "ZeroDivisionError: a fault of &lt;this&gt; test" in page
    assert "data:image/png" in page


def test_a_run_of_another_version_is_told_with_what_remakes_it(copied, refused):
    older = json.loads((copied / "manifest.json").read_text())
    older["identity"]["estimators"][1]["version"] = [1]
    older["digest"] = "0" * 64
    (copied / "manifest.json").write_text(json.dumps(older))
    said = refused("inspect", copied, "--worst", 1)
    assert not (copied / "inspect").exists()
    assert "estimators[landmark-harris].version[0] changed since" in said
    assert "to remake it: boresight run tiny --trials 24 --seed 5" in said


def test_every_folder_of_kinds_is_a_kind_of_its_name():
    assert [kind_named(name).name for name in kind_names()] == kind_names()


def test_every_kind_says_what_it_stores_and_what_is_known_on_board():
    assert set(SCHEMAS) == set(kind_names())
    sections = {"sequence": "apophis-sphere-sequence", "orbit-determination": "eros-like-orbit"}
    sections |= dict.fromkeys(("crater-navigation", "image-survey"), "eros-like-navigation")
    sections |= {"crater-matching": "eros-crater-pairs", "approach-orbit": "approach-orbit"}
    for name in kind_names():
        assert known_on_board(load_scenario(sections.get(name, "quickstart")).spec, name).items
    with pytest.raises(BoresightError, match="what is known on board in such trials"):
        known_on_board(load_scenario("quickstart").spec, "limb-width")


def test_every_kind_of_experiment_can_be_watched():
    assert all(callable(kind_named(name).watched) for name in kind_names())


@needs_chromium
def test_the_page_opens_and_prints_in_a_browser(copied):
    assert main(["inspect", str(copied), "--trial", "0", "--estimator", "landmark-harris"]) == 0
    page = copied / "inspect" / "scene_landmark-harris_0000000" / "index.html"
    assert not re.findall(r'(?:src|href)="(?!data:)', page.read_text())
    with opened(page) as shown:
        assert shown.locator("h1").inner_text() == "trial 0 of scene / landmark-harris"
        widths = shown.locator("figure img").evaluate_all("images => images.map(image => image.naturalWidth)")
        assert len(widths) >= 2
        assert min(widths) > 500
        assert shown.pdf().startswith(b"%PDF")
