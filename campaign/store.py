"""Run folders: Parquet tables in blocks of trials, a manifest, a lock; and the search for them, the newest first.

A block's detail tables are written before its rows, and only a block whose rows are complete counts as done. The
newest run is that of the last start: starts are counted, which does not depend on the clock.
"""

from __future__ import annotations

import fcntl
import json
import os
import shlex
import shutil
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field

from boresight.campaign import RUNS
from boresight.reports.schema.datapackage import FILE, stored_fields, write_data_package
from boresight.reports.schema.tables import TABLES, layout, refuse_older, schema
from boresight.scenarios import checksums
from boresight.scenarios.atomic import make_folder, write_atomically, write_text
from boresight.scenarios.checksums import refuse_damaged
from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.parquet import read_column, read_table, read_where
from boresight.scenarios.reading import held_to, plain_json, unreadable

if TYPE_CHECKING:
    import pandas as pd

Records = Sequence[Mapping[str, object]]

KEY = "start"
"""Entry of a manifest: the number of the last start of the run."""

_ROUND_BLOCKS = 50

_Text = str | None
_Count = Annotated[int, Field(ge=0, lt=2**63)]


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Hold an advisory lock of a run folder; the system drops it when the process ends, however it ends."""
    try:
        make_folder(folder)
        descriptor = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise BoresightError(
            f"{display(folder)}: cannot be used as a run folder ({error.strerror}): choose another with --out"
        ) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BoresightError(
                f"{folder}: another boresight process is working on this run: wait for it, or use --out"
            ) from error
        yield
    finally:
        os.close(descriptor)


class _Entries(BaseModel):
    """Required entries of a manifest, and the types of the optional ones that boresight reads."""

    model_config = ConfigDict(strict=True, extra="ignore")

    digest: str
    name: str
    seed: int
    trials: _Count
    scenarios: dict[str, dict[str, Any]]
    identity: dict[str, Any] = {}
    title: _Text = ""
    description: _Text = ""
    report: _Text = None
    campaign: dict[str, Any] = {}
    overrides: list[str] = []
    draft: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    embedded: list[str] = []
    files: dict[str, list[str]] = {}
    estimators: list[str] = []
    credits: list[str] = []
    created: _Text = ""
    finished: _Text = ""
    updated: _Text = ""
    start: _Count = 0
    command: _Text = ""
    commit: _Text = ""
    versions: dict[str, Any] = {}
    machine: dict[str, Any] = {}
    notes: list[str] = []


def read_manifest(path: Path) -> dict[str, Any]:
    """Read the manifest of a run as it is.

    Raise BoresightError if it is none that boresight writes, or that of a run that another version stored in another
    way.
    """
    try:
        found = plain_json(path)
        manifest: dict[str, Any] = found if isinstance(found, dict) else {}
        missing = [key for key, entry in _Entries.model_fields.items() if entry.is_required() and key not in manifest]
        if missing:
            raise BoresightError(
                f"{path}: not a manifest of boresight, which has a {missing[0]}: choose another folder with --out"
            )
        refuse_older(manifest, path)
        held_to(_Entries, manifest)
    except (OSError, ValueError) as error:
        raise unreadable(path, "a manifest", error) from error
    return manifest


@dataclass(frozen=True, slots=True)
class Block:
    """Trials ``[first, last)`` of one scenario: the unit that is computed, stored and resumed."""

    scenario: str
    first: int
    last: int
    number: int

    @property
    def trials(self) -> int:
        """Number of trials."""
        return self.last - self.first

    def holds(self, scenario: str, trial: int) -> bool:
        """Return whether a trial of a scenario is in the block."""
        return self.scenario == scenario and self.first <= trial < self.last

    @property
    def file_name(self) -> str:
        """Name of the block's file in each table's folder; names sort in the order of trials."""
        return f"{self.scenario}-{self.number:07d}.parquet"

    @property
    def checksums_name(self) -> str:
        """Name of the file of its checksums."""
        return f"{self.scenario}-{self.number:07d}.sha256"


class BlockState(Enum):
    """State of a stored block."""

    ABSENT = "nothing, or not yet its rows"
    SHORT = "rows of fewer trials than are wanted"
    WHOLE = "all of it"
    DAMAGED = "files that are not what was stored"


def blocks(scenarios: Sequence[str], trials: int, size: int) -> Iterator[Block]:
    """Yield every block of ``size`` trials of a campaign.

    Scenarios advance together, in rounds: a worker that changes to another opens its world, which takes as long as
    many trials.
    """
    for start in range(0, trials, _ROUND_BLOCKS * size):
        for scenario in scenarios:
            for first in range(start, min(start + _ROUND_BLOCKS * size, trials), size):
                yield Block(scenario, first, min(first + size, trials), first // size)


def _parquet(table: str, records: Records, kind: str) -> bytes:
    """Write a table as Parquet."""
    found = pa.Table.from_pylist([dict(record) for record in records], schema=schema(table, kind))
    sink = pa.BufferOutputStream()
    pq.write_table(found, sink)
    return bytes(sink.getvalue())


def _first_trial(path: Path, otherwise: int) -> int:
    return min((trial for trial in read_column(path, "trial") if isinstance(trial, int)), default=otherwise)


class RunFolder:
    """A run folder. Its only state is its absolute path."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()

    def read_manifest(self) -> dict[str, Any] | None:
        """Return the manifest, or None where no run has started.

        Raise BoresightError if the file is there but cannot be read as a manifest, or is that of a run that another
        version of boresight stored in another way.
        """
        path = self.path / "manifest.json"
        return read_manifest(path) if path.exists() else None

    def write_manifest(self, manifest: Mapping[str, object]) -> None:
        """Write the manifest atomically."""
        write_text(self.path / "manifest.json", json.dumps(manifest, indent=1, sort_keys=True, default=str) + "\n")

    def write_data_package(self, experiment: str) -> None:
        """Write ``datapackage.json``, which describes the files of every table that a run of a kind of trial has."""
        found = {}
        for name in TABLES:
            files = sorted(f"{name}/{path.name}" for path in (self.path / name).glob("*.parquet"))
            if files:
                found[name] = files, stored_fields(name, experiment)
        write_data_package(found, "parquet", self.read_manifest() or {}, self.path)

    def sweep(self) -> None:
        """Remove what a killed process left half written; only for who holds the lock."""
        places = (*TABLES, checksums.FOLDER, "products", "images/*", "chain/**")
        patterns = [".manifest.json.*.tmp", f".{FILE}.*.tmp", *(f"{place}/.*.tmp" for place in places)]
        for leftover in [path for pattern in patterns for path in self.path.glob(pattern)]:
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)

    def write_block(self, block: Block, tables: Mapping[str, Records], kind: str) -> None:
        """Store a block of a kind of trial: detail tables, then all checksums, then rows, which stand for the whole."""
        contents = {name: _parquet(name, tables[name], kind) for name in tables if tables[name]}
        for name in tables:
            if name in contents and name != "rows":
                self._write(f"{name}/{block.file_name}", contents[name])
            elif name not in contents:
                (self.path / name / block.file_name).unlink(missing_ok=True)
        sums = checksums.checksum_text({f"{name}/{block.file_name}": contents[name] for name in sorted(contents)})
        self._write(f"{checksums.FOLDER}/{block.checksums_name}", sums.encode())
        if "rows" in contents:
            self._write(f"rows/{block.file_name}", contents["rows"])

    def _write(self, name: str, content: bytes) -> None:
        write_atomically(self.path / name, lambda path: path.write_bytes(content))

    def state(self, block: Block, estimators: int) -> BlockState:
        """Tell what is stored of a block; more trials than it has are fine."""
        if not (self.path / "rows" / block.file_name).exists():
            return BlockState.ABSENT
        if any(checksums.damaged_of(self.path, self.path / checksums.FOLDER / block.checksums_name)):
            return BlockState.DAMAGED
        try:
            trials = read_column(self.path / "rows" / block.file_name, "trial")
        except BoresightError:
            return BlockState.DAMAGED
        wanted = [trial for trial in range(block.first, block.last) for _ in range(estimators)]
        return BlockState.WHOLE if trials[: len(wanted)] == wanted else BlockState.SHORT

    def table(self, name: str) -> pd.DataFrame:
        """Read one stored table whole; an empty frame with its columns where nothing is stored.

        Raise BoresightError if it is not what was stored, or cannot be read as such a table.
        """
        frame: pd.DataFrame = self.arrow(name).to_pandas(ignore_metadata=True)
        return frame

    def arrow(self, name: str) -> pa.Table:
        """Read one stored table as `table` does, but as a table of Arrow, without pandas."""
        refuse_damaged(self.path, name)
        if not any((self.path / name).glob("*.parquet")):
            return schema(name).empty_table()
        return read_table(self.path / name, layout(name))

    def of_trial(self, name: str, scenario: str, estimator: str, trial: int) -> pa.Table:
        """Read what one stored table holds of a trial, in the order in which it was stored.

        Raise BoresightError if the table is damaged.
        """
        # Names sort in the order of trials, and files may be many.
        files = sorted(
            path for path in (self.path / name).glob("*.parquet") if path.stem.rpartition("-")[0] == scenario
        )
        later = bisect_right(files, trial, key=lambda path: _first_trial(path, trial))
        if not later:
            return schema(name).empty_table()
        wanted = {"scenario": scenario, "trial": trial, "estimator": estimator}
        return read_where(files[later - 1], layout(name), wanted)


