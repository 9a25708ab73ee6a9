"""Checksums of the stored files of a run, in the format of ``sha256sum``.

They lie in ``FOLDER/*.sha256`` below the run folder; ``cd RUN && sha256sum -c checksums/*`` verifies them too.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from boresight.scenarios.errors import BoresightError

FOLDER, ROWS = "checksums", "rows"

_LINE = re.compile(r"(?P<sha256>[0-9a-f]{64})  (?P<name>[^/\n]+/[^/\n]+)\n")


def checksum_text(contents: Mapping[str, bytes]) -> str:
    """Return one line for each content; keys are file names, FOLDER/FILE."""
    return "".join(f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in contents.items())


def refuse_damaged(run: Path, table: str | None = None) -> None:
    """Verify the checksums of a run, or of one table of it.

    Raise BoresightError if a file differs from its checksum, or has none; the message names the first.
    """
    found = list(damaged(run, table))
    if found:
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        raise BoresightError(
            f"{run / found[0]}{more}: damaged, missing, or half of a start that was interrupted: not what its checksum"
            " says; run the campaign again into the same folder, which makes its trials anew"
        )


def damaged(run: Path, table: str | None = None) -> Iterator[str]:
    """Yield the files of a run, or of one ``table`` of it, that differ from their checksums.

    Blocks without rows are unfinished and not checked.
    """
    for rows in sorted((run / ROWS).glob("*.parquet")):
        yield from damaged_of(run, run / FOLDER / f"{rows.stem}.sha256", table)


def damaged_of(run: Path, checksums: Path, table: str | None = None) -> Iterator[str]:
    """Yield the files of a block that differ from their line in its checksum file.

    Yield the checksum file itself if it is missing or damaged, or does not list every file of the block.
    """
    text, block = _text(checksums), f"{checksums.stem}.parquet"
    lines = list(_LINE.finditer(text))
    stored = {f"{folder.name}/{block}" for folder in run.iterdir() if (folder / block).is_file()}
    if sum(len(line[0]) for line in lines) != len(text) or not stored <= {line["name"] for line in lines}:
        yield f"{FOLDER}/{checksums.name}"
        return
    for line in lines:
        if table in (None, line["name"].partition("/")[0]) and _sha256(run / line["name"]) != line["sha256"]:
            yield line["name"]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""


def _sha256(path: Path) -> str:
    try:
        if not path.is_file():  # a pipe or a device has no end
            return ""
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""
