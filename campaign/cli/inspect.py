"""``inspect``: understand one case of a run, recomputed from its seed with everything that came about on the way."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.runs import find_run, not_negative, positive
from campaign.cli.terminal import console
from scenarios.atomic import explain_write_error
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction

_WORST = 5


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    inspect = commands.add_parser("inspect", help="recompute single trials of a run, keep all of them and draw them")
    inspect.add_argument("run", help="a run folder, or a campaign's name")
    inspect.add_argument("--trial", type=not_negative, nargs="+", metavar="N", help="these trials")
    inspect.add_argument(
        "--worst", type=positive, metavar="N",
        help=f"the N worst cases (default: {_WORST}): estimators that raised, then failures, then the largest errors",
    )  # fmt: skip
    inspect.add_argument("--scenario", help="of this scenario alone")
    inspect.add_argument("--estimator", help="of this estimator alone (default: all but controls such as prior)")
    inspect.add_argument("--metric", help="what --worst ranks by (default: the position error; see boresight compare)")
    inspect.add_argument(
        "--look", action="store_true",
        help="in place of cases, a page in three dimensions: the body, its landmarks by how often and how well they are"
        " recognised, and the cameras of good and bad trials",
    )  # fmt: skip
    inspect.add_argument("--rerun", type=Path, metavar="FILE.rrd", help="the same as a recording for the viewer rerun")
    inspect.add_argument("--out", type=Path, help="folder of the pages (default: RUN/inspect)")
    inspect.set_defaults(handler=_inspect)


def _inspect(arguments: argparse.Namespace) -> int:
    return _look(arguments) if arguments.look or arguments.rerun is not None else _cases(arguments)


def _look(arguments: argparse.Namespace) -> int:
    # Imported here: plotly and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.inspection.case import Choice
    from campaign.inspection.look import look_of
    from campaign.inspection.recompute import reopened
    from reports.pages.view3d import write_recording, write_view3d
    from reports.run.data import read_run
    from reports.schema.named_figure import file_stem

    for name in ("trial", "worst", "metric"):
        if getattr(arguments, name) is not None:
            raise BoresightError(f"--{name}: a look is at all trials: leave it out, or --look and --rerun")
    folder = find_run(arguments.run)
    run = read_run(folder.path)
    look = look_of(reopened(folder), folder, run, Choice(arguments.scenario, arguments.estimator))
    written = []
    if arguments.look:
        written.append((arguments.out or folder.path / "inspect") / f"{file_stem('look', look.title)}.html")
        write_view3d(look, written[-1])
    if arguments.rerun is not None:
        try:
            write_recording(look, arguments.rerun)
        except OSError as error:
            raise BoresightError(explain_write_error(error.filename or arguments.rerun, error)) from error
        written.append(arguments.rerun)
    for path in written:
        console().print(f"look: {path}")
    return 0


def _cases(arguments: argparse.Namespace) -> int:
    # Imported here: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.imaging.image_store import store_switched
    from campaign.inspection.build import inspect_case, order_of
    from campaign.inspection.case import ORDER, Choice, chosen_rows, named_cases, worst_cases
    from campaign.inspection.recompute import reopened
    from reports.run.data import read_run

    if arguments.trial is not None and arguments.worst is not None:
        raise BoresightError("--trial and --worst: give one of them")
    if arguments.metric is not None and arguments.trial is not None:
        raise BoresightError("--metric says what --worst ranks by: leave it out, or --trial")
    folder, printer = find_run(arguments.run), console()
    run, choice = read_run(folder.path), Choice(arguments.scenario, arguments.estimator)
    if arguments.trial is not None:
        rows = chosen_rows(run.rows, choice, str(folder.path))
        cases, ranked_by = named_cases(rows, arguments.trial, str(folder.path)), None
    else:
        cases, ranked_by = worst_cases(run, arguments.worst or _WORST, choice, arguments.metric)
    campaign = reopened(folder)
    if ranked_by is not None:
        printer.print(f"worst first: {ORDER} {ranked_by}")
    out = arguments.out or folder.path / "inspect"
    same = True
    # Images are rendered anew: one that is kept would prove nothing.
    with store_switched(False):
        for case in order_of(cases):
            try:
                found = inspect_case(campaign, folder, case, out)
            except OSError as error:
                raise BoresightError(explain_write_error(error.filename or out, error)) from error
            same = same and not found.comparison.differences
            reason = f" ({found.row['reason']})" if found.row["reason"] else ""
            printer.print(f"{case}: {found.row['status']}{reason}; {found.comparison}")
            printer.print(f"  {found.page}")
    return 0 if same else 1
