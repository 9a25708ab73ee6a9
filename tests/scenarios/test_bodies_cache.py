"""The cache: one build, damage, eviction, several processes, folders that cannot be written."""

import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from boresight.scenarios.cache import Cache, default_cache
from boresight.scenarios.errors import BoresightError


def writer(text="content", size=1):
    def build(folder):
        (folder / "sub").mkdir()
        (folder / "sub" / "file.txt").write_text(text * size)
        build.calls += 1

    build.calls = 0
    return build


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path / "cache", 10**9)


def test_an_entry_is_built_once(cache):
    build = writer()
    folders = [cache.folder("kind", "key", build) for _ in range(3)]
    assert build.calls == 1
    assert set(folders) == {cache.root / "kind" / "key"}
    assert (folders[0] / "sub" / "file.txt").read_text() == "content"
    (entry,) = cache.entries()
    assert (entry.kind, entry.key, entry.size_bytes) == ("kind", "key", len("content"))
    assert cache.size_bytes() == len("content")


@pytest.mark.parametrize("damage", ["change", "cut", "remove", "add", "manifest"])
def test_a_damaged_entry_is_built_again(cache, damage):
    build = writer()
    file = cache.folder("kind", "key", build) / "sub" / "file.txt"
    if damage == "change":
        file.write_text("CONTENT")
    elif damage == "cut":
        file.write_text("con")
    elif damage == "remove":
        file.unlink()
    elif damage == "add":
        file.with_name("stray").write_text("x")
    else:
        (cache.root / "kind" / "key" / "manifest.json").write_text(json.dumps([1]))
    assert cache.folder("kind", "key", build) == file.parent.parent
    assert build.calls == 2
    assert file.read_text() == "content"


def test_the_least_recently_used_go_first(tmp_path):
    cache = Cache(tmp_path, limit_bytes=250)
    for age, key in enumerate(["old", "older", "oldest"]):
        manifest = cache.folder("kind", key, writer("x", 60)) / "manifest.json"
        os.utime(manifest, (time.time() - 100.0 * (age + 1),) * 2)
    cache.folder("kind", "oldest", writer())
    cache.folder("kind", "new", writer("x", 120))
    assert {entry.key for entry in cache.entries()} == {"old", "oldest", "new"}
    assert cache.entries()[0].key == "old"


def test_a_failed_build_leaves_nothing(cache):
    def build(folder):
        (folder / "half").write_text("half")
        raise BoresightError("no")

    with pytest.raises(BoresightError, match="no"):
        cache.folder("kind", "key", build)
    assert not [path for path in cache.root.rglob("*") if path.is_file()]
    assert cache.entries() == ()


def test_clear_removes_entries_and_left_overs(cache):
    cache.folder("kind", "key", writer())
    (cache.root / ".building" / "left-over").mkdir(parents=True)
    assert cache.clear() == 1
    assert cache.size_bytes() == 0
    assert list((cache.root / ".building").iterdir()) == []


