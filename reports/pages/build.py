"""Write the report of a run (page, Markdown, CSV, figures), each file whole or not at all, and the board of runs."""

from __future__ import annotations

import base64
import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from urllib.parse import quote

import cv2
from markupsafe import Markup

from boresight.reports.figures.named import NamedFigure, add_provenance, with_trial_counts
from boresight.reports.figures.style import report_styles, save_figure
from boresight.reports.kinds import Content, brief_grids, report_figures, report_grids, told_grids
from boresight.reports.kinds.maps import ERROR_MAP
from boresight.reports.kinds.ranges import OVER_RANGE
from boresight.reports.kinds.requirements import judged
from boresight.reports.kinds.tornado import TORNADO
from boresight.reports.pages.content import (
    content_of,
    covariance_line,
    estimator_results,
    headline,
    read_content,
    verdict_counts,
)
from boresight.reports.pages.document import Document, embed_figures, fill_template, template_text, write_document
from boresight.reports.run.data import RunData, read_run
from boresight.reports.run.limits import database_line, known_lines, single_draws
from boresight.reports.schema.grid import NO_VALUE, Grid, number
from boresight.reports.schema.records import count_of
from boresight.reports.tables import interval
from boresight.scenarios.errors import BoresightError

LEAD = "typical"
"""Stem of the figure at the top of a page: a trial in the middle of all."""
_MOST_TORNADOS = 3
"""Tornados that follow the table of requirements; the others are with the other figures."""
_ROWS_BEFORE_LEAD = 8
"""Rows of the table before it at most."""
_HEADS = ("run", "title", "started", "trials", "measure", "estimator", "ok", "median [95 %]", "prior", "verdicts")
_NOTE = (
    "Medians over all scenarios of a run, with their 95 % intervals, of the trials that have a value (ok: of all);"
    " prior: the median of the same error of the priors."
)
_THUMB_PX = 200
_BLOCK = 200_000
_MOST_SCENARIOS = 12  # whose keys stand on a page
"""Records that are written at a time, to bound the memory."""


def html_page(content: Content, figures: Sequence[tuple[NamedFigure, bytes]]) -> str:
    """Fill the page's template: what was asked and what came out first, how and from what last.

    Each figure has its PNG, which is embedded. After the card come the verdicts on requirements, or else the first
    table of the kind of trial, if that is short, and after it the figures of `_leads`.
    """
    run, manifest = content.run, content.run.manifest
    card = list(_card(content))
    said = {text for _, text in card}
    grids = [_on_page(grid, run) for grid in report_grids(content)]
    top = [replace(_on_page(grid, run), note="") for grid in brief_grids(content)]
    same = {(grid.columns, grid.rows): grid for grid in grids}
    brief = [same.get((grid.columns, grid.rows), grid) for grid in top]
    short = {grid.title for grid in brief}
    full = [grid for grid in grids if grid not in brief]
    full = [replace(grid, title=f"{grid.title}, in full") if grid.title in short else grid for grid in full]
    shown = list(_noted_once([*brief, *full]))
    own = brief[: len(brief) - len(told_grids(content))][:1]
    first = sum(1 for grid in own if manifest.requirements or len(grid.rows) <= _ROWS_BEFORE_LEAD)
    leads = _leads([figure for figure, _ in figures])
    embedded = dict(embed_figures(figures))
    return fill_template(
        "page.html",
        manifest=manifest,
        progress=run.progress(),
        card=card,
        brief=shown[:first],
        leads=[(one, embedded.pop(one)) for one in leads],
        facts=_facts(content),
        notes=[note for note in content.notes if note not in said],
        js=template_text("page.js"),
        grids=shown[first:],
        figures=list(embedded.items()),
        resolved={
            "scenarios": _resolved(manifest.scenarios),
            "estimators": json.dumps(manifest.estimators, indent=2, ensure_ascii=False),
        },
        command=reproduce_command(content),
    )


def _resolved(scenarios: Mapping[str, object]) -> str:
    few = dict(islice(scenarios.items(), _MOST_SCENARIOS))
    left = len(scenarios) - len(few)
    more = f"\n{count_of(left, 'further scenario')}: manifest.json of the run" if left else ""
    return json.dumps(few, indent=2, ensure_ascii=False) + more


def _leads(figures: Sequence[NamedFigure]) -> list[NamedFigure]:
    """Choose the figures after the first table; else the first of all.

    They are tornados, maps of errors, the first of errors over range, and `LEAD`.
    """
    moved = [one for one in figures if one.stem.startswith(TORNADO)][:_MOST_TORNADOS]
    over_range = [one for one in figures if one.stem.startswith(OVER_RANGE)][:1]
    maps = [one for one in figures if one.stem.startswith(ERROR_MAP)]
    return [*moved, *maps, *over_range, *(one for one in figures if one.stem == LEAD)] or list(figures[:1])


