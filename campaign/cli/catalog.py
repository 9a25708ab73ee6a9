"""``list``, ``init``, ``show``, ``validate``, ``schema``: what campaigns and scenarios there are, and their files."""

from __future__ import annotations

import argparse
import difflib
import json
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from fnmatch import fnmatch
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from boresight.campaign.catalog import PAPERS
from boresight.campaign.cli.terminal import console
from boresight.campaign.machine import cores
from boresight.campaign.runs.read import CATALOG, CampaignFiles, campaign_names, is_campaign, read_campaign
from boresight.campaign.trial.kind import kind_names
from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.errors import BoresightError, display, printable
from boresight.scenarios.load import (
    LoadedCampaign,
    LoadedScenario,
    canonical_json,
    dump_yaml,
    json_schema,
    load_campaign,
    load_scenario,
    scenario_names,
)
from boresight.scenarios.load.keys import keys_of
from boresight.scenarios.load.yaml_text import shortened
from boresight.scenarios.spec.body import without_detail
from boresight.scenarios.spec.campaign import grid_cells
from boresight.scenarios.spec.scenario import ScenarioSpec

if TYPE_CHECKING:
    from boresight.estimators.pages import EstimatorPage
    from boresight.scenarios.bodies import Body

_GROUPS = (
    ("start here", ("quickstart", "*-smoke")),
    ("real data", ("*-real", "*-navcam67p")),
    ("missions", ("osiris-rex-*", "dawn-*", "dart-*", "hayabusa2-*", "near-*")),
    ("sensitivity", ("*-sensitivity*", "knowledge-*", "photometric-*")),
    ("the papers", tuple(f"{paper}-*" for paper in PAPERS)),
    ("requirements", ("required-*",)),
    ("compare", ("trade-*", "compare-*", "partial-*", "approach-*")),
)
"""Headings of ``list`` with the names below them, in their order; a campaign belongs to the first that fits."""

_SHOWN = ("start here", "missions", "requirements", "the papers", "compare", "sensitivity", "real data")
_FURTHER = "further campaigns"
_GAP = "  "

_WIDEST = 100
"""Characters of a line at most, however wide the terminal is."""

FILES = ("scenario.yaml", "campaign.yaml")
"""What ``init`` writes."""


def list_command(arguments: argparse.Namespace) -> int:
    """List campaigns by group, a line each; with ``--all`` the rest, scenarios and estimators."""
    # Imported here: they read what is installed, which no other command of this file does.
    from boresight.estimators.registry import estimator_names, sequence_estimator_names

    out, groups, known = console(), _grouped(), {name: load_scenario(name) for name in scenario_names()}
    shown = (*_SHOWN, _FURTHER) if arguments.all else _SHOWN
    rows = [(heading, [_row(load_campaign(name, CATALOG), known) for name in groups[heading]]) for heading in shown]
    widths = [max(len(row[k]) for _, own in rows for row in own) for k in range(4)]
    for heading, own in rows:
        out.print(Text(heading, style="bold"))
        for row in own:
            _print_row(out, row, widths)
    out.print(
        f"\nname, trials of each scenario x scenarios, time on {cores()} core(s) by the last run here, what is missing."
        "\nmissing: data: boresight fetch NAME, or run NAME --embedded; images: boresight fetch NAME brings them, or"
        ' says where they are; gtsam: pip install -e ".[gtsam]".',
        soft_wrap=True,
        highlight=False,
    )
    if not arguments.all:
        out.print("further campaigns, scenarios and estimators: boresight list --all")
        return 0
    out.print(Text("\nscenarios", style="bold"))
    for name, scenario in known.items():
        _print_row(out, (name, scenario.spec.description), [max(map(len, known))])
    out.print(f"\nestimators: {', '.join(estimator_names())}")
    out.print(f"estimators of sequences: {', '.join(sequence_estimator_names())}")
    return 0


def _grouped() -> dict[str, list[str]]:
    """Return the names of the catalogue's campaigns by heading."""
    groups: dict[str, list[str]] = {heading: [] for heading in (*_SHOWN, _FURTHER)}
    left = campaign_names()
    for heading, patterns in _GROUPS:
        for pattern in patterns:
            groups[heading] += [name for name in left if fnmatch(name, pattern)]
            left = [name for name in left if not fnmatch(name, pattern)]
    return {**groups, _FURTHER: left}


