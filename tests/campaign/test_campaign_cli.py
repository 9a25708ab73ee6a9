"""The commands beside `run`: they print what is, and everything in the catalogue is sound."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from importlib.metadata import version

import cv2
import jsonschema
import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from ruamel.yaml import YAML
from tiny_campaign import SCENE, SMALL, compute, write_campaign
from undrawn import undrawn

from boresight.campaign.cli import main, terminal
from boresight.campaign.cli.terminal import ProgressListener
from boresight.campaign.imaging.world import open_world, trial_limit
from boresight.campaign.pool.steps import report_progress
from boresight.campaign.pool.workers import in_order
from boresight.campaign.products.databases import map_images
from boresight.campaign.runs.check import check_campaign
from boresight.campaign.runs.read import CATALOG, campaign_names, needs
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import kind_named, kind_names
from boresight.estimators.registry import estimator_names
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.pages.build import html_page
from boresight.reports.pages.content import read_content
from boresight.reports.published import load_published
from boresight.scenarios.bodies import load_body
from boresight.scenarios.data import DATA_VARIABLE
from boresight.scenarios.data.datasets import datasets
from boresight.scenarios.geometry import Pose, View
from boresight.scenarios.load import json_schema, load_campaign, load_scenario, scenario_names


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must succeed, and return what it printed."""
    assert main(list(arguments)) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def test_list_has_a_line_of_each_campaign_under_its_heading(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    lines = said(capsys, "list").splitlines()
    headings = ["start here", "missions", "requirements", "the papers", "compare", "sensitivity", "real data"]
    assert [line for line in lines if line in headings] == headings
    start = {name: lines.index(name) for name in headings}
    under = {
        "quickstart": ("start here", "60", "-"),
        "osiris-rex-bennu": ("missions", "50", "data"),
        "dawn-vesta-approach": ("missions", "50", "data"),
        "dart-didymos": ("missions", "50", "-"),
        "hayabusa2-descent": ("missions", "50", "-"),
        "near-eros": ("missions", "50", "data"),
        "required-itokawa": ("requirements", "100", "data"),
        "required-apophis": ("requirements", "400 x 2", "-"),
        "rowell2015-simulated": ("the papers", "6000", "data"),
        "delpech2015-images-textures": ("the papers", "6 x 10", "-"),
        "trade-slam": ("compare", "100 x 2", "-"),
        "approach-orbit": ("compare", "30", "-"),
        "approach-itokawa": ("compare", "60 x 12", "data"),
        "approach-67p-real": ("real data", "600 x 2", "images"),
        "compare-navcam67p": ("real data", "600 x 2", "images"),
        "bennu-real": ("real data", "100", "images"),
        "dawn-vesta-real": ("real data", "20 x 2", "images"),
        "rowell2015-real": ("real data", "1320", "images"),
        "rowell2015-sensitivity": ("sensitivity", "300", "data"),
    }
    for name, (heading, size, missing) in under.items():
        (line,) = [line for line in lines if line.split(" ", 1)[0] == name]
        assert line.startswith(f"{name:<29}  {size}  ")
        assert f"  {missing} " in line
        assert line.endswith(load_campaign(name, CATALOG).spec.title)
        place = lines.index(line)
        assert max((at, one) for one, at in start.items() if at < place)[1] == heading
    assert lines[1].startswith("quickstart")
    assert "apophis-loops" not in "".join(lines)
    assert lines[-1].endswith("boresight list --all")


def test_list_all_names_everything(capsys):
    lines = said(capsys, "list", "--all").splitlines()
    for name in (*campaign_names(), *scenario_names()):
        assert sum(line.split(" ", 1)[0] == name for line in lines) >= 1, name
    for name in estimator_names():
        assert name in "\n".join(lines[-2:])


@pytest.mark.parametrize("width", [80, 120])
def test_list_cuts_its_lines_at_the_width_of_a_terminal(capsys, monkeypatch, width):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", str(width))
    lines = re.sub(r"\x1b\[[0-9;]*m", "", said(capsys, "list")).splitlines()
    rows = [line for line in lines if line.split(" ", 1)[0] in campaign_names()]
    assert len(rows) > 40
    assert max(map(len, rows)) == width
    assert any(line.endswith("...") for line in rows)
    for line in rows:
        title = load_campaign(line.split(" ", 1)[0], CATALOG).spec.title
        assert line.endswith("...") or line.endswith(title)


@pytest.mark.parametrize("name", campaign_names())
def test_every_campaign_of_the_catalogue_is_sound(name):
    loaded = load_campaign(name, CATALOG)
    assert loaded.spec.name == name
    assert loaded.spec.title
    assert loaded.spec.description
    for scenario in loaded.spec.scenarios:
        assert load_scenario(scenario).spec.name == scenario
    labels = [estimator.name for estimator in loaded.spec.estimators]
    if loaded.spec.experiment == "single-image":
        assert labels[0] == "prior", "there is always a control row"
    if loaded.spec.report is not None:
        assert load_published(loaded.spec.report)
    missing = [need.name for need in needs(loaded) if not need.found]
    campaign = resolve(name)
    if not missing:
        ends = campaign.scenarios[:: max(1, len(campaign.scenarios) - 1)]
        check_campaign(replace(campaign, scenarios=tuple(map(with_few_facets, ends))), loaded.spec.trials)
    elif "gtsam" not in missing:
        for scenario in campaign.scenarios:
            kind_named(loaded.spec.experiment).build_methods(campaign, scenario)


def with_few_facets(scenario):
    """Return a scenario whose detailed bodies, the true one and the one on board, are quick to build."""
    few = {"facets": 20_000, "site": None, "boulders": None}

    def quick(body):
        if body is None or body.detail is None:
            return body
        return body.model_copy(update={"detail": body.detail.model_copy(update=few)})

    spec = scenario.spec
    onboard = spec.onboard.model_copy(update={"body": quick(spec.onboard.body)})
    return replace(scenario, spec=spec.model_copy(update={"body": quick(spec.body), "onboard": onboard}))


@pytest.mark.long
def test_every_scenario_of_the_catalogue_is_sound_with_all_its_facets():
    for campaign in map(resolve, campaign_names()):
        if all(need.found for need in needs(load_campaign(campaign.spec.name, CATALOG))):
            check_campaign(campaign, campaign.spec.trials)


def test_the_schema_is_printed_with_the_kinds_of_trial(capsys):
    assert json.loads(said(capsys, "schema", "scenario")) == json_schema("scenario")
    schema = json.loads(said(capsys, "schema", "campaign"))
    validator = jsonschema.Draft202012Validator(schema)
    content = {"scenarios": ["scene"], "estimators": ["prior"], "trials": 1, "seed": 0}
    for whole in (content, {"extends": "quickstart"}):
        for kind in kind_names():
            validator.validate({**whole, "experiment": kind})
        assert list(validator.iter_errors({**whole, "experiment": "sequense"}))
    assert schema["$defs"]["CampaignSpec"]["properties"]["experiment"]["enum"] == kind_names()


def test_show_prints_a_campaign_that_reads_back_the_same(tiny_run, tmp_path, capsys):
    text = said(capsys, "show", str(tiny_run.file), "--set", "camera.fov_deg=20")
    shown = YAML(typ="safe", pure=True).load(text)
    (scenario,) = shown["scenarios"]
    assert scenario["camera"]["fov_deg"] == 20
    assert scenario["rendering"] == {"samples_per_pixel": 4}, "defaults are filled in"
    (tmp_path / "again.yaml").write_text(json.dumps(scenario))
    own = load_scenario(str(tiny_run.file.parent / "scene.yaml"), ["camera.fov_deg=20"]).spec
    assert load_scenario(str(tmp_path / "again.yaml")).spec == own


@pytest.mark.parametrize("section", ["viewpoint", "sequence"])
def test_show_prints_a_trajectory_that_reads_back_the_same(section, tmp_path, capsys):
    hover = "{trajectory: {hover: {position_m: [2000, 0, 0], duration_s: 60, step_s: 20}}}"
    file = tmp_path / "hover.yaml"
    file.write_text(f"body: {{shape: sphere}}\ncamera: {{fov_deg: 20}}\n{section}: {hover}\n")
    shown = YAML(typ="safe", pure=True).load(said(capsys, "show", str(file)))["scenario"]
    (tmp_path / "again.yaml").write_text(json.dumps(shown))
    assert load_scenario(str(tmp_path / "again.yaml")).spec == load_scenario(str(file)).spec


def test_show_prints_a_scenario(capsys):
    shown = YAML(typ="safe", pure=True).load(said(capsys, "show", "itokawa-2km-lambert"))["scenario"]
    assert shown["body"]["shape"] == "itokawa_gaskell_q64.ply"
    assert shown["lighting"]["phase_deg"] == {"uniform": [0, 60]}


def test_validate_tells_campaigns_from_scenarios(tiny_run, capsys):
    scene = tiny_run.file.parent / "scene.yaml"
    first, views, prior, facets = said(capsys, "validate", str(scene)).splitlines()
    assert first == f"{scene}: ok, the scenario scene"
    assert prior.startswith("scene: errors of the prior (RMS): ")
    text = said(capsys, "validate", str(tiny_run.file))
    assert text.startswith(
        f"{tiny_run.file}: ok, a campaign of 1 scenario(s) and 2 estimator(s)\n{views}\n{prior}\n{facets}\n"
    )


def test_validate_describes_the_images_before_any_is_made(tiny_run, capsys):
    """Against the camera's own projection of the ends of the body's longest side."""
    file = str(tiny_run.file.parent / "scene.yaml")
    camera, mesh = load_scenario(file).spec.camera.camera(), load_body(load_scenario(file).spec.body, ()).mesh
    side = 0.5 * float(np.ptp(mesh.vertices_m, axis=0).max())
    for range_m, words in ((1500.0, "1500"), (3000.0, "{uniform: [1500, 3000]}")):
        views = said(capsys, "validate", file, "--set", f"viewpoint.range_m={words}").splitlines()[1]
        ends = camera.project(np.array([[-side, 0.0, range_m], [side, 0.0, range_m]]))
        assert f"{float(ends[1, 0] - ends[0, 0]):.4g} px long in {camera.width_px} x {camera.height_px}" in views
    assert "range 1500 to 3000 m, " in views
    assert main(["validate", file, "--set", "viewpoint.range_m=9e5"]) == 2
    assert "the body is " in (refused := capsys.readouterr().err)
    assert len(refused.splitlines()) == 1


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"boresight {version('boresight')}\n"


def test_cache_shows_and_clears_its_own_folder_alone(tmp_path, monkeypatch, capsys):
    store = tmp_path / "cache"
    monkeypatch.setenv("BORESIGHT_CACHE", str(store))
    neighbour = tmp_path / "neighbour.txt"
    neighbour.write_text("mine")
    file = write_campaign(tmp_path / "campaign", SMALL)
    compute(file, tmp_path / "run", 1)
    text = said(capsys, "cache")
    assert text.startswith(f"{store}: ")
    assert [line.split(":")[0] for line in text.splitlines()[1:] if not line.startswith(" ")] == [
        "bodies", "images", "landmark-candidates", "landmark-database",
    ]  # fmt: skip
    assert f"{store}: 6 entries removed" in said(capsys, "cache", "--clear")
    assert not [path for path in store.rglob("*") if path.is_file()]
    assert neighbour.read_text() == "mine"
    assert "0 entries removed, 0.0 MiB" in said(capsys, "cache", "--clear")


def test_doctor_tells_what_is_there(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "here"))
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path / "data"))
    text = said(capsys, "doctor")
    for part in (sys.version.split()[0], version("mitsuba"), version("numpy"), str(tmp_path / "here")):
        assert part in text
    known = sum(bool(one.files) for one in datasets().values())
    advice = "- for campaigns that need data of missions: boresight fetch all"
    assert f"{tmp_path / 'data'}, 0 of {known} data sets" in text
    assert advice in text
    radar = datasets()["bennu-radar"]
    (tmp_path / "data" / radar.folder).mkdir(parents=True)
    (tmp_path / "data" / radar.folder / radar.files[0].name).touch()
    text = said(capsys, "doctor")
    assert f"{tmp_path / 'data'}, 1 of {known} data sets" in text
    assert advice not in text
    monkeypatch.delenv(DATA_VARIABLE)
    assert f"({DATA_VARIABLE} is not set)" in said(capsys, "doctor")


