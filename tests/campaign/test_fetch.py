"""Downloads from servers of our own, which break off, send wrong files and record what they were asked."""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import os
import re
import shutil
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from mission_data import needs_data

from boresight.campaign.cli import main
from boresight.campaign.cli.fetch import wanted
from boresight.campaign.data.fetch import apophis, fetch, icq, state
from boresight.scenarios.bodies.readers import read_shape
from boresight.scenarios.data import data_folder, find_data_file, find_data_folder
from boresight.scenarios.data.datasets import DataSet, datasets, read_registry
from boresight.scenarios.errors import BoresightError

CONTENT = np.random.default_rng(0).bytes(300_000)
COMMIT = "0123456789abcdef0123" * 2


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


class Server(ThreadingHTTPServer):
    """Serves one content under every name, with ranges, also as a proxy."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answer)
        self.content = CONTENT
        self.breaks_off_after: int | None = None
        self.knows_ranges = True
        self.says_length = True
        self.asked: list[tuple[str, str | None]] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Answer(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server, content = self.server, self.server.content
        server.asked.append((self.path, self.headers.get("Range")))
        if "missing" in self.path:
            self.send_error(404)
            return
        wanted_from = re.match(r"bytes=(\d+)-", self.headers.get("Range") or "")
        goes_on = wanted_from is not None and server.knows_ranges
        first = int(wanted_from.group(1)) if wanted_from is not None and server.knows_ranges else 0
        if goes_on and first >= len(content):
            self.send_error(416)
            return
        self.send_response(206 if goes_on else 200)
        if goes_on:
            self.send_header("Content-Range", f"bytes {first}-{len(content) - 1}/{len(content)}")
        if server.says_length:
            self.send_header("Content-Length", str(len(content) - first))
        self.end_headers()
        last = len(content) if server.breaks_off_after is None else first + server.breaks_off_after
        self.wfile.write(content[first:last])

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def running(server: ThreadingHTTPServer) -> Iterator[str]:
    with server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


def folder_server(folder: Path) -> ThreadingHTTPServer:
    return ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    with running(made):
        yield made


def dataset(name: str = "a.bin", content: bytes = CONTENT, **file: object) -> DataSet:
    entry = {"name": name, "bytes": len(content), "sha256": sha256(content), **file}
    about = {"name": "some", "title": "Some", "folder": "shapes", "credit": "us", "licence": "CC0", "note": "in km"}
    return DataSet.model_validate({**about, "repository": "us/some", "commit": COMMIT, "files": (entry,)})


def run(data: DataSet, root: Path, source: str) -> list[tuple[str, str]]:
    return [(file.path.name, file.how) for file in fetch(data, root, lambda *_: None, source)]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_comes_whole_and_is_not_asked_for_again(server, tmp_path):
    data = dataset(name="b.bin")
    assert state(data, tmp_path) == "not there"
    seen = []
    (file,) = fetch(data, tmp_path, lambda *progress: seen.append(progress), server.url)
    assert (file.path, file.how) == (tmp_path / "shapes" / "b.bin", "fetched")
    assert file.path.read_bytes() == CONTENT
    assert seen[-1] == ("b.bin", len(CONTENT), len(CONTENT))
    assert run(data, tmp_path, server.url) == [("b.bin", "there")]
    assert server.asked == [("/shapes/b.bin", None)]
    assert state(data, tmp_path) == "there"
    assert names(tmp_path / "shapes") == ["b.bin", "some.licence.txt"]


def test_licence_credit_and_origin_are_stored_next_to_the_files(server, tmp_path):
    run(dataset(), tmp_path, server.url)
    stored = (tmp_path / "shapes" / "some.licence.txt").read_text()
    for line in ("licence: CC0", "credit: us", f"from: https://github.com/us/some, commit {COMMIT}", "in km", "a.bin"):
        assert line in stored


def test_without_a_mirror_a_file_comes_from_the_repository_at_the_commit(server, tmp_path, monkeypatch):
    data = dataset(path="some folder/+x/b.bin")
    assert data.url(data.files[0]) == f"https://raw.githubusercontent.com/us/some/{COMMIT}/some%20folder/%2Bx/b.bin"
    monkeypatch.setattr("boresight.scenarios.data.datasets.RAW_FILES", server.url)
    assert run(data, tmp_path, "") == [("a.bin", "fetched")]
    assert server.asked == [(f"/us/some/{COMMIT}/some%20folder/%2Bx/b.bin", None)]


@pytest.mark.parametrize("says_length", [True, False])
def test_a_download_that_broke_off_goes_on_there(server, tmp_path, says_length):
    data = dataset()
    server.breaks_off_after, server.says_length = 100_000, says_length
    with pytest.raises(BoresightError, match=r"the connection broke off: .* the same command goes on"):
        run(data, tmp_path, server.url)
    part = tmp_path / "shapes" / "a.bin.part"
    assert names(tmp_path / "shapes") == ["a.bin.part"]
    here = part.stat().st_size
    assert 0 < here < len(CONTENT)
    server.breaks_off_after = None
    assert run(data, tmp_path, server.url) == [("a.bin", "fetched")]
    assert (tmp_path / "shapes" / "a.bin").read_bytes() == CONTENT
    assert [asked for _, asked in server.asked] == [None, f"bytes={here}-"]
    assert names(tmp_path / "shapes") == ["a.bin", "some.licence.txt"]


@pytest.mark.parametrize("part", [CONTENT[::-1][:1000], CONTENT, CONTENT[::-1], CONTENT * 2, b""])
@pytest.mark.parametrize("ranges", [True, False])
def test_a_part_of_something_else_is_begun_anew(server, tmp_path, part, ranges):
    server.knows_ranges = ranges
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "a.bin.part").write_bytes(part)
    assert run(dataset(), tmp_path, server.url) == [("a.bin", "fetched")]
    assert (tmp_path / "shapes" / "a.bin").read_bytes() == CONTENT


def test_a_wrong_file_of_the_right_size_leaves_nothing(server, tmp_path):
    server.content = CONTENT[::-1]
    with pytest.raises(BoresightError, match=r"a\.bin: has the checksum .*, not the registered .*: nothing was kept"):
        run(dataset(), tmp_path, server.url)
    assert names(tmp_path / "shapes") == []


@pytest.mark.parametrize("says_length", [True, False])
def test_a_larger_file_leaves_nothing(server, tmp_path, says_length):
    server.content, server.says_length = CONTENT + b"x", says_length
    with pytest.raises(BoresightError, match=r"registered 300000( bytes)?; nothing was kept"):
        run(dataset(), tmp_path, server.url)
    assert names(tmp_path / "shapes") == []


def test_a_damaged_file_in_place_is_not_taken_nor_overwritten(server, tmp_path):
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "a.bin").write_bytes(b"damaged")
    with pytest.raises(BoresightError, match="move it away to fetch it again"):
        run(dataset(), tmp_path, server.url)
    assert server.asked == []
    assert (tmp_path / "shapes" / "a.bin").read_bytes() == b"damaged"


def test_a_server_without_the_file_or_no_server(server, tmp_path):
    with pytest.raises(BoresightError, match=r"/missing.bin: the server says 404 Not Found: .* --from"):
        run(dataset("missing.bin"), tmp_path, server.url)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        closed = f"http://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(BoresightError, match="no connection: check the network, or give a mirror with --from") as error:
        run(dataset(), tmp_path, closed)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250


def test_a_proxy_is_used(server, tmp_path, monkeypatch):
    monkeypatch.setenv("http_proxy", server.url)
    monkeypatch.setenv("no_proxy", "")
    assert run(dataset(), tmp_path, "http://mirror.invalid/data") == [("a.bin", "fetched")]
    assert server.asked == [("http://mirror.invalid/data/shapes/a.bin", None)]


def test_a_disk_that_is_full(server, tmp_path, monkeypatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(BoresightError, match=r"a.bin: the disk is full: free some space; the same command goes on"):
        run(dataset(), tmp_path, server.url)
    assert "a.bin" not in names(tmp_path / "shapes")


def test_a_folder_that_cannot_be_made(server, tmp_path):
    (tmp_path / "shapes").write_text("a file")
    with pytest.raises(BoresightError, match=r"a.bin: .* set BORESIGHT_DATA to a folder"):
        run(dataset(), tmp_path, server.url)


def test_a_folder_is_a_mirror_too(tmp_path):
    mirror = tmp_path / "mirror"
    (mirror / "shapes").mkdir(parents=True)
    with pytest.raises(BoresightError, match=r"a.bin: no such file: give the folder that holds a.bin"):
        run(dataset(), tmp_path, str(mirror))
    (mirror / "shapes" / "a.bin").write_bytes(CONTENT[:-1])
    with pytest.raises(BoresightError, match="has 299999 bytes, not the registered 300000"):
        run(dataset(), tmp_path, str(mirror))
    (mirror / "shapes" / "a.bin").write_bytes(CONTENT[::-1])
    with pytest.raises(BoresightError, match="has the checksum"):
        run(dataset(), tmp_path, str(mirror))
    (mirror / "shapes" / "a.bin").write_bytes(CONTENT)
    assert run(dataset(), tmp_path, str(mirror)) == [("a.bin", "fetched")]
    assert (tmp_path / "shapes" / "a.bin").read_bytes() == CONTENT


# --- derived files -----------------------------------------------------------------------------------------------

PLY = """ply
format ascii 1.0
element vertex 24
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
"""
TETRAHEDRON = b"v 0 0 0\nv 3 0 0\nv 0 2 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def ply_of_a_cube(path: Path) -> Path:
    """Write a PLY with the six faces of a cube, Q = 1, without welding."""
    points = [(f, u, v) for f in range(6) for u in (0, 1) for v in (0, 1)]
    path.write_text(PLY + "".join(f"{0.1 * f} {u} {-v}\n" for f, u, v in points) + "3 0 1 2\n3 1 2 3\n")
    return path


def test_an_icq_has_the_vertices_of_the_ply_in_their_order(tmp_path):
    lines = icq(ply_of_a_cube(tmp_path / "a.ply")).decode().splitlines()
    assert lines[0] == "1"
    assert lines[4] == "   0.00000   1.00000  -1.00000"
    assert lines[-1] == "   0.50000   1.00000  -1.00000"
    assert len(lines) == 25
    (tmp_path / "b.ply").write_text((PLY + "0 0 0\n" * 23 + "3 0 1 2\n3 1 2 3\n").replace("vertex 24", "vertex 23"))
    with pytest.raises(BoresightError, match="23 vertices are not six grids"):
        icq(tmp_path / "b.ply")


def test_apophis_is_scaled_to_its_volume_about_its_centre(tmp_path):
    """A tetrahedron has a sixth of the volume of its edges' box, and its centre at the mean of its corners."""
    (tmp_path / "raw.obj").write_bytes(TETRAHEDRON)
    (tmp_path / "scaled.obj").write_bytes(apophis(tmp_path / "raw.obj"))
    vertices, faces, _ = read_shape(tmp_path / "scaled.obj", "obj")
    scale = 0.375 / (6.0 / np.pi * 1.0) ** (1.0 / 3.0)
    raw = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1]])
    np.testing.assert_allclose(vertices, (raw - raw.mean(axis=0)) * scale, atol=6e-8)
    assert faces.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 3 2\n")
    with pytest.raises(BoresightError, match="enclose no volume"):
        apophis(tmp_path / "flat.obj")


