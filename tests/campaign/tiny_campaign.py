"""A campaign that runs in a second, and the command line as a user starts it."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd

from boresight.campaign.cli import main
from boresight.campaign.kinds.single_image import Records
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.schema.tables import TABLES

TRIALS = 24
SCENE = """\
description: A boulder-strewn contact binary at 2 km, 128 x 128.
body:
  detail:
    facets: 20000
    seed: 3
    boulders: {count: 250, min_diameter_m: 25, max_diameter_m: 80, height_ratio: 0.5}
    roughness: {rms_m: 1.5, max_wavelength_m: 100, min_wavelength_m: 25}
camera: {width_px: 128, height_px: 128, fov_deg: 18.3}
viewpoint: {range_m: 2000}
lighting: {phase_deg: {uniform: [0, 50]}}
"""
DATABASE = {"images": 40, "min_observations": 6, "clusters": {"seed_radius_m": 15, "sigma_floor_m": 0.1}}
CAMPAIGN = f"""\
title: A tiny campaign
scenarios: [scene]
estimators:
  - prior
  - landmark-harris:
      database: {{images: 40, min_observations: 6, clusters: {{seed_radius_m: 15, sigma_floor_m: 0.1}}}}
trials: {TRIALS}
seed: 5
"""
SMALL = CAMPAIGN.replace("images: 40, min_observations: 6", "images: 20, min_observations: 4")
"""The same with a data base that is quicker to build."""
# What a run stores of its trials, but for the wall times, the tracebacks and what methods print.
RESULTS = tuple(name for name in TABLES if name not in ("timings", "tracebacks", "said"))


def write_campaign(folder: Path, campaign: str = CAMPAIGN, scene: str = SCENE) -> Path:
    """Write a campaign with its scene; return the campaign's file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(scene, encoding="utf-8")
    (folder / "tiny.yaml").write_text(campaign, encoding="utf-8")
    return folder / "tiny.yaml"


def run(file: Path, out: Path, *arguments: object) -> int:
    """Run a campaign by the command line in this process, without a report unless ``--worst`` is given."""
    return main(_words("run", file, "--jobs", 1, "--out", out, *arguments))


class Heard:
    """Keeps what is said of a run."""

    def __init__(self) -> None:
        self.messages: list[str] = []

    def message(self, text: str) -> None:
        self.messages.append(text)

    def started(self, done: int, total: int) -> None: ...

    def block(self, records: Records, trials: int) -> None: ...


def compute(file: Path, out: Path, trials: int = TRIALS, jobs: int = 1) -> str:
    """Run a campaign from Python, without the report; return what was said."""
    campaign, heard = resolve(str(file), variant=choose_variant().name), Heard()
    run_campaign(campaign, RunRequest(out, trials, jobs), heard)
    return "\n".join(heard.messages)


def command(*arguments: object) -> list[str]:
    """Return the command line as a process."""
    return [sys.executable, "-m", "boresight", *_words(*arguments)]


def _words(*arguments: object) -> list[str]:
    """Return the words of a command; a run leaves out its report unless ``--worst`` is given, be it 0."""
    words = [str(argument) for argument in arguments]
    return [*words, "--no-report"] if words[:1] == ["run"] and "--worst" not in words else words


def boresight(
    *arguments: object, cwd: Path | None = None, timeout_s: float = 180.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    return subprocess.run(
        command(*arguments),
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout_s,
    )


@contextmanager
def started(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Start the command line in a process group of its own, its workers included; whatever is left of it ends."""
    process = subprocess.Popen(
        command(*arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell without job control has its background jobs ignore interrupts, and so would all that they start.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        yield process
    finally:
        if members(process.pid):
            stop(process)
        for pipe in (process.stdout, process.stderr):
            pipe.close()  # or it is told as a fault of whichever test comes next


def wait_for_blocks(process: subprocess.Popen[str], run: Path, count: int) -> None:
    """Wait until a run that is under way has stored so many blocks."""
    limit = time.monotonic() + 120
    while len(list(run.glob("rows/*.parquet"))) < count:
        if process.poll() is not None or time.monotonic() > limit:
            raise RuntimeError(f"no {count} blocks came: {stop(process)}")
        time.sleep(0.005)


def stop(process: subprocess.Popen[str], how: int = signal.SIGKILL, workers_too: bool = True) -> str:
    """Send a signal to the whole process group, or to the parent alone; return what it said on standard error."""
    if workers_too:
        os.killpg(process.pid, how)
    else:
        process.send_signal(how)
    return process.communicate(timeout=60)[1]


def members(group: int) -> dict[int, str]:
    """List the living processes of a process group with their command lines."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = stat.read_text().rpartition(")")[2].split()[:3]
            if int(its_group) == group and state != "Z":
                found[int(stat.parent.name)] = (stat.parent / "cmdline").read_text().replace("\0", " ")
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def workers(group: int) -> list[int]:
    """List the workers in the process group of a run with several jobs."""
    found = [pid for pid, line in members(group).items() if "loky.backend.popen" in line]
    if not found:
        raise RuntimeError(f"no workers among {members(group)}")
    return found


def ignores(process: int, number: int) -> bool:
    """Tell whether a process ignores a signal, or has it blocked while it starts."""
    status = Path(f"/proc/{process}/status").read_text()
    masks = [line.split()[1] for line in status.splitlines() if line.startswith(("SigIgn:", "SigBlk:"))]
    return any(int(mask, 16) >> (number - 1) & 1 for mask in masks)


def gone(group: int) -> bool:
    """Wait a little for the last process of a group to end."""
    limit = time.monotonic() + 20
    while members(group) and time.monotonic() < limit:
        time.sleep(0.05)
    return not members(group)


def files(folder: Path, *tables: str) -> dict[str, str]:
    """Hash every file below a folder, or below some of its tables."""
    roots = [folder / table for table in tables] or [folder]
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for root in roots
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def assert_same_results(first: Path, second: Path) -> None:
    """Compare all results of two runs, as numbers and as bytes."""
    for table in RESULTS:
        pd.testing.assert_frame_equal(RunFolder(first).table(table), RunFolder(second).table(table), check_exact=True)
    assert files(first, *RESULTS) == files(second, *RESULTS)
