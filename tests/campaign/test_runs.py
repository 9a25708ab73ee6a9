"""A run's rows do not depend on how it came about: workers, order, kills, interruptions, continuation."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
from tiny_campaign import (
    SCENE,
    TRIALS,
    assert_same_results,
    compute,
    files,
    gone,
    ignores,
    run,
    started,
    stop,
    wait_for_blocks,
    workers,
    write_campaign,
)
from tiny_sequences import write_sequences

from boresight.campaign.cli import main
from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds import sequence
from boresight.campaign.kinds.single_image import KIND
from boresight.campaign.pool import workers as pool
from boresight.campaign.runs.execute import run_block
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder, blocks
from boresight.campaign.trial.kind import WorkerContext
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.schema.tables import TABLES

LONG = 200
N_BLOCKS = LONG // sequence.KIND.block_trials


@pytest.fixture(scope="module")
def long_run(tmp_path_factory):
    """An undisturbed run of many blocks, to hold disturbed ones against; it is next to its campaign's file."""
    out = tmp_path_factory.mktemp("long") / "run"
    compute(write_sequences(out.parent, LONG), out, LONG)
    return out


def asked(long_run, out: Path) -> tuple[object, ...]:
    return ("run", long_run.parent / "orbits.yaml", "--jobs", 2, "--out", out)


def test_two_jobs_give_the_same_bytes(tiny_run, tmp_path):
    compute(tiny_run.file, tmp_path / "run", jobs=2)
    assert_same_results(tiny_run.folder, tmp_path / "run")


def test_a_killed_worker_is_told_and_replaced(tiny_run, tmp_path, monkeypatch):
    really, killed = pool._wait_for_one, []

    def kill_one(workers):
        if not killed:
            (process,) = next(one for one in workers if one.in_flight)._executor._processes
            os.kill(process, signal.SIGKILL)
            killed.append(process)
        really(workers)

    monkeypatch.setattr(pool, "_wait_for_one", kill_one)
    assert re.search(r"process ended.* tried again", compute(tiny_run.file, tmp_path / "run", jobs=2))
    assert_same_results(tiny_run.folder, tmp_path / "run")


def test_the_order_of_the_blocks_does_not_matter(tiny_run, tmp_path):
    campaign = resolve(str(tiny_run.file), variant=choose_variant().name)
    bench = WorkerContext(tiny_run.folder, jobs=1, keep_images=False)
    folder = RunFolder(tmp_path)
    for block in reversed(list(blocks(["scene"], TRIALS, KIND.block_trials))):
        folder.write_block(block, run_block(campaign, block, bench), campaign.spec.experiment)
    assert_same_results(tiny_run.folder, tmp_path)


def refused_meanwhile(long_run, process, out, capsys):
    """Stop a run that is under way, see that a second process is refused, and let the run go on."""
    wait_for_blocks(process, out, 1)
    os.killpg(process.pid, signal.SIGSTOP)
    before = files(out)
    assert run(long_run.parent / "orbits.yaml", out) == 2
    assert capsys.readouterr().err == (
        f"boresight: {out}: another boresight process is working on this run: wait for it, or use --out\n"
    )
    assert files(out) == before
    os.killpg(process.pid, signal.SIGCONT)


ONCE, AGAIN = (2, True), (3, False)


@pytest.mark.parametrize("interruptions", [(ONCE,), pytest.param((ONCE, AGAIN), marks=pytest.mark.long)], ids=len)
def test_an_interrupted_run_says_so_and_continues(long_run, tmp_path, capsys, interruptions):
    out = tmp_path / "run"
    for blocks_seen, workers_too in interruptions:
        with started(*asked(long_run, out)) as process:
            if (blocks_seen, workers_too) == ONCE:
                refused_meanwhile(long_run, process, out, capsys)
            wait_for_blocks(process, out, blocks_seen)
            assert all(ignores(pid, signal.SIGINT) for pid in workers(process.pid)), "else they would print tracebacks"
            errors = stop(process, signal.SIGINT, workers_too)
            assert process.returncode == 130
            assert errors == "boresight: interrupted; the same command continues\n"
            assert gone(process.pid), "no worker goes on alone"
        stored = files(out, "rows")
        assert blocks_seen <= len(stored) < N_BLOCKS
    compute(long_run.parent / "orbits.yaml", out, LONG)
    assert files(out, "rows").items() >= stored.items()
    assert_same_results(long_run, out)


def test_workers_of_a_killed_parent_end_and_leave_nothing_behind(long_run, tmp_path, monkeypatch):
    out, temporary = tmp_path / "run", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    with started(*asked(long_run, out)) as process:
        wait_for_blocks(process, out, 1)
        assert len(list(temporary.glob("boresight-worker-*"))) == 2
        stop(process, signal.SIGKILL, workers_too=False)
        assert gone(process.pid)
    assert not list(temporary.glob("boresight-*"))