def derived(tmp_path: Path) -> tuple[DataSet, bytes]:
    """Return a data set of a scaled tetrahedron, and its content."""
    (tmp_path / "x.obj").write_bytes(TETRAHEDRON)
    content = apophis(tmp_path / "x.obj")
    raw = {"name": "raw.obj", "bytes": len(TETRAHEDRON), "sha256": sha256(TETRAHEDRON)}
    return dataset("scaled.obj", content, by="apophis", raw=raw), content


def test_a_derived_file_is_made_of_the_raw_one(tmp_path, server, monkeypatch):
    data, content = derived(tmp_path)
    server.content = TETRAHEDRON
    monkeypatch.setattr("boresight.scenarios.data.datasets.RAW_FILES", server.url)
    assert run(data, tmp_path / "data", "") == [("scaled.obj", "derived")]
    assert (tmp_path / "data" / "shapes" / "scaled.obj").read_bytes() == content
    assert run(data, tmp_path / "data", "") == [("scaled.obj", "there")]
    assert len(server.asked) == 1


def test_a_mirror_may_have_the_raw_file_or_the_derived_one(tmp_path):
    data, content = derived(tmp_path)
    for name, stored, how in (("raw.obj", TETRAHEDRON, "derived"), ("scaled.obj", content, "fetched")):
        served = tmp_path / f"mirror-{name}"
        (served / "shapes").mkdir(parents=True)
        (served / "shapes" / name).write_bytes(stored)
        with running(folder_server(served)) as url:
            assert run(data, tmp_path / how, url) == [("scaled.obj", how)]
        assert (tmp_path / how / "shapes" / "scaled.obj").read_bytes() == content


