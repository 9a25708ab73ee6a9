"""``report``: the report of a run, written to its folder and summed up on the console."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from boresight.campaign.cli.printed import Printed, digests, keep, print_report, source_of
from boresight.campaign.inspection.build import case_figures
from boresight.campaign.inspection.show import show_of
from boresight.campaign.runs.newest import find_run
from boresight.campaign.runs.resolve import reload
from boresight.campaign.store import RunFolder
from boresight.reports.figures.named import NamedFigure
from boresight.reports.kinds import brief_grids
from boresight.reports.pages.build import write_report
from boresight.reports.run.outcomes import reason_lines, unsolved_lines
from boresight.scenarios.errors import BoresightError


def report_command(arguments: argparse.Namespace) -> int:
    """Write the report of a run and print its table."""
    folder = find_run(arguments.run)
    source = source_of(folder, arguments.worst, arguments.pdf)
    print_report(write(folder, arguments.worst, arguments.pdf, source), folder)
    return 0


def write(folder: RunFolder, worst: int, pdf: bool, source: str) -> Printed:
    """Write the report of a run, with pictures of so many of its worst trials; return what is printed of it.

    It is kept with the ``source`` of the report, unless pictures of trials are missing that a later start may make.
    """
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
        keep(files.folder, printed)
    return printed


def _trial_figures(folder: RunFolder, worst: int, missing: list[str]) -> Iterator[NamedFigure]:
    """Draw typical trials and the worst; if code, data or machine can no longer make them again, add why."""
    manifest = folder.read_manifest() or {}
    why = (
        "the run was made by another version of boresight or of its data:"
        f" run it again to have one: boresight run {manifest.get('name', '')}"
        f"{' --embedded' if manifest.get('embedded') else ''}".rstrip()
    )
    try:
        campaign = reload(manifest)
        if campaign is not None:
            show = show_of(campaign.spec.experiment)
            typical = () if show is None else show.examples(campaign, folder)
            yield from [*typical, *case_figures(campaign, folder, worst)]
            return
    except BoresightError as error:
        why = str(error)
    missing.append(why)
