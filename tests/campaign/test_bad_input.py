"""Bad input: one clear line on standard error (what, where, what to do), exit code 2, nothing half written."""

from __future__ import annotations

import ctypes
import functools
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from tiny_campaign import CAMPAIGN, SCENE, assert_same_results, boresight, compute, files, run, write_campaign
from tiny_sequences import write_sequences

from boresight.campaign.pool import workers
from boresight.campaign.store import RunFolder

PRIOR_ALONE = "scenarios: [scene]\nestimators: [prior]\ntrials: 4\nseed: 5\n"
REAL = """\
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
images: {folder: set, truth: ref}
"""
HEADING = "file,time_s,ref_qw,ref_qx,ref_qy,ref_qz,ref_tx_m,ref_ty_m,ref_tz_m,sun_body_x,sun_body_y,sun_body_z"
GOOD_ROW = "a.png,0,1,0,0,0,0,0,2000,0,0,-1"


def shaped(shape: str) -> str:
    return SCENE.replace("body:\n", f"body:\n  shape: {shape}\n")


# name: (campaign, scene, what the line must say)
FILES = {
    "missing shape": (
        CAMPAIGN, shaped("none.obj"), ["scene.yaml:3: body.shape: none.obj was not found", "BORESIGHT_DATA"],
    ),
    "shape with a long name": (
        CAMPAIGN, shaped("a" * 300), ["scene.yaml:3: body.shape: aaa", "aaa: File name too long: check the path"],
    ),
    "missing shape of a second body": (
        CAMPAIGN, SCENE + "second_body:\n  semi_major_axis_m: 900\n  body:\n    shape: dimorphoss-like\n",
        ["scene.yaml:14: second_body.body.shape: dimorphoss-like was not found", "did you mean dimorphos-like?"],
    ),
    "second body in the wrong unit": (
        CAMPAIGN, SCENE + "second_body:\n  semi_major_axis_m: 900\n  body: {shape: km.obj}\n",
        ["scene.yaml:13: ", "km.obj: with second_body.body.unit m", "set second_body.body.unit: km"],
    ),
    "broken shape": (CAMPAIGN, shaped("broken.obj"), ["broken.obj:2: 'f 1 2' is not a vertex", "OBJ file"]),
    "open shape": (CAMPAIGN, shaped("open.obj"), ["open.obj: the mesh is not closed", "mend the holes"]),
    "mesh in the wrong unit": (CAMPAIGN, shaped("km.obj"), ["km.obj: with body.unit m", "set body.unit: km"]),
    "unknown key": (
        CAMPAIGN, SCENE.replace("fov_deg", "fov_dge"),
        ["scene.yaml:8: camera.fov_dge: unknown key; did you mean fov_deg?"],
    ),
    "unknown experiment": (
        CAMPAIGN + "experiment: sequense\n", SCENE,
        ["tiny.yaml:9: experiment: 'sequense' is not a kind of trial; did you mean sequence?"],
    ),
    "not YAML": (CAMPAIGN, SCENE + "lighting: [1,\n", ["scene.yaml:"]),
    "camera inside the body": (
        CAMPAIGN, SCENE.replace("2000", "200"),
        ["scene.yaml: viewpoint.range_m: 200 m leads into the body", "choose a larger range"],
    ),
    "unknown scenario": (CAMPAIGN.replace("[scene]", "[scne]"), SCENE, ["scne: no such scenario"]),
    "unknown estimator": (
        CAMPAIGN.replace("landmark-harris", "landmark-surf"), SCENE,
        ["tiny.yaml:5: estimator 'landmark-surf' is unknown; did you mean landmark-sift?"],
    ),
    "no altimeter aboard": (
        CAMPAIGN.replace("  - prior", "  - landmark-altimeter"), SCENE,
        ["scene.yaml: sensors.altimeter: missing, but the estimator landmark-altimeter needs it", "add the section"],
    ),
    "unknown base": (
        CAMPAIGN.replace("  - prior", "  - landmark-altimeter: {base: lidar}"),
        SCENE + "sensors: {altimeter: {sigma_m: 5}}\n",
        ["tiny.yaml:4: estimator 'lidar' is unknown; there are: ", "landmark-harris, "],
    ),
    "unknown estimator option": (
        CAMPAIGN.replace("images: 40", "imges: 40"), SCENE,
        ["tiny.yaml:6: landmark-harris.database.imges: unknown key; did you mean images?"],
    ),
    "an experiment that does not fit": (
        CAMPAIGN.replace("landmark-harris", "ba-slam") + "experiment: sequence\n", SCENE,
        ["tiny.yaml:4: estimator 'prior' is unknown; there are: ba-slam, "],
    ),
    "a scenario that does not fit": (
        "scenarios: [scene]\nestimators: [ba-slam]\ntrials: 1\nseed: 5\nexperiment: sequence\n", SCENE,
        ["scene.yaml: sequence: missing, but the experiment sequence needs it"],
    ),
    "unknown published values": (
        CAMPAIGN + "report: rowell\n", SCENE, ["tiny.yaml:9: report: no published values"],
    ),
    "wrong level of a grid": (
        CAMPAIGN + "grid: {axes: {fov: {levels: {a: {}, b: {camera.fov_dg: 3}}}}}\n", SCENE,
        ["tiny.yaml:9: camera.fov_dg: unknown key; did you mean fov_deg?"],
    ),
    "a cratered world": (
        CAMPAIGN,
        "body: {shape: world.obj}\ncraters: {min_diameter_m: 80, edge_m: 10}\n" + SCENE[SCENE.index("camera:"):],
        ["scene.yaml: craters: a surface of ", "500 km across takes about", "take a smaller body"],
    ),
    "two estimators of one label": (CAMPAIGN.replace("- prior", "- prior\n  - prior"), SCENE, ["twice", "label"]),
}  # fmt: skip
# name: (table, image of height x width, further arguments, what the line must say)
IMAGES = {
    "NaN in the pose table": (
        [GOOD_ROW.replace("2000", "nan")], (40, 48), (), ["poses.csv:2: ref_tz_m: 'nan' is not a finite number"],
    ),
    "text in the pose table": ([GOOD_ROW, "b.png,soon"], (40, 48), (), ["poses.csv:3: time_s: 'soon' is not"]),
    "a quaternion that is none": ([GOOD_ROW.replace(",1,0", ",2,0", 1)], (40, 48), (), ["poses.csv:2: ref_qw", "is 2"]),
    "image of another size": (
        [GOOD_ROW], (40, 40), (), ["a.png: the image is 40 x 40 pixels, but the camera has 48 x 40"],
    ),
    "missing image": ([GOOD_ROW, GOOD_ROW.replace("a.", "b.")], (40, 48), (), ["b.png is not in"]),
    "more trials than images": ([GOOD_ROW], (40, 48), ("--trials", "2"), ["--trials 2", "1 trials at most"]),
}  # fmt: skip