def test_a_derived_file_with_another_checksum_is_not_kept(tmp_path, server):
    data, _ = derived(tmp_path)
    wrong = data.files[0].model_copy(update={"sha256": "0" * 64})
    data = data.model_copy(update={"files": (wrong,)})
    served = tmp_path / "mirror" / "shapes"
    served.mkdir(parents=True)
    (served / "raw.obj").write_bytes(TETRAHEDRON)
    with pytest.raises(BoresightError, match=r"scaled.obj does not have the registered checksum 0000"):
        run(data, tmp_path / "data", str(tmp_path / "mirror"))
    assert names(tmp_path / "data" / "shapes") == ["raw.obj"]


# --- the registry ------------------------------------------------------------------------------------------------

ABOUT = "title: X, credit: us, licence: none"
SOURCE = f"repository: us/some, commit: {COMMIT}"
FILE = f"{{name: a, bytes: 1, sha256: '{'0' * 64}'"


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        (f"folder: ../x, {SOURCE}, files: [{FILE}}}]", "folder: '../x' does not match"),
        (f"folder: a/../../x, {SOURCE}, files: [{FILE}}}]", "folder: 'a/../../x' does not match"),
        (f"folder: /etc, {SOURCE}, files: [{FILE}}}]", "folder: '/etc' does not match"),
        (f"folder: a, {SOURCE}, files: [{FILE.replace('a,', '../b,', 1)}}}]", "name: '../b' does not match"),
        (f"folder: a, {SOURCE}, files: [{FILE.replace('a,', '.hidden,', 1)}}}]", "name: '.hidden' does not match"),
        (f"folder: a, {SOURCE}, files: [{FILE}}}, {FILE}}}]", "two of them are called a"),
        (f"folder: a, {SOURCE}, files: [{{name: a, bytes: 1}}]", "sha256"),
        (f"folder: a, {SOURCE}, files: [{FILE}, by: icq}}]", "raw and by belong together"),
        (f"folder: a, {SOURCE}, files: []", "a repository needs a commit and files"),
        ("folder: a", "give either repository or published"),
    ],
)
def test_an_entry_of_the_registry_cannot_be_wrong(tmp_path, keys, line):
    (tmp_path / "x.yaml").write_text(f"x: {{{ABOUT}, {keys}}}\n")
    with pytest.raises(BoresightError) as refused:
        read_registry(tmp_path / "x.yaml")
    assert line in str(refused.value)


