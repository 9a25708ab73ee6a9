"""``run``: run campaigns, or continue them."""

from __future__ import annotations

import argparse
import shlex

from rich.console import Console

from boresight.campaign.cli.main import EXIT_IN_PART, EXIT_NOT_MET
from boresight.campaign.cli.report import report_after_run
from boresight.campaign.cli.terminal import ProgressListener, console
from boresight.campaign.imaging.image_store import store_is_on, store_switched
from boresight.campaign.runs.check import preflight
from boresight.campaign.runs.manifest import Cluster
from boresight.campaign.runs.start import Start, start
from boresight.campaign.store import RunFolder
from boresight.reports.schema.records import count_of
from boresight.scenarios.errors import BoresightError, display


def run_command(arguments: argparse.Namespace) -> int:
    """Run or continue campaigns, one after the other, and write their reports."""
    names: list[str] = arguments.names
    if len(names) > 1 and arguments.out is not None:
        raise BoresightError("--out is the folder of one run: leave it out where several campaigns are given")
    if twice := [name for name in names if names.count(name) > 1]:
        raise BoresightError(f"{twice[0]} is given twice: give each campaign once")
    if "craters-real" in names:
        raise BoresightError("craters-real is a command of its own: boresight craters-real")
    if arguments.fetch or arguments.source:
        # Imported here: downloads take 0.3 s to import.
        from boresight.campaign.cli.fetch import bring_missing

        bring_missing(names, arguments)
    # What cannot run is refused before the first campaign runs.
    ready = [
        start(
            name, overrides=arguments.overrides, seed=arguments.seed, trials=arguments.trials, until=arguments.until,
            jobs=arguments.jobs, out=arguments.out, variant=arguments.variant, keep_images=arguments.keep_images,
            cluster=_cluster(arguments), trial_limit_s=arguments.trial_limit, embedded=arguments.embedded,
            command=arguments.command,
        )
        for name in names
    ]  # fmt: skip
    return max(_run(begun, arguments) for begun in ready)


def _run(begun: Start, arguments: argparse.Namespace) -> int:
    campaign, request = begun.campaign, begun.request
    out = console()
    name, variant = campaign.spec.name, campaign.variant
    where, cluster = f"{request.jobs} job(s)", request.cluster
    if cluster is not None:
        where = f"Dask at {cluster.scheduler}" if cluster.scheduler else f"{cluster.local} Dask worker(s)"
    out.print(f"{name}: {count_of(request.trials, 'trial')} into {display(request.out)}, {where}, {variant}")
    for line in preflight(campaign.scenarios, campaign.spec, trials=request.trials):
        out.print(line)
    if campaign.embedded:
        out.print(f"values without verdicts: {', '.join(campaign.embedded)}")
    if begun.advice:
        out.print(begun.advice)
    with store_switched(store_is_on() and not arguments.no_store):
        with ProgressListener(out) as listener:
            folder = begun.go(listener)
        if arguments.no_report:
            out.print(f"stored; {shlex.join(['boresight', 'report', display(folder.path)])} writes the report")
        else:
            report_after_run(folder, arguments.worst, arguments.pdf)
    if campaign.spec.requirements and _not_passed(folder, out):
        return EXIT_NOT_MET
    return EXIT_IN_PART if (folder.table("rows")["status"] == "error").any() else 0


def _not_passed(folder: RunFolder, out: Console) -> bool:
    """Print the requirements that have not passed; return whether there are any."""
    # Imported here: figures take a while to import, and most campaigns have no requirements.
    from boresight.reports.kinds.requirements import judged
    from boresight.reports.run.data import read_run
    from boresight.reports.statistics.requirements import PASS

    missed = [one for one in judged(read_run(folder.path)) if one.verdict.verdict != PASS]
    for one in missed:
        out.print(f"{one.verdict.verdict}: {one.requirement.written}, {one.estimator}, {one.scenario}")
    return bool(missed)


def _cluster(arguments: argparse.Namespace) -> Cluster | None:
    """Read which cluster is asked for; the options of one back end are refused with the other."""
    if arguments.backend != "dask":
        if arguments.scheduler or arguments.local:
            raise BoresightError("--scheduler and --local are of --backend dask: give it too")
        return None
    if bool(arguments.scheduler) == bool(arguments.local):
        raise BoresightError("--backend dask: give either --scheduler ADDRESS or --local N")
    return Cluster(arguments.scheduler or "", arguments.local or 0)
