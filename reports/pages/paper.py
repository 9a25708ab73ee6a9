"""Page of a reproduced paper: every published number with ours, all figures, and its tables drawn with our values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.style import finish, hide_axes, new_figure, styled
from boresight.reports.kinds import Content
from boresight.reports.pages.content import beside_published
from boresight.reports.pages.document import Document, write_document
from boresight.reports.published import Comparison
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, row_grid, value_of
from boresight.reports.schema.records import Record, stage_label
from boresight.reports.schema.tables import measure_label, unit_of
from boresight.reports.verdicts import (
    VERDICT_RULE,
    ComparedClaim,
    ComparedValue,
    Verdict,
    ordered_values,
    verdict_of,
    verdict_of_claim,
)

_COLUMNS = [
    "campaign", "scenario", "estimator", "place", "quantity", "statistic", "published", "ours", "low", "high", "unit",
    "n_ok", "n", "tolerance", "verdict",
]  # fmt: skip
_NONE = (None, None, None, "", 0, 0)
_PLACE = re.compile(r"table (\d+)\b", re.IGNORECASE)
_SHOWN = ("scenario", "quantity", "statistic", "paper", "ours [95 %]", "ok", "tolerance", "verdict")
_LINE_IN, _GAP_IN, _TITLE_IN, _SIZE = 0.19, 0.22, 0.45, 8.0


@dataclass(frozen=True, slots=True)
class PaperLine:
    """One published number or statement with our numbers.

    Campaign, scenario and estimator are the source of ours; the last two are '' where nothing was run. ``printed`` is
    the paper's number or words, ``ours`` one number or those of an order, whose ``names`` tell its values apart.
    ``tolerance`` is the half-width of the band that counts as reproduced; None where there is none. ``said`` is the
    verdict as it is printed, with what it leaves out, ``remark`` why none is due though our numbers are known.
    ``in_words``: no number of ours can be compared with it.
    """

    campaign: str
    scenario: str
    estimator: str
    place: str
    quantity: str
    statistic: str
    printed: str
    ours: tuple[Record | None, ...]
    tolerance: float | None
    verdict: Verdict
    names: tuple[str, ...] = ()
    said: str = ""
    remark: str = ""
    in_words: bool = False

    @property
    def has_value(self) -> bool:
        """Whether all of our numbers have a value; 0 of n trials counts as one."""
        return bool(self.ours) and all(
            record is not None and (record.value is not None or 0 == record.n_ok < record.n) for record in self.ours
        )


def paper_lines(
    campaign: str,
    comparison: Comparison,
    content: Content | None,
    labels: Sequence[str],
    absent: Verdict = "not measured",
) -> Iterator[PaperLine]:
    """Pair every number and statement of a paper with those of a run, or with none if there is no run.

    ``labels`` are the estimators of the run that are the paper's own method. Without a run (``content``), ``absent`` is
    the verdict on each number.
    """
    if content is None:
        numbers = comparison.values  # noqa: PD011  a tuple of published values, not a table
        compared = tuple(ComparedValue(number.scenario, "", number, None, absent) for number in numbers)
        stated = tuple(ComparedClaim("", claim, (), absent) for claim in comparison.claims)
    elif content.comparison is None:  # made before its campaign named published values
        compared, stated = beside_published(content.run, content.records, comparison)
    else:
        compared, stated = content.compared, content.claims
    shown = [item for item in compared if content is None or item.estimator in labels]
    several = len({item.estimator for item in shown}) > 1
    for item in shown:
        published = item.published
        stage = stage_label(published.stage, timed=published.measure == "seconds")
        whose = f", {item.estimator}" if published.estimator or several else ""
        quantity = f"{measure_label(published.measure)}, {stage}{whose}"
        tolerance = published.tolerance if item.verdict != "context" else None
        yield PaperLine(
            campaign, item.scenario, item.estimator, published.place, quantity, published.statistic, published.quoted,
            (item.ours,), tolerance, item.verdict, said=verdict_of(item.verdict, (item.ours,)),
        )  # fmt: skip
    for statement in stated:
        claim = statement.claim
        bound = "" if claim.within is None else f"% of trials within {claim.within:g} {unit_of(claim.measure)}"
        order = f"order of the {claim.statistic}s"
        how = claim.unmeasured or ((bound or "trials solved") if claim.solves else order)
        quantity = "in words" if claim.unmeasured else measure_label(claim.measure)
        names = tuple(term.label for term in claim.order)
        yield PaperLine(
            campaign, statement.scenario, "", claim.place, quantity, how, claim.text, statement.ours, None,
            statement.verdict, names, verdict_of_claim(statement), claim.unjudged, bool(claim.unmeasured),
        )  # fmt: skip


def paper_grid(lines: Sequence[PaperLine]) -> Grid:
    """Lay the lines out as the one table of the paper."""
    rows = []
    for line in lines:
        alone = len(line.ours) == 1
        several = "" if alone else "; ".join(filter(None, (ordered_values(line.ours, line.names), line.remark)))
        rows.append({
            "place in the paper": line.place,
            "quantity": line.quantity,
            "statistic": line.statistic,
            "paper": line.printed,
            "ours [95 %]": value_of(line.ours[0], interval=True) if alone else several,
            "ok": counts(line.ours[0]) if alone else NO_VALUE,
            "tolerance": f"± {line.tolerance:g}" if line.tolerance is not None else NO_VALUE,
            "verdict": line.said or line.verdict,
            "campaign": line.campaign,
            "scenario": line.scenario or NO_VALUE,
        })  # fmt: skip
    text = rows[0].keys() - {"ok", "tolerance"}
    return row_grid("Every published number beside ours", rows, text, VERDICT_RULE)


def value_tally(lines: Sequence[PaperLine]) -> str:
    """Count in words how many of the paper's numbers and statements have a value of ours, and why others have none."""
    without = [line for line in lines if not line.has_value]
    words = [line for line in without if line.in_words]
    real = [line for line in without if line.verdict == "needs real images" and not line.in_words]
    parts = [f"{len(lines) - len(without)} of {len(lines)} published numbers and statements have a value"]
    others = (
        (len(real), "need real images"),
        (len(words), "are in words, without a number of ours"),
        (len(without) - len(real) - len(words), "have none, as no trial that was run is about them"),
    )
    return "; ".join([*parts, *(f"{number} {why}" for number, why in others if number)])


