"""The page of one inspected case: self-contained, with its figures as PNG and PDF beside it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from reports.figures.style import save_figure
from reports.grid import Grid
from reports.named_figure import NamedFigure
from scenarios.atomic import write_text


@dataclass(frozen=True, slots=True, eq=False)
class CasePage:
    """What is said of a case.

    Parameters
    ----------
    title
        Its heading.
    facts
        Names and values above everything else.
    notes
        Sentences above the figures.
    grids
        Tables below them.
    command
        What makes the page again.
    traceback
        Of an estimator that raised; '' of others.
    credits
        Of real images.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    notes: Sequence[str]
    grids: Sequence[Grid]
    command: str
    traceback: str = ""
    credits: Sequence[str] = ()


def write_case(page: CasePage, figures: Sequence[NamedFigure], folder: Path) -> Path:
    """Write the figures of a case and its page into ``folder``; return the page's path.

    Raises
    ------
    BoresightError
        If the page cannot be written.
    """
    pngs = [save_figure(figure.figure, folder / figure.stem)[0].read_bytes() for figure in figures]
    files = resources.files("reports")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(files.joinpath("case.html").read_text(encoding="utf-8"))
    encoded = [(figure, base64.b64encode(png).decode()) for figure, png in zip(figures, pngs, strict=True)]
    css = files.joinpath("page.css").read_text(encoding="utf-8")
    path = folder / "index.html"
    write_text(path, template.render(css=css, case=page, figures=encoded))
    return path
