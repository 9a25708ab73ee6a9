"""Comparison of ways to build a data base: its size, and the resulting errors."""

from __future__ import annotations

from collections.abc import Sequence

from boresight.reports.published import Comparison
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, value_of
from boresight.reports.schema.records import Key, Record, by_key
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
    "scenario", "estimator", "landmarks", "facets", "landmarks an image", "position m [95 %]", "attitude deg [95 %]",
    "ok", "failures", "position against the first [95 %]", "attitude against the first [95 %]",
)  # fmt: skip
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
    known = by_key(records)
    found = [paper.find(*key) for key in _PAPER] if paper is not None else []
    rows = [("", "the paper", *(one.printed if one else NO_VALUE for one in found), *[NO_VALUE] * 4)] if found else []
    for scenario, label in pairs:
        own = [key for key in known if (key.scenario, key.estimator) == (scenario, label)]
        first = (key.stage for key in own if (key.measure, key.statistic) == ("n_landmarks", MEDIAN.name))
        solved = Key(scenario, label, next(first, "recognition"), "", "n_landmarks", MEDIAN.name)
        sizes = (Key(scenario, label, "database", "", f"database_{name}", "count") for name in ("landmarks", "facets"))
        errors = [known.get(solved._replace(measure=name)) for name in _ERRORS]
        against = next((key.reference for key in own if key.stage == PAIRED), "")
        paired = Key(scenario, label, PAIRED, against, FAILURE_RATE, OWN)
        # The first line has no rate of its own: it is with those of the others, which are held against it.
        theirs = (key for key in known if key[0] == scenario and key[2:] == (PAIRED, label, FAILURE_RATE, THEIRS))
        rates = known.get(paired) or next(map(known.get, theirs), None)
        differences = (known.get(paired._replace(measure=name, statistic=MEDIAN.name)) for name in DIFFERENCES)
        rows.append((
            scenario,
            label,
            *(value_of(known.get(key)) for key in (*sizes, solved)),
            *(value_of(one, interval=True) for one in errors),
            counts(errors[0]),
            value_of(rates),
            *(value_of(one, interval=True) for one in differences),
        ))  # fmt: skip
    return Grid("Sensitivity of data base and errors", _HEADS, tuple(rows), frozenset({0, 1}), _NOTE)
