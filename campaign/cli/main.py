"""The command line: arguments and manual of every command, import of the one that is run, errors and exit codes."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tomllib
from collections.abc import Callable, Sequence
from importlib import import_module, resources
from pathlib import Path
from typing import Any, NoReturn, cast

from boresight.campaign import RUNS
from boresight.campaign.catalog import PAGES
from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.errors import BoresightError

EXIT_OK, EXIT_USER_ERROR, EXIT_IN_PART, EXIT_NOT_MET, EXIT_INTERRUPTED = 0, 2, 3, 4, 130
"""In part: an estimator raised, hung or returned nonsense in some trials, or runs that cannot be read were left out."""

ALL_PAPERS = "all"
COMPARISONS = Path("comparisons")
WORST = 5
"""How many of the worst trials are drawn by default."""

PEERS = (
    "all", "quick", "plain", "kernels", "images", "rays", "adjustment", "smoother", "methods", "craters", "combined",
    "recognition", "scaling", "size",
)  # fmt: skip
"""Works that tests/benchmarks times, against other software or a yardstick, and groups of them."""

_TRIALS, _SAMPLES = 20, 16
"""Defaults of ``sensitivity``: trials of each sample, and size of the design."""

_Argument = tuple[str, dict[str, Any]]


def _number(read: type[float], allowed: Callable[[float], bool], fault: str) -> dict[str, Any]:
    """Return the type of numbers; ``fault`` says, after its text, why one is not allowed."""

    def checked(text: str) -> float:
        try:
            value = read(text)
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"{text!r} is not a {'whole number' if read is int else 'number'}"
            ) from None
        if not allowed(value):
            raise argparse.ArgumentTypeError(f"{text} {fault}")
        return value

    return {"type": checked}


def _a(name: str, text: str | None, kind: dict[str, Any] | None = None, **how: Any) -> _Argument:
    """Describe an argument: its name, its help, the kind of its value, and what else argparse is told of it."""
    return name, {"help": text, **(kind or {}), **how}


_FLAG, _FILE = {"action": "store_true"}, {"type": Path}
_POSITIVE = _number(int, lambda value: value >= 1, "is below 1")
_NOT_NEGATIVE = _number(int, lambda value: value >= 0, "is below 0")
_SHARE = _number(float, lambda value: 0.0 < value <= 1.0, "is not above 0 and 1 at most")
_ANGLE_DEG = _number(float, lambda value: -360.0 <= value <= 360.0, "is not from -360 to 360")
_ABOVE_0 = _number(float, lambda value: 0.0 < value <= 1e6, "is not above 0 and 1e6 at most")

_EPOCH_S = _number(float, lambda value: abs(value) <= 1e11, "is not from -1e11 to 1e11")
_NAIF_ID = _number(int, lambda value: 0 < abs(value) < 2**31, "is no number of NAIF")

_RUN = _a("run", "a run folder, or a campaign's name")
_SCENARIO = _a("--scenario", "of this scenario alone")
_JOBS = _a("--jobs", "worker processes (default: one for each core, or GPU)", _POSITIVE)
_OVERRIDES = _a(
    "--set", "override a key of every scenario, for example --set camera.fov_deg=20",
    dest="overrides", metavar="KEY=VALUE", action="append", default=[],
)  # fmt: skip
_OPTION = _a(
    "--option", "option of the detector, for example --option model=moon.onnx",
    dest="options", metavar="KEY=VALUE", action="append", default=[],
)  # fmt: skip
_EMBEDDED = _a(
    "--embedded", "of a campaign: take built-in bodies in place of shape files, for values without verdicts", _FLAG
)
_SOURCE = _a(
    "--from", "mirror of the data: a URL or a folder with the files under their paths in the data folder (default: the"
    " public repositories)",
    dest="source", metavar="SOURCE", default="",
)  # fmt: skip
_FETCH = (_a("--fetch", "first download the data that are missing", _FLAG), _SOURCE)
_REPORT = (
    _a("--worst", f"pictures of the N worst trials in the report, recomputed (default: {WORST}); see boresight inspect",
       _NOT_NEGATIVE, metavar="N", default=WORST),
    _a("--pdf", "write the figures of the report as PDF too", _FLAG),
)  # fmt: skip

# fmt: off
_COMMANDS: dict[str, tuple[Any, ...]] = {
    "list": ("catalog:list_command", "list the campaigns by group, and what each misses here",
        _a("--all", "further campaigns, scenarios and estimators too", _FLAG),
    ),
    "init": ("catalog:init_command", "write a commented scenario and campaign to start from",
        _a("folder", "where to (default: here)", _FILE, nargs="?", default=Path()),
    ),
    "show": ("catalog:show_command", "print a campaign or scenario filled in, or the page of an estimator",
        _a("name", "a name from the list, or a YAML file"), _OVERRIDES, _EMBEDDED,
    ),
    "validate": ("catalog:validate_command", "check a campaign or scenario file",
        _a("file", "a YAML file, or a name from the list"), _OVERRIDES, _EMBEDDED,
    ),
    "schema": ("catalog:schema_command", "print the JSON Schema, so that editors complete and check",
        _a("kind", None, nargs="?", choices=["scenario", "campaign"], default="scenario"),
    ),
    "run": ("runs:run_command", "run campaigns, or continue them where they stopped",
        _a("names", "campaigns from the list, or YAML files", nargs="+", metavar="NAME"),
        _a("--trials", "trials of each scenario (default: what the campaign says)", _POSITIVE),
        _a("--until", 'stop when every 95 %% interval is narrow enough, for example "ci(position_error_m, median) <'
           ' 0.5" or "... < 5 %%", or when all "requirements" are decided; --trials stays the most',
           metavar="CONDITION"),
        _JOBS,
        _a("--seed", "seed (default: what the campaign says)", _NOT_NEGATIVE),
        _a("--out", "run folder of a single campaign (default: runs/NAME-DIGEST)", _FILE),
        _a("--variant", "Mitsuba variant (default: the fastest that works; see boresight doctor)"),
        _a("--keep-images", "keep every image as TIFF in the run folder", _FLAG),
        _a("--no-store", "render every image anew, and keep none in the cache", _FLAG),
        _a("--trial-limit", "stop an estimator that works longer at a trial, and store that as an error (default: no"
           " limit)", type=float, metavar="SECONDS"),
        _a("--backend", "what workers are (default: loky)", choices=("loky", "dask"), default="loky"),
        _a("--scheduler", "with --backend dask: a scheduler, such as tcp://10.0.0.1:8786", metavar="ADDRESS"),
        _a("--local", "with --backend dask: N workers of this machine", _POSITIVE, metavar="N"),
        _OVERRIDES, _EMBEDDED, *_FETCH, *_REPORT,
        _a("--no-report", "store the trials alone; boresight report tells of them", _FLAG),
    ),
    "status": ("status:status_command", "say how far a run is", _RUN),
    "report": ("report:report_command", "write the report of a run", _RUN, *_REPORT),
    "board": ("compare:board_command", "write an index page of all runs in a folder",
        _a("folder", f"where the runs are (default: {RUNS})", _FILE, nargs="?", default=RUNS),
    ),
    "inspect": ("inspect:inspect_command", "recompute single trials of a run, keep all of them and draw them",
        _RUN,
        _a("--trial", "these trials", _NOT_NEGATIVE, nargs="+", metavar="N"),
        _a("--worst", f"the N worst cases (default: {WORST}): estimators that raised, then failures, then the largest"
           " errors", _POSITIVE, metavar="N"),
        _SCENARIO,
        _a("--estimator", "of this estimator alone (default: all but controls such as prior)"),
        _a("--metric", "what --worst ranks by (default: the position error; see boresight compare)"),
        _a("--look", "in place of cases, a page in three dimensions: the body, its landmarks by how often and how well"
           " they are recognised, and the cameras of good and bad trials", _FLAG),
        _a("--out", "folder of the pages (default: RUN/inspect)", _FILE),
        _a("--pdf", "write the figures as PDF too", _FLAG),
    ),
    "export": ("inspect:export_command", "write trajectories, landmarks or tables of a run for other programs",
        _RUN,
        _a("--to", "tum: trajectories, truth and estimate; spice: the same as SPK and CK; colmap: estimated poses,"
           " landmarks; sum: estimated poses of single images; csv, parquet: stored tables; latex: tables of the"
           " report", required=True, choices=("tum", "spice", "colmap", "sum", "csv", "parquet", "latex")),
        _a("--body-id", "with --to spice: NAIF identifier of the body (default: one that no body has)", _NAIF_ID,
           metavar="ID"),
        _a("--start-et", "with --to spice: ET at the time 0 of the run, s past J2000 TDB (default: 0)", _EPOCH_S,
           metavar="SECONDS"),
        _a("--trial", "these trials alone", _NOT_NEGATIVE, nargs="+", metavar="N"),
        _SCENARIO,
        _a("--estimator", "of this estimator alone"),
        _a("--out", "folder of the files", _FILE, required=True),
    ),
    "compare": ("compare:compare_command", "compare estimators and scenarios of runs, trial by trial",
        _a("runs", "run folders, or campaigns' names", nargs="+", metavar="RUN"),
        _a("--by", "what tells the lines apart: estimator, scenario, run, or a key of the scenarios such as brdf or"
           " camera.fov_deg (default: estimator,scenario, and run where several runs have the same ones); the rest is"
           " pooled", metavar="FACTOR,..."),
        _a("--metric", "what is compared (default: position_error_m, of sequences after the last whole revolution; of"
           " runs without poses their first number, as missed_share of crater detection; a wrong one lists all that a"
           " run has)"),
        _a("--unpaired", "compare runs of other seeds or views too", _FLAG),
        _a("--out", f"folder of the comparison (default: {COMPARISONS}/RUN-...)", _FILE),
    ),
    "rare": ("compare:rare_command", "tell the rate of rare misses from trials with larger pose errors",
        _RUN,
        _a("that", "a requirement, as 'success in 99.99 %% at 90 %%' (default: those of the campaign)", nargs="?",
           metavar="REQUIREMENT"),
        _a("--law", "scenario, or its file, whose pose_error trials are weighted to (default: onboard.pose_error of"
           " those of the run)", metavar="SCENARIO"),
    ),
    "sensitivity": ("compare:sensitivity_command",
        "vary keys of a campaign's scenario together, and tell what matters",
        _a("name", "a campaign, or a YAML file"),
        _a("--scenario", "of this scenario, where the campaign has several"),
        _a("--over", "vary this key; KEY.max is the bound of a uniform distribution (several keys: give it again)",
           action="append", required=True, metavar="KEY=LOW:HIGH"),
        _a("--method", "design of the samples", choices=["sobol", "latin-hypercube"], default="sobol"),
        _a("--samples", f"size of the design (default: {_SAMPLES}; Sobol's runs K + 2 times as many scenarios for K"
           " keys)", _POSITIVE, default=_SAMPLES),
        _a("--trials", f"of each sample (default: {_TRIALS})", _POSITIVE, default=_TRIALS),
        _a("--metric", "as of compare (default: the position error)"),
        _a("--statistic", "over the trials: median, mean, rms, p75, p95 or p99", default="median"),
        _JOBS,
        _a("--seed", "seed (default: what the campaign says)", type=int),
        _a("--out", "run folder (default: runs/NAME-sensitivity-DIGEST)", _FILE),
        _OVERRIDES,
    ),
    "predict": ("predict:predict_command", "predict the covariance that a campaign will give, without images",
        _a("name", "a campaign, or a YAML file"),
        _a("--trials", "views to predict at (default: 20, or those of the run)", _POSITIVE),
        _a("--estimator", "of this estimator alone"),
        _a("--run", "a finished run of the campaign, to compare its errors with", metavar="FOLDER"),
        _a("--out", "write all predictions into this table, .csv or .json by its ending", _FILE, metavar="FILE"),
        _a("--seed", "seed (default: what the campaign says)", _NOT_NEGATIVE),
        _OVERRIDES, _EMBEDDED,
    ),
    "figures": ("figures:figures_command", "draw every figure of a paper, and compare every number with ours",
        _a("paper", "which paper, all of them, or reality: real data next to simulated ones",
           choices=(*PAGES, ALL_PAPERS)),
        _a("--runs", "where the runs are (default: runs)", _FILE, default=RUNS),
        _a("--out", "folder of the figures, of all papers that of their folders (default: figures/PAPER)", _FILE),
        _a("--run", "first run, or finish, the campaigns that are missing", _FLAG),
        _a("--trials", "with --run: trials of each scenario at most", _POSITIVE),
        _a("--trials-scale", "make a draft: run what is missing with this share of its trials, data bases of this share"
           " of their images, 120 at least, and arcs of this share of theirs, 24 at least",
           _SHARE, default=1.0, metavar="SHARE"),
        _a("--jobs", "worker processes of what is run or built again for a figure (default: one for each core, or GPU)",
           _POSITIVE),
        _EMBEDDED, *_FETCH,
    ),
    "craters": ("craters:craters_command", "detect craters in a picture, or in an image of Eros by NEAR's MSI",
        _a("image", "picture (PNG, TIFF, PGM, ...), or label or FITS file of MSI (default: the one in BORESIGHT_DATA)",
           _FILE, nargs="?"),
        _a("--sun", "of a picture: direction towards the Sun, deg from its columns' direction, clockwise as seen"
           " (default: estimated from the craters)", _ANGLE_DEG, metavar="DEG"),
        _a("--truth", "of a picture: table of labelled boxes, circles or ellipses to score the detections against",
           _FILE, metavar="TABLE"),
        _a("--columns", "names of the columns of a TABLE without a first line, as x,y,diameter", default=""),
        _a("--detector", "crater-classic (default), crater-heat-map, crater-learned, crater-onnx, or one of an"
           " installed package", default="crater-classic"),
        _OPTION,
        _a("--out", "folder of figures and tables", _FILE, default=Path("figures/craters")),
    ),
    "craters-real": ("craters:craters_real_command", "score a detector on labelled images of the Moon and Mars",
        _a("--detector", "crater-heat-map (default), crater-classic, crater-learned, crater-onnx, or one of an"
           " installed package", default="crater-heat-map"),
        _OPTION,
        _a("--set", "images of the Moon: those of the report (default), or those for choices of methods",
           choices=("report", "choices"), default="report"),
        _a("--out", "folder of the table", _FILE, default=Path("figures/craters-real")),
    ),
    "tracks": ("tracks:tracks_command", "track features through the images of a scenario, for sequences",
        _a("name", "a scenario with images, or a YAML file"),
        _a("--attitudes", "poses whose attitudes the matching is told, as label (default: images.truth)",
           metavar="NAME"),
        _a("--detector", "what finds the features (default: sift)", choices=("sift", "surf", "orb"), default="sift"),
        _a("--features", "features of an image at most, the strongest (default: 3000)", _POSITIVE, default=3000),
        _a("--angle", "match images whose boresights differ by at most DEG in body axes (default: 40)", _ANGLE_DEG,
           metavar="DEG", default=40.0),
        _a("--following", "match an image with the N after it alone (default: all within the angle)", _POSITIVE,
           metavar="N"),
        _a("--epipolar", "largest distance of a match from its epipolar line, px (default: 2)", _ABOVE_0,
           metavar="PX", default=2.0),
        _a("--out", "folder of the tables (default: sequences/SCENARIO in the data folder)", _FILE),
        _OVERRIDES,
    ),
    "bench": ("bench:bench_command", "compare our speed with other software, or time a campaign's stages",
        _a("name", f"{', '.join(PEERS)}: ratios to peers, in one run (default: all); or a campaign from the list, or a"
           " YAML file, of which every stage is timed", nargs="?", default="all"),
        _a("--blocks", "blocks of trials of each scenario, windows, or rounds in turn (default: 4)",
           type=int, default=4),
        _a("--check", "fail where a ratio to a peer fell by more than 30 %% since it was last recorded", _FLAG),
        _a("--record", "add ratios that are new, or changed by 10 %%, to the history", _FLAG),
        _a("--history", "ratios of earlier commits (default: boresight's own)", _FILE, metavar="FILE"),
        _a("--blender", "the interpreter that has bpy (default: $BORESIGHT_BLENDER_PYTHON, or this one)",
           _FILE, metavar="PYTHON"),
        _a("--variant", "Mitsuba variant (default: the fastest that works)"),
        _a("--json", "write the times as JSON", _FILE, metavar="FILE"),
        _a("--against", "a JSON of before, to compare the ratios with", _FILE, metavar="FILE"),
        _OVERRIDES,
    ),
    "fetch": ("fetch:fetch_command", "download the data of a paper or a campaign, or a data set",
        _a("name", "a data set, a campaign or its YAML file, a paper, or all", nargs="?"),
        _a("--list", "list the data sets", _FLAG),
        _SOURCE,
    ),
    "doctor": ("machine:doctor_command", "say what this machine offers and what to do about what is missing"),
    "cache": ("machine:cache_command", "show the cache (bodies, data bases, images, machine code), or clear it",
        _a("--clear", "delete everything in it, or one kind of things", metavar="KIND", nargs="?", const=""),
    ),
}
# fmt: on


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; its errors are raised as `BoresightError`."""
    parser: argparse.ArgumentParser = _Parser(
        prog="boresight", description="Monte Carlo evaluation of camera navigation around asteroids."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    pages = manual()
    parser.epilog, parser.formatter_class = pages["whole"], argparse.RawDescriptionHelpFormatter
    for name, (handler, text, *arguments) in _COMMANDS.items():
        command, page = commands.add_parser(name, help=text), pages["commands"][name]
        command.set_defaults(handler=handler)
        for argument, how in arguments:
            command.add_argument(argument, **how)
        wide = max(map(len, page["examples"]))
        lines = [f"  {example:<{wide}}   {what}" for example, what in page["examples"].items()]
        command.description, command.epilog = page["text"].strip(), "\n".join(["examples:", *lines])
        command.formatter_class = _CommandFormatter
    return parser


def manual() -> dict[str, Any]:
    """Read ``manual.toml``: the text below ``boresight --help`` (``whole``), and the page of each of ``commands``."""
    file = resources.files("boresight.campaign.cli").joinpath("manual.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


class _Parser(argparse.ArgumentParser):
    """Raises wrong arguments as an error of one line."""

    def error(self, message: str) -> NoReturn:
        raise BoresightError(f"{message}; see {self.prog} --help")


class _Version(argparse.Action):
    """Prints the version. Only here are the metadata of the installation imported and read."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        sys.stdout.write(f"boresight {version('boresight')}\n")
        parser.exit()


class _CommandFormatter(argparse.HelpFormatter):
    """Wraps the description of a command, and prints its examples as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith("examples:"):
            return "".join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    0: done; 1: an inspected trial is not the stored one, or a speed fell (bench --check); 2: bad input, said in one
    line; 3: done, but an estimator raised, hung or returned an invalid result in some trials, or runs that cannot be
    read were left out (figures, board); 4: done, but a requirement has not passed; 130: interrupted.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        if "_ARGCOMPLETE" in os.environ:
            _complete()
        parsed = make_parser().parse_args(words, argparse.Namespace(command=shlex.join(["boresight", *words])))
        return handler(parsed.handler)(parsed)
    except BoresightError as error:
        _complain(str(error))
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        _complain("interrupted; the same command continues")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return EXIT_OK
    except OSError as error:
        _complain(explain_write_error(error.filename or "standard output", error))
        return EXIT_USER_ERROR


def _complete() -> None:
    """Tell a shell with ``eval "$(register-python-argcomplete boresight)"`` how a word may end, and exit."""
    import argcomplete

    from boresight.campaign.runs.read import campaign_names
    from boresight.scenarios.load import scenario_names

    def names(prefix: str, **_: object) -> list[str]:
        return [*campaign_names(), *scenario_names(), *argcomplete.FilesCompleter()(prefix)]

    argcomplete.autocomplete(make_parser(), default_completer=names)


def handler(name: str) -> Callable[[argparse.Namespace], int]:
    """Import the function that carries out a command, named MODULE:FUNCTION within this package.

    Only the libraries of the command that is run are loaded: those of all commands take 2 s to import.
    """
    module, function = name.split(":")
    return cast(
        "Callable[[argparse.Namespace], int]", getattr(import_module(f"boresight.campaign.cli.{module}"), function)
    )


def _complain(text: str) -> None:
    for line in text.splitlines():
        print(f"boresight: {line}", file=sys.stderr)  # noqa: T201  the command line speaks
