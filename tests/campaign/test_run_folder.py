"""What a finished run holds, and what `status` and `report` make of it."""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from tiny_campaign import CAMPAIGN, DATABASE, RESULTS, SCENE, TRIALS, compute, files, run, write_campaign
from tiny_sequences import write_sequences

from boresight.campaign.cli import main
from boresight.campaign.cli.terminal import ProgressListener
from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds.single_image import SingleImage
from boresight.campaign.papers.page import finished_runs
from boresight.campaign.runs.resolve import reload, resolve
from boresight.campaign.store import RunFolder, run_folders
from boresight.campaign.trial.score import pose_error
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.schema.tables import columns_of
from boresight.scenarios.load import canonical_json, load_scenario

OF_IMAGES = {"rows", "stages", "landmarks", "diagnostics"}
OF_OTHERS = set(RESULTS) - OF_IMAGES
"""Tables that this run has none of: a rendered image has one truth, is no sequence, and has no known craters."""


def test_rows_are_one_for_each_trial_and_estimator(tiny_run):
    rows = pd.read_parquet(tiny_run.folder / "rows")
    expected = list(itertools.product(range(TRIALS), ["scene"], ["prior", "landmark-harris"]))
    assert list(rows[["trial", "scenario", "estimator"]].itertuples(index=False, name=None)) == expected
    assert list(rows["database"].fillna(-1)) == [-1, 0] * TRIALS, "the prior has none"
    others = ["database", "position_bound_m", "attitude_bound_deg"]
    numbers = rows.select_dtypes("number").drop(columns=others)
    assert np.isfinite(numbers).all(axis=None), "this campaign has no failures, and no estimator with a bound"
    assert set(rows["status"]) == {"ok"}


def test_stored_columns_are_the_documented_ones(tiny_run):
    for name in (*RESULTS, "timings"):
        if name not in OF_OTHERS:
            stored = pd.read_parquet(tiny_run.folder / name)
            assert list(stored.columns) == [column.name for column in columns_of(name, "single-image")], name
            assert len(stored), name
    assert not any((tiny_run.folder / name).exists() for name in OF_OTHERS)
    assert not (tiny_run.folder / "tracebacks").exists()


def test_wall_times_are_in_their_own_table_alone(tiny_run):
    times = pd.read_parquet(tiny_run.folder / "timings")
    assert {"image", "mesh_rendering", "centroid", "feature_extraction", "recognition"} <= set(times["stage"])
    assert (times["seconds"] > 0).all()
    for name in RESULTS:
        assert "seconds" not in RunFolder(tiny_run.folder).table(name).columns
    assert not RunFolder(tiny_run.folder).table("diagnostics")["name"].isin(set(times["stage"])).any()


def test_the_control_row_is_the_prior(tiny_run):
    rows = pd.read_parquet(tiny_run.folder / "rows")
    control = rows[rows["estimator"] == "prior"]
    for name in ("position_error_m", "attitude_error_deg", "position_error_x_m"):
        np.testing.assert_array_equal(control[name], control[f"prior_{name}"])
    found = rows[rows["estimator"] == "landmark-harris"]
    priors = [name for name in rows.columns if name.startswith("prior_")]
    np.testing.assert_array_equal(found[priors], control[priors])
    assert (found["n_landmarks"] >= 4).all()


def test_a_row_is_the_score_of_what_the_estimator_returned(tiny_run):
    rows, stages = (pd.read_parquet(tiny_run.folder / name) for name in ("rows", "stages"))
    landmarks = pd.read_parquet(tiny_run.folder / "landmarks")
    campaign = resolve(str(tiny_run.file), variant=choose_variant().name)
    experiment = SingleImage(
        world=open_world(campaign.scenarios[0], campaign.variant), scenario="scene", methods={}, seed=5
    )
    for trial in range(3):
        trial_image = experiment.world.source.trial_image(5, trial)
        frame = observe(experiment.world, trial_image, experiment.seed, trial).frame
        row = rows[(rows["trial"] == trial) & (rows["estimator"] == "landmark-harris")].iloc[0]
        for name, value in pose_error(frame.prior_T_cam_body, trial_image.view.T_cam_body).items():
            assert row[f"prior_{name}"] == value
        assert row["range_m"] == pytest.approx(2000.0)
        assert row["phase_deg"] == pytest.approx(np.degrees(trial_image.view.phase_angle_rad))
        mine = stages[stages["trial"] == trial]
        assert mine["stage"].tolist() == ["centroid", "recognition"]
        assert mine.iloc[-1]["position_error_m"] == row["position_error_m"]
        assert (landmarks["trial"] == trial).sum() == row["n_landmarks"]