def test_more_trials_extend_a_run_and_what_a_kill_left_half_written_is_swept(tiny_run, tmp_path):
    out = tmp_path / "run"
    compute(tiny_run.file, out, 15)
    first = RunFolder(out).table("rows")
    stamp = (out / "rows" / "scene-0000000.parquet").stat().st_mtime_ns
    left = [out / "rows" / ".scene-0000001.parquet.77.tmp", out / "products" / ".landmark-database-1.tmp" / "x.csv"]
    mine = [out / ".mine.tmp", out / "notes" / ".mine.tmp"]
    for path in (*left, *mine):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("half")
    compute(tiny_run.file, out)
    assert not any(path.exists() for path in left)
    assert all(path.exists() for path in mine), "only boresight's own leftovers go"
    rows = RunFolder(out).table("rows")
    pd.testing.assert_frame_equal(rows[rows["trial"] < 15].reset_index(drop=True), first, check_exact=True)
    assert (out / "rows" / "scene-0000000.parquet").stat().st_mtime_ns == stamp, "a whole block is not run again"
    assert_same_results(tiny_run.folder, out)


def test_fewer_trials_take_nothing_away(tiny_run, tmp_path):
    out = tmp_path / "run"
    compute(tiny_run.file, out, 12)
    before = files(out, *TABLES)
    compute(tiny_run.file, out, 3)
    assert files(out, *TABLES) == before
    assert RunFolder(out).read_manifest()["trials"] == 12


def test_a_damaged_block_is_told_refused_by_readers_and_run_again(tiny_run, tmp_path, refused, capsys):
    out = tmp_path / "run"
    shutil.copytree(tiny_run.folder, out)
    path = out / "stages" / "scene-0000001.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)
    for words in (["report", str(out)], ["compare", str(out)], ["inspect", str(out), "--trial", "3"]):
        assert refused(*words).startswith(f"boresight: {path}: damaged")
    assert run(tiny_run.file, out) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 of 3 stored blocks are not what was stored (the first: scene-0000001.parquet): 10 trials are run" in said
    assert "14 of 24 trials are stored already; continuing" in said
    assert_same_results(tiny_run.folder, out)


@pytest.mark.parametrize(
    "change",
    [
        ("--seed", "6"),
        ("--set", "lighting.phase_deg.uniform=[0, 20]"),
        pytest.param(("--variant", "scalar_rgb"), marks=pytest.mark.long),
    ],
)
def test_another_request_is_another_run(tiny_run, tmp_path, monkeypatch, change):
    if change[0] == "--variant" and choose_variant().name == change[1]:
        pytest.skip("scalar_rgb is the only variant here")
    monkeypatch.chdir(tmp_path)
    asked_for = ["run", str(tiny_run.file), "--jobs", "1", "--trials", "3", "--no-report", *change]
    assert main(asked_for) == 0
    (path,) = Path("runs").iterdir()
    digests = [RunFolder(folder).read_manifest()["digest"] for folder in (tiny_run.folder, path)]
    assert digests[0] != digests[1]
    assert path.name == f"tiny-{digests[1][:8]}"
    assert RunFolder(path).read_manifest()["command"] == shlex.join(["boresight", *asked_for])
    rows = RunFolder(tiny_run.folder).table("rows")
    assert not RunFolder(path).table("rows").equals(rows[rows["trial"] < 3].reset_index(drop=True))


def test_the_folder_of_another_run_is_refused_and_left_alone(tiny_run, refused):
    before = files(tiny_run.folder)
    for change in (("--seed", "6"), ("--set", "viewpoint.range_m=2100")):
        error = refused("run", tiny_run.file, "--out", tiny_run.folder, *change)
        assert error.startswith(f"boresight: {tiny_run.folder}: holds another run (tiny, digest ")
        assert error.endswith("choose another folder with --out\n")
    assert files(tiny_run.folder) == before


def test_tables_without_a_manifest_are_not_taken_over(tiny_run, tmp_path, capsys):
    (tmp_path / "run" / "rows").mkdir(parents=True)
    assert run(tiny_run.file, tmp_path / "run") == 2
    assert "has tables but no manifest" in capsys.readouterr().err


def test_a_shape_that_changed_under_its_name_is_another_run(tmp_path, capsys):
    scene = SCENE.replace("body:\n", "body:\n  shape: egg.obj\n")
    file = write_campaign(tmp_path, "scenarios: [scene]\nestimators: [prior]\ntrials: 2\nseed: 5\n", scene)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=200.0)
    images = []
    for scale in ([1.5, 1.0, 0.8], [1.0, 1.5, 0.8]):
        ball.copy().apply_scale(scale).export(tmp_path / "egg.obj")
        scenario = resolve(str(file)).scenarios[0]
        images.append(open_world(scenario, choose_variant().name).source.trial_image(5, 0).image)
        if len(images) == 1:
            compute(file, tmp_path / "run", 2)
    assert not np.array_equal(*images), "the second shape is read, though the first was kept under the same name"
    assert run(file, tmp_path / "run") == 2
    assert "holds another run" in capsys.readouterr().err
