"""The page of a paper: from whatever runs there are, named by the paper's numbers, and honest about the rest."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from stored_runs import seal
from tiny_campaign import SCENE, compute, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.cli.figures import Wanted, run_missing
from boresight.campaign.imaging.world import open_world
from boresight.campaign.papers.page import PaperFigure, drawn, finished_runs, gather, paper_called, paper_campaigns
from boresight.campaign.papers.rowell2015 import broadside_view, built_again, cluster_view, surface_view
from boresight.campaign.runs.read import CATALOG, sources
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder, run_folders
from boresight.estimators.landmark.database import DatabaseOptions
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.figures.named import NamedFigure
from boresight.reports.pages.paper import PaperLine, value_tally
from boresight.reports.published import load_published
from boresight.reports.schema.records import Record
from boresight.reports.schema.tables import FORMAT_VERSION
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_campaign

PAPER = paper_called("rowell2015")
BASE = "{images: 40, min_observations: 6, clusters: {seed_radius_m: 15, sigma_floor_m: 0.1}}"
HEAD = "scenarios: [scene]\nseed: 3\n"
CAMPAIGNS = {
    "rowell2015-simulated": f"estimators: [prior, landmark-harris: {{database: {BASE}}}]\ntrials: 6\n",
    "rowell2015-centroid": f"estimators: [prior, centroid: {{shape: landmark-mesh, database: {BASE}}}]\ntrials: 4\n",
    "rowell2015-database": f"experiment: landmark-database\nestimators: [landmark-database: {BASE}]\ntrials: 1\n",
    "rowell2015-convergence": (
        "experiment: pose-convergence\nestimators:\n"
        + "".join(
            f"  - pose-solver: {{label: {label}, method: {method}, database: {BASE}}}\n"
            for label, method in (
                ("closed-form", "closed-form"), ("non-linear-quaternion", "non-linear"), ("both-quaternion", "both"),
            )
        )
        + "trials: 30\n"
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(cache, tmp_path_factory):
    """A folder of small runs that go by the names of the paper's campaigns."""
    folder = tmp_path_factory.mktemp("paper")
    for name, text in CAMPAIGNS.items():
        report = f"report: {name}\n"
        file = write_campaign(folder / "files" / name, f"name: {name}\ntitle: T\n{HEAD}{text}{report}", SCENE)
        compute(file, folder / "runs" / f"{name}-a", trials(text))
    return folder / "runs"


def trials(text):
    return int(re.search(r"trials: (\d+)", text)[1])


@pytest.fixture(scope="module")
def page(runs):
    """What the command writes."""
    out = runs.parent / "figures"
    assert main(["figures", "rowell2015", "--runs", str(runs), "--out", str(out)]) == 0
    return out


def test_figures_are_named_by_the_numbers_of_the_paper(page):
    drawn_ = {path.name for path in page.glob("figure_*")}
    expected = {f"figure_{n:02d}.{kind}" for n in (1, 2, 3, 4, 5, 6, 7, 10) for kind in ("png", "pdf")}
    # In this scene some figures may have nothing to show: then a line says so, and no file is there.
    text = (page / "table.md").read_text(encoding="utf-8")
    for name in expected - drawn_:
        assert f"figure {int(name[7:9])}: " in text
    assert drawn_ <= expected
    assert {"figure_01.png", "figure_02.png", "figure_04.png", "figure_05.png", "figure_06.png"} <= drawn_
    assert all((page / name).stat().st_size > 5000 for name in drawn_)


def test_what_is_missing_is_said_in_one_line_each(page, runs):
    text = (page / "table.md").read_text(encoding="utf-8")
    missing = [name for name in paper_campaigns(PAPER) if name not in CAMPAIGNS]
    assert missing
    for name in missing:
        command = rf"boresight run {name} --out {runs / name}"
        assert len(re.findall(rf"^- {name}: no finished run .* {command}$", text, re.M)) == 1
    assert len(re.findall("^- figure 8: not drawn without a finished run of rowell2015-real or", text, re.M)) == 1


def test_each_campaign_says_what_was_known_on_board(page):
    text = (page / "table.md").read_text(encoding="utf-8")
    for name in CAMPAIGNS:
        line = rf"^- {name}: .* trials?, .*Perfect knowledge of: .*Imperfect or no knowledge of: "
        assert re.search(line, text, re.M), name


