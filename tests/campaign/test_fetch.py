"""Downloads from a server of our own, which breaks off, changes its mind and tells what it was asked."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import socket
import threading
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from campaign.cli import main
from campaign.data.fetch import fetch, state
from scenarios.data import find_data_file, find_data_folder
from scenarios.data.datasets import DataSetSpec, dataset_names, load_dataset
from scenarios.errors import BoresightError

CONTENT = np.random.default_rng(0).bytes(300_000)
SHA256 = hashlib.sha256(CONTENT).hexdigest()


class Server(ThreadingHTTPServer):
    """Serves one content under every name, with ranges and a tag of its version."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answer)
        self.content = CONTENT
        self.breaks_off_after: int | None = None
        self.knows_ranges = True
        self.asked: list[str | None] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Answer(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server, content = self.server, self.server.content
        server.asked.append(self.headers.get("Range"))
        if self.path.startswith("/missing"):
            self.send_error(404)
            return
        tag = f'"{hashlib.sha256(content).hexdigest()}"'
        wanted = re.match(r"bytes=(\d+)-", self.headers.get("Range") or "")
        goes_on = wanted is not None and server.knows_ranges and self.headers.get("If-Range") == tag
        first = int(wanted.group(1)) if goes_on else 0
        if goes_on and first >= len(content):
            self.send_error(416)
            return
        self.send_response(206 if goes_on else 200)
        if goes_on:
            self.send_header("Content-Range", f"bytes {first}-{len(content) - 1}/{len(content)}")
        self.send_header("ETag", tag)
        self.send_header("Content-Length", str(len(content) - first))
        self.end_headers()
        last = len(content) if server.breaks_off_after is None else first + server.breaks_off_after
        self.wfile.write(content[first:last])

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def dataset(server: Server, path: str = "a.bin", **file: object) -> DataSetSpec:
    entry = {"url": f"{server.url}/{path}", **file}
    about = {"name": "some", "title": "Some", "folder": "shapes", "credit": "us", "licence": "none"}
    return DataSetSpec.model_validate({**about, "files": (entry,)})


def run(data: DataSetSpec, root: Path) -> list[tuple[str, str, str]]:
    return [(file.path.name, file.how, file.trust) for file in fetch(data, root, lambda *_: None)]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_comes_whole_and_is_not_asked_for_again(server, tmp_path):
    data = dataset(server, sha256=SHA256, size_bytes=len(CONTENT), name="b.bin")
    assert state(data, tmp_path) == "not there"
    seen = []
    (file,) = fetch(data, tmp_path, lambda *progress: seen.append(progress))
    assert (file.path, file.sha256, file.how, file.trust) == (
        tmp_path / "shapes" / "b.bin", SHA256, "fetched", "registration",
    )  # fmt: skip
    assert file.path.read_bytes() == CONTENT
    assert seen[-1] == ("b.bin", len(CONTENT), len(CONTENT))
    assert run(data, tmp_path) == [("b.bin", "there", "registration")]
    assert server.asked == [None]
    assert state(data, tmp_path) == "there"
    assert names(tmp_path / "shapes") == [".boresight-fetched.json", "b.bin"]


def test_a_download_that_broke_off_goes_on_there(server, tmp_path):
    data = dataset(server, sha256=SHA256)
    server.breaks_off_after = 100_000
    with pytest.raises(BoresightError, match=r"the connection broke off: .* the same command goes on"):
        run(data, tmp_path)
    assert "a.bin" not in names(tmp_path / "shapes")
    part = tmp_path / "shapes" / "a.bin.part"
    here = [part.stat().st_size]
    with pytest.raises(BoresightError, match="broke off"):
        run(data, tmp_path)
    here.append(part.stat().st_size)
    assert 0 < here[0] < here[1] < len(CONTENT)
    server.breaks_off_after = None
    assert run(data, tmp_path) == [("a.bin", "fetched", "registration")]
    assert (tmp_path / "shapes" / "a.bin").read_bytes() == CONTENT
    assert server.asked == [None, f"bytes={here[0]}-", f"bytes={here[1]}-"]
    assert names(tmp_path / "shapes") == [".boresight-fetched.json", "a.bin"]


@pytest.mark.parametrize("what", ["another file", "no ranges", "all but the name"])
def test_a_part_that_does_not_fit_is_begun_anew(server, tmp_path, what):
    data = dataset(server)
    server.breaks_off_after = 100_000
    with pytest.raises(BoresightError, match="broke off"):
        run(data, tmp_path)
    server.breaks_off_after = None
    if what == "another file":
        server.content = CONTENT[::-1]
    elif what == "no ranges":
        server.knows_ranges = False
    else:  # the machine went down between the last byte and the renaming
        (tmp_path / "shapes" / "a.bin.part").write_bytes(CONTENT)
    run(data, tmp_path)
    assert (tmp_path / "shapes" / "a.bin").read_bytes() == server.content


def test_a_wrong_checksum_keeps_nothing(server, tmp_path):
    data = dataset(server, sha256="0" * 64)
    with pytest.raises(BoresightError, match=r"checksum is not 000000000000\.\.\., that of the registration: nothing"):
        run(data, tmp_path)
    assert names(tmp_path / "shapes") == []


def test_the_checksum_of_the_first_fetch_holds(server, tmp_path):
    data = dataset(server)
    assert run(data, tmp_path) == [("a.bin", "fetched", "nothing")]
    assert run(data, tmp_path) == [("a.bin", "there", "first fetch")]
    ledger = json.loads((tmp_path / "shapes" / ".boresight-fetched.json").read_text())
    assert ledger["a.bin"]["sha256"] == SHA256
    assert ledger["a.bin"]["url"] == f"{server.url}/a.bin"
    file = tmp_path / "shapes" / "a.bin"
    file.unlink()
    server.content = CONTENT[::-1]
    with pytest.raises(BoresightError, match="that of the first fetch: nothing was kept"):
        run(data, tmp_path)
    assert not file.exists()
    file.write_bytes(b"damaged")
    with pytest.raises(BoresightError, match="that of the first fetch: move it away to fetch it anew"):
        run(data, tmp_path)


def test_another_size_than_registered_is_refused_before_it_comes(server, tmp_path):
    with pytest.raises(BoresightError, match="has 300000 bytes, not the registered 299999; nothing was kept"):
        run(dataset(server, size_bytes=299_999), tmp_path)
    assert names(tmp_path / "shapes") == []


def test_what_the_server_and_the_net_may_say(server, tmp_path):
    with pytest.raises(BoresightError, match=r"/missing.bin: the server says 404 Not Found"):
        run(dataset(server, "missing.bin"), tmp_path)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        closed = f"http://127.0.0.1:{free.getsockname()[1]}/a.bin"
    nobody = dataset(server).model_copy(
        update={"files": (dataset(server).files[0].model_copy(update={"url": closed}),)}
    )
    with pytest.raises(BoresightError, match="no connection: check the network") as error:
        run(nobody, tmp_path)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250


def test_a_disk_that_is_full(server, tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
    with pytest.raises(BoresightError, match="0 MiB are to come, but the disk has 0 MiB left"):
        run(dataset(server), tmp_path)
    monkeypatch.undo()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(BoresightError, match=r"a.bin: the disk is full: free some space; the same command goes on"):
        run(dataset(server), tmp_path)
    assert "a.bin" not in names(tmp_path / "shapes")


def test_a_folder_that_cannot_be_made(server, tmp_path):
    (tmp_path / "shapes").write_text("a file")
    with pytest.raises(BoresightError, match="shapes: File exists: set BORESIGHT_DATA to a folder"):
        run(dataset(server), tmp_path)


def test_the_files_of_a_folder_are_those_of_its_listing(tmp_path):
    """Python's own server, which lists its folders and knows no ranges."""
    served = tmp_path / "served"
    served.mkdir()
    for name in ("st_1_v.fit", "st_1_v.lbl", "st_2_w.fit", "index.txt"):
        (served / name).write_text(name)

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(served))) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        url = f"http://127.0.0.1:{running.server_port}/"
        about = {"name": "day", "title": "A day", "folder": "images/day", "credit": "us", "licence": "none"}
        day = DataSetSpec.model_validate({**about, "listing": {"url": url, "pattern": r"st_[0-9]+_v\.(fit|lbl)"}})
        assert [name for name, _, _ in run(day, tmp_path)] == ["st_1_v.fit", "st_1_v.lbl"]
        assert state(day, tmp_path) == "2 files"
        assert (tmp_path / "images" / "day" / "st_1_v.fit").read_text() == "st_1_v.fit"
        none = DataSetSpec.model_validate({**about, "listing": {"url": url, "pattern": "x"}})
        with pytest.raises(BoresightError, match="lists no file that matches 'x'"):
            run(none, tmp_path)
        running.shutdown()