SHARED = needs_data("SOURCES.csv")


@SHARED
def test_every_file_of_the_data_folder_is_registered_as_its_table_says():
    with (data_folder() / "SOURCES.csv").open(newline="") as table:
        rows = {row["file"]: row for row in csv.DictReader(table)}
    fetched = {f"{one.folder}/{file.name}": (one, file) for one in datasets().values() for file in one.files}
    own = {f"{one.folder}/{name}" for one in datasets().values() for name in one.needed}
    assert set(rows) <= set(fetched) | own
    for path, (one, file) in fetched.items():
        row = rows[path]
        assert (str(file.bytes), file.sha256) == (row["bytes"], row["sha256"]), path
        if not (file.bundled or file.raw) and path != "shapes/itokawa_radar.obj":  # whose path there is told in words
            raw_url = f"{row['repository']}/{row['commit']}/{row['path']}"
            assert one.url(file).removeprefix("https://raw.githubusercontent.com/").replace("%2B", "+") == raw_url


@SHARED
def test_all_data_come_from_a_server_of_the_data_folder(tmp_path, monkeypatch, capsys):
    served = data_folder()
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    with running(folder_server(served)) as url:
        assert main(["fetch", "all", "--from", url]) == 0
    said = capsys.readouterr().out
    assert "apophis: 1 fetched; every checksum is right" in said
    assert "amica-20051001: bring your own" in said
    for one in datasets().values():
        for file in one.files:
            path = f"{one.folder}/{file.name}"
            assert (tmp_path / path).read_bytes() == (served / path).read_bytes()