def test_every_published_number_has_its_line(page):
    table = pd.read_csv(page / "table.csv", keep_default_na=False)
    for name in (*CAMPAIGNS, "navcam67p-real"):
        comparison = load_published("rowell2015-real-context" if name == "navcam67p-real" else name)
        mine = table[table["campaign"] == name]
        wanted = [value for value in comparison.values if value.scenario == ""]  # noqa: PD011
        assert {value.quoted for value in wanted} <= set(mine["published"])
        assert {claim.text for claim in comparison.claims} <= set(mine["published"])
    assert (table.loc[table["campaign"] == "navcam67p-real", "verdict"] == "needs real images").all()
    html = (page / "index.html").read_text(encoding="utf-8")
    assert html.count("<img ") == len(list(page.glob("*.png")))
    assert (page / "table_01.pdf").exists()
    assert "://" not in html.replace("http://www.w3.org", "")


def test_values_are_counted_by_line_and_page(page, runs):
    text = (page / "table.md").read_text(encoding="utf-8")
    real, words, none = re.search(
        r"^- Values: \d+ of \d+ published numbers and statements have a value; (\d+) need real images;"
        r" (\d+) are in words, without a number of ours; (\d+) have none, as no trial that was run is about them$",
        text, re.M,
    ).groups()  # fmt: skip
    table = pd.read_csv(page / "table.csv")
    without = table[table["ours"].isna()].drop_duplicates(["campaign", "scenario", "place", "published", "quantity"])
    assert int(real) == 40
    assert int(words) == (without["quantity"] == "in words").sum() > 0
    assert int(none) > 0, "of campaigns that were not run"


def test_statements_in_words_and_of_real_images_are_not_counted_as_lost():
    value = Record("s", "e", "prior", "", "position_error_m", "median", "m", 1.0, 0.9, 1.1, 3, 3)
    line = PaperLine("c", "s", "e", "p", "q", "median", "1", (value,), None, "context")
    lines = [
        line, replace(line, ours=(value, value)), replace(line, ours=(value, None)),
        replace(line, ours=(None,), verdict="needs real images"), replace(line, ours=(), in_words=True),
        replace(line, ours=(), in_words=True, verdict="needs real images"),
        replace(line, ours=(replace(value, value=None),)), replace(line, ours=(replace(value, value=None, n_ok=0),)),
    ]  # fmt: skip
    assert value_tally(lines) == (
        "3 of 8 published numbers and statements have a value; 1 need real images;"
        " 2 are in words, without a number of ours; 2 have none, as no trial that was run is about them"
    )


def test_numbers_are_those_of_the_rows(page, runs):
    table = pd.read_csv(page / "table.csv")
    rows = RunFolder(runs / "rowell2015-simulated-a").table("rows")
    rows = rows[rows["estimator"] == "landmark-harris"]
    line = table[(table["quantity"] == "position error, prior") & (table["campaign"] == "rowell2015-simulated")]
    assert line["ours"].item() == pytest.approx(rows["prior_position_error_m"].median())
    assert (line["n_ok"].item(), line["n"].item()) == (6, 6)
    assert line["low"].item() < line["ours"].item() < line["high"].item()


