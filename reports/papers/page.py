"""Page of a reproduced paper: every published number with ours, and all figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from boresight.reports.kinds import Content
from boresight.reports.pages.content import beside_published
from boresight.reports.pages.document import Document, write_document
from boresight.reports.published import Comparison
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, value_of
from boresight.reports.schema.labels import stage_label
from boresight.reports.schema.named_figure import NamedFigure
from boresight.reports.schema.records import Record
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


@dataclass(frozen=True, slots=True)
class PaperLine:
    """One published number or statement with our numbers.

    Parameters
    ----------
    campaign, scenario, estimator
        Source of our numbers; scenario and estimator are '' where nothing was run.
    place
        Place in the paper.
    quantity, statistic
        Measured quantity and its statistic.
    printed
        The paper's number or words.
    ours
        Our numbers: one, or those of an order.
    tolerance
        Half-width of the band that counts as reproduced; None where there is none.
    verdict
        By the rule.
    names
        Of an order: what tells its values apart.
    said
        The verdict as it is printed, with what it leaves out.
    remark
        Why no verdict is due, though our numbers are known.
    in_words
        Whether it is a statement that no number of ours can be compared with.
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
        """Whether all of our numbers have a value."""
        return bool(self.ours) and all(record is not None and record.value is not None for record in self.ours)


def paper_lines(
    campaign: str,
    comparison: Comparison,
    content: Content | None,
    labels: Sequence[str],
    absent: Verdict = "not measured",
) -> Iterator[PaperLine]:
    """Pair every number and statement of a paper with those of a run, or with none if there is no run.

    Parameters
    ----------
    campaign
        Name of the campaign.
    comparison
        What the paper says.
    content
        The run; None where there is none.
    labels
        Estimators of the run that are the paper's own method.
    absent
        What to say of each number if there is no run.
    """
    if content is None:
        numbers = comparison.values  # noqa: PD011  a tuple of published values, not a table
        nothing = (ComparedValue(number.scenario, "", number, None, absent) for number in numbers)
        yield from (_value_line(campaign, item) for item in nothing)
        claims = (ComparedClaim("", claim, (), absent) for claim in comparison.claims)
        yield from (_claim_line(campaign, item) for item in claims)
        return
    compared, stated = content.compared, content.claims
    if content.comparison is None:  # made before its campaign named published values
        compared, stated = beside_published(content.run, content.records, comparison)
    told = [item for item in compared if item.estimator in labels]
    several = len({item.estimator for item in told}) > 1
    yield from (_value_line(campaign, item, name=several) for item in told)
    yield from (_claim_line(campaign, item) for item in stated)


def _value_line(campaign: str, item: ComparedValue, *, name: bool = False) -> PaperLine:
    published = item.published
    stage = stage_label(published.stage, timed=published.measure == "seconds")
    whose = f", {item.estimator}" if published.estimator or name else ""
    return PaperLine(
        campaign,
        item.scenario,
        item.estimator,
        published.place,
        f"{measure_label(published.measure)}, {stage}{whose}",
        published.statistic,
        published.quoted,
        (item.ours,),
        published.tolerance if item.verdict != "context" else None,
        item.verdict,
        said=verdict_of(item.verdict, (item.ours,)),
    )


def _claim_line(campaign: str, item: ComparedClaim) -> PaperLine:
    claim = item.claim
    solved = (
        "trials solved" if claim.within is None else f"% of trials within {claim.within:g} {unit_of(claim.measure)}"
    )
    how = claim.unmeasured or (solved if claim.solves else f"order of the {claim.statistic}s")
    quantity = "in words" if claim.unmeasured else measure_label(claim.measure)
    names = tuple(term.label for term in claim.order)
    return PaperLine(
        campaign, item.scenario, "", claim.place, quantity, how, claim.text, item.ours, None, item.verdict, names,
        verdict_of_claim(item), claim.unjudged, bool(claim.unmeasured),
    )  # fmt: skip


