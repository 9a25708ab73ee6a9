"""Runs on a real Dask cluster: a scheduler and workers in processes, folders and caches of their own, on loopback."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("distributed", reason="distributed (the extra dask) is not installed")

from tiny_campaign import RESULTS, compute, files, run, started, wait_for_blocks, write_campaign
from tiny_sequences import write_sequences

from boresight.campaign.runs.dask import asset_file, bundle_of, opened
from boresight.campaign.runs.resolve import resolve
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError

LONG = 60
MANY = 200  # quick ones, of sequences


class ClusterProcesses:
    """A scheduler and its workers; none sees the folder of the run, and each worker has a cache of its own."""

    def __init__(self, folder: Path):
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self.all: list[subprocess.Popen[bytes]] = []
        port = self.address.rpartition(":")[2]
        self._start("scheduler", "--host", "127.0.0.1", "--port", port)

    def _start(self, kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        place = self.folder / f"{kind}-{len(self.all)}"
        place.mkdir()
        environment = {k: v for k, v in os.environ.items() if k not in ("BORESIGHT_DATA", "BORESIGHT_CACHE")}
        environment |= {"BORESIGHT_CACHE": str(place / "cache"), "HOME": str(place)}
        words = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments, "--no-dashboard"]
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self.all.append(subprocess.Popen(words, cwd=place, env=environment, start_new_session=True, **silent))
        return self.all[-1]

    def add_worker(self) -> subprocess.Popen[bytes]:
        return self._start("worker", self.address, "--nthreads", "1", "--nworkers", "1", "--no-nanny")

    def caches(self) -> list[Path]:
        return [cache for cache in self.folder.glob("worker-*/cache") if any(cache.glob("assets/*"))]


@pytest.fixture
def cluster(tmp_path_factory):
    found = ClusterProcesses(tmp_path_factory.mktemp("cluster"))
    yield found
    for process in found.all:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(10)


@contextmanager
def under_way(file, out, cluster, blocks, trials=LONG):
    """Start a run on a cluster and wait for its first blocks."""
    words = ("--trials", trials, "--backend", "dask", "--scheduler", cluster.address, "--out", out)
    with started("run", file, *words) as process:
        wait_for_blocks(process, out, blocks)
        yield process


@pytest.mark.long
def test_three_workers_give_the_rows_of_one_process(cluster, tmp_path):
    for _ in range(3):
        cluster.add_worker()
    file = write_campaign(tmp_path)
    compute(file, tmp_path / "here", LONG)
    arguments = ("--trials", LONG, "--backend", "dask", "--scheduler", cluster.address)
    assert run(file, tmp_path / "there", *arguments) == 0
    assert files(tmp_path / "there", *RESULTS) == files(tmp_path / "here", *RESULTS)
    assert cluster.caches(), "what a worker needs came to its own cache"


@pytest.mark.long
def test_a_worker_that_is_killed_and_one_that_comes_late_change_nothing(cluster, tmp_path):
    first, _ = cluster.add_worker(), cluster.add_worker()
    file = write_campaign(tmp_path)
    compute(file, tmp_path / "here", LONG)
    with under_way(file, tmp_path / "there", cluster, 1) as process:
        os.killpg(first.pid, signal.SIGKILL)
        cluster.add_worker()
        said = process.communicate(timeout=180)[1]
        assert process.returncode == 0, said
    assert files(tmp_path / "there", *RESULTS) == files(tmp_path / "here", *RESULTS)


def test_a_run_goes_on_where_a_cluster_of_one_worker_left_it(cluster, tmp_path):
    cluster.add_worker()
    file = write_sequences(tmp_path, MANY)
    compute(file, tmp_path / "here", MANY)
    with under_way(file, tmp_path / "there", cluster, 1, MANY) as process:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode == 130
    compute(file, tmp_path / "there", MANY)
    assert files(tmp_path / "there", *RESULTS) == files(tmp_path / "here", *RESULTS)


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("boresight.campaign.runs.dask._PATIENCE_S", 2.0)
    words = ("--trials", 2, "--backend", "dask", "--scheduler", "tcp://127.0.0.1:9")
    assert run(write_campaign(tmp_path), tmp_path / "run", *words) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert "--scheduler tcp://127.0.0.1:9: no scheduler answers there" in error[0]


@pytest.fixture
def bundled(tmp_path, monkeypatch):
    """Return a campaign on a shape file, and its bundle."""
    shape = "v 100 0 0\nv 0 80 0\nv -100 0 0\nv 0 -80 0\nv 0 0 60\nv 0 0 -60\n"
    shape += "".join(f"f {a} {b} 5\nf {b} {a} 6\n" for a, b in ((1, 2), (2, 3), (3, 4), (4, 1)))
    (tmp_path / "rock.obj").write_text(shape)
    cv2.imwrite(str(tmp_path / "map.png"), np.full((4, 8), 9, dtype=np.uint8))
    body = "{shape: rock.obj, unit: m, albedo_map: {file: map.png}}"
    (tmp_path / "scene.yaml").write_text(f"extends: quickstart\nbody: {body}\n")
    (tmp_path / "c.yaml").write_text("title: t\nscenarios: [scene.yaml]\nestimators: [prior]\ntrials: 1\nseed: 1\n")
    campaign = resolve(str(tmp_path / "c.yaml"), variant=choose_variant().name)
    return campaign, bundle_of(campaign, tmp_path / "run")


def test_a_bundle_holds_what_a_scenario_reads_and_is_opened_elsewhere(bundled, tmp_path, monkeypatch):
    campaign, bundle = bundled
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "rock.obj").unlink()
    there, folder = opened(bundle.digest, bundle.assets.__getitem__, tmp_path)
    assert there.digest == campaign.digest
    assert (folder / "data" / "rock.obj").read_text().startswith("v 100 0 0")
    assert (folder / "data" / "map.png").is_file()
    assert there.scenarios[0].search_dirs == (folder / "data",)
    asked = []
    opened.cache_clear()
    opened(bundle.digest, lambda sha256: asked.append(sha256), tmp_path)
    assert asked == [], "all of it is in the cache by now"


def test_an_asset_that_came_damaged_is_refused_and_not_kept(bundled, tmp_path, monkeypatch):
    _, bundle = bundled
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    with pytest.raises(BoresightError, match="came damaged"):
        asset_file(bundle.digest, lambda sha256: bundle.assets[sha256][:-1])
    assert asset_file(bundle.digest, bundle.assets.__getitem__).read_bytes() == bundle.assets[bundle.digest]


def test_an_absolute_path_is_refused_for_a_cluster(bundled, tmp_path):
    scene = (tmp_path / "scene.yaml").read_text()
    (tmp_path / "scene.yaml").write_text(scene.replace("rock.obj", str(tmp_path / "rock.obj")))
    campaign = resolve(str(tmp_path / "c.yaml"), variant=choose_variant().name)
    with pytest.raises(BoresightError, match="means nothing on another machine"):
        bundle_of(campaign, tmp_path / "run")
