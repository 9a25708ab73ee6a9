"""Runs and pages on built-in bodies in place of shape files: values, marked, and never verdicts."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from boresight.campaign.cli import main
from boresight.campaign.papers.page import finished_runs, gather_runs, paper_called, paper_page
from boresight.campaign.runs.read import campaign_names, read_campaign
from boresight.campaign.runs.resolve import reload, resolve
from boresight.reports.figures.named import run_label
from boresight.reports.pages.content import read_content
from boresight.reports.pages.paper import paper_lines
from boresight.reports.published import load_published
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.body import EMBEDDED_NAMES, STAND_INS, BodySpec

SCENE = """extends: itokawa-2km-lambert
body: {detail: null}
camera: {width_px: 96, height_px: 96, fov_deg: 18.3}
"""
CAMPAIGN = """title: Tiny
scenarios: [scene.yaml]
estimators: [prior, photometric]
trials: 2
seed: 1
report: rowell2015-simulated
"""


@pytest.fixture(autouse=True)
def nothing_there(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path / "nothing"))
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(SCENE)
    Path("tiny.yaml").write_text(CAMPAIGN)


def test_a_body_is_replaced_with_the_reading_of_its_file():
    body = BodySpec(shape="itokawa_gaskell_q64.ply", unit="km", format="ply", shading="smooth", even_facets=100)
    assert body.embedded() == BodySpec(shape="itokawa-like", shading="smooth", even_facets=100)
    for other in (BodySpec(shape="mine.obj", unit="km"), BodySpec(shape="eros-like")):
        assert other.embedded() is other
    assert set(STAND_INS.values()) <= set(EMBEDDED_NAMES)


def test_every_campaign_without_real_images_or_tracks_can_do_without_files():
    for name in campaign_names():
        for scenario in read_campaign(name, embedded=True).scenarios:
            believed = scenario.spec.onboard.body
            shapes = {scenario.spec.body.shape, *(() if believed is None else (believed.shape,))}
            sequence = scenario.spec.sequence
            real = scenario.spec.images is not None or (sequence is not None and sequence.tracks is not None)
            assert real or shapes <= set(EMBEDDED_NAMES), name


def test_the_body_on_board_is_replaced_too():
    Path("scene.yaml").write_text(SCENE + "onboard: {body: {shape: itokawa_radar.obj, unit: km}}\n")
    campaign = resolve("tiny.yaml", embedded=True)
    assert campaign.scenarios[0].spec.onboard.body == BodySpec(shape="contact-binary")
    assert campaign.embedded == (
        "itokawa-like in place of itokawa_gaskell_q64.ply", "contact-binary in place of itokawa_radar.obj",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "shape"),
    [("rowell2015-real", "itokawa_gaskell_q64.ply"), ("vesta-real-slam", "images/dawn_fc_vesta/vesta_5002.ply")],
)
def test_real_images_and_tracks_keep_their_shape(name, shape):
    campaign = resolve(name, embedded=True)
    assert campaign.scenarios[0].spec.body.shape == shape
    assert campaign.embedded == ()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["run", "rowell2015-simulated"],
            r"gaskell_q64\.ply is missing, .*: boresight fetch rowell2015 brings it",
        ),
        (["validate", "trade-landmarks"], r"boresight fetch trade-landmarks brings .* same command with --embedded"),
        (["run", "tiny.yaml"], r"boresight fetch tiny\.yaml brings"),
        (["run", "quickstart", "--embedded"], "reads no shape file .*: leave it out"),
        (
            ["run", "rowell2015-real", "--embedded"],
            "hayabusa_amica_20051001, .* missing.* rowell2015 .*, or says where to get",
        ),
    ],
)
def test_what_is_missing_names_both_commands_in_one_line(words, line, refused):
    assert re.search(line, refused(*words))


def test_figures_says_both_commands_too(capsys):
    assert main(["figures", "rowell2015", "--run", "--trials", "1", "--jobs", "1", "--runs", "runs"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "boresight fetch rowell2015 brings it; or give the same command with --embedded" in said
    assert "needs real images" in said


@pytest.mark.parametrize(
    ("paper", "words", "commands"),
    [
        (
            "rowell2015",
            ["--embedded"],
            ["run rowell2015-database --embedded", "fetch rowell2015-real && boresight"],
        ),
        ("rowell2015", [], ["fetch rowell2015-database && boresight run rowell2015-database\n"]),
        (
            "cheng2003",
            ["--embedded"],
            ["run cheng2003-detection\n", "run cheng2003-orbit --embedded"],
        ),
    ],
)
def test_the_command_to_run_a_campaign_is_one_that_runs_it(paper, words, commands):
    """With shape files that a built-in body stands for, without any, and with real images."""
    assert main(["figures", paper, *words]) == 0
    page = (Path("figures") / paper / "table.md").read_text(encoding="utf-8")
    assert [one for one in commands if f"to run it: boresight {one}" not in page] == []


def test_the_values_of_all_papers_are_counted_together(capsys):
    assert main(["figures", "all", "--embedded"]) == 0
    counted = r"(all papers: )?0 of (\d+) published numbers and statements have a value"
    *papers, last = re.findall(counted, capsys.readouterr().out)
    assert [whose for whose, _ in (*papers, last)] == ["", "", "", "all papers: "]
    assert int(last[1]) == sum(int(number) for _, number in papers) > 200


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One run, without data."""
    folder = tmp_path_factory.mktemp("embedded")
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "tiny.yaml").write_text(CAMPAIGN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BORESIGHT_DATA", str(folder / "nothing"))
        words = ["--jobs", "1", "--worst", "0", "--out", str(folder / "run")]
        assert main(["run", str(folder / "tiny.yaml"), "--embedded", *words]) == 0
    return folder / "run"


@pytest.fixture
def run_folder(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "run"))