def test_a_second_call_without_runs_leaves_no_old_figures(page, runs, tmp_path, capsys):
    out = tmp_path / "figures"
    out.mkdir()
    for name in ("figure_06.png", "figure_06.pdf", "mine.png"):
        (out / name).write_bytes(b"old")
    assert main(["figures", "rowell2015", "--runs", str(tmp_path), "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["index.html", "mine.png", "table.csv", "table.md"]
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"rowell2015: no finished run; to run: {len(paper_campaigns(PAPER))} campaigns, ")
    specs = [load_campaign(name, CATALOG).spec for name in paper_campaigns(PAPER)]
    trials = sum(spec.trials * len(sources(spec)) for spec in specs)
    assert said[0].endswith(f", {trials:,} trials in all")
    assert any(line.startswith("images missing for 2 campaigns: rowell2015-real, ") for line in said)
    assert len(said) <= 10
    assert set(pd.read_csv(out / "table.csv")["verdict"]) == {"not measured", "needs real images"}


def test_what_is_missing_is_run_on_request_with_no_more_trials_than_the_campaign_says(cache, tmp_path):
    name = "rowell2015-centroid"
    file = write_campaign(tmp_path / "files", f"name: {name}\ntitle: T\n{HEAD}{CAMPAIGNS[name]}", SCENE)
    for asked, stored in ((1, 1), (None, 4), (100, 4)):
        run_missing([str(file)], Wanted(tmp_path / "runs", 1.0, asked, "boresight figures"), 1)
        (folder,) = run_folders(tmp_path / "runs")
        assert RunFolder(folder).table("rows")["trial"].nunique() == stored
    assert finished_runs([folder], name)[0]


def test_a_draft_has_a_share_of_the_trials_and_is_never_taken_for_a_run(cache, tmp_path):
    name = "rowell2015-centroid"
    file = write_campaign(tmp_path / "files", f"name: {name}\ntitle: T\n{HEAD}{CAMPAIGNS[name]}", SCENE)
    run_missing([str(file)], Wanted(tmp_path / "runs", 0.6, None, "boresight figures"), 1)
    folders = run_folders(tmp_path / "runs")
    assert not finished_runs(folders, name)[0]
    (draft, *_), _ = finished_runs(folders, name, 0.6)
    assert draft.folder.table("rows")["trial"].nunique() == 3
    assert any("draft of scale 0.6" in note for note in draft.content.notes)
    assert draft.campaign().draft == 0.6


SIDE_BY_SIDE = """
import sys
from pathlib import Path
from boresight.campaign.cli.figures import Wanted, run_missing
run_missing(sys.argv[3:], Wanted(Path(sys.argv[1]), 0.6, None, "boresight figures"), int(sys.argv[2]))
"""


@pytest.mark.long
def test_drafts_side_by_side_are_those_of_one_after_another_and_one_without_data_stops_none(cache, tmp_path):
    files = [
        write_campaign(tmp_path / "files" / name, f"name: {name}\ntitle: T\n{HEAD}{CAMPAIGNS[name]}", SCENE)
        for name in ("rowell2015-centroid", "rowell2015-simulated")
    ]
    names = [str(files[0]), str(tmp_path / "nowhere.yaml"), str(files[1])]
    for jobs in ("1", "2"):
        words = [sys.executable, "-c", SIDE_BY_SIDE, str(tmp_path / f"runs-{jobs}"), jobs, *names]
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        assert all(f"{name}: " in said for name in names)
    alone, beside = (sorted(run_folders(tmp_path / f"runs-{jobs}")) for jobs in (1, 2))
    assert [folder.name for folder in alone] == [folder.name for folder in beside]
    assert len(alone) == 2
    for one, other in zip(alone, beside, strict=True):
        pd.testing.assert_frame_equal(RunFolder(one).table("rows"), RunFolder(other).table("rows"), check_exact=True)
        assert finished_runs([other], read_name(other), 0.6)[0]


def read_name(folder):
    return RunFolder(folder).read_manifest()["name"]


def test_campaigns_without_their_data_are_told_and_left_out(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    out = tmp_path / "figures"
    words = ["figures", "rowell2015", "--run", "--trials", "1", "--runs", str(tmp_path / "runs"), "--out", str(out)]
    assert main(words) == 0
    said = capsys.readouterr().out
    for name in paper_campaigns(PAPER):
        assert len(re.findall(rf"^{name}: (?!{name}).* (is|are) missing, ", said, re.M)) == 1, name
    assert (out / "index.html").exists()


def test_the_newest_finished_run_is_taken_and_unfinished_ones_are_not(tmp_path):
    def store(name, finished, trials, rows, overrides=()):
        folder = tmp_path / name
        (folder / "rows").mkdir(parents=True)
        manifest = {"name": "c", "digest": "d", "finished": finished, "trials": trials, "scenarios": {"s": {}}}
        manifest |= {"overrides": overrides, "seed": 1, "format": FORMAT_VERSION}
        (folder / "manifest.json").write_text(json.dumps(manifest))
        stored = pd.DataFrame({"scenario": "s", "estimator": "e", "status": "ok", "trial": range(rows)})
        stored.to_parquet(folder / "rows" / "s-0.parquet")
        seal(folder)

    store("old", "2024-01-01T00:00:00+00:00", 3, 3)
    store("new", "2024-02-01T00:00:00+00:00", 3, 3)
    store("continued", "2024-03-01T00:00:00+00:00", 5, 3)  # finished once, then asked for more
    store("running", None, 3, 3)
    store("another-world", "2024-04-01T00:00:00+00:00", 3, 3, ["camera.fov_deg=20"])
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "manifest.json").write_text("{")
    (found, *_), _ = finished_runs(run_folders(tmp_path), "c")
    assert found.folder.path.name == "new"
    assert not finished_runs(run_folders(tmp_path), "another")[0]


def test_a_run_of_another_version_keeps_its_numbers_and_loses_its_pictures(runs):
    found = gather(PAPER, runs).found
    run = found["rowell2015-database"]
    stale = replace(run, manifest={**run.manifest, "digest": "another"})
    with pytest.raises(BoresightError, match="another version"):
        drawn(PAPER.figures[0], {"rowell2015-database": stale}, 1)
    assert stale.content.records


def test_a_further_campaign_stands_beside_the_first(runs):
    found = gather(PAPER, runs).found
    twice = {"rowell2015-real": found["rowell2015-simulated"], "navcam67p-real": found["rowell2015-simulated"]}
    figures = drawn(PAPER.figures[8], twice, 1)
    assert [figure.stem for figure in figures] == ["figure_09", "figure_09_navcam67p-real"]
    assert all(figure.caption.startswith("Figure 9. ") for figure in figures)


def test_footers_name_the_runs_that_a_drawing_shows(runs):
    found = gather(PAPER, runs).found
    two = ("rowell2015-simulated", "rowell2015-centroid")

    def draw(run):
        yield NamedFigure("", Figure(), "Drawn.", "")

    for together in (False, True):
        figures = drawn(PaperFigure("11", two, draw, together), found, 1)
        footers = ["".join(text.get_text() for text in figure.figure.texts) for figure in figures]
        told = [[name for name in two if f"boresight {name}," in footer] for footer in footers]
        assert told == ([list(two)] if together else [[name] for name in two])


@pytest.fixture(scope="module")
def made(runs):
    campaign = resolve(str(runs.parent / "files" / "rowell2015-database" / "tiny.yaml"), variant=choose_variant().name)
    world = open_world(campaign.scenarios[0], campaign.variant)
    options = DatabaseOptions(images=40, min_observations=6, clusters={"seed_radius_m": 15}, seed=3)
    return world, built_again(world, options, 1, campaign.variant), broadside_view(world, 2000.0)


def test_the_view_is_broadside(made):
    """The body's longest principal axis lies across the image and its shortest along the line of sight."""
    world, _, view = made
    in_camera = view.T_cam_body.rotate(world.body.mesh.vertices_m - world.body.mesh.vertices_m.mean(axis=0))
    moments = in_camera.T @ in_camera
    np.testing.assert_allclose(moments - np.diag(np.diag(moments)), 0.0, atol=1e-6 * moments.max())
    assert moments[0, 0] >= moments[1, 1] >= moments[2, 2]


def test_clusters_are_drawn_where_their_points_are(made):
    """Each drawn point is on the lit or dark side of the body itself, and belongs to the cluster of its colour."""
    world, built, view = made
    seen = cluster_view(world, built, view)
    assert set(seen.merged_of) <= set(range(len(built.clusters.refined)))
    points = world.renderer.surface(view, seen.merged_px).points_body_m
    for number in np.unique(seen.merged_of)[:10]:
        members = built.points_m[built.clusters.refined[number].members]
        mine = points[seen.merged_of == number]
        nearest = np.linalg.norm(mine[:, None] - members[None], axis=2).min(axis=1)
        assert nearest.max() < 3.0
    assert len(seen.seed_px) >= len(seen.merged_px)


def test_facets_face_the_camera_and_normals_point_out_of_them(made):
    _, built, view = made
    seen = surface_view(built.database, view)
    mesh = built.database.mesh()
    to_camera = view.T_cam_body.camera_position_m - mesh.corners_m.mean(axis=1)
    facing = int((np.einsum("fi,fi->f", to_camera, mesh.normals) > 0).sum())
    assert len(seen.facets_px) == len(seen.shades) == len(seen.normals_px) == facing
    assert seen.n_facets == len(mesh.faces)
    # Counter-clockwise from outside is clockwise in an image whose v grows downwards.
    first, second = seen.facets_px[:, 1] - seen.facets_px[:, 0], seen.facets_px[:, 2] - seen.facets_px[:, 0]
    assert ((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) < 0).all()
    assert ((seen.shades >= 0) & (seen.shades <= 1)).all()
