"""Arguments of every command, and the function that carries each out, named so that it is imported when called."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from boresight.campaign.papers import PAPERS
from boresight.campaign.runs.request import RUNS

if TYPE_CHECKING:
    from argparse import _SubParsersAction

    Commands = _SubParsersAction[argparse.ArgumentParser]

ALL_PAPERS = "all"
COMPARISONS = Path("comparisons")
WORST = 5
"""How many of the worst trials are drawn by default."""

PEERS = (
    "all",
    "quick",
    "plain",
    "kernels",
    "images",
    "rays",
    "adjustment",
    "smoother",
    "recognition",
    "scaling",
)
"""Works that are timed beside those of other software, by tests/benchmarks, and groups of them."""

_TRIALS, _SAMPLES = 20, 16
"""Defaults of ``sensitivity``: trials of each sample, and size of the design."""


def add_commands(commands: Commands) -> None:
    """Add every command with its arguments to the parser."""
    for add in (
        _catalog, _runs, _inspect, _export, _compare, _sensitivity, _figures, _craters, _bench, _fetch, _machine,
    ):  # fmt: skip
        add(commands)


def _catalog(commands: Commands) -> None:
    listing = commands.add_parser("list", help="list the campaigns by group, and what each misses here")
    listing.add_argument("--all", action="store_true", help="further campaigns, scenarios and estimators too")
    listing.set_defaults(handler="catalog:list_command")
    init = commands.add_parser("init", help="write a commented scenario and campaign to start from")
    init.add_argument("folder", type=Path, nargs="?", default=Path(), help="where to (default: here)")
    init.set_defaults(handler="init:init_command")
    show = commands.add_parser("show", help="print a campaign or scenario filled in, or the page of an estimator")
    show.add_argument("name", help="a name from the list, or a YAML file")
    _add_overrides(show)
    _add_embedded(show)
    show.set_defaults(handler="catalog:show_command")
    validate = commands.add_parser("validate", help="check a campaign or scenario file")
    validate.add_argument("file", help="a YAML file, or a name from the list")
    _add_overrides(validate)
    _add_embedded(validate)
    validate.set_defaults(handler="catalog:validate_command")
    schema = commands.add_parser("schema", help="print the JSON Schema, so that editors complete and check")
    schema.add_argument("kind", nargs="?", choices=["scenario", "campaign"], default="scenario")
    schema.set_defaults(handler="catalog:schema_command")


def _runs(commands: Commands) -> None:
    run = commands.add_parser("run", help="run a campaign, or continue it where it stopped")
    run.add_argument("name", help="a campaign from the list, or a YAML file")
    run.add_argument("--trials", type=_positive, help="trials of each scenario (default: what the campaign says)")
    run.add_argument(
        "--until", metavar="CONDITION",
        help='stop when every 95 %% interval is narrow enough, for example "ci(position_error_m, median) < 0.5" or'
        ' "... < 5 %%"; --trials stays the most',
    )  # fmt: skip
    run.add_argument("--jobs", type=_positive, help="worker processes (default: one for each core, or GPU)")
    run.add_argument("--seed", type=_not_negative, help="seed (default: what the campaign says)")
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
    run.add_argument("--local", type=_positive, metavar="N", help="with --backend dask: N workers of this machine")
    _add_overrides(run)
    _add_embedded(run)
    _add_fetch(run)
    _add_report(run)
    run.add_argument("--no-report", action="store_true", help="store the trials alone; boresight report tells of them")
    run.set_defaults(handler="runs:run_command")
    status = commands.add_parser("status", help="say how far a run is")
    status.add_argument("run", help="a run folder, or a campaign's name")
    status.set_defaults(handler="status:status_command")
    report = commands.add_parser("report", help="write the report of a run")
    report.add_argument("run", help="a run folder, or a campaign's name")
    _add_report(report)
    report.set_defaults(handler="report:report_command")
    board = commands.add_parser("board", help="write an index page of all runs in a folder")
    board.add_argument("folder", type=Path, nargs="?", default=RUNS, help=f"where the runs are (default: {RUNS})")
    board.set_defaults(handler="board:board_command")


def _inspect(commands: Commands) -> None:
    inspect = commands.add_parser("inspect", help="recompute single trials of a run, keep all of them and draw them")
    inspect.add_argument("run", help="a run folder, or a campaign's name")
    inspect.add_argument("--trial", type=_not_negative, nargs="+", metavar="N", help="these trials")
    inspect.add_argument(
        "--worst", type=_positive, metavar="N",
        help=f"the N worst cases (default: {WORST}): estimators that raised, then failures, then the largest errors",
    )  # fmt: skip
    inspect.add_argument("--scenario", help="of this scenario alone")
    inspect.add_argument("--estimator", help="of this estimator alone (default: all but controls such as prior)")
    inspect.add_argument("--metric", help="what --worst ranks by (default: the position error; see boresight compare)")
    inspect.add_argument(
        "--look", action="store_true",
        help="in place of cases, a page in three dimensions: the body, its landmarks by how often and how well they are"
        " recognised, and the cameras of good and bad trials",
    )  # fmt: skip
    inspect.add_argument("--out", type=Path, help="folder of the pages (default: RUN/inspect)")
    inspect.add_argument("--pdf", action="store_true", help="write the figures as PDF too")
    inspect.set_defaults(handler="inspect:inspect_command")


def _export(commands: Commands) -> None:
    export = commands.add_parser("export", help="write trajectories, landmarks or tables of a run for other programs")
    export.add_argument("run", help="a run folder, or a campaign's name")
    export.add_argument(
        "--to", required=True, choices=("tum", "colmap", "csv", "parquet", "latex"),
        help="tum: trajectories, truth and estimate; colmap: estimated poses, landmarks; csv, parquet: stored tables;"
        " latex: tables of the report",
    )  # fmt: skip
    export.add_argument("--trial", type=_not_negative, nargs="+", metavar="N", help="these trials alone")
    export.add_argument("--scenario", help="of this scenario alone")
    export.add_argument("--estimator", help="of this estimator alone")
    export.add_argument("--out", type=Path, required=True, help="folder of the files")
    export.set_defaults(handler="export:export_command")


def _compare(commands: Commands) -> None:
    compare = commands.add_parser("compare", help="compare estimators and scenarios of runs, trial by trial")
    compare.add_argument("runs", nargs="+", metavar="RUN", help="run folders, or campaigns' names")
    compare.add_argument(
        "--by", metavar="FACTOR,...",
        help="what tells the lines apart: estimator, scenario, run, or a key of the scenarios such as brdf or"
        " camera.fov_deg (default: estimator,scenario, and run where several runs have the same ones); the rest is"
        " pooled",
    )  # fmt: skip
    compare.add_argument(
        "--metric",
        help="what is compared (default: position_error_m, of sequences after the last whole revolution; of runs"
        " without poses their first number, as missed_share of crater detection; a wrong one lists all that a run has)",
    )  # fmt: skip
    compare.add_argument("--unpaired", action="store_true", help="compare runs of other seeds or views too")
    compare.add_argument("--out", type=Path, help=f"folder of the comparison (default: {COMPARISONS}/RUN-...)")
    compare.set_defaults(handler="compare:compare_command")


def _sensitivity(commands: Commands) -> None:
    own = commands.add_parser("sensitivity", help="vary keys of a campaign's scenario together, and tell what matters")
    own.add_argument("name", help="a campaign, or a YAML file")
    own.add_argument("--scenario", help="of this scenario, where the campaign has several")
    own.add_argument(
        "--over", action="append", required=True, metavar="KEY=LOW:HIGH",
        help="vary this key; KEY.max is the bound of a uniform distribution (several keys: give it again)",
    )  # fmt: skip
    own.add_argument("--method", choices=["sobol", "latin-hypercube"], default="sobol", help="design of the samples")
    own.add_argument(
        "--samples", type=_positive, default=_SAMPLES,
        help=f"size of the design (default: {_SAMPLES}; Sobol's runs K + 2 times as many scenarios for K keys)",
    )  # fmt: skip
    own.add_argument("--trials", type=_positive, default=_TRIALS, help=f"of each sample (default: {_TRIALS})")
    own.add_argument("--metric", default=None, help="as of compare (default: the position error)")
    own.add_argument("--statistic", default="median", help="over the trials: median, mean, rms, p75, p95 or p99")
    own.add_argument("--jobs", type=_positive, help="worker processes (default: one for each core, or GPU)")
    own.add_argument("--seed", type=int, help="seed (default: what the campaign says)")
    own.add_argument("--out", type=Path, help="run folder (default: runs/NAME-sensitivity-DIGEST)")
    _add_overrides(own)
    own.set_defaults(handler="sensitivity:sensitivity_command")


def _figures(commands: Commands) -> None:
    figures = commands.add_parser("figures", help="draw every figure of a paper, and set every number beside ours")
    figures.add_argument("paper", choices=(*PAPERS, ALL_PAPERS), help="which paper, or all of them")
    figures.add_argument("--runs", type=Path, default=RUNS, help="where the runs are (default: runs)")
    figures.add_argument(
        "--out", type=Path, help="folder of the figures, of all papers that of their folders (default: figures/PAPER)"
    )
    figures.add_argument("--run", action="store_true", help="first run, or finish, the campaigns that are missing")
    figures.add_argument("--trials", type=_positive, help="with --run: trials of each scenario at most")
    figures.add_argument(
        "--trials-scale", type=_share, default=1.0, metavar="SHARE",
        help="make a draft: run what is missing with this share of its trials, data bases of this share of their"
        " images, 120 at least, and arcs of this share of theirs, 24 at least",
    )  # fmt: skip
    figures.add_argument(
        "--jobs", type=_positive,
        help="worker processes of what is run or built again for a figure (default: one for each core, or GPU)",
    )  # fmt: skip
    _add_embedded(figures)
    _add_fetch(figures)
    figures.set_defaults(handler="figures:figures_command")


def _craters(commands: Commands) -> None:
    craters = commands.add_parser("craters", help="detect craters in a real image of Eros by NEAR's MSI")
    craters.add_argument("image", type=Path, nargs="?", help="label or FITS file (default: the one in BORESIGHT_DATA)")
    craters.add_argument(
        "--detector", default="crater-classic",
        help="crater-classic (default), crater-learned, or a detector of an installed package",
    )  # fmt: skip
    craters.add_argument("--out", type=Path, default=Path("figures/craters"), help="folder of figures and tables")
    craters.set_defaults(handler="craters:craters_command")


def _bench(commands: Commands) -> None:
    bench = commands.add_parser("bench", help="set our speed beside that of others, or time a campaign's stages")
    bench.add_argument(
        "name", nargs="?", default="all",
        help=f"{', '.join(PEERS)}: ratios to peers, in one run (default: all); or a campaign from the list, or a YAML"
        " file, of which every stage is timed",
    )  # fmt: skip
    bench.add_argument(
        "--blocks", type=int, default=4,
        help="blocks of trials of each scenario, windows, or rounds in turn (default: 4)",
    )  # fmt: skip
    bench.add_argument(
        "--check", action="store_true",
        help="fail where a ratio to a peer fell by more than 30 %% since it was last recorded",
    )  # fmt: skip
    bench.add_argument(
        "--record", action="store_true", help="add ratios that are new, or changed by 10 %%, to the history"
    )
    bench.add_argument(
        "--history",
        type=Path,
        metavar="FILE",
        help="ratios of earlier commits (default: boresight's own)",
    )
    bench.add_argument(
        "--blender",
        type=Path,
        metavar="PYTHON",
        help="the interpreter that has bpy (default: $BORESIGHT_BLENDER_PYTHON, or this one)",
    )
    bench.add_argument("--variant", help="Mitsuba variant (default: the fastest that works)")
    bench.add_argument("--json", type=Path, metavar="FILE", help="write the times as JSON")
    bench.add_argument("--against", type=Path, metavar="FILE", help="a JSON of before, to compare the ratios with")
    _add_overrides(bench)
    bench.set_defaults(handler="bench:bench_command")


def _fetch(commands: Commands) -> None:
    fetch = commands.add_parser("fetch", help="download the data of a paper or a campaign, or a data set")
    fetch.add_argument("name", nargs="?", help="a data set, a campaign or its YAML file, a paper, or all")
    fetch.add_argument("--list", action="store_true", help="list the data sets")
    _add_source(fetch)
    fetch.set_defaults(handler="fetch:fetch_command")


def _add_embedded(parser: argparse.ArgumentParser) -> None:
    """Add ``--embedded`` to a command."""
    parser.add_argument(
        "--embedded", action="store_true",
        help="of a campaign: take built-in bodies in place of shape files, for values without verdicts",
    )  # fmt: skip


def _add_fetch(parser: argparse.ArgumentParser) -> None:
    """Add ``--fetch`` and ``--from`` to a command."""
    parser.add_argument("--fetch", action="store_true", help="first download the data that are missing")
    _add_source(parser)


def _add_source(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--from", dest="source", metavar="SOURCE", default="",
        help="mirror of the data: a URL or a folder with the files under their paths in the data folder"
        " (default: the public repositories)",
    )  # fmt: skip


def _machine(commands: Commands) -> None:
    doctor = commands.add_parser("doctor", help="say what this machine offers and what to do about what is missing")
    doctor.set_defaults(handler="machine:doctor_command")
    store = commands.add_parser("cache", help="show the cache (bodies, data bases, images, machine code), or clear it")
    store.add_argument(
        "--clear", metavar="KIND", nargs="?", const="", help="delete everything in it, or one kind of things"
    )
    store.set_defaults(handler="machine:cache_command")


def _add_overrides(parser: argparse.ArgumentParser) -> None:
    """Add ``--set`` to a command."""
    parser.add_argument(
        "--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[],
        help="override a key of every scenario, for example --set camera.fov_deg=20",
    )  # fmt: skip


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--worst", type=_not_negative, metavar="N", default=WORST,
        help=f"pictures of the N worst trials in the report, recomputed (default: {WORST}); see boresight inspect",
    )  # fmt: skip
    parser.add_argument("--pdf", action="store_true", help="write the figures of the report as PDF too")


def _positive(text: str) -> int:
    """Read a whole number above 0 from the command line."""
    return _integer(text, 1)


def _not_negative(text: str) -> int:
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


def _share(text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.0 < share <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not above 0 and 1 at most")
    return share