@pytest.mark.parametrize(
    "link", ["..%2F..%2Fevil", "%2e%2e", "a%20b.fit", ".boresight-fetched.json", "x%00", "-rf", "a%5Cb"]
)
def test_a_listing_cannot_lead_out_of_its_folder(tmp_path, link):
    class Listing(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(f'<a href="{link}">x</a>'.encode() if self.path == "/day/" else b"content")

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Listing) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        about = {"name": "day", "title": "A day", "folder": "images/day", "credit": "us", "licence": "none"}
        listing = {"url": f"http://127.0.0.1:{running.server_port}/day/", "pattern": "(?s).+"}
        data = DataSetSpec.model_validate({**about, "listing": listing})
        try:
            fetched = run(data, tmp_path / "data")
        except BoresightError as error:
            assert "is no plain file name" in str(error)
        else:
            assert [name for name, _, _ in fetched] == ["evil"], "the last part alone is the name"
        running.shutdown()
    folder = tmp_path / "data" / "images" / "day"
    assert {path.parent for path in tmp_path.rglob("*") if path.is_file()} <= {folder}


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ("folder: ../x\nfiles: [{url: 'http://h/a'}]", "folder: '../x' does not match"),
        ("folder: a/../../x\nfiles: [{url: 'http://h/a'}]", "leads out of the data folder"),
        ("folder: /etc\nfiles: [{url: 'http://h/a'}]", "folder: '/etc' does not match"),
        ("folder: a\nfiles: [{url: 'http://h/a', name: ../b}]", "name: '../b' does not match"),
        ("folder: a\nfiles: [{url: 'http://h/..'}]", "ends in no plain file name"),
        ("folder: a\nfiles: [{url: 'http://h/.boresight-fetched.json'}]", "ends in no plain file name"),
        ("folder: a\nfiles: [{url: 'file:///etc/passwd', name: b}]", "url: 'file:///etc/passwd' does not match"),
        ("folder: a\nlisting: {url: 'http://h/', pattern: '('}", "is no regular expression"),
        (
            "folder: a\nlisting: {url: 'http://h/', pattern: '[a--b]'}",
            "is no regular expression: Possible set difference",
        ),
    ],
)
def test_a_data_set_cannot_lead_out_of_its_folder(tmp_path, keys, line):
    (tmp_path / "x.yaml").write_text(f"title: X\ncredit: us\nlicence: none\n{keys}\n")
    with pytest.raises(BoresightError) as refused:
        load_dataset(str(tmp_path / "x.yaml"))
    assert line in str(refused.value)