def results(out: Path) -> set[str]:
    """List what a refused run left, but for its lock."""
    return {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()} - {".lock"}


@pytest.mark.parametrize("fault", FILES)
def test_a_wrong_file(tmp_path, refused, monkeypatch, fault):
    monkeypatch.delenv("BORESIGHT_DATA", raising=False)
    monkeypatch.setattr("boresight.scenarios.craters.tiles.installed_memory_bytes", lambda: 24 * 10**9)
    campaign, scene, expected = FILES[fault]
    file = write_campaign(tmp_path, campaign, scene)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.25)
    ball.export(tmp_path / "km.obj")
    trimesh.Trimesh(1e6 * ball.vertices, ball.faces, process=False).export(tmp_path / "world.obj")
    trimesh.Trimesh(250 * 4 * ball.vertices, ball.faces[1:], process=False).export(tmp_path / "open.obj")
    (tmp_path / "broken.obj").write_text("v 1 2 3\nf 1 2\n")
    error = refused("run", file, "--jobs", 1, "--out", tmp_path / "run")
    assert all(part in error for part in expected), error
    assert not results(tmp_path / "run")
    assert refused("validate", file) == error
    if scene != SCENE and "landmark-altimeter" not in campaign:
        assert refused("validate", tmp_path / "scene.yaml") == error


@pytest.mark.parametrize("fault", IMAGES)
def test_a_wrong_image_set(tmp_path, refused, fault):
    table, size, arguments, expected = IMAGES[fault]
    file = write_campaign(tmp_path, PRIOR_ALONE.replace("4", "1"), REAL)
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "poses.csv").write_text("\n".join([HEADING, *table]) + "\n")
    cv2.imwrite(str(tmp_path / "set" / "a.png"), np.full(size, 7, dtype=np.uint8))
    error = refused("run", file, "--jobs", 1, "--out", tmp_path / "run", *arguments)
    assert all(part in error for part in expected), error
    assert not results(tmp_path / "run")
    if not arguments:
        assert [refused("validate", checked) for checked in (file, tmp_path / "scene.yaml")] == [error] * 2


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/boresight/run"])
def test_a_folder_that_cannot_be_written(tiny_run, tmp_path, monkeypatch, refused, place):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    error = refused("run", tiny_run.file, "--out", place, "--trials", 2)
    assert f"boresight: {place}: cannot be used as a run folder" in error
    assert "--out" in error
    assert (tmp_path / "file").read_text() == "mine"


