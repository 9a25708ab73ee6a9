"""Write the pages that follow from the code: keys, options, columns, commands, estimators and Python names.

They are written below ``reference/`` and ``estimators/`` when a build begins, and are not part of the checkout.
"""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import get_args

from ruamel.yaml import YAML
from sphinx.application import Sphinx
from sphinx.domains.std import ConfigurationValue

import boresight
from boresight.campaign.cli.main import make_parser, manual
from boresight.campaign.trial.kind import kind_names
from boresight.estimators.pages import COSTS, FAMILIES, EstimatorPage, page_of
from boresight.reports.schema.column import COMMON_ROW, Column
from boresight.reports.schema.tables import TABLES, kind_schema
from boresight.scenarios import catalog
from boresight.scenarios.load.keys import Key, as_yaml, keys_of, words_of
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import CampaignSpec
from boresight.scenarios.spec.distribution import Choice, LogNormal, LogUniform, Normal, Uniform
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.vectors import Choice3, Correlated3, Correlated6, Mixture3, Normal3, Uniform3

KEY_TYPES = {"scenario-key": "key of scenarios", "campaign-key": "key of campaigns", "option-key": "option"}

PYTHON = {
    "Campaigns and runs": ("run", "read_run", "summary", "report", "compare", "Comparison", "figures"),
    "Single trials": ("render", "trial", "inspect", "Rendered", "Trial"),
    "Files and names": ("load", "show", "campaign_names", "scenario_names", "estimator_names", "BoresightError"),
    "Your own estimator of single images": ("Estimator", "Observation", "Frame", "Estimate", "Stage", "Assets"),
    "Your own estimator of sequences": (
        "SequenceEstimator", "TrackSequence", "TrackFrame", "SequenceEstimate", "FrameEstimate",
    ),
    "Bodies, cameras and images": (
        "load_body", "TriangleMesh", "Camera", "Pose", "View", "MitsubaRenderer", "Detector", "calibrate", "StarField",
    ),
}  # fmt: skip
"""Every public name of the package, in groups."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the object types of keys, and write the pages before the sources are read."""
    for name, what in KEY_TYPES.items():
        app.add_object_type(name, name, indextemplate=f"pair: %s; {what}", objname=what)
        directive = type("KeyDirective", (ConfigurationValue,), {"index_template": f"%s; {what}"})
        app.add_directive_to_domain("std", name, directive, override=True)
    app.connect("builder-inited", lambda sphinx: write_pages(Path(sphinx.srcdir)))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_pages(folder: Path) -> None:
    """Write all pages below ``folder``; remove those of names that are gone, and leave unchanged files alone."""
    pages = dict(_pages())
    for place in ("estimators", "reference"):
        for old in (folder / place).rglob("*.md"):
            if old.relative_to(folder).as_posix() not in pages:
                old.unlink()
    for name, text in pages.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def _pages() -> Iterator[tuple[str, str]]:
    """Yield the path and the text of every page."""
    yield "reference/index.md", _lines("# Reference", _toctree([
        "scenario-keys", "campaign-keys", "estimator-options", "columns", "command-line", "python",
    ]))  # fmt: skip
    yield (
        "reference/scenario-keys.md",
        _lines(
            "# Keys of scenario files",
            words_of(ScenarioSpec),
            "A file writes keys in sections; `--set` and `set` of a campaign may use dots: `camera.fov_deg=20`."
            " An unknown key is an error. `boresight show NAME` prints a scenario with every default filled in.",
            "A file with `extends: NAME` starts from another scenario: a file or a name from `boresight list`."
            " `NAME` may be a list; later ones override earlier ones.",
            *_keys(ScenarioSpec, "scenario-key"),
            "## Distributions",
            "A key whose type is a distribution takes a number, which is a constant, or one of these:",
            "\n".join(f"- {words_of(law)}" for law in (Uniform, Normal, LogUniform, LogNormal, Choice)),
            "Those of pose errors have three components, or six with one covariance:",
            "\n".join(f"- {words_of(law)}" for law in (Uniform3, Normal3, Correlated3, Choice3, Mixture3, Correlated6)),
        ),
    )
    yield (
        "reference/campaign-keys.md",
        _lines(
            "# Keys of campaign files",
            "A campaign runs every estimator on every scenario, with the same trials from one seed.",
            "As in scenario files, an unknown key is an error, and `extends: NAME` starts from another campaign.",
            *_keys(CampaignSpec, "campaign-key"),
            "## Kinds of trial",
            f"The values of `experiment` are {_listed(kind_names())}.",
        ),
    )
    yield "reference/columns.md", _columns()
    yield "reference/command-line.md", _command_line()
    yield from _python()
    yield from _estimators()


def _lines(*blocks: str) -> str:
    return "\n\n".join(filter(None, blocks)) + "\n"


