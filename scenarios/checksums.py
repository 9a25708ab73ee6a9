"""Checksums of stored files in files of their own, in the format of ``sha256sum``.

``FOLDER/*.sha256`` below a run folder name files of the run; ``cd RUN && sha256sum -c checksums/*`` checks them too.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from scenarios.errors import BoresightError

FOLDER, ROWS = "checksums", "rows"

_LINE = re.compile(r"(?P<sha256>[0-9a-f]{64})  (?P<name>[^/\n]+/[^/\n]+)\n")


def checksum_text(contents: Mapping[str, bytes]) -> str:
    """Write a line for each content by the name of its file, FOLDER/FILE."""
    return "".join(f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in contents.items())


def refuse_damaged(run: Path, table: str | None = None) -> None:
    """Refuse a run, or one table of it, in which a file is not what was stored.

    Raises
    ------
    BoresightError
        If one is not; it names the first.
    """
    found = list(damaged(run, table))
    if found:
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        raise BoresightError(
            f"{run / found[0]}{more}: damaged, or half of a start that was interrupted: not what its checksum says; run"
            " the campaign again into the same folder, which makes its trials anew"
        )


def damaged(run: Path, table: str | None = None) -> Iterator[str]:
    """Yield the files of a run that are not what they were when they were stored; what is unfinished has none yet.

    Parameters
    ----------
    run
        The run folder. What has no checksums, as runs of earlier versions, cannot be checked.
    table
        Only the files of this folder of it.
    """
    for path in sorted((run / FOLDER).glob("*.sha256")):
        if (run / ROWS / path.with_suffix(".parquet").name).exists():
            yield from damaged_of(run, path, table)


def damaged_of(run: Path, checksums: Path, table: str | None = None) -> Iterator[str]:
    """Yield those files that one file of checksums names and that are not what it says; itself if it says nothing."""
    text = _text(checksums)
    lines = list(_LINE.finditer(text))
    if not lines or sum(len(line[0]) for line in lines) != len(text):
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