def test_machine_code_of_kernels_is_listed_and_cleared(cache, monkeypatch):
    """Kernels are compiled in a separate process, as in a run; entries of other kinds stay."""
    monkeypatch.setenv("BORESIGHT_CACHE", str(cache.root))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    code = (
        "import numpy as np; from boresight.estimators.slam.adjustment.compiled.envelope import make_envelope\n"
        "make_envelope(np.array([2, 1]))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    cache.folder("bodies", "key", writer())
    machine_code = list(cache.root.glob("kernels/*/*.nbc"))
    assert machine_code
    listed = [entry for entry in cache.entries() if entry.kind == "kernels"]
    assert [entry.path for entry in listed] == [machine_code[0].parent]
    assert listed[0].size_bytes >= sum(file.stat().st_size for file in machine_code)
    assert cache.clear("kernels") == 1
    assert not any((cache.root / "kernels").iterdir())
    assert [entry.kind for entry in cache.entries()] == ["bodies"]


@pytest.mark.parametrize("place", ["a file", "a full disk"])
def test_without_a_writable_folder_it_works_with_a_warning(tmp_path, caplog, place):
    root = tmp_path / "root"
    build = writer()
    if place == "a file":
        root.write_text("in the way")
    else:
        healthy = build

        def build(folder):
            if tmp_path in folder.parents:
                raise OSError(28, "No space left on device")
            healthy(folder)

    with caplog.at_level(logging.WARNING):
        folder = Cache(root, 10**9).folder("kind", "key", build)
    assert (folder / "sub" / "file.txt").read_text() == "content"
    assert folder.is_relative_to(tempfile.gettempdir())
    assert "working without the cache" in caplog.text


def test_without_any_writable_folder_one_line_explains_it(tmp_path):
    def build(folder):
        raise OSError(28, "No space left on device", str(folder / "file"))

    with pytest.raises(BoresightError, match=r"cannot write \(No space left.*set BORESIGHT_CACHE"):
        Cache(tmp_path, 10**9).folder("kind", "key", build)


@pytest.mark.parametrize("name", ["", "..", "a/b", ".hidden", "x" * 200])
def test_names_that_leave_the_folder_are_refused(cache, name):
    with pytest.raises(BoresightError, match="a name has only letters"):
        cache.folder("kind", name, writer())


def test_processes_that_build_the_same_key_agree(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from boresight.scenarios.cache import Cache\n"
        "def build(folder):\n"
        "    for i in range(20): (folder / str(i)).write_text('x' * 1000); time.sleep(0.005)\n"
        "folder = Cache(Path(sys.argv[1]), 10**9).folder('kind', 'key', build)\n"
        "print(folder, sum(len((folder / str(i)).read_text()) for i in range(20)))\n"
    )
    runs = [
        subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    results = [run.communicate(timeout=60)[0].strip() for run in runs]
    assert results == [f"{tmp_path / 'kind' / 'key'} 20000"] * 4
    assert len(Cache(tmp_path, 10**9).entries()) == 1
    assert list((tmp_path / ".building").iterdir()) == []


def test_the_default_follows_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path))
    monkeypatch.setenv("BORESIGHT_CACHE_GB", "0.5")
    assert default_cache() == Cache(tmp_path, 500_000_000)
    monkeypatch.delenv("BORESIGHT_CACHE")
    monkeypatch.delenv("BORESIGHT_CACHE_GB")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert default_cache().limit_bytes == 4_000_000_000
    assert default_cache().root.is_relative_to(Path.home())
    for wrong in ("much", "-1", "nan", "inf"):
        monkeypatch.setenv("BORESIGHT_CACHE_GB", wrong)
        with pytest.raises(BoresightError, match=f"BORESIGHT_CACHE_GB: '{wrong}' is not a size in GB"):
            default_cache()


def test_large_and_long_unused_entries_are_evicted_first(tmp_path):
    """The order is that of size times time since the last use, not of the last use alone."""
    cache = Cache(tmp_path, limit_bytes=1000)
    for key, size, hours in (("body", 500, 24), ("older", 150, 2), ("newer", 150, 1), ("landmarks", 2, 48)):
        manifest = cache.folder("kind", key, writer("x", size)) / "manifest.json"
        os.utime(manifest, (time.time() - 3600.0 * hours,) * 2)
    cache.folder("kind", "first", writer("x", 300))
    assert {entry.key for entry in cache.entries()} == {"older", "newer", "landmarks", "first"}
    cache.folder("kind", "second", writer("x", 400))
    assert {entry.key for entry in cache.entries()} == {"newer", "landmarks", "first", "second"}


def test_put_replaces_and_find_builds_nothing(cache):
    assert cache.find("kind", "key") is None
    for text in ("first", "second"):
        assert cache.put("kind", "key", writer(text))
        assert (cache.find("kind", "key") / "sub" / "file.txt").read_text() == text
    (cache.root / "kind" / "key" / "sub" / "file.txt").write_text("damage")
    assert cache.find("kind", "key") is None
    assert [entry.key for entry in cache.entries()] == ["key"]


def test_puts_keep_within_the_limit(tmp_path):
    cache = Cache(tmp_path, limit_bytes=1000)
    for number in range(200):
        cache.put("kind", f"key-{number}", writer("x", 100))
        assert cache.size_bytes() <= 1000 + 1000 / 50 + 100
    assert cache.find("kind", "key-199") is not None


def test_the_time_of_a_put_does_not_grow_with_the_number_of_entries(tmp_path, monkeypatch):
    """The cache is listed rarely: listing 100,000 entries often would take as long as rendering them."""
    looks, entries = [], Cache.entries
    monkeypatch.setattr(Cache, "entries", lambda cache: looks.append(cache) or entries(cache))
    cache = Cache(tmp_path, limit_bytes=12_000)
    for number in range(1000):
        cache.put("kind", f"key-{number}", writer("x", 10))
    assert 1 < len(looks) < 20


def test_put_warns_if_nothing_can_be_stored(tmp_path, caplog):
    (tmp_path / "file").write_text("in the way")
    assert Cache(tmp_path / "file", 10**9).put("kind", "key", writer()) is False
    assert "nothing is kept there" in caplog.text