@contextmanager
def as_a_user() -> Iterator[None]:
    """Take CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH from this thread: root writes everywhere; nobody else has them."""
    library, header, before = ctypes.CDLL(None), (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    assert library.capget(header, before) == 0
    without = type(before)(before[0] & ~0b110, *before[1:])
    try:
        assert library.capset(header, without) == 0
        yield
    finally:
        library.capset(header, before)


def test_read_only_folders_are_left_alone(tmp_path, refused):
    """A folder for a new run, and a run that became read-only: it neither goes on nor has a report."""
    file, out, locked = write_sequences(tmp_path / "campaign", 4), tmp_path / "run", tmp_path / "locked"
    compute(file, out, 2)
    before = files(out)
    locked.mkdir()
    folders = [locked, out, *(path for path in out.rglob("*") if path.is_dir())]
    for path in folders:
        path.chmod(0o555)
    commands = (("run", file, "--out", locked / "run"), ("run", file, "--out", out), ("report", out))
    with as_a_user():
        errors = [refused(*words) for words in commands]
    for path in folders:
        path.chmod(0o755)
    assert str(locked / "run") in errors[0]
    assert "--out" in errors[0]
    assert not list(locked.iterdir())
    assert all(str(out) in error for error in errors[1:])
    assert files(out) == before


@pytest.mark.parametrize("name", ["landmarks", "products"])
def test_a_file_in_the_place_of_a_table(tiny_run, tmp_path, refused, name):
    out = tmp_path / "run"
    compute(tiny_run.file, out, 10)
    before = files(out)
    for path in sorted((out / name).rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    (out / name).rmdir()
    (out / name).write_text("in the way")
    assert str(out / name) in refused("run", tiny_run.file, "--jobs", 1, "--out", out, "--trials", 15)
    assert RunFolder(out).table("rows")["trial"].max() == 9, "a block has rows only when all of it is stored"
    after = files(out)
    for path, content in before.items():
        if not path.startswith((name, "manifest.json")):
            assert after[path] == content, path


@contextmanager
def file_size_limit(limit: int) -> Iterator[None]:
    """Let no file of this process and of workers that it starts grow beyond a size: like on a full disk, writing fails.

    Python ignores the signal.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("limit", "jobs", "options", "stopped_at"),
    [
        (1_000, 1, (), "products/landmark-database"),
        (8_000, 1, (), "scene-0000001.parquet"),
        pytest.param(40_000, 2, ("--keep-images",), "images/scene/00000", marks=pytest.mark.long),
        pytest.param(40_000, 1, ("--worst", "0"), "report", marks=pytest.mark.long),
    ],
    ids=["product", "table", "image in a worker", "report"],
)
def test_a_full_disk(tiny_run, tmp_path, monkeypatch, refused, limit, jobs, options, stopped_at):
    out = tmp_path / "run"
    if stopped_at.endswith("parquet"):
        compute(tiny_run.file, out, 10)
    before = files(out)
    monkeypatch.setattr(workers, "_idle_workers", functools.cache(workers._IdleWorkers))  # with the limit from birth
    with file_size_limit(limit):
        assert stopped_at in refused("run", tiny_run.file, "--out", out, "--jobs", jobs, *options)
    after = files(out)
    assert {path: after[path] for path in before if path != "manifest.json"} == {
        path: content for path, content in before.items() if path != "manifest.json"
    }
    assert not [path for path in after if ".tmp" in path], "nothing half written stays"
    compute(tiny_run.file, out)
    assert_same_results(tiny_run.folder, out)


def test_standard_output_on_a_full_disk():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "boresight", "list"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "disk is full" in done.stderr


def test_a_reader_that_stops_reading_is_no_fault():
    code = f"{sys.executable} -m boresight schema | head -c 5; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, '{\n "$', "")


def test_a_fault_of_the_user_shows_no_traceback_in_a_process_of_its_own(tmp_path):
    file = write_campaign(tmp_path, scene=SCENE.replace("fov_deg", "fov_dge"))
    done = boresight("show", file)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    assert run(file, tmp_path / "run") == 2
    assert not (tmp_path / "run").exists()
