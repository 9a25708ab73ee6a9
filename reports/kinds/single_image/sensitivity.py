"""Comparison of ways to build a data base: its size, and the resulting errors."""

from __future__ import annotations

from collections.abc import Sequence

from boresight.reports.published import Comparison
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, value_of
from boresight.reports.schema.records import Record, find
from boresight.reports.statistics.measured import MEDIAN
from boresight.reports.statistics.paired import DIFFERENCES, FAILURE_RATE, OWN, PAIRED, THEIRS

_ERRORS = ("position_error_m", "attitude_error_deg")
_PAPER = (
    ("database_landmarks", "database", "count"),
    ("database_facets", "database", "count"),
    ("n_landmarks", "recognition", MEDIAN.name),
    ("position_error_m", "recognition", MEDIAN.name),
    ("attitude_error_deg", "recognition", MEDIAN.name),
)
_HEADS = (
    "scenario",
    "estimator",
    "landmarks",
    "facets",
    "landmarks an image",
    "position m [95 %]",
    "attitude deg [95 %]",
    "ok",
    "failures",
    "position against the first [95 %]",
    "attitude against the first [95 %]",
)
_NOTE = (
    "Size of each data base, medians of the number of recognised landmarks and of the errors after recognition,"
    " failures (no estimate, or a position error above the prior's), and the medians of the differences to the first"
    " line, trial by trial (negative is better)."
)


def mesh_variants(run: RunData) -> list[tuple[str, str]]:
    """List the scenario and estimator of each landmark mesh, in the order of the campaign, where there are several."""
    meshes = [product for product in run.manifest.products if product.n_facets is not None and product.database == 0]
    several = [
        scenario
        for scenario in dict.fromkeys(product.scenario for product in meshes)
        if len({product.folder for product in meshes if product.scenario == scenario}) > 1
    ]
    return [(product.scenario, product.estimator) for product in meshes if product.scenario in several]


def sensitivity_grid(
    records: Sequence[Record], pairs: Sequence[tuple[str, str]], paper: Comparison | None = None
) -> Grid | None:
    """Tabulate the size of several data bases and the errors that follow; None where there are not at least two.

    Parameters
    ----------
    records
        Of one run.
    pairs
        Scenario and estimator of each line, in their order.
    paper
        Its values make the first line.
    """
    if len(pairs) < 2:
        return None
    rows = [_line(records, scenario, label) for scenario, label in pairs]
    if paper is not None:
        rows.insert(0, _paper_line(paper))
    return Grid("Sensitivity of data base and errors", _HEADS, tuple(rows), frozenset({0, 1}), _NOTE)


def _line(records: Sequence[Record], scenario: str, label: str) -> tuple[str, ...]:
    mine = [r for r in records if r.scenario == scenario and r.estimator == label]
    first = [find(mine, stage="database", measure=f"database_{name}") for name in ("landmarks", "facets")]
    number = find(mine, measure="n_landmarks", statistic=MEDIAN.name)
    stage = number.stage if number else "recognition"
    errors = [find(mine, stage=stage, measure=name, statistic=MEDIAN.name) for name in _ERRORS]
    paired = [r for r in mine if r.stage == PAIRED]
    against = {r.reference for r in paired}
    key = {"reference": next(iter(against), "")}
    rates = find(paired, **key, measure=FAILURE_RATE, statistic=OWN)
    if rates is None:  # the first line, which the others are held against
        others = [r for r in records if (r.scenario, r.stage, r.reference) == (scenario, PAIRED, label)]
        rates = find(others, reference=label, measure=FAILURE_RATE, statistic=THEIRS)
    differences = [find(paired, **key, measure=name, statistic=MEDIAN.name) for name in DIFFERENCES]
    return (
        scenario,
        label,
        *(value_of(r) for r in first),
        value_of(number),
        *(value_of(r, interval=True) for r in errors),
        counts(errors[0]),
        value_of(rates),
        *(value_of(r, interval=True) for r in differences),
    )


def _paper_line(paper: Comparison) -> tuple[str, ...]:
    found = [paper.find(*key) for key in _PAPER]
    return ("", "the paper", *(value.printed if value else NO_VALUE for value in found), *[NO_VALUE] * 4)
