"""Comparison of our values with published ones by one rule, and its tables.

The rule is the same for all values; the file of each paper states what was known of our values when its tolerances and
bounds were chosen.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, TypeVar

from boresight.reports.published import Comparison, PublishedClaim, PublishedValue, Term
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, row_grid, value_of, value_of_ended
from boresight.reports.schema.records import (
    CONTROL,
    DERIVED,
    RATIO,
    REDUCTION,
    SEQUENCE,
    Key,
    Record,
    by_key,
    stage_label,
)
from boresight.reports.schema.tables import measure_label, unit_of
from boresight.reports.statistics.intervals import wilson

_OF_RUNS = frozenset({SEQUENCE, REDUCTION, RATIO, "orbit"})
"""Stages of whole runs, of which those that do not end have no error; elsewhere counts are of other things."""
_WITHOUT_OTHERS = " of the runs that ended"
_NONE_DUE = frozenset({"context", "not measured", "embedded body", "needs real images"})

Verdict = Literal[
    "reproduced", "better", "differs", "differs (lower)", "differs (higher)", "undecided", "context", "not measured",
    "embedded body", "needs real images",
]  # fmt: skip

VERDICT_RULE = (
    "reproduced: the whole 95 % interval lies within the tolerance; differs (lower, higher): the whole interval lies "
    "outside it, below or above, even where ours is the better value, because a method of the paper with other results "
    "is not the same method; better: the same on the better side, of a method that the paper does not have; undecided: "
    "the interval reaches across an edge of the tolerance, or there is none, so that more trials, or sets of images, "
    "are needed; context: no verdict is given, because conditions differ or no tolerance was set; embedded body: the "
    "same, because a built-in body is in place of the paper's. Where the paper says "
    "'more than', or names an order, the intervals must agree with it, and stay below an upper bound where the words "
    "set one ('somewhat broader')."
)


@dataclass(frozen=True, slots=True)
class ComparedValue:
    """A published value, ours (None if the run does not measure it) and the verdict."""

    scenario: str
    estimator: str
    published: PublishedValue
    ours: Record | None
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class ComparedClaim:
    """A statement of the paper in words, our values in the stated order, and the verdict."""

    scenario: str
    claim: PublishedClaim
    ours: tuple[Record | None, ...]
    verdict: Verdict


Compared = TypeVar("Compared", ComparedValue, ComparedClaim)


def compare(records: Sequence[Record], comparison: Comparison) -> tuple[ComparedValue, ...]:
    """Compare each published value with ours, for every scenario that it is for and every estimator but the control.

    A value of ours that belongs to a scenario alone is used for each of its estimators.
    """
    known = by_key(records)
    pairs = dict.fromkeys((r.scenario, r.estimator) for r in records if r.estimator not in ("", CONTROL))
    compared = []
    for scenario, estimator in pairs:
        for published in comparison.values:
            if published.scenario not in ("", scenario) or published.estimator not in ("", estimator):
                continue
            which = (published.stage, published.against, published.measure, published.statistic)
            ours = known.get(Key(scenario, estimator, *which)) or known.get(Key(scenario, "", *which))
            if ours is None and published.stage == DERIVED:
                continue
            own = bool(published.estimator) or estimator in comparison.methods
            due = value_verdict(ours, published, own) if comparison.verdicts else "context"
            compared.append(ComparedValue(scenario, estimator, published, ours, due))
    return tuple(compared)


def compare_claims(records: Sequence[Record], comparison: Comparison) -> tuple[ComparedClaim, ...]:
    """Compare each statement of the paper with our values, scenario by scenario."""
    known, found = by_key(records), []
    scenarios = tuple(dict.fromkeys(r.scenario for r in records))
    for claim in comparison.claims:
        for scenario in ("",) if claim.unmeasured or any(term.scenario for term in claim.order) else scenarios:
            if claim.scenario not in ("", scenario):
                continue
            terms = (Term(estimator=claim.solves),) if claim.solves else claim.order
            keys = (
                Key(
                    term.scenario or scenario,
                    term.estimator or claim.estimator,
                    term.stage or claim.stage,
                    term.against or claim.against,
                    term.measure or claim.measure,
                    term.statistic or claim.compared_statistic,
                )
                for term in terms
            )
            ours = tuple(map(known.get, keys))
            due = solved_verdict(ours[0], claim.share) if claim.solves else order_verdict(ours)
            if due != "not measured" and (claim.unjudged or not comparison.verdicts):
                due = "context"
            found.append(ComparedClaim(scenario, claim, ours, due))
    return tuple(found)


def on_embedded_body(item: Compared) -> Compared:
    """Replace a verdict of a run with built-in bodies, which give values alone."""
    return item if item.verdict in _NONE_DUE else replace(item, verdict="embedded body")


def solved_verdict(ours: Record | None, share: float = 0.9) -> Verdict:
    """Judge whether the share of solved trials is reached, by its 95 % Wilson interval; of "all" none may fail."""
    if ours is None or not ours.n:
        return "not measured"
    if share == 1:
        return "reproduced" if ours.n_ok == ours.n else "differs (lower)"
    low, high = wilson(ours.n_ok, ours.n)
    if low > share:
        return "reproduced"
    return "differs (lower)" if high < share else "undecided"


def order_verdict(ascending: Sequence[Record | None]) -> Verdict:
    """Judge whether values ascend as stated: their intervals must not overlap, in the stated order or in another."""
    bounds: list[tuple[float, float]] = []
    for record in ascending:
        if record is None or record.value is None:
            return "not measured"
        if record.low is None or record.high is None:
            return "undecided"
        bounds.append((record.low, record.high))
    if not bounds:
        return "not measured"
    if all(first[1] < second[0] for first, second in pairwise(bounds)):
        return "reproduced"
    return "differs" if any(first[0] > second[1] for first, second in pairwise(bounds)) else "undecided"


def value_verdict(ours: Record | None, published: PublishedValue, own: bool = True) -> Verdict:
    """Apply `VERDICT_RULE` to one value; ``own``: whether the paper has the method itself."""
    if ours is None or ours.value is None:
        return "not measured"
    about = published.relation == "about"
    if about and published.tolerance is None:
        return "context"
    if ours.low is None or ours.high is None:
        return "undecided"
    least, most = published.value, math.inf if published.at_most is None else published.at_most
    if published.relation == "below":
        least, most = -math.inf, published.value
    elif published.tolerance is not None and about:
        least, most = published.value - published.tolerance, published.value + published.tolerance
    if ours.high < least or ours.low > most:
        side = "lower" if ours.high < least else "higher"
        if about and side == published.better and not own:
            return "better"
        return "differs (lower)" if side == "lower" else "differs (higher)"
    # An interval that ends at the printed number is not above it.
    if not (least <= ours.low and ours.high <= most) or (published.relation == "above" and ours.low == least):
        return "undecided"
    beyond = {"above": "higher", "below": "lower"}.get(published.relation)
    return "better" if beyond == published.better and not own else "reproduced"


def verdict_tally(verdicts: Iterable[Verdict]) -> str:
    """Count the verdicts in words; '' if there are none."""
    return ", ".join(f"{count} {verdict}" for verdict, count in Counter(verdicts).most_common())


def comparison_grid(compared: Sequence[ComparedValue]) -> Grid | None:
    """Tabulate published values and ours; None if the campaign is compared with nothing."""
    rows = list(_compared_rows(compared))
    text = ("quantity", "stage", "statistic", "verdict", "place in the paper")
    return row_grid("Beside the published values", rows, text, VERDICT_RULE) if rows else None


def verdict_grid(compared: Sequence[ComparedValue]) -> Grid | None:
    """Tabulate the same in few columns, without times; None if the campaign is compared with nothing."""
    rows = []
    for item, row in zip(compared, _compared_rows(compared), strict=True):
        if item.published.measure != "seconds":
            what = ", ".join(row[head] for head in ("quantity", "stage", "statistic"))
            rows.append({"quantity": what} | {head: row[head] for head in ("paper", "ours [95 %]", "verdict")})
    # Words of the paper may wrap, or a terminal has no room for the verdicts.
    text = ("quantity", "verdict", *(["paper"] if any('"' in row["paper"] for row in rows) else []))
    return row_grid("Beside the published values", rows, text) if rows else None


def _compared_rows(compared: Sequence[ComparedValue]) -> Iterator[dict[str, str]]:
    several = len({(one.scenario, one.estimator) for one in compared}) > 1
    for one in compared:
        published, ours = one.published, one.ours
        judged = one.verdict != "context" and published.tolerance is not None
        printed = value_of_ended if ours is not None and ours.stage in _OF_RUNS else value_of
        yield {
            "quantity": f"{one.scenario}, {one.estimator}: " * several + measure_label(published.measure),
            "stage": stage_label(published.stage, timed=published.measure == "seconds"),
            "statistic": published.statistic,
            "paper": published.quoted,
            "ours [95 %]": printed(ours, interval=True),
            "ok": counts(ours),
            "tolerance": f"± {published.tolerance:g}" if judged else NO_VALUE,
            "verdict": verdict_of(one.verdict, (ours,)),
            "place in the paper": published.place,
        }


def verdict_of(verdict: Verdict, ours: Sequence[Record | None]) -> str:
    """Print a verdict; where some runs have no value, say that it is of the runs that ended."""
    # A trial must end to have these values; counts of other things need no end.
    of_ended = [one for one in ours if one is not None and (one.stage in _OF_RUNS or one.measure in POSE_COLUMNS)]
    left_out = any(one.n_ok < one.n for one in of_ended)
    return f"{verdict}{_WITHOUT_OTHERS}" if left_out and verdict not in _NONE_DUE else verdict


def claim_grid(claims: Sequence[ComparedClaim]) -> Grid | None:
    """Tabulate orders that the paper states in words; None if it states none."""
    heads = ("the paper says", "scenario", "ours [95 %], in that order", "verdict", "place in the paper")
    rows = tuple(
        (item.claim.text, item.scenario, claim_values(item), verdict_of_claim(item), item.claim.place)
        for item in claims
    )
    return Grid("Beside what the paper says in words", heads, rows, frozenset({0, 1, 2, 3, 4})) if rows else None


def claim_values(item: ComparedClaim) -> str:
    """Print our side of a claim: values in its order, how many are solved, or why it is not measured."""
    if item.claim.solves and item.ours and item.ours[0]:
        bound = "" if item.claim.within is None else f" to within {item.claim.within:g} {unit_of(item.claim.measure)}"
        n_ok, n = item.ours[0].n_ok, item.ours[0].n
        return f"{item.claim.solves} solves {counts(item.ours[0]) if n_ok else f'none of {n}'}{bound}"
    names = [term.label for term in item.claim.order]
    values = item.claim.unmeasured or ordered_values(item.ours, names)
    return f"{values}; {item.claim.unjudged}" if item.claim.unjudged else values


def verdict_of_claim(item: ComparedClaim) -> str:
    """Print the verdict of a statement; a share of solved runs counts all of them."""
    return item.verdict if item.claim.solves else verdict_of(item.verdict, item.ours)


def ordered_values(ours: Sequence[Record | None], names: Sequence[str]) -> str:
    """Print values in the order of a claim, with the relation that holds between neighbours; ``-`` for none."""
    parts: list[str] = []
    for before, record, name in zip((None, *ours), ours, names, strict=False):
        if parts and before and record and before.value is not None and record.value is not None:
            parts.append("<" if before.value < record.value else ">" if before.value > record.value else "=")
        elif parts:
            parts.append("?")
        unit = "" if record is None or record.unit == "s" else record.unit  # a time is printed with its own
        parts.append(f"{name} {value_of(record, interval=True)} {unit}".strip() if record else NO_VALUE)
    return " ".join(parts) or NO_VALUE
