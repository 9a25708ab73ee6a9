"""``inspect`` and ``export``: single trials of a run, recomputed and drawn, and runs in the formats of others."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence

from rich.progress import track

from boresight.campaign.cli.main import WORST
from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.export import export
from boresight.campaign.export.kernels import Origin
from boresight.campaign.imaging.image_store import store_switched
from boresight.campaign.inspection.build import inspect_case
from boresight.campaign.inspection.recompute import ORDER, Case, Choice, chosen_rows, named_cases, reopened, worst_cases
from boresight.campaign.inspection.show import look_of
from boresight.campaign.store import find_run
from boresight.reports.figures.named import file_stem
from boresight.reports.pages.view3d import write_view3d
from boresight.reports.run.data import read_run
from boresight.scenarios.errors import BoresightError, display


def inspect_command(arguments: argparse.Namespace) -> int:
    """Recompute and draw single trials, or draw all trials in three dimensions."""
    return _look(arguments) if arguments.look else _cases(arguments)


def _look(arguments: argparse.Namespace) -> int:
    for name in ("trial", "worst", "metric"):
        if getattr(arguments, name) is not None:
            raise BoresightError(f"--{name}: a look is at all trials: leave it out, or --look")
    folder = find_run(arguments.run)
    run = read_run(folder.path)
    look = look_of(reopened(folder), folder, run, Choice(arguments.scenario, arguments.estimator))
    page = (arguments.out or folder.path / "inspect") / f"{file_stem('look', look.title)}.html"
    write_view3d(look, page)
    console().print(f"look: {display(page)}")
    return 0


def _cases(arguments: argparse.Namespace) -> int:
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
        cases, ranked_by = worst_cases(run, arguments.worst or WORST, choice, arguments.metric)
    campaign = reopened(folder)
    if ranked_by is not None:
        printer.print(f"worst first: {ORDER} {ranked_by}")
    out = arguments.out or folder.path / "inspect"
    same, scenarios = True, list(dict.fromkeys(case.scenario for case in cases))
    # Images are rendered anew: one that is kept would prove nothing.
    with store_switched(False):
        for case in sorted(cases, key=lambda case: scenarios.index(case.scenario)):  # each world is built once
            with writing(out):
                found, page = inspect_case(campaign, folder, case, out, arguments.pdf)
            same = same and not found.comparison.differences
            reason = f" ({found.row['reason']})" if found.row["reason"] else ""
            printer.print(f"{case}: {found.row['status']}{reason}; {found.comparison}")
            printer.print(f"  {display(page)}")
    return 0 if same else 1


def export_command(arguments: argparse.Namespace) -> int:
    """Write trajectories, landmarks or tables of a run."""
    printer, choice = console(), Choice(arguments.scenario, arguments.estimator)

    def shown(cases: Sequence[Case]) -> Iterable[Case]:
        printer.print(f"working out {len(cases)} trials again, for what the run does not hold of them")
        return track(cases, "trials", console=printer, disable=not printer.is_terminal)

    given = {"body": arguments.body_id, "et": arguments.start_et}
    given = {key: value for key, value in given.items() if value is not None}
    origin = Origin(**given) if given else None
    with writing(arguments.out):
        written = export(find_run(arguments.run), arguments.to, choice, arguments.trial, arguments.out, shown, origin)
    if not written:
        raise BoresightError(f"{arguments.run}: nothing to export: no chosen trial has an estimate")
    more = ", ..." if len(written) > 6 else ""
    printer.print(f"{len(written)} files in {arguments.out}: {', '.join(path.name for path in written[:6])}{more}")
    return 0