def _toctree(names: Sequence[str], *options: str) -> str:
    return "\n".join(["```{toctree}", ":maxdepth: 1", *options, "", *names, "```"])


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _keys(model: type[SpecModel], kind: str, prefix: str = "") -> Iterator[str]:
    """Yield the keys of a model and, under headings, of its sections; a model that was described is linked."""
    described: dict[type[SpecModel], str] = {}

    def section(model: type[SpecModel], path: str, level: int, suffix: str = "") -> Iterator[str]:
        keys = [key for key in keys_of(model) if not (suffix and key.name == "kind")]
        for key in keys:
            yield _key(key, path, kind, prefix, suffix)
        for key in keys:
            yield from below(key, f"{path}{key.name}", level)

    def below(key: Key, path: str, level: int) -> Iterator[str]:
        several, mark = len(key.sections) > 1, "#" * min(level, 5)
        known = [one for one in key.sections if one in described]
        if known:
            first = described[known[0]]
            yield f"{mark} `{path}`"
            yield f"Has the keys of [`{first}`](#{_anchor(kind, prefix, first)})."
            return
        if key.sections:
            yield f"({_anchor(kind, prefix, path)})=\n{mark} `{path}`"
            yield f"{key.meaning}." if several else ""
        for one in key.sections:
            described[one] = path
            law = get_args(one.model_fields["kind"].annotation)[0] if several and "kind" in one.model_fields else ""
            yield f"{mark}# `{path}` with `kind: {law}`" if law else ""
            yield words_of(one)
            named = "NAME." if key.type == "section of names" else ""
            yield from section(one, f"{path}.{named}", level + 1 + bool(law), law)

    return section(model, "", 2)