@pytest.fixture(scope="module")
def without_llvm(tiny_run, tmp_path_factory):
    """What ``doctor``, a run and a report of another variant's run print where LLVM is hidden, and their folder."""
    folder = tmp_path_factory.mktemp("hidden")
    shutil.copytree(tiny_run.folder, folder / "other")
    commands = (
        ["doctor"],
        ["run", str(tiny_run.file), "--jobs", "1", "--trials", "6", "--no-report", "--out", str(folder / "run")],
        ["report", str(folder / "other")],
    )
    code = (
        "from boresight.campaign.cli import main\n"
        "from boresight.reports.figures import style\n"
        "style.render = lambda *_: b''  # texts are what is read\n"
        f"for words in {commands!r}:\n    assert main(words) == 0\n    print(end='\f')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "BORESIGHT_HIDE_LLVM": "1"}, capture_output=True, text=True, check=False, timeout=180,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\f"), folder


def test_doctor_without_llvm_says_what_to_do(without_llvm):
    text = without_llvm[0][0]
    assert "scalar_rgb" in text
    assert "none that is usable" in text
    advice = text.split("What to do:")[1]
    assert "pip install karellen-llvm-core" in advice
    assert "libllvm19" in advice


def test_a_run_without_llvm_gives_nearly_the_same_rows(tiny_run, without_llvm):
    printed, out = without_llvm[0][1], without_llvm[1] / "run"
    assert "scalar_rgb" in printed
    assert "pip install karellen-llvm-core" in printed
    manifest = RunFolder(out).read_manifest()
    assert manifest["machine"]["variant"] == "scalar_rgb"
    with_llvm, without = (_first(6, RunFolder(folder).table("rows")) for folder in (tiny_run.folder, out))
    controls = [rows[rows["estimator"] == "prior"].reset_index(drop=True) for rows in (with_llvm, without)]
    assert controls[0].equals(controls[1]), "the draws do not depend on the variant"
    found = [rows[rows["estimator"] == "landmark-harris"] for rows in (with_llvm, without)]
    assert (found[1]["status"] == "ok").mean() > 0.8
    stages = [_first(6, RunFolder(folder).table("stages")) for folder in (tiny_run.folder, out)]
    centroids = [table[table["stage"] == "centroid"]["position_error_m"].median() for table in stages]
    assert centroids[1] == pytest.approx(centroids[0], rel=0.2), "brightness centroids hardly feel single pixels"