def _card(content: Content) -> Iterator[tuple[str, str]]:
    """Yield what was asked and required, what came out, what the spacecraft knew, and how much was run."""
    run = content.run
    done, total = run.progress()
    trials = f"{done} of {total}" if done < total else f"{total:,}"
    yield from [("Asked", run.manifest.description)] if run.manifest.description else []
    verdicts: dict[str, Counter[str]] = {}
    for one in judged(run):
        verdicts.setdefault(one.requirement.in_words(), Counter())[one.verdict.verdict] += 1
    for words, counted in verdicts.items():
        yield "Required", f"{words}: {', '.join(f'{n} {verdict}' for verdict, n in sorted(counted.items()))}"
    yield from [("Result", result)] if (result := headline(run)) else []
    yield from [("Covariances", line)] if (line := covariance_line(run)) else []
    yield from (("On board", line) for line in known_lines(run))
    yield "Trials", trials
    yield from [("Intervals", database_line(run))] if database_line(run) else []
    published = verdict_counts(content)
    yield from [("Published values", published)] if published else []


def _noted_once(grids: Iterable[Grid]) -> Iterator[Grid]:
    """Leave out notes that an earlier table has."""
    said: set[str] = set()
    for grid in grids:
        yield replace(grid, note="") if grid.note in said else grid
        said.add(grid.note)


def _on_page(grid: Grid, run: RunData) -> Grid:
    """Leave out of a table what the top of the page says of all: limits of intervals, knowledge, the only scenario."""
    limits = single_draws(run)
    grid = replace(grid, title=grid.title.removesuffix(f", of {limits}") if limits else grid.title, known="")
    kept = [name for name in grid.columns if name != "scenario"]
    return grid.keep(*kept) if len(run.manifest.scenarios) == 1 and len(kept) < len(grid.columns) else grid


def reproduce_command(content: Content) -> str:
    """Write the command line that makes this run again."""
    manifest = content.run.manifest
    return manifest.command or f"boresight run {manifest.name} --trials {manifest.trials} --seed {manifest.seed}"


def _facts(content: Content) -> list[tuple[str, str]]:
    """List campaign, seed, date, commit, machine and versions of a run."""
    manifest = content.run.manifest
    facts = [
        ("Campaign", manifest.name),
        ("Seed", str(manifest.seed)),
        ("Created", manifest.created),
        ("Commit", manifest.commit),
        ("Machine", _listed(manifest.machine)),
        ("Versions", _listed(manifest.versions)),
    ]
    return [(name, value) for name, value in facts if value]


def _listed(mapping: Mapping[str, object]) -> str:
    """Write a mapping on one line, without empty values."""
    said = {name: value for name, value in mapping.items() if value not in ("", None)}
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in said.items())


@dataclass(frozen=True, slots=True, eq=False)
class ReportFiles:
    """Paths of a written report, and its content, for the tables of the terminal.

    ``tables`` are ``table.csv`` (every measured number beside the published one), ``timings.csv`` and ``failures.csv``;
    ``figures`` are PNG, and PDF on request.
    """

    folder: Path
    html: Path
    markdown: Path
    tables: tuple[Path, ...]
    figures: tuple[Path, ...]
    content: Content


def write_report(
    run: Path, out: Path | None = None, extra: Iterable[NamedFigure] = (), pdf: bool = False
) -> ReportFiles:
    """Write the report of a run folder, into ``run/report`` by default; other files there are left alone.

    An unfinished run is reported as such. ``extra`` are further figures, shown after those of the tables (such as
    `reports.figures.draw_fit_panels`), and drawn when it is known that the run can be read. With ``pdf`` figures are
    written as PDF too.

    Raises `BoresightError` if the run cannot be read or the report cannot be written; files of an earlier report then
    stay as they were.
    """
    content, further = read_content(run), list(extra)
    folder = out or run / "report"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".writing-", dir=folder, ignore_cleanup_errors=True) as work:
            with report_styles(map(str, content.run.manifest.estimators)):
                names = _write_all(content, Path(work), further, ("png", "pdf") if pdf else ("png",))
            for name in names:
                (Path(work) / name).replace(folder / name)
                if name.endswith(".png") and not pdf:  # one of an earlier report would show other numbers
                    (folder / name).with_suffix(".pdf").unlink(missing_ok=True)
    except OSError as error:
        raise BoresightError(
            f"{folder}: the report cannot be written: {error.strerror}; choose another --out"
        ) from error
    paths = [folder / name for name in names]
    return ReportFiles(
        folder,
        folder / "report.html",
        folder / "report.md",
        tuple(path for path in paths if path.suffix == ".csv"),
        tuple(path for path in paths if path.suffix in (".png", ".pdf")),
        content,
    )


