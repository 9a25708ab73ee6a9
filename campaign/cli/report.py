"""The report of a run, written to its folder and summed up on the console."""

from __future__ import annotations

from campaign.cli.terminal import console
from campaign.crater_examples import crater_examples
from campaign.fit_figures import fit_figures
from campaign.matching_examples import matching_examples
from campaign.resolve import reload
from campaign.store import RunFolder
from reports.build import write_report
from reports.console import console_table
from reports.named_figure import NamedFigure
from scenarios.errors import BoresightError


def print_report(folder: RunFolder) -> None:
    """Write the report of a run and print its table."""
    out = console()
    files = write_report(folder.path, extra=_fit_figures(folder))
    out.print(console_table(files.content))
    out.print(f"report: {files.html}")


def _fit_figures(folder: RunFolder) -> list[NamedFigure]:
    """Draw a typical trial, or images with their craters, unless code, data or machine can no longer make its image."""
    manifest = folder.read_manifest() or {}
    why = (
        "the run was made by another version of boresight or of its data:"
        f" run it again to have one: boresight run {manifest.get('name', '')}".rstrip()
    )
    try:
        campaign = reload(manifest)
        if campaign is not None and campaign.spec.experiment == "crater-detection":
            return list(crater_examples(campaign, folder.path))
        if campaign is not None and campaign.spec.experiment == "crater-matching":
            return list(matching_examples(campaign, folder.path))
        if campaign is not None:
            return list(fit_figures(campaign, folder.path, folder.table("rows")))
    except BoresightError as error:
        why = str(error)
    console().print(f"no figure of a single fit: {why}")
    return []