def _row(loaded: LoadedCampaign, known: Mapping[str, LoadedScenario]) -> tuple[str, ...]:
    """Describe a campaign: name, size, cost here, what is missing in one word, title."""
    from boresight.campaign.runs.read import core_seconds, in_words, needs

    spec, core_s = loaded.spec, core_seconds(loaded.spec.name)
    scenarios = len(spec.scenarios) * (1 if spec.grid is None else len(grid_cells(spec.grid)))
    size = f"{spec.trials}" if scenarios == 1 else f"{spec.trials} x {scenarios}"
    time = "-" if core_s is None else in_words(core_s * spec.trials * scenarios / cores())
    missing = {need.word for need in needs(loaded, known) if not need.found}
    word = next((one for one in ("images", "data") if one in missing), ", ".join(sorted(missing)) or "-")
    return spec.name, size, time, word, spec.title


def _print_row(out: Console, row: Sequence[str], widths: Sequence[int]) -> None:
    """Print a line of columns; a terminal cuts it at its width, a pager or a program gets it whole."""
    cells = [*(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=False)), *row[len(widths) :]]
    line = printable(_GAP.join(cells))
    if out.is_terminal and len(line) > out.width:
        line = f"{line[: out.width - 3]}..."
    out.print(line, soft_wrap=True, highlight=False, markup=False)