def paper_grid(lines: Sequence[PaperLine]) -> Grid:
    """Lay the lines out as the one table of the paper."""
    heads = (
        "place in the paper", "quantity", "statistic", "paper", "ours [95 %]", "ok", "tolerance", "verdict", "campaign",
        "scenario",
    )  # fmt: skip
    rows = tuple(
        (
            line.place,
            line.quantity,
            line.statistic,
            line.printed,
            _ours(line),
            counts(line.ours[0]) if len(line.ours) == 1 else NO_VALUE,
            f"± {line.tolerance:g}" if line.tolerance is not None else NO_VALUE,
            line.said or line.verdict,
            line.campaign,
            line.scenario or NO_VALUE,
        )
        for line in lines
    )
    return Grid("Every published number beside ours", heads, rows, frozenset({0, 1, 2, 3, 4, 7, 8, 9}), VERDICT_RULE)


def _ours(line: PaperLine) -> str:
    if len(line.ours) == 1:
        return value_of(line.ours[0], interval=True)
    return "; ".join(filter(None, (ordered_values(line.ours, line.names), line.remark)))


def verdict_tally(lines: Sequence[PaperLine]) -> str:
    """Count the verdicts in words."""
    tally = Counter(line.verdict for line in lines)
    return ", ".join(f"{count} {verdict}" for verdict, count in tally.most_common())


def value_tally(lines: Sequence[PaperLine]) -> str:
    """Count in words how many of the paper's numbers and statements have a value of ours, and why others have none."""
    without = [line for line in lines if not line.has_value]
    words = [line for line in without if line.in_words]
    real = [line for line in without if line.verdict == "needs real images" and not line.in_words]
    parts = [f"{len(lines) - len(without)} of {len(lines)} published numbers and statements have a value"]
    others = (
        (len(real), "need real images"),
        (len(words), "are in words, without a number of ours"),
        (len(without) - len(real) - len(words), "have none"),
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
    """All that the page of a paper shows.

    Parameters
    ----------
    title, source
        Heading, and the paper's reference.
    lines
        The one table.
    grids
        Further tables.
    figures
        The paper's figures and tables, named by its numbers.
    runs
        What each number comes from: campaign, and how its run was made.
    conditions
        How the bounds of the verdicts came about, and under which conditions each campaign is compared.
    missing
        What is not there, and how to make it.
    refused
        Stored runs that cannot be read, and why.
    credits
        Credit lines of real images.
    """

    title: str
    source: str
    lines: tuple[PaperLine, ...]
    grids: tuple[Grid, ...]
    figures: tuple[NamedFigure, ...]
    runs: tuple[tuple[str, str], ...]
    conditions: tuple[str, ...]
    missing: tuple[str, ...]
    refused: tuple[str, ...]
    credits: tuple[str, ...]


def write_paper(page: PaperPage, folder: Path) -> Path:
    """Write the drawings (PNG and PDF), ``table.csv``, ``table.md`` and ``index.html`` into a folder; return the page.

    Drawings of the paper that an earlier call left there and that this one cannot draw are removed.
    """
    grids = (paper_grid(page.lines), *page.grids)
    document = Document(
        product="boresight figures",
        title=page.title,
        facts=[
            ("Paper", page.source),
            ("Values", value_tally(page.lines)),
            ("Verdicts", verdict_tally(page.lines)),
            *page.runs,
        ],
        lists=[
            ("Not read", page.refused),
            ("Not there", page.missing),
            ("What is compared, and by which bounds", page.conditions),
        ],
        grids=grids,
        figures=page.figures,
        credits=page.credits,
    )
    path = write_document(document, folder, "index.html", "table.md")
    stems = {figure.stem for figure in page.figures}
    patterns = [f"{kind}_[0-9]*.{end}" for kind in ("figure", "table") for end in ("png", "pdf")]
    for old in [path for pattern in patterns for path in folder.glob(pattern)]:
        if old.stem not in stems:
            old.unlink()
    paper_table(page.lines).to_csv(folder / "table.csv", index=False, lineterminator="\n")
    return path
