"""``inspect``: understand one case of a run, recomputed from its seed with everything that came about on the way."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.runs import find_run, not_negative, positive
from campaign.cli.terminal import console
from scenarios.atomic import explain
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
    inspect.add_argument("--out", type=Path, help="folder of the pages (default: RUN/inspect)")
    inspect.set_defaults(handler=_inspect)


def _inspect(arguments: argparse.Namespace) -> int:
    # Imported here: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.image_store import store_switched
    from campaign.inspection.build import inspect_case, order_of
    from campaign.inspection.case import Choice, chosen_rows, named_cases
    from campaign.inspection.ranking import ORDER, worst_cases
    from campaign.inspection.recompute import reopened
    from reports.run_data import read_run

    if arguments.trial is not None and arguments.worst is not None:
        raise BoresightError("--trial and --worst: give one of them")
    if arguments.metric is not None and arguments.trial is not None:
        raise BoresightError("--metric says what --worst ranks by: leave it out, or --trial")
    folder, printer = find_run(arguments.run), console()
    run, choice = read_run(folder.path), Choice(arguments.scenario, arguments.estimator)
    if arguments.trial is not None:
        cases = named_cases(chosen_rows(run.rows, choice, str(folder.path)), arguments.trial, str(folder.path))
    else:
        cases, name = worst_cases(run, arguments.worst or _WORST, choice, arguments.metric)
        printer.print(f"worst first: {ORDER} {name}")
    campaign = reopened(folder)
    out = arguments.out or folder.path / "inspect"
    same = True
    # Images are rendered anew: one that is kept would prove nothing.
    with store_switched(False):
        for case in order_of(cases):
            try:
                found = inspect_case(campaign, folder, case, out)
            except OSError as error:
                raise BoresightError(explain(error.filename or out, error)) from error
            same = same and not found.sameness.differences
            reason = f" ({found.row['reason']})" if found.row["reason"] else ""
            printer.print(f"{case}: {found.row['status']}{reason}; {found.sameness}")
            printer.print(f"  {found.page}")
    return 0 if same else 1
