"""Reading and writing of a run folder."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from campaign.store.columns import FORMAT_VERSION, TABLES, schema
from scenarios import checksums
from scenarios.atomic import write_atomically, write_text
from scenarios.checksums import refuse_damaged, unreadable
from scenarios.errors import BoresightError

Records = Sequence[Mapping[str, object]]

_ROUND_BLOCKS = 50
_MANIFEST = {"digest": str, "name": str, "seed": int, "trials": int, "scenarios": dict}
"""What all who read a manifest rely on, whatever version wrote it."""


@dataclass(frozen=True, slots=True)
class Block:
    """Trials ``[first, last)`` of one scenario: the unit that is computed, stored and resumed."""

    scenario: str
    first: int
    last: int
    number: int

    @property
    def file_name(self) -> str:
        """Name of the block's file in each table's folder; names sort in the order of trials."""
        return f"{self.scenario}-{self.number:07d}.parquet"

    @property
    def checksums_name(self) -> str:
        """Name of the file of its checksums."""
        return f"{self.scenario}-{self.number:07d}.sha256"


class BlockState(Enum):
    """What is stored of a block."""

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


def _parquet(table: str, records: Records) -> bytes:
    """Write a table as Parquet."""
    found = pa.Table.from_pylist([dict(record) for record in records], schema=schema(table))
    sink = pa.BufferOutputStream()
    pq.write_table(found, sink)
    return bytes(sink.getvalue())


def _write_bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)


class RunFolder:
    """A run on the disk. It keeps no state beside its path."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def manifest_path(self) -> Path:
        """Where the manifest is."""
        return self.path / "manifest.json"

    def read_manifest(self) -> dict[str, Any] | None:
        """Return the manifest, or None where no run has started.

        Raises
        ------
        BoresightError
            If the file is there but cannot be read as a manifest, or is that of a run that another version of
            boresight stored in another way.
        """
        if not self.manifest_path.exists():
            return None
        try:
            found = json.loads(self.manifest_path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise unreadable(self.manifest_path, "a manifest", error) from error
        manifest: dict[str, Any] = found if isinstance(found, dict) else {}
        for key, kind in _MANIFEST.items():
            if not isinstance(manifest.get(key), kind):
                raise BoresightError(
                    f"{self.manifest_path}: not a manifest of boresight, which has a {key}: choose another folder with"
                    " --out"
                )
        if manifest.get("format") != FORMAT_VERSION:
            stored = manifest.get("format", "unknown")
            raise BoresightError(
                f"{self.path}: stored in format {stored}, and this version of boresight reads {FORMAT_VERSION}: run the"
                " campaign again, into another folder (--out)"
            )
        return manifest

    def write_manifest(self, manifest: Mapping[str, object]) -> None:
        """Write the manifest atomically."""
        write_text(self.manifest_path, json.dumps(manifest, indent=1, sort_keys=True, default=str) + "\n")

    def sweep(self) -> None:
        """Remove what a killed process left half written; only for who holds the lock."""
        places = (*TABLES, checksums.FOLDER, "products", "images/*", "chain/**")
        patterns = [".manifest.json.*.tmp", *(f"{place}/.*.tmp" for place in places)]
        for leftover in [path for pattern in patterns for path in self.path.glob(pattern)]:
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)

    def write_block(self, block: Block, tables: Mapping[str, Records]) -> None:
        """Store a block: its detail tables first, then all checksums, its rows last: rows stand for the whole block."""
        contents = {name: _parquet(name, tables[name]) for name in tables if tables[name]}
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
        write_atomically(self.path / name, lambda path: _write_bytes(path, content))

    def state(self, block: Block, estimators: int) -> BlockState:
        """Tell what is stored of a block; more trials than it has are fine."""
        if not (self.path / "rows" / block.file_name).exists():
            return BlockState.ABSENT
        if any(self._damaged(block)):
            return BlockState.DAMAGED
        try:
            trials = pq.read_table(self.path / "rows" / block.file_name, columns=["trial"]).column("trial").to_pylist()
        except (OSError, pa.ArrowException):
            return BlockState.DAMAGED
        wanted = [trial for trial in range(block.first, block.last) for _ in range(estimators)]
        return BlockState.WHOLE if trials[: len(wanted)] == wanted else BlockState.SHORT

    def _damaged(self, block: Block) -> Iterator[str]:
        """Yield the files of a block that are not what was stored; runs of earlier versions have no checksums."""
        path = self.path / checksums.FOLDER / block.checksums_name
        return checksums.damaged_of(self.path, path) if path.exists() else iter(())

    def table(self, name: str) -> pd.DataFrame:
        """Read one stored table whole; an empty frame with its columns where nothing is stored.

        Raises
        ------
        BoresightError
            If it is not what was stored, or cannot be read.
        """
        folder = self.path / name
        refuse_damaged(self.path, name)
        if not any(folder.glob("*.parquet")):
            empty: pd.DataFrame = schema(name).empty_table().to_pandas()
            return empty
        try:
            stored: pd.DataFrame = pd.read_parquet(folder)
        except (OSError, pa.ArrowException) as error:
            raise unreadable(folder, "a stored table", error) from error
        return stored

    def of_trial(self, name: str, scenario: str, estimator: str, trial: int) -> pa.Table:
        """Read what one stored table holds of a trial, in the order in which it was stored.

        Raises
        ------
        BoresightError
            If the table is damaged.
        """
        folder = self.path / name
        if not any(folder.glob("*.parquet")):
            return schema(name).empty_table()
        wanted = [("scenario", "=", scenario), ("trial", "=", trial)]
        try:
            found = pq.read_table(folder, filters=wanted)
        except (OSError, pa.ArrowException) as error:
            raise unreadable(folder, "a stored table", error) from error
        if "estimator" in found.column_names:
            found = found.filter(pc.equal(found["estimator"], estimator))
        return found

    @staticmethod
    def table_names() -> tuple[str, ...]:
        """Return the names of the stored tables."""
        return tuple(TABLES)