def _first(trials: int, table: pd.DataFrame) -> pd.DataFrame:
    return table[table["trial"] < trials]


def test_a_report_is_written_where_the_variant_of_the_run_does_not_work(without_llvm):
    if choose_variant().name == "scalar_rgb":
        pytest.skip("the run was made by scalar_rgb, which works everywhere")
    assert "no figure of single trials: the Mitsuba variant" in without_llvm[0][2]
    assert (without_llvm[1] / "other" / "report" / "report.html").is_file()


def test_two_scenarios_are_compared_on_the_same_draws(tmp_path):
    file = write_campaign(tmp_path, SMALL.replace("[scene]", "[scene, dull]"))
    (tmp_path / "dull.yaml").write_text(SCENE + "brdf: {kind: oren-nayar}\n")
    compute(file, tmp_path / "run", 3)
    rows = RunFolder(tmp_path / "run").table("rows")
    priors = [name for name in rows.columns if name.startswith("prior_")] + ["range_m", "phase_deg"]
    first, second = (rows[rows["scenario"] == name].reset_index(drop=True) for name in ("scene", "dull"))
    assert first[priors].equals(second[priors])
    assert not first.equals(second.assign(scenario="scene"))
    assert sorted(path.name for path in (tmp_path / "run" / "rows").iterdir()) == [
        "dull-0000000.parquet",
        "scene-0000000.parquet",
    ]


