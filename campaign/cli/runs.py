"""``run`` and ``status``: run a campaign, and print how far it is."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from typing import Any

from campaign.cli.terminal import ProgressListener, console
from campaign.imaging.image_store import store_is_on, store_switched
from campaign.runs.newest import find_run
from campaign.runs.request import Cluster
from campaign.runs.start import start
from campaign.store import RunFolder
from reports.schema.labels import count_of
from scenarios.errors import BoresightError
from scenarios.load.find import display


def run_command(arguments: argparse.Namespace) -> int:
    """Run or continue a campaign, and write its report."""
    begun = start(
        arguments.name,
        overrides=arguments.overrides,
        seed=arguments.seed,
        trials=arguments.trials,
        until=arguments.until,
        jobs=arguments.jobs,
        out=arguments.out,
        variant=arguments.variant,
        keep_images=arguments.keep_images,
        cluster=_cluster(arguments),
        trial_limit_s=arguments.trial_limit,
        command=arguments.command,
    )
    campaign, request = begun.campaign, begun.request
    out = console()
    name, variant = campaign.spec.name, campaign.variant
    where = f"{request.jobs} job(s)" if request.cluster is None else _named(request.cluster)
    out.print(f"{name}: {count_of(request.trials, 'trial')} into {display(request.out)}, {where}, {variant}")
    if begun.advice:
        out.print(begun.advice)
    with store_switched(store_is_on() and not arguments.no_store):
        with ProgressListener(out) as listener:
            folder = begun.go(listener)
        if arguments.no_report:
            out.print(f"stored; {shlex.join(['boresight', 'report', display(folder.path)])} writes the report")
        else:
            # Matplotlib and the reports, 1 s to import, are needed only here.
            from campaign.cli.report import print_report

            print_report(folder, arguments.worst)
    return 3 if (folder.table("rows")["status"] == "error").any() else 0


def _cluster(arguments: argparse.Namespace) -> Cluster | None:
    """Read which cluster is asked for; the options of one back end are refused with the other."""
    if arguments.backend != "dask":
        if arguments.scheduler or arguments.local:
            raise BoresightError("--scheduler and --local are of --backend dask: give it too")
        return None
    if bool(arguments.scheduler) == bool(arguments.local):
        raise BoresightError("--backend dask: give either --scheduler ADDRESS or --local N")
    return Cluster(arguments.scheduler or "", arguments.local or 0)


def _named(cluster: Cluster) -> str:
    return f"Dask at {cluster.scheduler}" if cluster.scheduler else f"{cluster.local} Dask worker(s)"


def status_command(arguments: argparse.Namespace) -> int:
    """Print how many trials of a run are stored, and with which results."""
    folder = find_run(arguments.run)
    manifest = folder.read_manifest()
    if manifest is None:
        raise BoresightError(f"{folder.path}: no run has started there")
    rows = folder.table("rows")
    total = manifest["trials"] * len(manifest["scenarios"])
    done = len(rows[["scenario", "trial"]].drop_duplicates())
    out = console()
    finished = manifest.get("finished") if done >= total else None
    out.print(f"{display(folder.path)}: {manifest['name']}, {done} of {total} trials stored, seed {manifest['seed']}")
    out.print(
        f"started {manifest.get('created') or 'some time'}, " + (f"finished {finished}" if finished else "not finished")
    )
    if not finished:
        out.print(f"{'to end it' if done >= total else 'to continue'}: {_again(manifest, folder)}")
    for (scenario, estimator), group in rows.groupby(["scenario", "estimator"]):
        counts = group["status"].value_counts()
        out.print(f"  {scenario} / {estimator}: " + ", ".join(f"{n} {status}" for status, n in counts.items()))
    return 0


def _again(manifest: Mapping[str, Any], folder: RunFolder) -> str:
    """Say how a run goes on: as it was started last, but for all of the trials that it was ever asked for, and here."""
    trials = str(manifest["trials"])
    try:
        words = shlex.split(manifest.get("command") or "")
    except ValueError:  # a quotation that has no end
        words = []
    if words[:2] != ["boresight", "run"]:
        return f"run the campaign again into the same folder, with {trials} trials of each scenario"
    # Of an option that is given twice the last counts.
    asked = ["--out", display(folder.path), *([] if "--until" in words else ["--trials", trials])]
    return shlex.join([*words, *asked])