def _write_all(content: Content, folder: Path, extra: Sequence[NamedFigure], kinds: Sequence[str]) -> list[str]:
    """Write all files into ``folder`` and list their names; the page is last, so that it never shows missing files."""
    rows = content.run.rows
    failures = rows.loc[rows["status"] != "ok", ["trial", "scenario", "estimator", "status", "reason"]]
    failures.to_csv(folder / "failures.csv", index=False, lineterminator="\n")
    for first in range(0, max(len(content.records), 1), _BLOCK):
        table = content.table(content.records[first : first + _BLOCK])
        timed = table["measure"] == "seconds"
        for name, frame in (("table.csv", table[~timed]), ("timings.csv", table[timed])):
            frame.to_csv(folder / name, mode="a", header=first == 0, index=False, lineterminator="\n")
    names = ["table.csv", "timings.csv", "failures.csv"]
    figures = [*(with_trial_counts(figure, [content.run]) for figure in report_figures(content)), *extra]
    twice = [stem for stem, count in Counter(figure.stem for figure in figures).items() if count > 1]
    if twice:
        raise ValueError(f"two figures are called {twice[0]}: one would take the place of the other")
    for figure in figures:
        add_provenance(figure.figure, [content.run])
        names += [path.name for path in save_figure(figure.figure, folder / figure.stem, kinds)]
    (folder / "report.md").write_text(markdown(content, figures), encoding="utf-8")
    with_png = [(figure, (folder / f"{figure.stem}.png").read_bytes()) for figure in figures]
    (folder / "report.html").write_text(html_page(content, with_png), encoding="utf-8")
    return [*names, "report.md", "report.html"]


def markdown(content: Content, figures: Sequence[NamedFigure]) -> str:
    """Write the report as Markdown, with its figures in the same folder."""
    manifest, card, leads = content.run.manifest, list(_card(content)), _leads(figures)
    said = {text for _, text in card}
    return Document(
        product="boresight report",
        title=manifest.title or manifest.name,
        facts=card,
        closing=[("How the numbers are made", [note for note in content.notes if note not in said])],
        grids=report_grids(content),
        leads=leads,
        figures=[figure for figure in figures if figure not in leads],
        command=reproduce_command(content),
        credits=manifest.credits,
    ).markdown()


def write_board(folders: Sequence[Path], out: Path, command: str) -> tuple[Path, tuple[str, ...]]:
    """Write ``index.html`` on runs into a folder; return its path and what is wrong with runs that cannot be read.

    Raises `OSError` if the page cannot be written.
    """
    rows, refused = [], []
    for folder in folders:
        try:
            rows.append(_line(read_run(folder), out))
        except BoresightError as error:
            refused.append(str(error))
    document = Document(
        product="boresight board",
        title=f"Runs in {out.absolute()}",
        facts=(),
        lists=[("Not read", refused)],
        grids=[
            Grid(
                f"{count_of(len(rows), 'run')}, the newest first",
                _HEADS,
                tuple(rows),
                frozenset({0, 1, 2, 4, 5, 9}),
                _NOTE,
            )
        ],
        command=command,
    )
    return write_document(document, out, "index.html"), tuple(refused)


def _line(run: RunData, out: Path) -> tuple[str, ...]:
    """Lay out the cells of a run; those on its estimators have a line for each."""
    manifest, report = run.manifest, run.folder / "report" / "report.html"
    done, total = run.progress()
    try:
        metric, found = estimator_results(run)
        measured = metric.axis
    except BoresightError:  # its trials have no number to go by
        found, measured = [], NO_VALUE
    estimators = [(one.estimator, f"{one.n_ok}/{one.n}", interval(one.solved[0]), number(one.prior)) for one in found]
    name: str = run.folder.name
    if report.exists():
        way = quote(Path(os.path.relpath(report, out)).as_posix())
        name = Markup('<a href="{}">{}</a>').format(way, name)
    verdicts = verdict_counts(content_of(run)) if manifest.report else ""
    return (
        name,
        Markup("{}{}").format(manifest.title or manifest.name, _thumb(run.folder / "report" / f"{LEAD}.png")),
        _lines([manifest.created[:16].replace("T", " ")]),
        f"{done}/{total}",
        measured,
        *(_lines(column) for column in (zip(*estimators, strict=True) if estimators else [[NO_VALUE]] * 4)),
        verdicts or NO_VALUE,
    )


def _lines(texts: Iterable[str]) -> str:
    return Markup('<span class="lines">{}</span>').format(Markup("<br>").join(texts))


def _thumb(picture: Path) -> str:
    """Return the lead picture of a report, scaled down; '' where there is none."""
    pixels = cv2.imread(str(picture)) if picture.exists() else None
    if pixels is None:
        return ""
    scale = _THUMB_PX / max(pixels.shape[:2])
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    png = base64.b64encode(cv2.imencode(".png", small)[1].tobytes()).decode()
    return Markup('<img class="thumb" src="data:image/png;base64,{}" alt="">').format(png)
