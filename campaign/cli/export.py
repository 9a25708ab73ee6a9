"""``export``: a stored run in the formats of others."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.progress import track

from campaign.cli.runs import find_run, not_negative
from campaign.cli.terminal import console
from scenarios.atomic import explain_write_error
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction

    from campaign.inspection.case import Case

_FORMATS = ("tum", "colmap", "csv", "parquet", "latex")


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    export = commands.add_parser("export", help="write trajectories, landmarks or tables of a run for other programs")
    export.add_argument("run", help="a run folder, or a campaign's name")
    export.add_argument(
        "--to", required=True, choices=_FORMATS,
        help="tum: trajectories, truth and estimate; colmap: estimated poses, landmarks; csv, parquet: stored tables;"
        " latex: tables of the report",
    )  # fmt: skip
    export.add_argument("--trial", type=not_negative, nargs="+", metavar="N", help="these trials alone")
    export.add_argument("--scenario", help="of this scenario alone")
    export.add_argument("--estimator", help="of this estimator alone")
    export.add_argument("--out", type=Path, required=True, help="folder of the files")
    export.set_defaults(handler=_export)


def _export(arguments: argparse.Namespace) -> int:
    try:
        written = _tables(arguments) if arguments.to in ("csv", "parquet", "latex") else _poses(arguments)
    except OSError as error:
        raise BoresightError(explain_write_error(error.filename or arguments.out, error)) from error
    if not written:
        raise BoresightError(f"{arguments.run}: nothing to export: no chosen trial has an estimate")
    console().print(
        f"{len(written)} files in {arguments.out}: {', '.join(path.name for path in written[:6])}"
        + (", ..." if len(written) > 6 else "")
    )
    return 0


def _tables(arguments: argparse.Namespace) -> list[Path]:
    # Imported here: pandas and the reports take a third of the start-up, and most commands need none of them.
    from campaign.export.tables import write_latex, write_tables
    from campaign.inspection.case import Choice, checked_trials, chosen_rows
    from reports.run.data import read_run

    folder = find_run(arguments.run)
    if arguments.to == "latex":
        for name in ("trial", "scenario", "estimator"):
            if getattr(arguments, name) is not None:
                raise BoresightError(f"--{name}: the tables of a report are of the whole run: leave it out")
        return write_latex(folder, arguments.out)
    choice = Choice(arguments.scenario, arguments.estimator)
    rows = chosen_rows(read_run(folder.path).rows, choice, str(folder.path))
    checked_trials(rows, arguments.trial, str(folder.path))
    only = {name: value for name, value in (("scenario", choice.scenario), ("estimator", choice.estimator)) if value}
    return write_tables(folder, arguments.to, arguments.trial, only, arguments.out)


def _poses(arguments: argparse.Namespace) -> list[Path]:
    # Imported here, as above.
    from campaign.export.poses import check_posed, posed, stored_images, trajectories, write_model, write_trajectory
    from campaign.inspection.case import Choice, cases_of, checked_trials, chosen_rows
    from campaign.inspection.recompute import reopened
    from reports.run.data import read_run

    folder = find_run(arguments.run)
    choice = Choice(arguments.scenario, arguments.estimator)
    rows = chosen_rows(read_run(folder.path).rows, choice, str(folder.path))
    trials = checked_trials(rows, arguments.trial, str(folder.path))
    rows, written = rows[rows["trial"].isin(trials)], []
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
