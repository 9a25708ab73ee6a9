"""Readers of run folders, as somebody else may have made them: the checksums are right, and what they are of is not."""

from __future__ import annotations

import argparse
import hashlib
import io
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import pyarrow as pa

from boresight.campaign.cli.printed import MADE, Printed, print_report, printed_before
from boresight.campaign.cli.status import status_command
from boresight.campaign.inspection.recompute import reopened
from boresight.campaign.papers.gather import newest_finished
from boresight.campaign.runs.manifest import make_manifest
from boresight.campaign.runs.newest import newest_first
from boresight.campaign.runs.request import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store.folder import Block, RunFolder
from boresight.reports.run.clusters import clusters_of, pools
from boresight.reports.run.data import read_run
from boresight.reports.run.limits import known_lines
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.tables import schema
from boresight.scenarios.checksums import checksum_text
from boresight.scenarios.errors import BoresightError
from hostile import recipes
from hostile.target import Target

_BLOCK = Block("orbit", 0, 2, 0)
_ROWS, _SUMS = f"rows/{_BLOCK.file_name}", f"checksums/{_BLOCK.checksums_name}"
_SCENE = (
    "camera: {width_px: 64, height_px: 64, fov_deg: 30}\nsequence: {sphere_radius_m: 190, orbit: {radius_m: 790}}\n"
)
_METHOD = "dead-reckoning"
_SOURCE = "0" * 64
_CAMPAIGN = f"experiment: sequence\nscenarios: [orbit.yaml]\nestimators: [{_METHOD}]\ntrials: 2\nseed: 5\n"


def targets() -> dict[str, Target]:
    """Each kind of file of a run folder, the others as they should be."""
    return {
        "manifest": Target(_manifest, lambda: (_stored()["manifest.json"],), _JSON, cost=2),
        "rows": Target(_recipe, lambda: (recipes.table_recipe(_rows()),), _COLUMNS, cost=4),
        "rows-bytes": Target(_rows_bytes, lambda: (_stored()[_ROWS],)),
        "report-record": Target(_report_record, lambda: (_record(),), (*_JSON, *_SUM_WORDS)),
        "checksums": Target(_checksums, lambda: (_stored()[_SUMS],), _SUM_WORDS),
    }


_JSON = (b"{}", b"[]", b"null", b"NaN", b"-Infinity", b'"\\ud800"', b'"\\u001b[31m"', b"[[1]]", b'"x"', b"1.5", b"true")
_COLUMNS = (
    b"int64", b"double", b"string", b"bool", b"binary", b"timestamp[s]", b"null", b"uint8", b"list<double>", b"date32",
    b"float", b"trial", b"scenario", b"status", b"ok", b"failed", b"error", b"large_string", b"image", b"reason",
    b"nees",
)  # fmt: skip
_SUM_WORDS = (b"/dev/zero", b"../manifest.json", b"rows/../x", b"rows//dev/zero", b"rows/", b"  ", b" *", b"0" * 64)


@cache
def _stored() -> Mapping[str, bytes]:
    """Make the files of a run by what writes them, without running it."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "orbit.yaml").write_text(_SCENE)
        (place / "orbits.yaml").write_text(_CAMPAIGN)
        run = RunFolder(place / "run")
        campaign = resolve(str(place / "orbits.yaml"))
        run.write_manifest(make_manifest(campaign, RunRequest(run.path, 2, 1), [], None))
        rows = _rows().to_pylist()
        times = [
            {**{key: row[key] for key in ("trial", "scenario", "estimator")}, "stage": "x", "seconds": 0.5}
            for row in rows
        ]
        run.write_block(_BLOCK, {"rows": rows, "timings": times}, "sequence")
        return {path.relative_to(run.path).as_posix(): path.read_bytes() for path in run.path.rglob("*.*")}


def _rows() -> pa.Table:
    known = {
        "trial": [0, 1],
        "scenario": ["orbit"] * 2,
        "estimator": ["dead-reckoning"] * 2,
        "status": ["ok", "failed"],
    }
    columns = []
    for field in schema("rows", "sequence"):
        numbers, texts = ([2, None], [1.5, None])[pa.types.is_floating(field.type)], ["", "why"]
        columns.append(pa.array(known.get(field.name, texts if field.type == pa.string() else numbers), field.type))
    return pa.table(columns, schema=schema("rows", "sequence"))


def _manifest(content: bytes, folder: Path) -> object:
    ways = (
        lambda run: newest_first([run.path]),
        reopened,
        lambda run: newest_finished([run.path], "orbits"),
    )
    return _read(folder, {"manifest.json": content}, ways)


def _record() -> bytes:
    grid = Grid(title="x", columns=("a", "b"), rows=(("c", "1"),), text=frozenset({0}), note="", known="y")
    files = {"report.md": hashlib.sha256(b"x").hexdigest()}
    return Printed(source=_SOURCE, files=files, grids=(grid,), lines=("z",)).model_dump_json().encode()


def _report_record(content: bytes, folder: Path) -> object:
    """Read what a report was made from and printed, as a start of the same run does."""
    _lay(folder, {"report/report.md": b"x", f"report/{MADE}": content})
    found, out = printed_before(RunFolder(folder), _SOURCE), io.StringIO()
    if found is not None:
        with redirect_stdout(out):
            print_report(found, RunFolder(folder))
    assert all(line.isprintable() for line in out.getvalue().split("\n")), ascii(out.getvalue())
    return found


def _recipe(content: bytes, folder: Path) -> object:
    return _rows_bytes(recipes.parquet(content), folder)


def _rows_bytes(content: bytes, folder: Path) -> object:
    files = {name: data for name, data in _stored().items() if name.endswith(".parquet")} | {_ROWS: content}
    ways = (
        lambda run: run.state(_BLOCK, 1),
        lambda run: run.of_trial("rows", "orbit", _METHOD, 1).to_pylist(),
    )
    return _read(folder, {_ROWS: content, _SUMS: checksum_text(files).encode()}, ways)


def _checksums(content: bytes, folder: Path) -> object:
    _lay(folder, {_SUMS: content})
    return read_run(folder).progress()


def _lay(folder: Path, changed: Mapping[str, bytes]) -> None:
    """Write what is not there yet, and what is changed."""
    for name, content in {**_stored(), **changed}.items():
        if name in changed or not (folder / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)


def _read(folder: Path, changed: Mapping[str, bytes], ways: Sequence[Callable[[RunFolder], object]]) -> object:
    """Read a run in some of the ways in which runs are read; those that the first refuses are tried all the same."""
    _lay(folder, changed)
    complaints = [_complaint(way, RunFolder(folder)) for way in (*ways, _status, _summed_up)]
    if any(complaints):
        raise BoresightError("\n".join(filter(None, complaints)))
    return None


def _complaint(way: Callable[[RunFolder], object], run: RunFolder) -> str:
    """Let a reader complain, as long as it does it properly: the next one has its turn."""
    try:
        way(run)
    except BoresightError as error:
        return str(error)
    return ""


def _status(run: RunFolder) -> None:
    """What the command of that name prints must not steer the terminal either."""
    said = io.StringIO()
    with redirect_stdout(said):
        status_command(argparse.Namespace(run=str(run.path)))
    assert all(line.isprintable() for line in said.getvalue().split("\n")), ascii(said.getvalue())


def _summed_up(run: RunFolder) -> object:
    """Read as reports do, with what they work out of the manifest."""
    found = read_run(run.path)
    names = [found.truth_name(name) for name, _ in found.pairs()]
    told = list(known_lines(found))
    return found.progress(), found.posed_pairs(), names, pools(found), clusters_of(found, found.rows), told