def paper_table(lines: Sequence[PaperLine]) -> pd.DataFrame:
    """Tabulate the lines as numbers, a row for each of ours."""
    rows = []
    for line in lines:
        for ours in line.ours or (None,):
            estimator = ours.estimator if ours and ours.estimator else line.estimator
            number = (ours.value, ours.low, ours.high, ours.unit, ours.n_ok, ours.n) if ours else _NONE
            known = (line.campaign, line.scenario, estimator, line.place, line.quantity, line.statistic, line.printed)
            rows.append((*known, *number, line.tolerance, line.verdict))
    return pd.DataFrame(rows, columns=_COLUMNS)


@dataclass(frozen=True, slots=True, eq=False)
class PaperPage:
    """The page of a paper: all that it shows, the lines of its first table, and how many runs our numbers come from.

    ``missing`` says what is not there and how to make it, ``refused`` which stored runs cannot be read, and why.
    """

    document: Document
    lines: tuple[PaperLine, ...]
    runs: int
    missing: tuple[str, ...]
    refused: tuple[str, ...]


def write_paper(page: PaperPage, folder: Path) -> Path:
    """Write the drawings (PNG and PDF), ``table.csv``, ``table.md`` and ``index.html`` into a folder; return the page.

    Drawings of the paper that an earlier call left there and that this one cannot draw are removed.
    """
    path = write_document(page.document, folder, "index.html", "table.md")
    stems = {figure.stem for figure in page.document.figures}
    patterns = [f"{kind}_[0-9]*.{end}" for kind in ("figure", "table") for end in ("png", "pdf")]
    for old in [path for pattern in patterns for path in folder.glob(pattern)]:
        if old.stem not in stems:
            old.unlink()
    first = page.document.grids[:1]
    table = (
        paper_table(page.lines) if page.lines or not first else pd.DataFrame(first[0].rows, columns=first[0].columns)
    )
    table.to_csv(folder / "table.csv", index=False, lineterminator="\n")
    return path


@styled
def draw_table(grid: Grid) -> Figure:
    """Draw a table as wide as its cells: texts to the left, numbers to the right, three rules."""
    columns = list(zip(grid.columns, *grid.rows, strict=True))
    figure, (axes,) = new_figure(1)
    drawn = [[axes.text(0.0, 0.0, cell, fontsize=_SIZE, va="center") for cell in column] for column in columns]
    for heading, *_ in drawn:
        heading.set_fontweight("bold")
    widths = [max(cell.get_window_extent().width for cell in column) / figure.dpi for column in drawn]
    lines, width = len(grid.rows) + 1, sum(widths) + _GAP_IN * len(widths)
    figure.set_size_inches(width, _TITLE_IN + _LINE_IN * (lines + 0.5))
    axes.set(xlim=(0.0, width), ylim=(lines + 0.25, -0.25))
    hide_axes(axes)
    left = 0.5 * _GAP_IN
    for number, (column, own) in enumerate(zip(drawn, widths, strict=True)):
        for row, cell in enumerate(column):
            cell.set_position((left if number in grid.text else left + own, row + 0.5))
            cell.set_horizontalalignment("left" if number in grid.text else "right")
        left += own + _GAP_IN
    # Rules above and below the table and below its headings; its lines are one unit high.
    for at, thick in ((0.0, 1.2), (1.0, 0.7), (float(lines), 1.2)):
        axes.hlines(at, 0.0, width, color="black", linewidth=thick)
    return finish(figure, grid.title)


def lines_by_table(lines: Sequence[PaperLine]) -> dict[str, list[PaperLine]]:
    """Gather the lines whose numbers are printed in each table of the paper, in the order of the tables."""
    gathered: dict[str, list[PaperLine]] = {}
    for line in lines:
        found = _PLACE.match(line.place)
        if found:
            gathered.setdefault(found[1], []).append(line)
    return {number: gathered[number] for number in sorted(gathered, key=int)}


def table_figure(number: str, lines: Sequence[PaperLine]) -> NamedFigure:
    """Draw a table of the paper: its numbers, ours with their intervals and counts, and the verdicts."""
    grid = paper_grid(lines).keep(*_SHOWN)
    columns = zip(grid.columns, zip(*grid.rows, strict=True), strict=True)
    with_values = grid.keep(*(name for name, column in columns if set(column) != {NO_VALUE}))
    grid = replace(with_values, title=f"Table {number} of the paper, and ours")
    campaigns = ", ".join(dict.fromkeys(line.campaign for line in lines))
    return NamedFigure(
        f"table_{number:0>2}",
        draw_table(grid),
        f"Table {number}. What the paper prints in its table, and ours with 95 % intervals and the trials behind each"
        f" number, from {campaigns}.",
        f"The {len(lines)} numbers of table {number} beside ours.",
    )
