"""``export``: a stored run in the formats of others."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd
from rich.progress import track

from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.export import (
    check_posed,
    posed,
    stored_images,
    trajectories,
    write_latex,
    write_model,
    write_tables,
    write_trajectory,
)
from boresight.campaign.inspection.show import PosedFrame, PosedFrames, Show, show_of
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.store import RunFolder, find_run
from boresight.campaign.trial.score import pose_of
from boresight.reports.figures.named import file_stem
from boresight.reports.kinds import report_grids
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run
from boresight.scenarios.errors import BoresightError


def export_command(arguments: argparse.Namespace) -> int:
    """Write trajectories, landmarks or tables of a run."""
    write = _tables if arguments.to in ("csv", "parquet", "latex") else _poses
    with writing(arguments.out):
        written = write(find_run(arguments.run), arguments)
    if not written:
        raise BoresightError(f"{arguments.run}: nothing to export: no chosen trial has an estimate")
    console().print(
        f"{len(written)} files in {arguments.out}: {', '.join(path.name for path in written[:6])}"
        + (", ..." if len(written) > 6 else "")
    )
    return 0


def _tables(folder: RunFolder, arguments: argparse.Namespace) -> list[Path]:
    if arguments.to == "latex":
        for name in ("trial", "scenario", "estimator"):
            if getattr(arguments, name) is not None:
                raise BoresightError(f"--{name}: the tables of a report are of the whole run: leave it out")
        return write_latex(folder, arguments.out)
    _chosen(folder, arguments)
    only = {name: getattr(arguments, name) for name in ("scenario", "estimator") if getattr(arguments, name)}
    return write_tables(folder, arguments.to, arguments.trial, only, arguments.out)


def _chosen(folder: RunFolder, arguments: argparse.Namespace) -> pd.DataFrame:
    """Return the rows of the chosen scenario, estimator and trials."""
    choice, run = Choice(arguments.scenario, arguments.estimator), str(folder.path)
    rows = chosen_rows(read_run(folder.path).rows, choice, run)
    return rows[rows["trial"].isin(checked_trials(rows, arguments.trial, run))]


def _poses(folder: RunFolder, arguments: argparse.Namespace) -> list[Path]:
    rows, written = _chosen(folder, arguments), []
    stored = stored_images(rows) if arguments.to == "tum" else None
    if stored is not None:
        return [path for name, frames in stored for path in write_trajectory(name, frames, arguments.out)]
    campaign = reopened(folder)
    check_posed(campaign)
    cases = _shown(cases_of(rows))
    if arguments.to == "tum":
        for name, frames in trajectories(campaign, folder, cases):
            written += write_trajectory(name, frames, arguments.out) if frames else []
        return written
    for name, found in posed(campaign, folder, cases):
        written += write_model(found, arguments.out / name) if found.frames else []
    return written


def _shown(cases: Sequence[Case]) -> Iterable[Case]:
    """Say that cases are worked out again, and show how many are done."""
    printer = console()
    printer.print(f"working out {len(cases)} trials again, for what the run does not hold of them")
    return track(cases, "trials", console=printer, disable=not printer.is_terminal)