@SHARED
def test_an_icq_derived_from_the_real_ply_is_the_registered_one(tmp_path, monkeypatch):
    source = data_folder() / "shapes" / "itokawa_gaskell_q64.ply"
    (tmp_path / "mirror" / "shapes").mkdir(parents=True)
    shutil.copy(source, tmp_path / "mirror" / "shapes")
    found = run(datasets()["itokawa-gaskell"], tmp_path, str(tmp_path / "mirror"))
    assert found == [("itokawa_gaskell_q64.ply", "fetched"), ("itokawa_gaskell_q64.icq", "derived")]


def test_the_poses_of_the_comet_are_ours_and_part_of_boresight(tmp_path):
    comet = datasets()["navcam-67p"]
    poses = [file for file in comet.files if file.bundled]
    assert [file.name for file in poses] == ["poses.csv"]
    assert run(comet.model_copy(update={"files": tuple(poses)}), tmp_path, "") == [("poses.csv", "copied")]


# --- what a name stands for --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "fetched", "own"),
    [
        ("eros", ["eros"], []),
        ("rowell2015-simulated", ["itokawa-gaskell"], []),
        ("navcam67p-real", ["comet-67p", "navcam-67p"], []),
        ("bennu-real", ["bennu-mapcam"], []),
        ("dawn-vesta-real", ["dawn-vesta"], []),
        ("delpech2015-sensitivity", ["apophis", "itokawa-gaskell", "itokawa-radar"], []),
        ("rowell2015", ["itokawa-gaskell", "comet-67p", "navcam-67p"], ["amica-20051001", "hayabusa-spice"]),
        ("cheng2003", ["eros"], []),
        ("quickstart", [], []),
    ],
)
def test_a_paper_or_a_campaign_stands_for_the_data_it_reads(name, fetched, own, tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    found = wanted(name)
    assert [one.name for one in found.fetched] == fetched
    assert [one.name for one in found.own] == own
    assert found.unknown == ()


def test_a_campaign_file_names_files_of_no_data_set(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    (tmp_path / "scene.yaml").write_text("extends: quickstart\nbody: {shape: mine.obj, detail: null}\n")
    (tmp_path / "mine.yaml").write_text("scenarios: [scene.yaml]\nestimators: [prior]\ntrials: 1\nseed: 1\n")
    assert wanted(str(tmp_path / "mine.yaml")).unknown == ("mine.obj",)


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture
def registry(tmp_path, monkeypatch):
    """A registry of two data sets, one of which a user must bring."""
    entry = json.loads(dataset().model_dump_json(exclude_unset=True))
    other = {key: entry[key] for key in ("title", "credit", "licence")} | {"folder": "x", "published": "a paper"}
    entry.pop("name")
    (tmp_path / "registry.yaml").write_text(json.dumps({"some": entry, "yours": other}))
    monkeypatch.setattr("boresight.scenarios.data.datasets.REGISTRY", tmp_path / "registry.yaml")
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


def test_the_command_says_size_licence_and_credit_before(server, registry, capsys):
    server.breaks_off_after = 0
    assert main(["fetch", "some", "--from", server.url]) == 2
    captured = capsys.readouterr()
    assert captured.out.startswith(f"0.3 MB to fetch into {registry} from {server.url}\n")
    assert "some: Some; not there, 0.3 MB to come" in captured.out
    assert "licence: CC0" in captured.out
    assert "credit: us" in captured.out
    assert captured.err.count("\n") == 1
    server.breaks_off_after = None
    assert main(["fetch", "all", "--from", server.url]) == 0
    said = capsys.readouterr().out
    assert "some: 1 fetched; every checksum is right; in km" in said
    assert "yours: bring your own: Some, into x; published at a paper" in said
    assert main(["fetch", "some"]) == 0
    assert "0.0 MB to fetch" in capsys.readouterr().out


def test_the_command_refuses_a_disk_without_space_before_it_begins(server, registry, monkeypatch, capsys):
    usage = shutil.disk_usage(registry.parent)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
    assert main(["fetch", "some", "--from", server.url]) == 2
    assert "0.3 MB are to come, but the disk has 0.0 MB left" in capsys.readouterr().err
    assert server.asked == []
    assert not registry.exists()


def test_the_command_lists_what_there_is(registry, capsys):
    assert main(["fetch", "--list"]) == 0
    said = capsys.readouterr().out
    assert f"data folder: {registry}" in said
    assert "some  not there  0.3 MB  Some" in said
    assert "yours  Some, into x; a paper" in said


def test_without_a_variable_data_go_to_the_users_folder(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("BORESIGHT_DATA", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert main(["fetch", "--list"]) == 0
    assert f"data folder: {tmp_path / 'boresight'}" in capsys.readouterr().out


def test_a_run_brings_what_it_needs(server, registry, tmp_path, monkeypatch, capsys):
    """A cube of 2 m as the one file of the registry."""
    corners = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1))
    server.content = f"{corners}f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n".encode()
    entry = json.loads(
        dataset(name="a.obj", content=server.content).model_dump_json(exclude_unset=True, exclude={"name"})
    )
    (tmp_path / "registry.yaml").write_text(json.dumps({"some": entry}))
    monkeypatch.chdir(tmp_path)
    body = "{shape: a.obj, unit: m}"
    scene = f"body: {body}\ncamera: {{width_px: 32, height_px: 32, fov_deg: 20}}\nviewpoint: {{range_m: 10}}\n"
    Path("scene.yaml").write_text(f"{scene}pose_error: {{position_cam_m: {{normal: [1, 1, 1]}}}}\n")
    Path("mine.yaml").write_text("scenarios: [scene.yaml]\nestimators: [prior]\ntrials: 1\nseed: 1\n")
    words = ["run", "mine.yaml", "--out", "run", "--jobs", "1", "--no-report"]
    assert main(words) == 2
    assert "a.obj is missing" in (told := capsys.readouterr().err) and "boresight fetch mine.yaml brings it" in told
    assert main([*words, "--from", server.url]) == 2
    assert "give --fetch too" in capsys.readouterr().err
    assert main([*words, "--fetch", "--from", server.url]) == 0
    assert "some: 1 fetched" in capsys.readouterr().out
    assert (registry / "shapes" / "a.obj").read_bytes() == server.content
    assert main([*words, "--fetch", "--from", server.url]) == 0
    assert "to fetch" not in capsys.readouterr().out


# --- messages about missing files --------------------------------------------------------------------------------


def test_what_is_missing_names_the_data_set_that_has_it(monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    with pytest.raises(BoresightError, match="to fetch it: boresight fetch eros"):
        find_data_file("eros022540.tab", (), "shapes", "body.shape")
    with pytest.raises(BoresightError, match="to fetch it: boresight fetch navcam-67p"):
        find_data_folder("rosetta_navcam_67p", (), "images", "images.folder")
    with pytest.raises(BoresightError, match=r"bring your own: SPICE kernels of Hayabusa .* published at https://naif"):
        find_data_file("hayabusa/amica31.ti", (), "spice", "images.spice.kernels")
    with pytest.raises(BoresightError, match=r"nothing\.tab was not found; .*; check the path"):
        find_data_file("nothing.tab", (), "shapes", "body.shape")


def test_a_folder_for_a_file_and_a_file_for_a_folder_are_named(tmp_path):
    file = tmp_path / "a.obj"
    file.write_text("v 0 0 0\n")
    with pytest.raises(BoresightError, match=f"body.shape: {tmp_path} is a folder: give the path of a file"):
        find_data_file(str(tmp_path), (), "shapes", "body.shape")
    with pytest.raises(BoresightError, match=f"images.folder: {file} is a file: give the path of a folder"):
        find_data_folder("a.obj", (tmp_path,), "images", "images.folder")
    with pytest.raises(BoresightError, match=r"body\.shape: a{60}: File name too long: check the path"):
        find_data_file("a" * 9999, (tmp_path,), "shapes", "body.shape")


def test_the_users_folder_is_searched_where_no_variable_is_set(monkeypatch, tmp_path):
    monkeypatch.delenv("BORESIGHT_DATA", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    file = tmp_path / "boresight" / "shapes" / "a.obj"
    file.parent.mkdir(parents=True)
    file.write_text("v 0 0 0\n")
    assert find_data_file("a.obj", (), "shapes", "body.shape") == file