def test_a_run_gives_values_and_no_verdict_and_is_marked(run_folder):
    content = read_content(run_folder)
    due = {item.verdict for item in content.compared}
    assert "embedded body" in due
    assert due <= {"embedded body", "context", "not measured"}
    assert {claim.verdict for claim in content.claims} <= {"embedded body", "context", "not measured"}
    assert any(item.ours is not None and item.ours.value is not None for item in content.compared)
    assert content.run.manifest.embedded == ("itokawa-like in place of itokawa_gaskell_q64.ply",)
    note = "On embedded bodies, which give values but no verdicts: itokawa-like in place of itokawa_gaskell_q64.ply."
    for page in ("report.html", "report.md"):
        text = next(run_folder.rglob(page)).read_text()
        assert "Tiny (embedded bodies)" in text
        assert note in text


def test_a_run_is_found_only_where_embedded_bodies_are_wanted(run_folder):
    assert finished_runs([run_folder], "tiny")[0] == []
    assert gather_runs([run_folder], ["tiny"]).found == {}
    found = gather_runs([run_folder], ["tiny"], embedded=True).found
    assert found["tiny"].folder.path == run_folder
    lines = list(paper_lines("tiny", load_published("rowell2015-simulated"), found["tiny"].content, ["photometric"]))
    assert {line.verdict for line in lines} <= {"embedded body", "context", "not measured"}


def test_the_footer_of_a_figure_names_draft_and_embedded_bodies(run_folder):
    run = read_content(run_folder).run
    drafted = run_label(replace(run, manifest=run.manifest.model_copy(update={"draft": 0.05, "commit": ""})))
    assert drafted.endswith("seed 1, a draft of scale 0.05, itokawa-like in place of itokawa_gaskell_q64.ply")


def test_a_page_names_the_campaigns_on_embedded_bodies(run_folder, tmp_path):
    paper = replace(paper_called("rowell2015"), campaigns=("rowell2015-simulated",), figures=())
    manifest = json.loads((run_folder / "manifest.json").read_text())
    shutil.copytree(run_folder, tmp_path / "runs" / "one")
    (tmp_path / "runs" / "one" / "manifest.json").write_text(json.dumps({**manifest, "name": paper.campaigns[0]}))
    page = paper_page(paper, tmp_path / "runs", 1, embedded=True)
    assert page.document.title.endswith(" (embedded bodies)")
    conditions = dict(page.document.lists)["What is compared, and by which bounds"]
    assert conditions[0].endswith("so without verdicts: rowell2015-simulated")


def test_a_run_on_the_real_body_comes_first(run_folder, tmp_path):
    """The manifest of the same run, as if its body were the real one."""
    real = Path(shutil.copytree(run_folder, tmp_path / "real"))
    manifest = json.loads((real / "manifest.json").read_text())
    assert reload(manifest).embedded == ("itokawa-like in place of itokawa_gaskell_q64.ply",)
    (real / "manifest.json").write_text(json.dumps({**manifest, "embedded": []}))
    found = gather_runs([run_folder, real], ["tiny"], embedded=True).found
    assert found["tiny"].folder.path == real


def test_a_file_in_place_of_a_stand_in_is_told_apart_by_its_digest():
    with pytest.raises(BoresightError, match="was not found"):
        _ = resolve("tiny.yaml").digest
    assert resolve("tiny.yaml", embedded=True).digest
