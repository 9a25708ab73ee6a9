"""Record of the source and the printed tables of a report: one that would be the same is not made again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from pydantic import BaseModel, ConfigDict
from rich.console import Group

from boresight import campaign
from boresight.campaign.cli.terminal import console
from boresight.campaign.store import RunFolder
from boresight.reports.pages.rich_tables import rich_parts
from boresight.reports.schema.grid import Grid
from boresight.scenarios import checksums
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import display
from boresight.scenarios.reading import held_to, plain_json

MADE = "made.json"
_PACKAGES = ("scenarios", "renderers", "estimators", "reports", "campaign")
_OF_A_START = frozenset({"start", "finished", "updated"})
"""Entries of a manifest that each start changes, and no report shows."""


class Printed(BaseModel):
    """Tables and lines of a report for the terminal, and the digests that decide whether it would be the same.

    ``source`` is the digest of rows, manifest, options and code. ``files`` has the SHA-256 of each file of the report,
    by its path in the report's folder.
    """

    model_config = ConfigDict(frozen=True)

    source: str
    files: dict[str, str]
    grids: tuple[Grid, ...]
    lines: tuple[str, ...]


def source_of(folder: RunFolder, worst: int, pdf: bool) -> str:
    """Return the digest of what a report is made from: rows by their checksums, manifest, options, and our code.

    What other libraries draw otherwise after an update is not seen; ``boresight report`` always makes a report again.
    """
    manifest = {key: value for key, value in (folder.read_manifest() or {}).items() if key not in _OF_A_START}
    found = hashlib.sha256(json.dumps([manifest, worst, pdf], sort_keys=True).encode())
    for path in sorted((folder.path / checksums.FOLDER).glob("*.sha256")):
        found.update(path.name.encode() + path.read_bytes())
    root = Path(campaign.__file__).parents[1]
    for path in sorted(path for name in _PACKAGES for path in (root / name).rglob("*") if path.is_file()):
        if path.suffix != ".pyc":
            found.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return found.hexdigest()


def keep(report: Path, printed: Printed) -> None:
    """Write down what a report was made from and printed."""
    write_text(report / MADE, printed.model_dump_json(indent=1) + "\n")


def digests(report: Path, files: Iterable[Path]) -> dict[str, str]:
    """Return the SHA-256 of files by their paths in the folder of a report."""
    return {str(path.relative_to(report)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def printed_before(folder: RunFolder, source: str) -> Printed | None:
    """Return what a report printed; None if it was made of anything else, or a file of it is not as it was written.

    Raise BoresightError if a stored table is damaged.
    """
    report = folder.path / "report"
    try:
        printed = held_to(Printed, plain_json(report / MADE))
        # Only files that are found are read: a path in the record may lead anywhere.
        named = set(map(report.joinpath, printed.files))
        files = [path for path in report.rglob("*") if path in named and path.is_file()]
        same = printed.source == source and digests(report, files) == printed.files
    except (OSError, ValueError):
        return None
    checksums.refuse_damaged(folder.path)
    return printed if same else None


def print_report(printed: Printed, folder: RunFolder) -> None:
    """Print the tables of a report, the lines below them, and where it is."""
    out = console()
    out.print(Group(*(part for grid in printed.grids for part in rich_parts(grid))))
    for line in printed.lines:
        out.print(line)
    out.print(f"report: {display(folder.path / 'report' / 'report.html')}")
