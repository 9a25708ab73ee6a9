"""Page of an inspected case: self-contained, with its figures as files in the same folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from boresight.reports.figures.style import save_figure
from boresight.reports.pages.templates import embed_figures, fill_template
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.named_figure import NamedFigure
from boresight.scenarios.atomic import write_text


@dataclass(frozen=True, slots=True, eq=False)
class CasePage:
    """Content of the page of an inspected case.

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
        Command line that makes the page again.
    traceback
        Traceback of an estimator that raised; '' otherwise.
    said
        Stream to the text that the method wrote to it.
    credits
        Credit lines of real images.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    notes: Sequence[str]
    grids: Sequence[Grid]
    command: str
    traceback: str = ""
    said: Mapping[str, str] = field(default_factory=dict)
    credits: Sequence[str] = ()


def write_case(page: CasePage, figures: Iterable[NamedFigure], folder: Path, pdf: bool) -> Path:
    """Write the figures of a case, as PDF too if asked, and its page into ``folder``; return the page's path.

    Raises
    ------
    BoresightError
        If the page cannot be written.
    """
    kinds = ("png", "pdf") if pdf else ("png",)
    drawn = [(figure, save_figure(figure.figure, folder / figure.stem, kinds)[0].read_bytes()) for figure in figures]
    path = folder / "index.html"
    write_text(path, fill_template("case.html", case=page, figures=embed_figures(drawn)))
    return path