def _anchor(kind: str, prefix: str, path: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", f"{kind}-section-{prefix}{path}".lower()).strip("-")


@cache
def _examples() -> Mapping[str, tuple[object, str]]:
    """Return for each dotted key of scenarios a value, with the scenario of the catalogue that it is from."""
    found: dict[str, tuple[object, str]] = {}

    def collect(content: Mapping[str, object], path: str, file: str) -> None:
        for key, value in content.items():
            if value is not None:
                found.setdefault(f"{path}{key}", (value, file))
            if isinstance(value, Mapping):
                collect(value, f"{path}{key}.", file)

    for file in sorted(Path(catalog.__file__).parent.glob("*.yaml")):
        collect(YAML(typ="safe").load(file), "", file.stem)
    return found


def _example(key: Key, dotted: str) -> str:
    """Write an example of a key whose default is no value."""
    if key.sections or key.default not in (None, "left out") or dotted not in _examples():
        return ""
    value, file = _examples()[dotted]
    return f"Example: `{key.name}: {as_yaml(value)}` (`{file}`)."


def _key(key: Key, path: str, kind: str, prefix: str, suffix: str) -> str:
    """Write one key: its name, type, unit and default, its meaning and, of scenarios, an example."""
    name = f"{prefix}{path}{key.name}" + (f" ({suffix})" if suffix else "")
    default = "required" if key.default is None else f"default `{key.default}`"
    if key.default in ("left out", "the name of the file", "the defaults of its keys"):
        default = f"default: {key.default}"
    facts = ", ".join(filter(None, (_escaped(key.type), key.unit)))
    head = f"```{{{kind}}} {name}\n:no-contents-entry:\n"
    example = _example(key, f"{path}{key.name}") if kind == "scenario-key" and not suffix else ""
    told = f"{key.meaning}. {example}".strip()
    return f"{head}\n{{.key-facts}}\n{facts} · {default}\n\n{told}\n```"


def _escaped(text: str) -> str:
    """Write text so that Markdown shows it as it is."""
    return re.sub(r"([\[\]{}*_<>|])", r"\\\1", text)


def _columns() -> str:
    told = [
        "# Columns of stored tables",
        "A run folder holds these tables as Parquet files, which store the meanings too."
        " `boresight export RUN --to csv --out DIR` writes them as CSV; `boresight.read_run` reads a run.",
        "## `rows`: one row for each trial and estimator",
        _column_table(COMMON_ROW),
    ]
    for kind in kind_names():
        told += [f"### Further columns of `rows` of kind `{kind}`", _column_table(kind_schema(kind).row)]
    for name, columns in TABLES.items():
        if name != "rows":
            told += [f"## `{name}`", _column_table(columns)]
    return _lines(*told)


def _column_table(columns: Sequence[Column]) -> str:
    if not columns:
        return "None."
    lines = ["| column | type | unit | meaning |", "|---|---|---|---|"]
    for one in columns:
        lines.append(f"| `{one.name}` | {one.type} | {one.stored_unit} | {_escaped(one.meaning)} |")
    return "\n".join(lines)


def _command_line() -> str:
    parser = make_parser()
    (commands,) = (one for one in parser._actions if isinstance(one, argparse._SubParsersAction))
    pages = manual()
    told = ["# Command line", *_whole(pages["whole"])]
    for name, command in commands.choices.items():
        page = pages["commands"][name]
        usage = command.format_usage().removeprefix("usage: ").strip()
        told += [
            f"## `boresight {name}`",
            page["text"].strip(),
            f"```text\n{usage}\n```",
            f"```{{program}} boresight {name}\n```",
        ]
        told += [_argument(one) for one in command._actions if one.dest != "help"]
        told += ["Examples:"]
        told += [f"```console\n$ {example}\n```\n{{.example}}\n{what}." for example, what in page["examples"].items()]
    return _lines(*told)


def _whole(text: str) -> Iterator[str]:
    """Yield the text below ``boresight --help``: a list under the heading of each group of lines."""
    for group in text.strip().split("\n\n"):
        heading, *lines = group.splitlines()
        yield f"## {heading.removesuffix(':').capitalize()}"
        rows: list[list[str]] = []
        for line in lines:
            parts = re.split(r" {2,}", line.strip(), maxsplit=1)
            if len(parts) == 2:
                rows.append(parts)
            else:
                # A line of one column continues the one before.
                rows[-1][1] += f" {parts[0]}"
        yield "\n\n".join(f"`{one}`\n: {_escaped(other)}" for one, other in rows)


def _argument(action: argparse.Action) -> str:
    """Write one argument of a command as an object that can be linked."""
    shown = action.metavar or ("" if action.nargs == 0 else action.dest.upper())
    shown = "{" + ",".join(map(str, action.choices)) + "}" if action.choices else str(shown)
    name = f"{', '.join(action.option_strings)} {shown}".strip() if action.option_strings else shown
    told = _escaped((action.help or "").replace("%%", "%"))
    return f"```{{option}} {name}\n{told}.\n```"


def _python() -> Iterator[tuple[str, str]]:
    missing = set(dir(boresight)) ^ {name for names in PYTHON.values() for name in names}
    if missing:
        raise ValueError(f"docs/_ext/generated.py: PYTHON and the names of the package differ by {sorted(missing)}")
    told = ["# Python", (boresight.__doc__ or "").split("\n\n")[0]]
    for group, names in PYTHON.items():
        lines = [f"| [`{name}`](python/{name}.md) | {_summary(name)} |" for name in names]
        told += [f"## {group}", "\n".join(["| name | what it is |", "|---|---|", *lines])]
        for name in names:
            yield f"reference/python/{name}.md", _lines(f"# `boresight.{name}`", _documented(name))
    every = [f"python/{name}" for names in PYTHON.values() for name in names]
    yield "reference/python.md", _lines(*told, _toctree(every, ":hidden:"))


def _summary(name: str) -> str:
    return _escaped((inspect.getdoc(getattr(boresight, name)) or "").split("\n\n")[0].replace("\n", " "))


def _documented(name: str) -> str:
    found = getattr(boresight, name)
    lines = [f".. autoclass:: boresight.{name}", "   :members:", "   :member-order: bysource"]
    if not inspect.isclass(found):
        lines = [f".. autofunction:: boresight.{name}"]
    return "\n".join(["```{eval-rst}", *lines, "```"])


def _estimators() -> Iterator[tuple[str, str]]:
    told = ["# Estimators", "`boresight show NAME` prints the page of an estimator in short."]
    options = ["# Options of estimators", "A campaign writes options after the name of the estimator:"]
    options += ["```yaml\nestimators:\n  - prior\n  - landmark-ransac: {log_evidence_min: 3}\n```"]
    for family, registry in FAMILIES.items():
        pages = [page_of(name) for name in registry.own]
        told += [f"## {family}", _table(("estimator", "what it does"), {_link(one): one.summary for one in pages})]
        told += [_toctree([one.name for one in pages], ":hidden:", f":caption: {family}")]
        links = {_link(one, "../estimators/"): _option_names(one) for one in pages}
        options += [f"## {family}", _table(("estimator", "options"), links)]
        for one in pages:
            yield f"estimators/{one.name}.md", _estimator(one)
    yield "estimators/index.md", _lines(*told)
    yield "reference/estimator-options.md", _lines(*options)


def _table(heads: tuple[str, str], cells: Mapping[str, str]) -> str:
    return "\n".join([f"| {' | '.join(heads)} |", "|---|---|", *(f"| {one} | {two} |" for one, two in cells.items())])


def _link(page: EstimatorPage, folder: str = "") -> str:
    return f"[`{page.name}`]({folder}{page.name}.md)"


def _option_names(page: EstimatorPage) -> str:
    return _listed([key.name for model in page.options for key in keys_of(model)])


def _estimator(page: EstimatorPage) -> str:
    told = [f"# `{page.name}`", page.summary, page.text]
    for heading, text in page.sections.items():
        told += [f"## {heading}", text, COSTS if heading == "Cost" and text != "None." else ""]
    keys = [line for model in page.options for line in _keys(model, "option-key", f"{page.name}: ")]
    return _lines(*told, "## Options", *(keys or ["None."]), f"Version {page.version}.")