def test_the_manifest_says_what_was_asked(tiny_run):
    manifest = RunFolder(tiny_run.folder).read_manifest()
    assert manifest["seed"] == 5
    assert manifest["trials"] == TRIALS
    assert manifest["estimators"] == ["prior", "landmark-harris"]
    assert manifest["campaign"]["estimators"][1]["landmark-harris"]["database"] == DATABASE
    assert manifest["scenarios"]["scene"]["camera"]["fov_deg"] == 18.3
    assert manifest["scenarios"]["scene"]["rendering"] == {"samples_per_pixel": 4}, "defaults are filled in"
    (product,) = manifest["products"]
    assert (product["kind"], product["scenario"]) == ("landmark-database", "scene")
    landmarks = pd.read_csv(tiny_run.folder / product["folder"] / "landmarks.csv", comment="#")
    assert product["n_landmarks"] == len(landmarks) > 10


def test_the_manifest_says_from_what_and_where_the_run_came(tiny_run):
    manifest = RunFolder(tiny_run.folder).read_manifest()
    assert manifest["versions"]["numpy"] == np.__version__
    assert manifest["versions"]["mitsuba"] == version("mitsuba")
    assert manifest["versions"]["boresight"] == version("boresight")
    assert manifest["machine"]["cores"] == len(os.sched_getaffinity(0))
    assert manifest["machine"]["variant"] == choose_variant().name
    assert manifest["machine"]["memory_gib"] > 0
    assert manifest["machine"]["processor"]
    commit = manifest["commit"].removesuffix("-dirty")
    if (Path(__file__).parents[2] / ".git").exists():
        known = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
        assert subprocess.run(known, cwd=Path(__file__).parent, check=False).returncode == 0
    else:
        assert commit == ""
    created, finished = (datetime.fromisoformat(manifest[key]) for key in ("created", "finished"))
    assert created <= finished
    assert created.utcoffset().total_seconds() == 0


def test_a_run_is_resolved_again_from_its_manifest_alone(tiny_run, tmp_path):
    manifest = RunFolder(tiny_run.folder).read_manifest()
    campaign = reload(manifest)
    assert campaign is not None
    assert campaign.digest == manifest["digest"]
    assert canonical_json(campaign.scenarios[0].spec) == canonical_json(
        load_scenario(str(tiny_run.file.parent / "scene.yaml")).spec
    )
    assert reload({**manifest, "seed": 6}) is None
    assert reload({key: value for key, value in manifest.items() if key != "scenarios"}) is None


def test_scenarios_are_resolved_again_in_the_order_of_the_campaign(tmp_path):
    """A manifest is sorted by name, and the digest of a run is not."""
    file = write_campaign(tmp_path, CAMPAIGN.replace("[scene]", "[scene, another]"))
    (tmp_path / "another.yaml").write_text(SCENE + "detector: {}\n", encoding="utf-8")
    compute(file, tmp_path / "run", 1)
    manifest = RunFolder(tmp_path / "run").read_manifest()
    assert list(manifest["scenarios"]) == ["another", "scene"]
    campaign = reload(manifest)
    assert campaign is not None
    assert [scenario.spec.name for scenario in campaign.scenarios] == ["scene", "another"]


def test_the_campaign_in_the_manifest_can_be_run_again(tiny_run, tmp_path):
    manifest = RunFolder(tiny_run.folder).read_manifest()
    (tmp_path / "scene.yaml").write_text(json.dumps(manifest["scenarios"]["scene"]))
    (tmp_path / "again.yaml").write_text(json.dumps(manifest["campaign"]))
    again = resolve(str(tmp_path / "again.yaml"), variant=choose_variant().name)
    assert again.digest == manifest["digest"]