def init_command(arguments: argparse.Namespace) -> int:
    """Write both files into a folder, which is made if it is missing; a file that is there is never changed."""
    folder: Path = arguments.folder
    texts = {
        folder / name: resources.files(__package__ or "").joinpath(f"init_{name}").read_text(encoding="utf-8")
        for name in FILES
    }
    present = [display(file) for file in texts if file.exists() or file.is_symlink()]
    if present:
        raise BoresightError(f"{present[0]}: is there already, and init changes no file: choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in texts.items():
            # Fails, instead of writing over it, if another program made the file in the meantime.
            with file.open("x", encoding="utf-8") as stream:
                stream.write(text)
    except OSError as error:
        reason = explain_write_error(error.filename or folder, error)
        raise BoresightError(reason.removesuffix(" with --out")) from error
    scenario, campaign = map(display, texts)
    console().print(f"{scenario}: a body, a camera, the errors\n{campaign}: estimators on trials of it")
    console().print(f"next: {shlex.join(['boresight', 'run', campaign])}")
    return 0


def show_command(arguments: argparse.Namespace) -> int:
    """Print a campaign or a scenario as YAML, every default filled in, with a preview; or the page of an estimator."""
    name = arguments.name
    if _is_estimator(name):
        if arguments.overrides:
            raise BoresightError(f"--set changes scenarios and campaigns, and {name} is an estimator: remove it")
        print_page(name)
        return 0
    if is_campaign(name):
        read: CampaignFiles | LoadedScenario = read_campaign(name, arguments.overrides, embedded=arguments.embedded)
    else:
        read = load_scenario(name, arguments.overrides)
    console().print(as_yaml(read), end="", highlight=False)
    for line in _previewed(read):
        console().print(f"# {line}", highlight=False, markup=False)
    return 0


def _previewed(read: CampaignFiles | LoadedScenario) -> list[str]:
    """Describe the images and the lengths that are left out; why not where the data are missing or wrong."""
    try:
        if isinstance(read, LoadedScenario):
            from boresight.campaign.imaging.preview import preview

            return [f"{read.spec.name}: {line}" for line in preview(read, detailed=False)]
        # Imported here: it loads kinds of trial and estimators, 1.5 s, which scenarios do without.
        from boresight.campaign.runs.check import preflight

        return preflight(read.scenarios, read.loaded.spec, detailed=False)
    except BoresightError as error:
        return [f"no preview: {printable(str(error))}"]


def _is_estimator(name: str) -> bool:
    """Return whether a name is that of an estimator of any kind.

    Raise BoresightError if there is nothing of that name, and an estimator has the most similar one.
    """
    files = {*campaign_names(), *scenario_names()}
    if name in files or Path(name).suffix in (".yaml", ".yml"):
        return False
    from boresight.estimators.pages import FAMILIES

    estimators = {one for registry in FAMILIES.values() for one in registry.names()}
    near = difflib.get_close_matches(name, files | estimators, n=1)
    if name in estimators or ":" in name:
        return True
    if near and near[0] in estimators and not Path(name).exists():
        raise BoresightError(f"{shortened(name)}: no such campaign, scenario or estimator; did you mean {near[0]}?")
    return False


def as_yaml(read: CampaignFiles | LoadedScenario) -> str:
    """Write a campaign or a scenario as YAML, every default filled in."""
    if isinstance(read, CampaignFiles):
        shown = {
            "campaign": json.loads(canonical_json(read.loaded.spec)),
            "scenarios": [_in_a_file(s.spec) for s in read.scenarios],
        }
    else:
        shown = {"scenario": _in_a_file(read.spec)}
    return dump_yaml(shown)


def _in_a_file(spec: ScenarioSpec) -> dict[str, Any]:
    """Return a scenario as a file may have it: without the states that are read from its trajectory's source."""
    plain: dict[str, Any] = json.loads(canonical_json(spec))
    for section in ("viewpoint", "sequence"):
        ((plain.get(section) or {}).get("trajectory") or {}).pop("read_states", None)
    return plain


def validate_command(arguments: argparse.Namespace) -> int:
    """Check a campaign or a scenario file as a run does before anything is built."""
    # Imported here: they load kinds of trial and estimators, 1.5 s, which the other commands do without.
    from boresight.campaign.runs.check import check_campaign, check_scenario, preflight
    from boresight.campaign.runs.resolve import resolve

    # Shapes and bodies are held until the end, so that each file is read once.
    if is_campaign(arguments.file):
        campaign = resolve(arguments.file, arguments.overrides, embedded=arguments.embedded)
        told, _shapes = _tell_memory(campaign.scenarios)
        _bodies = check_campaign(campaign, campaign.spec.trials)
        lines = preflight(campaign.scenarios, campaign.spec)
        what = f"a campaign of {len(campaign.scenarios)} scenario(s) and {len(campaign.labels)} estimator(s)"
    else:
        scenario = load_scenario(arguments.file, arguments.overrides)
        told, _shapes = _tell_memory((scenario,))
        _checked = check_scenario(scenario)
        lines = preflight((scenario,))
        what = f"the scenario {scenario.spec.name}"
    console().print(f"{arguments.file}: ok, {what}")
    for line in lines:
        if line not in told:
            console().print(line)
    return 0


def _tell_memory(scenarios: Sequence[LoadedScenario]) -> tuple[set[str], list[Body]]:
    """Print the size of large bodies before they are made; checks report what is wrong.

    Return the lines, and the shapes without detail: as long as a caller holds them, their files are not read again.
    """
    from boresight.campaign.imaging.preview import memory_in_words
    from boresight.scenarios.bodies import load_body

    told: dict[str, str] = {}  # to the name of the first scenario
    held: list[Body] = []
    for scenario in scenarios:
        with suppress(BoresightError):
            held += [load_body(without_detail(body), scenario.search_dirs) for body in scenario.spec.bodies]
            for line in memory_in_words(scenario):
                told.setdefault(line, f"{scenario.spec.name}: {line}")
    for line in told.values():
        console().print(line)
    return set(told.values()), held


def schema_command(arguments: argparse.Namespace) -> int:
    """Print the JSON Schema of scenario or campaign files."""
    schema = json_schema(arguments.kind)
    if arguments.kind == "campaign":
        # The models of files are in `scenarios`, which does not import the kinds of trial.
        for definition in schema["$defs"].values():
            if "experiment" in definition.get("properties", {}):
                definition["properties"]["experiment"]["enum"] = kind_names()
    console().print(json.dumps(schema, indent=1), highlight=False)
    return 0


def print_page(name: str) -> None:
    """Print what an estimator does, when to use it, when it fails, its cost, source and options."""
    # Imported here: the other commands do without estimators.
    from boresight.estimators.pages import COSTS, page_of

    page, out = page_of(name), console()
    width = min(out.width, _WIDEST)
    out.print(Text(f"{page.name}, version {page.version}", style="bold"))
    for paragraph in (page.summary, *filter(None, page.text.split("\n\n"))):
        out.print("\n" + _filled(paragraph, width))
    for heading, text in page.sections.items():
        out.print(Text(f"\n{heading}", style="bold"))
        out.print(_filled(f"{text} {COSTS}" if heading == "Cost" and text != "None." else text, width, "  ", "  "))
    out.print(Text("\nOptions", style="bold"))
    for line in _option_lines(page):
        out.print(_filled(line, width, "  ", "      "))


def _filled(text: str, width: int, first: str = "", others: str = "") -> str:
    """Wrap text without the marks of literals."""
    told = text.replace("`", "")
    return textwrap.fill(told, width, initial_indent=first, subsequent_indent=others, break_on_hyphens=False)


def _option_lines(page: EstimatorPage) -> Iterator[str]:
    """Yield a line for each option; the keys of its sections are in the documentation."""
    keys = [key for model in page.options for key in keys_of(model)]
    for key in keys:
        default = "required" if key.default is None else f"default: {key.default}"
        yield f"{key.name}: {key.meaning} ({', '.join(filter(None, (key.type, key.unit, default)))})"
    if not keys:
        yield "None."
