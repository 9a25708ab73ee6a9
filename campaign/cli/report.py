"""``report``: the report of a run, written to its folder and summed up on the console."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from campaign.cli.terminal import console
from campaign.inspection.build import worst_figures
from campaign.inspection.show import show_of
from campaign.runs.newest import find_run
from campaign.runs.resolve import reload
from campaign.store import RunFolder
from reports.pages.build import write_report
from reports.pages.console import console_table
from reports.run.outcomes import reason_lines
from reports.schema.named_figure import NamedFigure
from scenarios.errors import BoresightError, display


def report_command(arguments: argparse.Namespace) -> int:
    """Write the report of a run and print its table."""
    print_report(find_run(arguments.run), arguments.worst)
    return 0


def print_report(folder: RunFolder, worst: int) -> None:
    """Write the report of a run, with pictures of so many of its worst trials, and print its table."""
    out = console()
    files = write_report(folder.path, extra=_trial_figures(folder, worst))
    out.print(console_table(files.content))
    for line in reason_lines(files.content.run):
        out.print(line)
    said = folder.table("said").drop_duplicates(["scenario", "trial", "estimator"])
    if len(said):
        counted = ", ".join(f"{name} in {n:,}" for name, n in said["estimator"].value_counts().items())
        out.print(f"printed or warned in trials: {counted}; boresight inspect shows what, and the table said keeps it")
    out.print(f"report: {display(files.html)}")


def _trial_figures(folder: RunFolder, worst: int) -> Iterator[NamedFigure]:
    """Draw typical trials and the worst, unless code, data or machine can no longer make them again."""
    manifest = folder.read_manifest() or {}
    why = (
        "the run was made by another version of boresight or of its data:"
        f" run it again to have one: boresight run {manifest.get('name', '')}".rstrip()
    )
    try:
        campaign = reload(manifest)
        if campaign is not None:
            show = show_of(campaign.spec.experiment)
            typical = () if show is None else show.examples(campaign, folder)
            yield from [*typical, *worst_figures(campaign, folder, worst)]
            return
    except BoresightError as error:
        why = str(error)
    console().print(f"no figure of single trials: {why}")
