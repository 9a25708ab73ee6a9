"""`boresight export`: what comes out is read by others' readers, or by their documented formats, and is the run."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation
from tiny_campaign import compute

from boresight.campaign.cli import main
from boresight.campaign.inspection.recompute import Case, recompute, reopened
from boresight.campaign.runs.execute import opened
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.score import pose_of
from boresight.reports.schema.grid import _SPECIAL, Grid
from boresight.reports.schema.tables import TABLES, measure_label, unit_of
from boresight.scenarios.checksums import damaged
from boresight.scenarios.geometry import Pose, View
from boresight.scenarios.load import load_scenario

SEQUENCE = """\
extends: apophis-sphere-sequence
sequence:
  orbit: {revolutions: 0.25}
  body_motion: {kind: spin, period_h: 30.4, axis_body: [0, 0.2, 1]}
"""
SEQUENCES = """\
title: Short sequences
experiment: sequence
scenarios: [orbit.yaml]
estimators: [fixed-lag]
trials: 2
seed: 3
"""


@pytest.fixture(scope="module")
def sequences(cache, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sequences")
    (folder / "orbit.yaml").write_text(SEQUENCE, encoding="utf-8")
    (folder / "campaign.yaml").write_text(SEQUENCES, encoding="utf-8")
    compute(folder / "campaign.yaml", folder / "run", trials=2)
    return folder / "run"


def export(run, kind, out, *arguments):
    assert main(["export", str(run), "--to", kind, "--out", str(out), *map(str, arguments)]) == 0


def test_a_tum_trajectory_holds_the_stored_errors(sequences, tmp_path):
    export(sequences, "tum", tmp_path, "--trial", 1)
    truth, estimate = (np.loadtxt(tmp_path / f"orbit_fixed-lag_0000001.{w}.tum") for w in ("truth", "estimate"))
    epochs = pd.read_parquet(sequences / "epochs").query("trial == 1")
    assert truth.shape == (len(epochs), 8)
    np.testing.assert_array_equal(truth[:, 0], epochs["time_s"])
    errors = np.linalg.norm(estimate[:, 1:4] - truth[:, 1:4], axis=1)
    np.testing.assert_allclose(errors, epochs["position_error_m"], atol=1e-6)
    # The camera looks at the body's centre, where inertial axes begin: its third axis leads there.
    forward = Rotation.from_quat(truth[:, 4:]).as_matrix()[:, :, 2]
    towards = -truth[:, 1:4] / np.linalg.norm(truth[:, 1:4], axis=1, keepdims=True)
    np.testing.assert_allclose(forward, towards, atol=1e-9)


def test_evo_reads_trajectories_and_finds_the_stored_errors(sequences, tiny_run, tmp_path):
    metrics = pytest.importorskip("evo.core.metrics")
    read = pytest.importorskip("evo.tools.file_interface").read_tum_trajectory_file
    export(sequences, "tum", tmp_path, "--trial", 0)
    export(tiny_run.folder, "tum", tmp_path, "--estimator", "prior")
    epochs = pd.read_parquet(sequences / "epochs").query("trial == 0")
    images = pd.read_parquet(tiny_run.folder / "rows").query("estimator == 'prior'").sort_values("trial")
    position, attitude = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg
    for name, relation, stored in (
        ("orbit_fixed-lag_0000000", position, epochs["position_error_m"]),
        ("scene_prior", position, images["position_error_m"]),
        ("scene_prior", attitude, images["attitude_error_deg"]),
    ):
        found = metrics.APE(relation)
        found.process_data(tuple(read(tmp_path / f"{name}.{which}.tum") for which in ("truth", "estimate")))
        np.testing.assert_allclose(found.error, stored, rtol=1e-6, atol=1e-6)


def test_single_images_have_trajectories_too(tiny_run, tmp_path):
    export(tiny_run.folder, "tum", tmp_path, "--trial", 0, 3, "--estimator", "prior")
    truth, estimate = (np.loadtxt(tmp_path / f"scene_prior.{which}.tum") for which in ("truth", "estimate"))
    rows = pd.read_parquet(tiny_run.folder / "rows").query("estimator == 'prior' and trial in (0, 3)")
    assert truth[:, 0].tolist() == [0.0, 3.0]
    moved = estimate[:, 1:4] - truth[:, 1:4]
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), rows["position_error_m"], rtol=1e-9)
    turned = Rotation.from_quat(truth[:, 4:]).inv() * Rotation.from_quat(estimate[:, 4:])
    np.testing.assert_allclose(np.degrees(turned.magnitude()), rows["attitude_error_deg"], rtol=1e-6)


def test_trajectories_of_images_are_those_that_are_stored(tiny_run, tmp_path, monkeypatch):
    monkeypatch.setattr("boresight.campaign.inspection.recompute.recompute", None)
    monkeypatch.setattr("boresight.campaign.cli.inspect.track", None)
    export(tiny_run.folder, "tum", tmp_path, "--estimator", "landmark-harris", "--trial", 0, 1)
    rows = pd.read_parquet(tiny_run.folder / "rows").query("estimator == 'landmark-harris' and trial < 2")
    for name, prefix in (("truth", "true_"), ("estimate", "")):
        lines = np.loadtxt(tmp_path / f"scene_landmark-harris.{name}.tum")
        for line, row in zip(lines, rows.to_dict("records"), strict=True):
            matrix = Rotation.from_quat([row[f"{prefix}q{part}"] for part in "xyzw"]).as_matrix()
            camera = -matrix.T @ [row[f"{prefix}t{axis}_m"] for axis in "xyz"]
            np.testing.assert_allclose(line[1:4], camera, rtol=1e-12, atol=1e-9)


def test_an_exported_trajectory_is_one_of_a_scenario(tiny_run, tmp_path):
    export(tiny_run.folder, "tum", tmp_path, "--estimator", "prior", "--trial", 0, 3)
    (tmp_path / "scene.yaml").write_text(
        "extends: quickstart\nviewpoint: {trajectory: {table: scene_prior.estimate.tum}}\n", encoding="utf-8"
    )
    states = load_scenario(str(tmp_path / "scene.yaml")).spec.viewpoint.trajectory.states
    rows = pd.read_parquet(tiny_run.folder / "rows").query("estimator == 'prior' and trial in (0, 3)")
    for place, quaternion, row in zip(states.position_m, states.attitude, rows.to_dict("records"), strict=True):
        pose = pose_of(row)
        np.testing.assert_allclose(place, pose.camera_position_m, rtol=1e-15)
        assert Pose.from_quat_wxyz(np.array(quaternion), np.zeros(3)).angle_to(pose) < 1e-12


def test_colmap_reads_a_model_and_projects_it_as_we_do(tiny_run, sequences, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    export(tiny_run.folder, "colmap", tmp_path, "--estimator", "landmark-harris", "--trial", 0, 1, 2, 3)
    model = pycolmap.Reconstruction(str(tmp_path / "scene_landmark-harris"))
    rows = pd.read_parquet(tiny_run.folder / "rows").query("estimator == 'landmark-harris' and trial < 4")
    solved = rows[rows["status"] == "ok"]
    assert len(model.images) == len(solved) > 1
    marks = pd.read_parquet(tiny_run.folder / "landmarks").query("estimator == 'landmark-harris'")
    experiment = opened(reopened(RunFolder(tiny_run.folder)), "scene", tiny_run.folder)
    for image in model.images.values():
        trial = int(image.name.removesuffix(".tiff"))
        own = marks[marks["trial"] == trial]
        seen = np.array([point.xy for point in image.points2D])
        np.testing.assert_array_equal(seen, own[["u_px", "v_px"]])
        # COLMAP projects to the same pixels what the renderer sees there: one convention of axes, pose and pixels.
        matrix = image.cam_from_world().matrix()
        view = View(experiment.world.camera, Pose(matrix[:, :3], matrix[:, 3]), np.array([1.0, 0.0, 0.0]))
        hits = experiment.world.renderer.surface(view, seen)
        projected = [image.project_point(point) for point in hits.points_body_m[hits.hit]]
        np.testing.assert_allclose(projected, seen[hits.hit], atol=1e-2)
        true = experiment.world.source.trial_image(experiment.seed, trial).view.T_cam_body.camera_position_m
        error = np.linalg.norm(image.projection_center() - true)
        assert error == pytest.approx(solved.set_index("trial").loc[trial, "position_error_m"], rel=1e-9)
    mean = model.compute_mean_reprojection_error()
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() == pytest.approx(mean, rel=1e-9)


def test_a_sequence_is_a_model_whose_tracks_fit(sequences, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    export(sequences, "colmap", tmp_path, "--trial", 0)
    model = pycolmap.Reconstruction(str(tmp_path / "orbit_fixed-lag_0000000"))
    folder = RunFolder(sequences)
    again = recompute(reopened(folder), folder, Case("orbit", "fixed-lag", 0))
    assert len(model.images) == len(again.shown.estimate.frames)
    assert sum(len(i.points2D) for i in model.images.values()) == again.shown.observation.frames[0].tracks.size + sum(
        frame.tracks.size for frame in again.shown.observation.frames[1:]
    )
    errors = [point.error for point in model.points3D.values() if point.track.length() > 3]
    assert np.median(errors) < 2.0


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_tables_come_back_bit_for_bit(tiny_run, tmp_path, kind):
    export(tiny_run.folder, kind, tmp_path, "--estimator", "landmark-harris")
    read = pd.read_parquet if kind == "parquet" else pd.read_csv
    for name in ("rows", "stages", "landmarks"):
        stored = RunFolder(tiny_run.folder).table(name).query("estimator == 'landmark-harris'").reset_index(drop=True)
        back = read(tmp_path / f"{name}.{kind}")
        numbers = [column for column in stored if stored[column].dtype == np.float64]
        pd.testing.assert_frame_equal(back[numbers].astype(float), stored[numbers], check_exact=True)
        assert (back["trial"] == stored["trial"]).all()
    meanings = pd.read_csv(tmp_path / "columns.csv")
    assert set(meanings["table"]) <= set(TABLES)
    assert (meanings["meaning"].str.len() > 3).all()


# --- `boresight export --to latex`: tables that LaTeX itself sets, whatever characters their cells hold --------------


LATEX, FINDER = shutil.which("pdflatex"), shutil.which("kpsewhich")


def lacks_packages() -> bool:
    """Tell whether LaTeX is here without what the tables need."""
    names = ["booktabs.sty", "graphicx.sty"]
    return FINDER is None or subprocess.run([FINDER, *names], capture_output=True, check=False).returncode != 0


def test_latex_tables_have_whole_rows_and_no_bare_commands(tiny_run, tmp_path):
    assert main(["export", str(tiny_run.folder), "--to", "latex", "--out", str(tmp_path)]) == 0
    files = sorted(tmp_path.glob("*.tex"))
    assert files
    for file in files:
        text = file.read_text()
        body = text[text.index(r"\toprule") : text.index(r"\bottomrule")]
        columns = text.split(r"\begin{tabular}{")[1].split("}")[0]
        rows = [line for line in body.splitlines() if line.endswith(r" \\")]
        assert len(rows) > 1
        assert all(row.replace(r"\&", "").count("&") == len(columns) - 1 for row in rows)
    grid = Grid("A & B", ("50 %", "x_1"), ((r"a\b", "{1}"),))
    assert r"50 \% & x\_1 \\" in grid.latex()
    assert r"a\textbackslash{}b & \{1\} \\" in grid.latex()
    assert r"\caption{A \& B}" in grid.latex()


@pytest.mark.skipif(LATEX is None, reason="there is no pdflatex on the PATH")
@pytest.mark.skipif(LATEX is not None and lacks_packages(), reason="LaTeX is here without booktabs or graphicx")
def test_latex_sets_every_table_within_the_line(tiny_run, tmp_path):
    assert main(["export", str(tiny_run.folder), "--to", "latex", "--out", str(tmp_path / "tables")]) == 0
    every = "".join(_SPECIAL) + 'á [a] * "q"'
    odd = Grid(every, ("a", every), (("[0, 1]", every), ("*", "|"), ("x " * 200, "")), note=every)
    (tmp_path / "tables" / "odd.tex").write_text(odd.latex(), encoding="utf-8")
    tables = sorted((tmp_path / "tables").glob("*.tex"))
    lines = [r"\documentclass{article}", r"\usepackage{booktabs,graphicx}", r"\begin{document}"]
    lines += [rf"\input{{tables/{table.name}}}" for table in tables]
    (tmp_path / "main.tex").write_text("\n".join([*lines, r"\end{document}", ""]), encoding="utf-8")
    command = [LATEX, "-interaction=nonstopmode", "-halt-on-error", "main.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    log = (tmp_path / "main.log").read_text(encoding="utf-8", errors="replace")
    assert re.findall(r"(?:Overfull .*|Missing character.*|.*Warning.*)", log) == []
    captions = (tmp_path / "main.aux").read_text(encoding="utf-8").count(r"\contentsline {table}")
    assert captions == len(tables) > 3


def test_a_data_package_describes_every_column_of_the_files(tiny_run, tmp_path):
    export(tiny_run.folder, "csv", tmp_path)
    package = json.loads((tmp_path / "datapackage.json").read_text(encoding="utf-8"))
    assert re.fullmatch(r"[-a-z0-9._]+", package["name"])
    resources = {one["name"]: one for one in package["resources"]}
    assert {f"{name}.csv" for name in resources} == {p.name for p in tmp_path.glob("*.csv")} - {"columns.csv"}
    read = {"integer": int, "number": float, "boolean": {"True": True, "False": False}.__getitem__, "string": str}
    for name, resource in resources.items():
        cells = pd.read_csv(tmp_path / resource["path"], dtype=str, keep_default_na=False)
        fields = {field["name"]: field for field in resource["schema"]["fields"]}
        assert list(fields) == list(cells)
        meanings = {column.name: column.meaning for column in TABLES[name]}
        for field, described in fields.items():
            assert described["description"] == meanings[field]
            for cell in cells[field]:
                assert cell == "" or read[described["type"]](cell) is not None
    units = {field["name"]: field.get("unit") for field in resources["rows"]["schema"]["fields"]}
    assert (units["range_m"], units["phase_deg"], units["nees"], units["trial"]) == ("m", "deg", None, None)


def described_rows(run):
    """Return how many rows the files have that the data package of a run names, and check its fields with theirs."""
    package, found = json.loads((run / "datapackage.json").read_text(encoding="utf-8")), {}
    types = {"integer": pa.int64(), "number": pa.float64(), "boolean": pa.bool_(), "string": pa.string()}
    for resource in package["resources"]:
        fields = {field["name"]: types[field["type"]] for field in resource["schema"]["fields"]}
        fields |= {gapped: pa.int64() for gapped in ("database", "n_used") if fields.get(gapped) == pa.float64()}
        tables = [pq.read_table(run / path) for path in resource["path"]]
        assert all(dict(zip(table.schema.names, table.schema.types, strict=True)) == fields for table in tables)
        found[resource["name"]] = sum(len(table) for table in tables)
    return found


def test_the_folder_of_a_run_describes_its_tables_also_after_it_went_on(tiny_file, tmp_path):
    tiny_file.write_text("scenarios: [scene]\nestimators: [prior]\ntrials: 2\nseed: 5\n", encoding="utf-8")
    for trials in (2, 40):
        compute(tiny_file, tmp_path / "run", trials)
        stored = {name: len(RunFolder(tmp_path / "run").table(name)) for name in TABLES}
        assert described_rows(tmp_path / "run") == {name: rows for name, rows in stored.items() if rows}
        assert stored["rows"] == trials
        assert list(damaged(tmp_path / "run")) == []


def test_frictionless_finds_the_tables_as_described(tiny_run, tmp_path):
    frictionless = pytest.importorskip("frictionless")
    export(tiny_run.folder, "csv", tmp_path)
    for folder in (tmp_path, tiny_run.folder):
        report = frictionless.Package(str(folder / "datapackage.json")).validate()
        assert report.flatten(["title", "message"]) == []
        assert len(report.tasks) >= 5


def test_units_are_those_of_the_ends_of_names():
    ends = {"epoch_velocity_error_m_s": "m/s", "time_s": "s", "time_days": "days", "range_m": "m", "nees": ""}
    assert {name: unit_of(name) for name in ends} == ends
    assert measure_label("epoch_velocity_error_m_s") == "epoch velocity error"
