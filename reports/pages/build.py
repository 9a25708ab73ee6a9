"""Write a run's report: page, Markdown, CSV and figures, each file whole or not at all."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from boresight.reports.figures.provenance import add_provenance, with_trial_counts
from boresight.reports.figures.style import report_styles, save_figure
from boresight.reports.kinds import Content, draw_figures, report_grids
from boresight.reports.pages.content import read_content
from boresight.reports.pages.distributions import distributions
from boresight.reports.pages.templates import embed_figures, fill_template, template_text
from boresight.reports.run.row_files import row_links, write_row_files
from boresight.reports.schema.named_figure import NamedFigure
from boresight.scenarios.errors import BoresightError


def html_page(content: Content, figures: Sequence[tuple[NamedFigure, bytes]]) -> str:
    """Fill the page's template.

    Parameters
    ----------
    content
        Content of the report.
    figures
        Each with its PNG, which is embedded.
    """
    manifest = content.run.manifest
    return fill_template(
        "page.html",
        manifest=manifest,
        progress=content.run.progress(),
        facts=_facts(content),
        notes=content.notes,
        js=template_text("page.js"),
        grids=[(grid, row_links(content.run, grid)) for grid in report_grids(content)],
        distributions=list(distributions(content.run)),
        figures=embed_figures(figures),
        resolved={
            "scenarios": json.dumps(dict(manifest.scenarios), indent=2, ensure_ascii=False),
            "estimators": json.dumps(manifest.estimators, indent=2, ensure_ascii=False),
        },
        command=reproduce_command(content),
    )


def reproduce_command(content: Content) -> str:
    """Write the command line that makes this run again."""
    manifest = content.run.manifest
    return manifest.command or f"boresight run {manifest.name} --trials {manifest.trials} --seed {manifest.seed}"


def _facts(content: Content) -> list[tuple[str, str]]:
    """List campaign, trials, seed, date, commit, machine and versions of a run."""
    manifest = content.run.manifest
    done, total = content.run.progress()
    facts = [
        ("Campaign", manifest.name),
        ("Trials", f"{done} of {total}"),
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
    """Paths of a written report, and its content.

    Parameters
    ----------
    folder
        Holds all files.
    html, markdown
        ``report.html`` and ``report.md``.
    tables
        ``table.csv`` (every measured number beside the published one), ``timings.csv``, ``failures.csv``.
    rows
        Files that the tables of the page link to.
    figures
        PNG of each figure, and PDF on request.
    content
        For `reports.pages.console.console_table`.
    """

    folder: Path
    html: Path
    markdown: Path
    tables: tuple[Path, ...]
    rows: tuple[Path, ...]
    figures: tuple[Path, ...]
    content: Content


def write_report(
    run: Path, out: Path | None = None, extra: Iterable[NamedFigure] = (), pdf: bool = False
) -> ReportFiles:
    """Write the report of a run folder.

    Parameters
    ----------
    run
        Folder with ``manifest.json`` and ``rows``; an unfinished run is reported as such.
    out
        Folder of the report, ``run/report`` by default. Other files in it are left alone.
    extra
        Further figures, shown after those of the tables (such as `reports.figures.draw_fit_panels`); drawn when it is
        known that the run can be read.
    pdf
        Whether figures are written as PDF too.

    Raises
    ------
    BoresightError
        If the run cannot be read or the report cannot be written; files of an earlier report then stay as they were.
    """
    content, further = read_content(run), list(extra)
    folder = out or run / "report"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=".writing-", dir=folder))
    except OSError as error:
        raise BoresightError(
            f"{folder}: the report cannot be written: {error.strerror}; choose another --out"
        ) from error
    try:
        with report_styles(map(str, content.run.manifest.estimators)):
            names = _write_all(content, work, further, ("png", "pdf") if pdf else ("png",))
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            (work / name).replace(folder / name)
            if name.endswith(".png") and not pdf:  # one of an earlier report would show other numbers
                (folder / name).with_suffix(".pdf").unlink(missing_ok=True)
    except OSError as error:
        raise BoresightError(
            f"{folder}: the report cannot be written: {error.strerror}; choose another --out"
        ) from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
    paths = [folder / name for name in names]
    return ReportFiles(
        folder,
        folder / "report.html",
        folder / "report.md",
        tuple(path for path in paths if path.suffix == ".csv" and path.parent == folder),
        tuple(path for path in paths if path.parent != folder),
        tuple(path for path in paths if path.suffix in (".png", ".pdf")),
        content,
    )


def _write_all(content: Content, folder: Path, extra: Sequence[NamedFigure], kinds: Sequence[str]) -> list[str]:
    """Write all files into ``folder`` and list their names; the page is last, so that it never shows missing files."""
    names = _write_tables(content, folder)
    figures = [*(with_trial_counts(figure, [content.run]) for figure in draw_figures(content)), *extra]
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


def _write_tables(content: Content, folder: Path) -> list[str]:
    table = content.table()
    timed = table["measure"] == "seconds"
    failed = content.run.rows[content.run.rows["status"] != "ok"]
    failures = failed[["trial", "scenario", "estimator", "status", "reason"]]
    frames: dict[str, pd.DataFrame] = {
        "table.csv": table[~timed],
        "timings.csv": table[timed],
        "failures.csv": failures,
    }
    for name, frame in frames.items():
        frame.to_csv(folder / name, index=False, lineterminator="\n")
    return [*frames, *write_row_files(content.run, folder)]


def markdown(content: Content, figures: Sequence[NamedFigure]) -> str:
    """Write the report as Markdown, with its figures beside it."""
    manifest = content.run.manifest
    parts = [f"# {_plain_line(manifest.title or manifest.name)}", "\n".join(f"- {note}" for note in content.notes)]
    parts += [grid.markdown() for grid in report_grids(content)]
    parts += [f"![{figure.alt}]({figure.stem}.png)\n\n{figure.caption}" for figure in figures]
    parts += [f"To make this again: `{reproduce_command(content)}`", *manifest.credits]
    return "\n\n".join(parts) + "\n"


def _plain_line(text: str) -> str:
    """Return a text as one line of Markdown without markup."""
    return re.sub(r"([\\`*_\[\]<>])", r"\\\1", " ".join(text.split()))