def test_status_counts_what_is_stored(tiny_run, tmp_path, capsys):
    out = tmp_path / "run"
    shutil.copytree(tiny_run.folder, out)
    assert main(["status", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"{out}: tiny, 24 of 24 trials stored, seed 5" in said
    assert "finished 20" in said
    assert "scene / landmark-harris: 24 ok" in said
    (out / "rows" / "scene-0000001.parquet").unlink()
    assert main(["status", str(out)]) == 0
    said = capsys.readouterr().out
    assert "14 of 24 trials stored" in said
    assert "not finished" in said
    assert "to continue: run the campaign again" in said, "it was run from Python"


def test_status_proposes_what_runs_the_rest(tmp_path, capsys):
    file, out = write_sequences(tmp_path, 12), tmp_path / "run"
    assert run(file, out) == 0
    (out / "rows" / "orbit-0000002.parquet").unlink()
    assert run(file, out, "--trials", 2) == 0
    capsys.readouterr()
    assert main(["status", str(out)]) == 0
    said = capsys.readouterr().out
    assert "10 of 12 trials stored" in said
    (command,) = re.findall("to continue: boresight (.*)", said)
    assert main(shlex.split(command)) == 0
    assert main(["status", str(out)]) == 0
    said = capsys.readouterr().out
    assert "12 of 12 trials stored" in said
    assert "to continue" not in said


def test_status_and_report_find_the_newest_run_by_name_and_change_none_of_it(tiny_run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for number in (1, 2):
        compute(tiny_run.file, Path("runs") / f"tiny-{number}", number)
    out = Path("runs") / "tiny-2"
    before = files(out)
    assert main(["status", "tiny"]) == 0
    assert capsys.readouterr().out.startswith("runs/tiny-2: tiny, 2 of 2 trials stored")
    assert main(["report", "tiny"]) == 0
    said = capsys.readouterr().out
    after = files(out)
    assert {name: after[name] for name in before} == before
    report = {name for name in after if name not in before}
    assert {"report/report.html", "report/report.md", "report/table.csv", "report/timings.csv"} <= report
    median = pd.read_parquet(out / "rows").query("estimator == 'prior'")["position_error_m"].median()
    assert f"{median:.3g}" in said
    assert not list((out / "report").glob(".*")), "nothing half-written stays"
    assert not (Path("runs") / "tiny-1" / "report").exists()
    assert main(["status", "tin"]) == 2
    assert (
        capsys.readouterr().err
        == "boresight: tin: no run there, nor in runs/ as tin-...: give a run folder, or run it first\n"
    )


def test_kept_images_read_back_as_they_were_seen(tiny_file, tmp_path):
    file, out = tiny_file, tmp_path / "run"
    file.write_text(CAMPAIGN.replace("estimators:", "set: {detector: {bits: 12}}\nestimators:"))
    assert run(file, out, "--trials", 2, "--keep-images") == 0
    campaign = resolve(str(file), variant=choose_variant().name)
    source = open_world(campaign.scenarios[0], campaign.variant).source
    for trial in range(2):
        kept = cv2.imread(str(out / "images" / "scene" / f"{trial:07d}.tiff"), cv2.IMREAD_UNCHANGED)
        seen = source.trial_image(5, trial).image
        assert kept.dtype == seen.dtype == np.float32
        np.testing.assert_array_equal(kept, seen)
        assert len(np.unique(kept)) > 100, "an image of the body, not a blank one"
    assert sorted(path.name for path in (out / "images" / "scene").iterdir()) == ["0000000.tiff", "0000001.tiff"]


@pytest.mark.parametrize("errors", [(4.1, 105.9), (0.0, 0.0, 5.0), (3.0, 9.0, 4.0, 8.0)])
def test_the_live_median_is_that_of_the_table(errors, tmp_path):
    out = StringIO()
    listener = ProgressListener(Console(file=out, width=200))
    listener.started(0, len(errors) + 1)
    key = {"scenario": "scene", "estimator": "mine"}
    listener.block({"rows": [{**key, "position_error_m": error} for error in errors]}, len(errors))
    listener.block({"rows": [{**key, "position_error_m": None}]}, 1)
    assert f"median mine {np.median(errors):.3g} m" in out.getvalue()
    listener.block({"rows": [{**key, "scenario": "other", "position_error_m": 7.0}]}, 0)
    assert "median of other mine 7 m" in out.getvalue()
    many = [{**key, "scenario": "wide", "estimator": f"m{k}", "position_error_m": 1.0} for k in range(8)]
    listener.block({"rows": many}, 0)
    assert "m5 1 m  and 2 more" in out.getvalue()


class ClockSetBack:
    """Goes an hour back with every look."""

    def __init__(self) -> None:
        self._now = datetime(2026, 1, 1, tzinfo=UTC)

    def now(self, zone):
        self._now -= timedelta(hours=1)
        return self._now.astimezone(zone)


def test_a_clock_that_is_set_back_turns_no_order_round(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file = write_sequences(tmp_path, 2)
    monkeypatch.setattr("boresight.campaign.runs.manifest.datetime", ClockSetBack())
    for number in (1, 2):
        folder = Path("runs") / f"orbits-{number}"
        compute(file, folder, number)
        os.utime(folder, (1e9 - number, 1e9 - number))
        manifest = RunFolder(folder).read_manifest()
        assert manifest["created"] <= manifest["finished"] <= manifest["updated"]
    assert RunFolder(Path("runs/orbits-2")).read_manifest()["created"] < "2025-12-31T22"
    assert main(["status", "orbits"]) == 0
    assert capsys.readouterr().out.startswith("runs/orbits-2: orbits, 2 of 2 trials stored")
    assert finished_runs(run_folders(Path("runs")), "orbits")[0][0].folder.path.name == "orbits-2"
    compute(file, Path("runs/orbits-1"), 2)
    assert main(["status", "orbits"]) == 0
    assert capsys.readouterr().out.startswith("runs/orbits-1: "), "what was gone on with last is the newest"