def run_folders(runs: Path) -> list[Path]:
    """Return the folders below ``runs`` that contain a manifest, by name."""
    return sorted(path.parent for path in runs.glob("*/manifest.json"))


def next_start(folder: Path) -> int:
    """Return the number of the start of a run: one more than that of any other run in the folder."""
    return 1 + max(map(start_of, run_folders(folder.absolute().parent)), default=0)


def start_of(folder: Path) -> int:
    """Return the number of a run's last start; 0 where its manifest has none, as in earlier versions."""
    try:
        manifest = plain_json(folder / "manifest.json")
        return int(manifest.get(KEY, 0))
    except (OSError, ValueError, TypeError, AttributeError, OverflowError):
        return 0


def newest_first(folders: Iterable[Path]) -> list[Path]:
    """Sort run folders by their last start; those of earlier versions come after, by when they changed last."""
    return sorted(folders, key=lambda path: (start_of(path), path.stat().st_mtime), reverse=True)


def run_words(manifest: Mapping[str, Any]) -> list[str]:
    """Return the words of the command that started a run, ``boresight run ...``; none if it was started otherwise."""
    try:
        words = shlex.split(manifest.get("command") or "")
    except ValueError:  # a quotation that has no end
        return []
    return words if words[:2] == ["boresight", "run"] else []


def find_run(name: str) -> RunFolder:
    """Find a run by its folder, or by a campaign's name under ``runs/`` (the newest of several).

    Raise BoresightError if there is none, or it has no manifest that this version of boresight reads.
    """
    prefix = f"{name}-"
    named = [path for path in RUNS.iterdir() if path.name.startswith(prefix)] if RUNS.is_dir() else []
    candidates = [Path(name), *newest_first(named)]
    for candidate in candidates:
        if (candidate / "manifest.json").exists():
            folder = RunFolder(candidate)
            folder.read_manifest()
            return folder
    raise BoresightError(f"{name}: no run there, nor in {RUNS}/ as {prefix}...: give a run folder, or run it first")
