"""``report``: the report of a run, written to its folder and printed; one that would be the same is not made again."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict
from rich.console import Group

from boresight import campaign
from boresight.campaign.cli.terminal import console
from boresight.campaign.store import RunFolder, find_run
from boresight.reports.pages.rich_tables import rich_parts
from boresight.reports.schema.grid import Grid
from boresight.scenarios import checksums
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.reading import held_to, plain_json

if TYPE_CHECKING:
    from boresight.reports.figures.named import NamedFigure

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


def report_command(arguments: argparse.Namespace) -> int:
    """Write the report of a run and print its table."""
    folder = find_run(arguments.run)
    source = source_of(folder, arguments.worst, arguments.pdf)
    print_report(write(folder, arguments.worst, arguments.pdf, source), folder)
    return 0


def report_after_run(folder: RunFolder, worst: int, pdf: bool) -> None:
    """Print the tables of the report of a run, and write it before that unless it would be the same."""
    source = source_of(folder, worst, pdf)
    print_report(printed_before(folder, source) or write(folder, worst, pdf, source), folder)


def write(folder: RunFolder, worst: int, pdf: bool, source: str) -> Printed:
    """Write the report of a run, with pictures of so many of its worst trials; return what is printed of it.

    It is kept with the ``source`` of the report, unless pictures of trials are missing that a later start may make.
    """
    # Imported here: Matplotlib and the reports take 1 s, and a report that would be the same needs neither.
    from boresight.reports.kinds import brief_grids
    from boresight.reports.pages.build import write_report
    from boresight.reports.run.outcomes import reason_lines, unsolved_lines

    missing: list[str] = []
    files = write_report(folder.path, extra=_trial_figures(folder, worst, missing), pdf=pdf)
    lines = [f"no figure of single trials: {why}" for why in missing]
    lines += [*unsolved_lines(files.content.run), *reason_lines(files.content.run)]
    said = folder.table("said").drop_duplicates(["scenario", "trial", "estimator"])
    if len(said):
        counted = ", ".join(f"{name} in {n:,}" for name, n in said["estimator"].value_counts().items())
        lines.append(
            f"printed or warned in trials: {counted}; boresight inspect shows what, and the table said keeps it"
        )
    written = (files.html, files.markdown, *files.tables, *files.figures)
    printed = Printed(
        source=source, files=digests(files.folder, written), grids=tuple(brief_grids(files.content)), lines=tuple(lines)
    )
    if not missing:
        write_text(files.folder / MADE, printed.model_dump_json(indent=1) + "\n")
    return printed


def _trial_figures(folder: RunFolder, worst: int, missing: list[str]) -> Iterator[NamedFigure]:
    """Draw typical trials and the worst; if code, data or machine can no longer make them again, add why."""
    from boresight.campaign.inspection.build import case_figures
    from boresight.campaign.inspection.show import show_of
    from boresight.campaign.runs.resolve import reload

    manifest = folder.read_manifest() or {}
    why = (
        "the run was made by another version of boresight or of its data:"
        f" run it again to have one: boresight run {manifest.get('name', '')}"
        f"{' --embedded' if manifest.get('embedded') else ''}".rstrip()
    )
    try:
        resolved = reload(manifest)
        if resolved is not None:
            show = show_of(resolved.spec.experiment)
            typical = () if show is None else show.examples(resolved, folder)
            yield from [*typical, *case_figures(resolved, folder, worst)]
            return
    except BoresightError as error:
        why = str(error)
    missing.append(why)


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
