"""Runs that end at any instant: killed, or with the power cut. No row that was told is lost, and none counted twice."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from tiny_campaign import (
    Heard,
    assert_same_results,
    command,
    members,
    started,
    stop,
    wait_for_blocks,
    workers,
    write_campaign,
)
from tiny_sequences import write_sequences

from boresight.campaign.kinds.sequence import KIND
from boresight.campaign.pool import workers as parallel
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import BlockState, RunFolder, blocks
from boresight.scenarios import atomic

CUT_TRIALS, KILL_TRIALS = 20, 60


class Disk:
    """What a disk is told while a run is stored, to be cut off after any of it.

    What was flushed survives: the content of a file once it was flushed itself, its name once its folder was flushed,
    and all of it only with the names of the folders above. Of the rest a cut leaves a part that chance chooses.
    """

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.root = root
        self.told: list[tuple[str, Path, object]] = []
        flush, replace = atomic._flush, Path.replace

        def flushed(path: Path) -> None:
            flush(path)
            kept = [p for p in path.iterdir() if p.is_dir()] if path.is_dir() else path.read_bytes()
            self.told.append(("folder" if path.is_dir() else "file", path, kept))

        def renamed(path: Path, target: Path) -> Path:
            self.told.append(("rename", path, (target, path.read_bytes())))
            return replace(path, target)

        monkeypatch.setattr(atomic, "_flush", flushed)
        monkeypatch.setattr(Path, "replace", renamed)

    def after_cut(self, count: int, rng: np.random.Generator) -> dict[Path, bytes]:
        """Return what is on the disk after so many of the things that it was told, by path below the root."""
        contents: dict[Path, bytes] = {}
        named: dict[Path, bytes] = {}
        folders, pending = {self.root}, []
        for what, path, kept in self.told[:count]:
            if what == "file":
                contents[path] = kept
            elif what == "rename":
                pending.append((kept[0], contents.get(path, kept[1][: rng.integers(len(kept[1]) + 1)])))
            else:
                folders.update(kept)
                named.update((target, content) for target, content in pending if target.parent == path)
                pending = [one for one in pending if one[0].parent != path]
        named.update(one for one in pending if rng.random() < 0.5)
        kept = {path.relative_to(self.root): content for path, content in named.items()}
        doubtful = {self.root / above for path in kept for above in path.parents} - folders
        lost = {path for path in sorted(doubtful) if rng.random() < 0.5}
        return {p: kept[p] for p in kept if not lost & {self.root / above for above in p.parents}}


class Told(Heard):
    """Hears of stored blocks, and after how much of what the disk was told."""

    def __init__(self, disk: Disk) -> None:
        self.disk, self.blocks = disk, []

    def block(self, records, trials) -> None:
        self.blocks.append(len(self.disk.told))


@pytest.mark.parametrize("instants", [5, pytest.param(50, marks=pytest.mark.long)])
def test_a_power_cut_at_any_instant_loses_nothing_that_was_told(tmp_path, monkeypatch, instants):
    campaign = resolve(str(write_sequences(tmp_path, CUT_TRIALS)))
    (tmp_path / "runs").mkdir()
    whole = tmp_path / "runs" / "whole"
    with monkeypatch.context() as patch:
        disk = Disk(tmp_path / "runs", patch)
        listener = Told(disk)
        run_campaign(campaign, RunRequest(whole, CUT_TRIALS, 1), listener)
    every = list(blocks(["orbit"], CUT_TRIALS, KIND.block_trials))
    assert len(listener.blocks) == len(every)
    rng = np.random.default_rng(20261121)
    for instant in rng.choice(np.arange(1, len(disk.told)), instants, replace=False):
        place = tmp_path / f"cut-{instant}"
        for path, content in disk.after_cut(int(instant), rng).items():
            (place / path).parent.mkdir(parents=True, exist_ok=True)
            (place / path).write_bytes(content)
        folder = RunFolder(place / "whole")
        done = sum(told <= instant for told in listener.blocks)
        assert [folder.state(block, 1) for block in every[:done]] == [BlockState.WHOLE] * done, f"after {instant}"
        run_campaign(campaign, RunRequest(folder.path, CUT_TRIALS, 1), Heard())
        assert_same_results(whole, folder.path)


SERVER = f"""
import os, sys
from pathlib import Path
import boresight.campaign.kinds.sequence
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.runs.execute import run_campaign
campaign = resolve(sys.argv[1])
campaign.digest

class Listener:
    def message(self, text): print(text, flush=True)
    def started(self, done, total): print("stored", done, flush=True)
    def block(self, records, trials): pass

