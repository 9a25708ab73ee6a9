"""``run``, ``status`` and ``report``: a campaign while it runs and after."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from campaign.cli.catalog import add_overrides
from campaign.cli.progress import ProgressListener
from campaign.cli.terminal import console
from campaign.imaging.image_store import store_is_on, store_switched
from campaign.runs.newest import newest_first
from campaign.runs.request import Cluster
from campaign.runs.start import RUNS, start
from campaign.store import RunFolder
from reports.schema.labels import count_of
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands to the parser."""
    run = commands.add_parser("run", help="run a campaign, or continue it where it stopped")
    run.add_argument("name", help="a campaign from the list, or a YAML file")
    run.add_argument("--trials", type=positive, help="trials of each scenario (default: what the campaign says)")
    run.add_argument(
        "--until", metavar="CONDITION",
        help='stop when every 95 %% interval is narrow enough, for example "ci(position_error_m, median) < 0.5" or'
        ' "... < 5 %%"; --trials stays the most',
    )  # fmt: skip
    run.add_argument("--jobs", type=positive, help="worker processes (default: one for each core, or GPU)")
    run.add_argument("--seed", type=not_negative, help="seed (default: what the campaign says)")
    run.add_argument("--out", type=Path, help="run folder (default: runs/NAME-DIGEST)")
    run.add_argument("--variant", help="Mitsuba variant (default: the fastest that works; see boresight doctor)")
    run.add_argument("--keep-images", action="store_true", help="keep every image as TIFF in the run folder")
    run.add_argument("--no-store", action="store_true", help="render every image anew, and keep none in the cache")
    run.add_argument(
        "--trial-limit", type=float, metavar="SECONDS",
        help="stop an estimator that works longer at a trial, and store that as an error (default: no limit)",
    )  # fmt: skip
    run.add_argument("--backend", choices=("loky", "dask"), default="loky", help="what workers are (default: loky)")
    run.add_argument(
        "--scheduler", metavar="ADDRESS", help="with --backend dask: a scheduler, such as tcp://10.0.0.1:8786"
    )
    run.add_argument("--local", type=positive, metavar="N", help="with --backend dask: N workers of this machine")
    add_overrides(run)
    _add_worst(run)
    run.add_argument("--no-report", action="store_true", help="store the trials alone; boresight report tells of them")
    run.set_defaults(handler=_run)
    status = commands.add_parser("status", help="say how far a run is")
    status.add_argument("run", help="a run folder, or a campaign's name")
    status.set_defaults(handler=_status)
    report = commands.add_parser("report", help="write the report of a run")
    report.add_argument("run", help="a run folder, or a campaign's name")
    _add_worst(report)
    report.set_defaults(handler=_report)


def _add_worst(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--worst", type=not_negative, metavar="N", default=5,
        help="pictures of the N worst trials in the report, recomputed (default: 5); see boresight inspect",
    )  # fmt: skip


def positive(text: str) -> int:
    """Read a whole number above 0 from the command line."""
    return _integer(text, 1)


def not_negative(text: str) -> int:
    """Read a whole number from 0 on from the command line."""
    return _integer(text, 0)


def _integer(text: str, lowest: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if value < lowest:
        raise argparse.ArgumentTypeError(f"{value} is below {lowest}")
    return value


def _run(arguments: argparse.Namespace) -> int:
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
    out.print(f"{name}: {count_of(request.trials, 'trial')} into {request.out}, {where}, {variant}")
    if begun.advice:
        out.print(begun.advice)
    with store_switched(store_is_on() and not arguments.no_store):
        with ProgressListener(out) as listener:
            folder = begun.go(listener)
        if arguments.no_report:
            out.print(f"stored; {shlex.join(['boresight', 'report', str(folder.path)])} writes the report")
        else:
            _print_report(folder, arguments.worst)
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


def _status(arguments: argparse.Namespace) -> int:
    folder = find_run(arguments.run)
    manifest = folder.read_manifest()
    if manifest is None:
        raise BoresightError(f"{folder.path}: no run has started there")
    rows = folder.table("rows")
    total = manifest["trials"] * len(manifest["scenarios"])
    done = len(rows[["scenario", "trial"]].drop_duplicates())
    out = console()
    finished = manifest.get("finished") if done >= total else None
    out.print(f"{folder.path}: {manifest['name']}, {done} of {total} trials stored, seed {manifest['seed']}")
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
    asked = ["--out", str(folder.path), *([] if "--until" in words else ["--trials", trials])]
    return shlex.join([*words, *asked])


def _report(arguments: argparse.Namespace) -> int:
    _print_report(find_run(arguments.run), arguments.worst)
    return 0


def _print_report(folder: RunFolder, worst: int) -> None:
    # Imported here: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.cli.report import print_report

    print_report(folder, worst)


def find_run(name: str) -> RunFolder:
    """Find a run by its folder, or by a campaign's name under ``runs/`` (the newest of several).

    Raises
    ------
    BoresightError
        If there is none, or it has no manifest that this version of boresight reads.
    """
    prefix = f"{name}-"
    named = [path for path in RUNS.iterdir() if path.name.startswith(prefix)] if RUNS.is_dir() else []
    candidates = [Path(name), *newest_first(named)]
    for candidate in candidates:
        if (candidate / "manifest.json").exists():
            folder = RunFolder(candidate)
            folder.read_manifest()
            return folder
    raise BoresightError(f"{name}: no run there, nor in {RUNS}/ as {prefix}...: give a run folder, or run it first")