# --- the command -------------------------------------------------------------------------------------------------


def test_the_command_says_where_it_goes_and_what_it_trusts(server, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path / "data"))
    file = tmp_path / "mine.yaml"
    file.write_text(
        f"title: Mine\nfolder: shapes\ncredit: A. Body\nlicence: CC0\nfiles: [{{url: '{server.url}/a.bin'}}]\n"
    )
    assert main(["fetch", str(file)]) == 0
    said = capsys.readouterr().out
    assert f"into {tmp_path / 'data' / 'shapes'}" in said
    assert "a.bin: fetched, no checksum is known: this one is kept and holds from now on" in said
    assert SHA256 in said
    assert "credit: A. Body" in said
    assert main(["fetch", str(file)]) == 0
    assert "a.bin: there, the checksum is that of the first fetch" in capsys.readouterr().out


def test_the_command_lists_what_there_is(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    assert main(["fetch", "--list"]) == 0
    said = capsys.readouterr().out
    for name in dataset_names():
        assert name in said
    assert "not there" in said


@pytest.mark.parametrize(
    ("words", "line"),
    [(["fetch", "itokawa-3.2m"], "did you mean itokawa-3.1m"), (["fetch"], "boresight fetch --list")],
)
def test_the_command_refuses_in_one_line(words, line, capsys):
    assert main(words) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1


def test_without_a_variable_data_go_to_the_users_folder(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("BORESIGHT_DATA", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert main(["fetch", "--list"]) == 0
    assert f"data folder: {tmp_path / 'boresight'}" in capsys.readouterr().out


# --- the catalogue -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", dataset_names())
def test_every_data_set_of_the_catalogue_is_sound(name):
    data = load_dataset(name)
    assert data.name == name
    urls = [file.url for file in data.files or ()] + ([data.listing.url] if data.listing else [])
    assert urls
    assert all(url.startswith("https://") for url in urls)


def test_what_is_missing_names_the_data_set_that_has_it(monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    with pytest.raises(BoresightError, match=r"to fetch it: boresight fetch itokawa-3\.1m"):
        find_data_file("itokawa_quad512q.tab", (), "shapes", "body.shape")
    with pytest.raises(BoresightError, match="to fetch it: boresight fetch amica-20051001"):
        find_data_folder("hayabusa_amica_20051001", (), "images", "images.folder")
    with pytest.raises(BoresightError, match="to fetch it: boresight fetch hayabusa-spice"):
        find_data_file("hayabusa/amica31.ti", (), "spice", "images.spice.kernels")
    with pytest.raises(BoresightError, match=r"nothing\.tab was not found; .*; check the path"):
        find_data_file("nothing.tab", (), "shapes", "body.shape")


def test_the_users_folder_is_searched_where_no_variable_is_set(monkeypatch, tmp_path):
    monkeypatch.delenv("BORESIGHT_DATA", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    file = tmp_path / "boresight" / "shapes" / "a.obj"
    file.parent.mkdir(parents=True)
    file.write_text("v 0 0 0\n")
    assert find_data_file("a.obj", (), "shapes", "body.shape") == file