for line in sys.stdin:
    pid = os.fork()
    if pid == 0:
        print("child", os.getpid(), flush=True)
        run_campaign(campaign, RunRequest(Path(line.strip()), {KILL_TRIALS}, 1), Listener())
        os._exit(0)
    print("ended", os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


class Server:
    """Starts a run again and again in children of one process, which has imported all that takes long."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def start(self, out: Path) -> int:
        """Start the run in a folder; return its process."""
        self._process.stdin.write(f"{out}\n")
        self._process.stdin.flush()
        return int(self.said("child"))

    def said(self, what: str) -> str:
        """Read on until it says something, and return what."""
        for line in self._process.stdout:
            if line.startswith(f"{what} "):
                return line.split()[1]
        raise RuntimeError(f"it never said {what}")


@contextmanager
def serving(file: Path):
    """Serve runs of a campaign."""
    with subprocess.Popen(
        [sys.executable, "-c", SERVER, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield Server(process)
        process.stdin.close()


@pytest.mark.long
def test_kills_at_random_instants_change_nothing(tmp_path):
    instants = 50
    file, out, whole = write_sequences(tmp_path, KILL_TRIALS), tmp_path / "run", tmp_path / "whole"
    every = list(blocks(["orbit"], KILL_TRIALS, KIND.block_trials))
    rng = np.random.default_rng(20150709)
    kills = 0
    with serving(file) as server:
        server.start(whole)
        assert server.said("ended") == "0"
        for wanted in np.sort(rng.integers(len(every), size=instants)):
            child = server.start(out)
            limit = time.monotonic() + 120.0
            while len(list(out.glob("rows/*.parquet"))) < wanted and time.monotonic() < limit:
                time.sleep(0.002)
            time.sleep(rng.uniform(0.0, 0.01))
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            kills += server.said("ended") == "-9"
        stored = sum(RunFolder(out).state(block, 1) is BlockState.WHOLE for block in every)
        server.start(out)
        assert int(server.said("stored")) == stored * KIND.block_trials
        assert server.said("ended") == "0"
    assert kills >= instants / 2, "most kills came while the run was under way"
    assert_same_results(whole, out)


@pytest.mark.long
def test_workers_that_are_killed_again_and_again_are_replaced(tmp_path, monkeypatch):
    """Each kill ends what a worker does at a random instant; only a method that is hit twice is stored as an error."""
    text, kills = "scenarios: [scene]\nestimators: [prior]\ntrials: 3000\nseed: 5\n", 10
    file, rng = write_campaign(tmp_path, text), np.random.default_rng(3)
    notes = tmp_path / "notes"
    notes.mkdir()
    monkeypatch.setenv("TMPDIR", str(notes))
    with started("run", file, "--jobs", 2, "--out", tmp_path / "run") as process:
        for _ in range(kills):
            wait_for_work(process, tmp_path / "run", notes)
            time.sleep(rng.uniform(0.0, 0.2))
            os.kill(int(rng.choice(workers(process.pid))), signal.SIGKILL)
        said, errors = process.communicate(timeout=600)
        assert process.returncode == 0, errors
        assert " ".join(said.split()).count("tried again") == kills
    done = subprocess.run(command("run", file, "--jobs", 1, "--out", tmp_path / "whole"), check=False)
    assert done.returncode == 0
    assert_same_results(tmp_path / "whole", tmp_path / "run")


def wait_for_work(process: subprocess.Popen[str], run: Path, notes: Path) -> None:
    """Wait until both workers have been at a method since now, and what was lost before is stored.

    A block that loses its process three times before any method is at work ends the run, as it should, and a worker
    without a block has nothing to lose.
    """
    now, limit = time.time() + 0.02, time.monotonic() + 120.0
    while len(fresh := [note for note in notes.glob("boresight-worker-*/call") if note.stat().st_mtime > now]) < 2:
        if process.poll() is not None or time.monotonic() > limit:
            raise RuntimeError(f"only {len(fresh)} workers were at work: {stop(process)}")
        time.sleep(0.001)
    # Blocks are stored in order, so none that is stored later was under way.
    wait_for_blocks(process, run, len(list(run.glob("rows/*.parquet"))) + 2 * parallel._AHEAD + 1)


@pytest.mark.long
def test_memory_is_flat_over_many_trials_and_workers_are_renewed(tmp_path):
    trials = int(os.environ.get("BORESIGHT_MEMORY_TRIALS", "10000"))
    file = write_campaign(tmp_path, f"scenarios: [scene]\nestimators: [prior]\ntrials: {trials}\nseed: 5\n")
    seen: list[tuple[float, int, dict[int, float]]] = []
    with started("run", file, "--jobs", 2, "--no-store", "--out", tmp_path / "run") as process:
        while process.poll() is None:
            done = 10 * len(list((tmp_path / "run").glob("rows/*.parquet"))) / trials
            sizes = {pid: resident_mb(pid) for pid in members(process.pid)}
            if 0.2 < done < 1.0 and process.pid in sizes:
                seen.append((done, sizes.pop(process.pid), sizes))
            time.sleep(1.0)
        assert process.returncode == 0, process.stderr.read()
    parent = [size for _, size, _ in seen]
    others = {pid for _, _, sizes in seen for pid in sizes}
    largest = max(max(sizes.values(), default=0.0) for _, _, sizes in seen)
    first = max(seen[0][2].values())
    told = f"parent {parent[0]:.0f} to {parent[-1]:.0f} MB, {len(others)} workers, {first:.0f} to {largest:.0f} MB"
    print(told)  # noqa: T201  what a long test measured
    assert parent[-1] < parent[0] + 50.0, told
    assert largest < first + 300.0, told
    assert len(others) >= trials / 1000.0, told


def resident_mb(pid: int) -> float:
    """Return the memory that a process holds; 0 where it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
