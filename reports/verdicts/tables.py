"""The tables that set published values and statements beside ours."""

from __future__ import annotations

from collections.abc import Sequence

from reports.schema.common import POSE_COLUMNS
from reports.schema.grid import NO_VALUE, Grid, counts, value_of, value_of_ended
from reports.schema.labels import stage_label
from reports.schema.records import RATIO, REDUCTION, SEQUENCE, Record
from reports.schema.tables import measure_label
from reports.verdicts.comparison import VERDICT_RULE, ComparedClaim, ComparedValue, Verdict

_OF_RUNS = frozenset({SEQUENCE, REDUCTION, RATIO, "orbit"})
"""Stages of whole runs, of which those that do not end have no error; elsewhere counts are of other things."""
_WITHOUT_OTHERS = " of the runs that ended"
_NONE_DUE = frozenset({"context", "not measured"})


def comparison_grid(compared: Sequence[ComparedValue]) -> Grid | None:
    """Tabulate published values beside ours; None if the campaign is compared with nothing."""
    if not compared:
        return None
    heads = (
        "quantity",
        "stage",
        "statistic",
        "paper",
        "ours [95 %]",
        "ok",
        "tolerance",
        "verdict",
        "place in the paper",
    )
    several = len({(c.scenario, c.estimator) for c in compared}) > 1
    rows = tuple(_compared_cells(c, several) for c in compared)
    return Grid("Beside the published values", heads, rows, frozenset({0, 1, 2, 7, 8}), VERDICT_RULE)


def verdict_grid(compared: Sequence[ComparedValue]) -> Grid | None:
    """Tabulate the same in few columns, without times; None if the campaign is compared with nothing."""
    several = len({(c.scenario, c.estimator) for c in compared}) > 1
    rows = []
    for item in compared:
        if item.published.measure != "seconds":
            quantity, stage, statistic, paper, ours, _, _, verdict, _ = _compared_cells(item, several)
            rows.append((f"{quantity}, {stage}, {statistic}", paper, ours, verdict))
    heads = ("quantity", "paper", "ours [95 %]", "verdict")
    # Words of the paper may wrap, or a terminal has no room for the verdicts.
    text = {0, 3} | ({1} if any('"' in row[1] for row in rows) else set())
    return Grid("Beside the published values", heads, tuple(rows), frozenset(text)) if rows else None


def _compared_cells(compared: ComparedValue, several: bool) -> tuple[str, ...]:
    published, ours = compared.published, compared.ours
    quantity = measure_label(published.measure)
    judged = compared.verdict != "context" and published.tolerance is not None
    return (
        f"{compared.scenario}, {compared.estimator}: {quantity}" if several else quantity,
        stage_label(published.stage, timed=published.measure == "seconds"),
        published.statistic,
        published.quoted,
        (value_of_ended if ours is not None and ours.stage in _OF_RUNS else value_of)(ours, interval=True),
        counts(ours),
        f"± {published.tolerance:g}" if judged else NO_VALUE,
        verdict_of(compared.verdict, (ours,)),
        published.place,
    )


def verdict_of(verdict: Verdict, ours: Sequence[Record | None]) -> str:
    """Print a verdict, and that it is of the runs that ended where others have no value."""
    left_out = any(record is not None and record.n_ok < record.n and _needs_an_end(record) for record in ours)
    return f"{verdict}{_WITHOUT_OTHERS}" if left_out and verdict not in _NONE_DUE else verdict


def _needs_an_end(record: Record) -> bool:
    """Tell what a trial that does not end has no value of, from counts of other things."""
    return record.stage in _OF_RUNS or record.measure in POSE_COLUMNS


def claim_grid(claims: Sequence[ComparedClaim]) -> Grid | None:
    """Tabulate orders that the paper states in words; None if it states none."""
    heads = ("the paper says", "scenario", "ours [95 %], in that order", "verdict", "place in the paper")
    rows = tuple(
        (
            item.claim.text,
            item.scenario,
            claim_values(item),
            verdict_of_claim(item),
            item.claim.place,
        )
        for item in claims
    )
    return Grid("Beside what the paper says in words", heads, rows, frozenset({0, 1, 2, 3, 4})) if rows else None


def claim_values(item: ComparedClaim) -> str:
    """Print what a claim is held against: values in its order, how many are solved, or why it is not measured."""
    if item.claim.solves and item.ours and item.ours[0]:
        return f"{item.claim.solves} solves {counts(item.ours[0])}"
    names = [term.label for term in item.claim.order]
    values = item.claim.unmeasured or ordered_values(item.ours, names)
    return f"{values}; {item.claim.unjudged}" if item.claim.unjudged else values


def verdict_of_claim(item: ComparedClaim) -> str:
    """Print the verdict of a statement; what counts the runs that end leaves none out."""
    return item.verdict if item.claim.solves else verdict_of(item.verdict, item.ours)


def ordered_values(ours: Sequence[Record | None], names: Sequence[str]) -> str:
    """Print values in the order of a claim, with the relation that holds between neighbours; ``-`` for none."""
    parts: list[str] = []
    for before, record, name in zip((None, *ours), ours, names, strict=False):
        parts += [_relation(before, record)] if parts else []
        parts.append(_named(record, name) if record else NO_VALUE)
    return " ".join(parts) or NO_VALUE


def _named(record: Record, name: str) -> str:
    unit = "" if record.unit == "s" else record.unit  # a time is printed with its own
    return f"{name} {value_of(record, interval=True)} {unit}".strip()


def _relation(before: Record | None, after: Record | None) -> str:
    if before is None or after is None or before.value is None or after.value is None:
        return "?"
    return "<" if before.value < after.value else ">" if before.value > after.value else "="
