"""What a paper is to its page: campaigns, figures by the paper's numbers, and the methods that are its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from campaign.papers.gather import FinishedRun
from reports.schema.grid import Grid
from reports.schema.named_figure import NamedFigure

Runs = Mapping[str, FinishedRun]
Draw = Callable[[Runs, int | None], Iterator[NamedFigure]]
"""Draws runs; what it builds again takes so many workers, None for one for each core, or GPU."""


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """A figure of the paper: its number, the campaigns of which it needs one, and how it is drawn.

    Each run of them gives drawings of its own, unless one drawing shows them all ``together``.
    """

    number: str
    campaigns: tuple[str, ...]
    draw: Draw
    together: bool = False

    def named(self, figure: NamedFigure, suffix: str = "") -> NamedFigure:
        """Give a figure the paper's number."""
        return replace(
            figure, stem=f"figure_{self.number:0>2}{suffix}", caption=f"Figure {self.number}. {figure.caption}"
        )


@dataclass(frozen=True, slots=True)
class Paper:
    """All that its page is made of.

    Parameters
    ----------
    title
        Heading of the page.
    campaigns
        Names of its campaigns, in the order of its sections; those that are not in the catalogue are left out.
    methods
        Names of what the paper itself describes; other estimators of a run are not held against it.
    figures
        Its figures.
    grids
        Further tables of a run.
    """

    title: str
    campaigns: tuple[str, ...]
    methods: tuple[str, ...]
    figures: tuple[PaperFigure, ...]
    grids: Callable[[FinishedRun], list[Grid]]