def test_a_campaign_of_real_images_scores_against_every_reference(tmp_path):
    (tmp_path / "set").mkdir()
    poses = ["file", "time_s", "sun_body_x", "sun_body_y", "sun_body_z"]
    for prefix in ("ref", "label"):
        poses += [f"{prefix}_{part}" for part in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")]
    rows = [",".join(poses)]
    for number in range(3):
        cv2.imwrite(str(tmp_path / "set" / f"{number}.png"), np.full((40, 48), 9 * number, dtype=np.uint8))
        rows.append(f"{number}.png,{number},0,0,-1,1,0,0,0,0,0,2000,1,0,0,0,3,4,2000")
    (tmp_path / "set" / "poses.csv").write_text("\n".join(rows) + "\n")
    scene = "body: {shape: sphere}\ncamera: {width_px: 48, height_px: 40, fov_deg: 18.3}\n"
    scene += "images: {folder: set, also_score: [label], noise_realisations: 2, credit: A. N. Other}\n"
    scene += (
        "pose_error: {position_cam_m: {uniform: [[0, 0], [0, 0], [0, 0]]}, attitude: {angle_deg: {uniform: [0, 0]}}}\n"
    )
    file = write_campaign(tmp_path, "scenarios: [scene]\nestimators: [prior]\ntrials: 6\nseed: 1\n", scene)
    assert trial_limit(load_scenario(str(tmp_path / "scene.yaml"))) == 6
    compute(file, tmp_path / "run", 6)
    folder = RunFolder(tmp_path / "run")
    assert folder.table("rows")["image"].tolist() == ["0.png", "1.png", "2.png"] * 2
    np.testing.assert_allclose(folder.table("rows")["position_error_m"], 0.0, atol=1e-9)
    references = folder.table("references").set_index("reference")["position_error_m"]
    np.testing.assert_allclose(references["ref"], 0.0, atol=1e-9)
    np.testing.assert_allclose(references["label"], 5.0)
    assert folder.read_manifest()["credits"] == ["A. N. Other"]
    assert "A. N. Other" in html_page(read_content(folder.path), ())


def test_several_campaigns_run_one_after_the_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "scenarios: [scene]\nestimators: [prior]\ntrials: 2\nseed: 1\n"
    first = write_campaign(tmp_path, text, SCENE)
    (tmp_path / "second.yaml").write_text(text.replace("seed: 1", "seed: 2"))
    assert main(["run", str(first), "second.yaml", "--jobs", "1", "--no-report"]) == 0
    made = {RunFolder(path).read_manifest()["name"]: RunFolder(path) for path in (tmp_path / "runs").iterdir()}
    assert sorted(made) == ["second", first.stem]
    errors = [folder.table("rows")["prior_position_error_m"].tolist() for folder in made.values()]
    assert errors[0] != errors[1]
    assert [len(one) for one in errors] == [2, 2]
    assert main(["run", str(first), "missing.yaml"]) == 2


def test_the_views_of_real_images_are_rendered_where_that_is_asked_for(tmp_path):
    (tmp_path / "set").mkdir()
    columns = ["qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"]
    rows = [",".join(["file", "time_s", "sun_body_x", "sun_body_y", "sun_body_z", *(f"ref_{one}" for one in columns)])]
    for number in range(3):
        cv2.imwrite(str(tmp_path / "set" / f"{number}.png"), np.zeros((40, 48), dtype=np.uint8))
        rows.append(f"{number}.png,{number},0.6,0,-0.8,1,0,0,0,{100 * number},20,2000")
    (tmp_path / "set" / "poses.csv").write_text("\n".join(rows) + "\n")
    scene = "body: {shape: contact-binary}\ncamera: {width_px: 48, height_px: 40, fov_deg: 18.3}\n"
    scene += "images: {folder: set, rendered: true, noise_realisations: 2, credit: A. N. Other}\n"
    file = write_campaign(tmp_path, "scenarios: [scene, noisy]\nestimators: [prior]\ntrials: 6\nseed: 1\n", scene)
    (tmp_path / "noisy.yaml").write_text(scene + "detector: {psf_sigma_px: 0.5}\n")
    compute(file, tmp_path / "run", 6)
    folder = RunFolder(tmp_path / "run")
    assert folder.table("rows")["image"].tolist() == ["0.png", "1.png", "2.png"] * 4
    assert folder.read_manifest()["credits"] == [], "no real image is shown"
    assert "These are real images" not in html_page(read_content(folder.path), ())
    plain, noisy = (
        open_world(load_scenario(str(tmp_path / f"{name}.yaml")), choose_variant().name) for name in ("scene", "noisy")
    )
    for trial in range(3):
        pose = Pose(np.eye(3), np.array([100.0 * trial, 20.0, 2000.0]))
        expected = plain.renderer.render(View(plain.camera, pose, np.array([0.6, 0.0, -0.8])))
        assert expected.max() > 0.0
        np.testing.assert_array_equal(plain.source.trial_image(1, trial).image, expected)
        np.testing.assert_array_equal(plain.source.trial_image(1, trial + 3).image, expected)
        first, again = (noisy.source.trial_image(1, number).image for number in (trial, trial + 3))
        assert not np.array_equal(first, again), "each trial has noise of its own"
        assert np.corrcoef(first.ravel(), again.ravel())[0, 1] > 0.99


def test_the_report_shows_the_worst_trials_and_how_to_see_all_of_them(tiny_run, tmp_path, capsys):
    shutil.copytree(tiny_run.folder, tmp_path / "run", ignore=shutil.ignore_patterns("report"))
    with undrawn("png", "pdf"):
        said(capsys, "report", str(tmp_path / "run"), "--worst", "2")
    names = {path.name for path in (tmp_path / "run" / "report").glob("worst_*.png")}
    assert names == {"worst_1.png", "worst_2.png"}
    rows = pd.read_parquet(tmp_path / "run" / "rows")
    own = rows[rows["estimator"] != "prior"]
    failed = own[own["status"] != "ok"].sort_values("prior_position_error_m", ascending=False)
    worst = failed if len(failed) else own.sort_values("position_error_m", ascending=False)
    page = (tmp_path / "run" / "report" / "report.html").read_text(encoding="utf-8")
    assert f"--trial {worst.iloc[0]['trial']}" in page


@pytest.mark.parametrize(("error_m", "told"), [(3.0, "0 s left, median mine 3 m\n"), (None, "0 s left\n")])
def test_progress_tells_a_median_where_there_are_position_errors(error_m, told):
    out = io.StringIO()
    with ProgressListener(Console(file=out)) as listener:
        listener.started(0, 1)
        listener.block({"rows": [{"position_error_m": error_m, "scenario": "scene", "estimator": "mine"}]}, 1)
    assert out.getvalue().endswith(told)


def doubled(numbers):
    return [2 * number for number in numbers]


def test_progress_counts_the_images_of_a_data_base(monkeypatch):
    monkeypatch.setattr(terminal, "_SILENCE_S", -1.0)
    out = io.StringIO()
    with ProgressListener(Console(file=out)):
        assert map_images(1, 35, doubled) == [2 * number for number in range(35)]
    lines = out.getvalue().splitlines()
    assert [line.split(",")[0] for line in lines] == ["10/35 images", "20/35 images", "30/35 images"]
    assert all(line.endswith(" s left") for line in lines)
    map_images(1, 35, doubled)
    assert out.getvalue().splitlines() == lines, "no longer counted"


def slowly(trials):
    for number in range(trials):
        time.sleep(0.6)
        report_progress("images of a trial", number + 1, trials)
    return trials


def test_progress_tells_how_far_long_trials_in_workers_are(monkeypatch):
    monkeypatch.setattr(terminal, "_SILENCE_S", -1.0)
    out = io.StringIO()
    with ProgressListener(Console(file=out)) as listener:
        listener.started(0, 2)
        assert list(in_order(2, slowly, [(5,), (7,)])) == [5, 7]
    lines = out.getvalue().splitlines()
    assert all(line.startswith("0/2 trials; ") for line in lines)
    assert {line.split()[2].split("/")[1] for line in lines} == {"5", "7"}, "one of the workers is never heard of"
    assert all(" images of a trial, " in line and line.endswith(" s left") for line in lines)
