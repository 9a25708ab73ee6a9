"""Self-contained pages of facts, tables and figures, some also as Markdown, and of an inspected case."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.style import save_figure
from boresight.reports.schema.grid import Grid
from boresight.scenarios.atomic import write_text

ON_BOARD = "On board"
"""Name of the fact that says what was known on board."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Document:
    """Content of a page that a command, the ``product``, writes.

    ``facts`` are names and values of the card below the heading, ``lists`` titles and lines before the tables, and
    ``closing`` after the figures. The ``leads`` are figures after the first table, ``figures`` come after all.
    ``command`` makes the page again; ``credits`` are the credit lines of real images.
    """

    product: str
    title: str
    facts: Sequence[tuple[str, str]]
    grids: Sequence[Grid]
    lists: Sequence[tuple[str, Sequence[str]]] = ()
    closing: Sequence[tuple[str, Sequence[str]]] = ()
    figures: Sequence[NamedFigure] = ()
    leads: Sequence[NamedFigure] = ()
    command: str = ""
    credits: Sequence[str] = ()

    def drawn(self) -> list[NamedFigure]:
        """List all figures, the leads first."""
        return [*self.leads, *self.figures]

    def on_page(self) -> list[Grid]:
        """List the tables without their lines on the onboard knowledge where the card says it in full."""
        said = ON_BOARD in dict(self.facts)
        return [replace(grid, known="") if said else grid for grid in self.grids]

    def markdown(self) -> str:
        """Write the page as Markdown, with its figures in the same folder."""
        tables = [grid.markdown() for grid in self.grids]
        figures = [f"![{figure.alt}]({figure.stem}.png)\n\n{figure.caption}" for figure in self.drawn()]
        title = re.sub(r"([\\`*_\[\]<>])", r"\\\1", " ".join(self.title.split()))
        parts = [f"# {title}", _bullets(f"{name}: {value}" for name, value in self.facts)]
        first, last = ([_section(*one) for one in lists if one[1]] for lists in (self.lists, self.closing))
        parts += [*first, *tables[:1], *figures[: len(self.leads)], *tables[1:], *figures[len(self.leads) :], *last]
        parts += [f"To make this again: `{self.command}`"] if self.command else []
        return "\n\n".join(part for part in (*parts, *self.credits) if part) + "\n"


def write_document(
    document: Document, folder: Path, page: str, markdown: str = "", kinds: Sequence[str] = ("png", "pdf")
) -> Path:
    """Write the figures, the page and, if it is named, the Markdown into a folder; return the page.

    Raises `OSError` if the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = [(one, save_figure(one.figure, folder / one.stem, kinds)[0].read_bytes()) for one in document.drawn()]
    if markdown:
        (folder / markdown).write_text(document.markdown(), encoding="utf-8")
    template = "case.html" if isinstance(document, CasePage) else "document.html"
    text = fill_template(template, document=document, figures=embed_figures(drawn), js=template_text("page.js"))
    write_text(folder / page, text)
    return folder / page


def _section(title: str, lines: Iterable[str]) -> str:
    return f"## {title}\n\n{_bullets(lines)}"


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CasePage(Document):
    """Content of the page of an inspected case; its figures are before its tables.

    ``notes`` are above the figures. ``traceback`` is that of an estimator that raised, '' otherwise; ``said`` maps a
    stream to the text that the method wrote to it.
    """

    notes: Sequence[str]
    traceback: str
    said: Mapping[str, str]


def fill_template(template: str, **values: object) -> str:
    """Fill a template with values and the style sheet."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=PackageLoader("boresight.reports.pages", "."),
    )  # fmt: skip
    return environment.get_template(template).render(css=template_text("page.css"), **values)


def template_text(name: str) -> str:
    """Read a file of the templates' folder."""
    return resources.files("boresight.reports.pages").joinpath(name).read_text(encoding="utf-8")


def embed_figures(figures: Iterable[tuple[NamedFigure, bytes]]) -> list[tuple[NamedFigure, str]]:
    """Encode the PNG of each figure for its place in a page."""
    return [(figure, base64.b64encode(png).decode()) for figure, png in figures]
