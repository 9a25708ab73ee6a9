"""Readers of run folders, as somebody else may have made them: the checksums are right, and what they are of is not."""

from __future__ import annotations

import argparse
import hashlib
import io
import tempfile
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import pyarrow as pa
from fuzz import recipes

from boresight.campaign.cli.report import MADE, Printed, print_report, printed_before
from boresight.campaign.cli.status import status_command
from boresight.campaign.inspection.recompute import reopened
from boresight.campaign.papers.page import finished_runs
from boresight.campaign.runs.manifest import RunRequest, make_manifest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import Block, RunFolder, newest_first
from boresight.reports.run.clusters import clusters_of, pools
from boresight.reports.run.data import read_run
from boresight.reports.run.limits import known_lines
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.tables import schema
from boresight.scenarios.checksums import checksum_text
from boresight.scenarios.errors import BoresightError

BLOCK, METHOD, SOURCE = Block("orbit", 0, 2, 0), "dead-reckoning", "0" * 64
ROWS, SUMS = f"rows/{BLOCK.file_name}", f"checksums/{BLOCK.checksums_name}"
SCENE = "camera: {width_px: 64, height_px: 64, fov_deg: 30}\nsequence: {sphere_radius_m: 190, orbit: {radius_m: 790}}\n"
CAMPAIGN = f"experiment: sequence\nscenarios: [orbit.yaml]\nestimators: [{METHOD}]\ntrials: 2\nseed: 5\n"


@cache
def stored() -> Mapping[str, bytes]:
    """Make the files of a run by what writes them, without running it."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "orbit.yaml").write_text(SCENE)
        (place / "orbits.yaml").write_text(CAMPAIGN)
        run = RunFolder(place / "run")
        campaign = resolve(str(place / "orbits.yaml"))
        run.write_manifest(make_manifest(campaign, RunRequest(run.path, 2, 1), [], None))
        rows = _table().to_pylist()
        keys = ("trial", "scenario", "estimator")
        times = [{**{key: row[key] for key in keys}, "stage": "x", "seconds": 0.5} for row in rows]
        run.write_block(BLOCK, {"rows": rows, "timings": times}, "sequence")
        return {path.relative_to(run.path).as_posix(): path.read_bytes() for path in run.path.rglob("*.*")}


def _table() -> pa.Table:
    known = {"trial": [0, 1], "scenario": ["orbit"] * 2, "estimator": [METHOD] * 2, "status": ["ok", "failed"]}
    columns = []
    for field in schema("rows", "sequence"):
        numbers, texts = ([2, None], [1.5, None])[pa.types.is_floating(field.type)], ["", "why"]
        columns.append(pa.array(known.get(field.name, texts if field.type == pa.string() else numbers), field.type))
    return pa.table(columns, schema=schema("rows", "sequence"))


def rows_seeds() -> tuple[bytes, ...]:
    return (recipes.table_recipe(_table()),)


def record_seeds() -> tuple[bytes, ...]:
    grid = Grid(title="x", columns=("a", "b"), rows=(("c", "1"),), text=frozenset({0}), note="", known="y")
    files = {"report.md": hashlib.sha256(b"x").hexdigest()}
    return (Printed(source=SOURCE, files=files, grids=(grid,), lines=("z",)).model_dump_json().encode(),)


def manifest(content: bytes, folder: Path) -> None:
    run = _written(folder, {"manifest.json": content})
    _all_ways(
        lambda: newest_first([run.path]), lambda: reopened(run), lambda: finished_runs([run.path], "orbits"), run=run
    )


def rows(content: bytes, folder: Path) -> None:
    files = {name: data for name, data in stored().items() if name.endswith(".parquet")} | {ROWS: content}
    run = _written(folder, {ROWS: content, SUMS: checksum_text(files).encode()})
    _all_ways(lambda: run.state(BLOCK, 1), lambda: run.of_trial("rows", "orbit", METHOD, 1).to_pylist(), run=run)


def rows_recipe(content: bytes, folder: Path) -> None:
    rows(recipes.parquet(content), folder)


def checksums(content: bytes, folder: Path) -> object:
    return read_run(_written(folder, {SUMS: content}).path).progress()


def report_record(content: bytes, folder: Path) -> None:
    """Read what a report was made from and printed, as a start of the same run does."""
    run = _written(folder, {"report/report.md": b"x", f"report/{MADE}": content})
    found = printed_before(run, SOURCE)
    if found is not None:
        _printable(lambda: print_report(found, run))


def _written(folder: Path, changed: Mapping[str, bytes]) -> RunFolder:
    """Write what is not there yet, and what is changed."""
    for name, content in {**stored(), **changed}.items():
        if name in changed or not (folder / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    return RunFolder(folder)


def _all_ways(*ways: Callable[[], object], run: RunFolder) -> None:
    """Read a run in some of the ways in which runs are read; those that the first refuses are tried all the same."""
    complaints = []
    for way in (
        *ways,
        lambda: _printable(lambda: status_command(argparse.Namespace(run=str(run.path)))),
        lambda: _summed_up(run),
    ):
        try:
            way()
        except BoresightError as error:
            complaints.append(str(error))
    if complaints:
        raise BoresightError("\n".join(complaints))


def _printable(command: Callable[[], object]) -> None:
    """What a command prints must not steer the terminal either."""
    with redirect_stdout(io.StringIO()) as out:
        command()
    assert all(line.isprintable() for line in out.getvalue().split("\n")), ascii(out.getvalue())


def _summed_up(run: RunFolder) -> object:
    """Read as reports do, with what they work out of the manifest."""
    found = read_run(run.path)
    names = [found.truth_name(name) for name, _ in found.pairs()]
    lines = list(known_lines(found))
    return found.progress(), found.posed_pairs(), names, pools(found), clusters_of(found, found.rows), lines
