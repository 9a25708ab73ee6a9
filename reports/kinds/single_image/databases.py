"""Data bases of landmarks: accuracy and cost of the estimators that read them, and ways to build one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.reports.published import Comparison
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData, select
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.column import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, number, row_grid, value_of
from boresight.reports.schema.records import CONTROL, Key, Record, by_key
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, share_of
from boresight.reports.statistics.paired import DIFFERENCES, FAILURE_RATE, OWN, PAIRED, THEIRS
from boresight.reports.tables import interval

POSITION, ATTITUDE = _ERRORS = "position_error_m", "attitude_error_deg"


@dataclass(frozen=True, slots=True)
class Cost:
    """An estimator of a scenario: what it attains, and what it takes.

    Errors are medians over the trials with an estimate, ``n_ok`` of ``n``; ``failed`` is the share without one or with
    a position error above the prior's. ``seconds`` is the median wall time of all its own stages of a trial.
    ``landmarks`` and ``size_bytes`` are of all that it reads, as it is stored, the mean over several data bases; None
    where it reads none.
    """

    scenario: str
    estimator: str
    position_m: Measured
    attitude_deg: Measured
    n_ok: int
    n: int
    failed: Measured
    seconds: Measured
    landmarks: int | None
    size_bytes: int | None


def costs(run: RunData) -> list[Cost]:
    """List the estimators of each scenario in which several are compared and a data base is read, in their order."""
    pairs = [pair for pair in run.posed_pairs() if pair[1] != CONTROL]
    found = [_cost(run, *pair) for pair in sorted(pairs, key=lambda pair: run.place_of(pair[1]))]
    shown = []
    for scenario in dict.fromkeys(cost.scenario for cost in found):
        here = [cost for cost in found if cost.scenario == scenario]
        if len(here) > 1 and any(cost.size_bytes is not None for cost in here):
            shown += here
    return shown


def prior_medians(run: RunData, scenario: str) -> dict[str, float]:
    """Medians of the prior's errors over all trials of a scenario, by `POSITION` and `ATTITUDE`."""
    rows = run.rows[run.rows["scenario"] == scenario].drop_duplicates("trial")
    return {name: float(np.median(rows[f"prior_{name}"])) for name in _ERRORS}


_NOTE = (
    "Medians over the trials with an estimate. Failures: no estimate, or a position error above the prior's. Time:"
    " median of all the estimator's own stages, the camera's image left out. Data base: its landmarks, maplets or"
    " features (each as often as it is in an image), and its size as it is stored: corners as text, maplets and"
    " features packed."
)


def trade_grid(run: RunData) -> Grid | None:
    """Tabulate accuracy and cost; None without two estimators of which one has a data base."""
    rows = []
    for cost in costs(run):
        size, seconds = cost.size_bytes, cost.seconds.value
        rows.append({
            "scenario": cost.scenario,
            "estimator": cost.estimator,
            "ok": f"{cost.n_ok}/{cost.n}",
            "position m [95 %]": interval(cost.position_m),
            "attitude deg [95 %]": interval(cost.attitude_deg),
            "failures % [95 %]": interval(cost.failed, 100.0),
            "time an image ms": number(None if seconds is None else 1e3 * seconds),
            "landmarks": NO_VALUE if cost.landmarks is None else str(cost.landmarks),
            "data base kB": number(None if size is None else size / 1e3),
            "bytes a landmark": number(None if size is None or not cost.landmarks else size / cost.landmarks),
        })  # fmt: skip
    return row_grid("Accuracy and its cost", rows, ("scenario", "estimator"), _NOTE) if rows else None


def _cost(run: RunData, scenario: str, estimator: str) -> Cost:
    rows = select(run.rows, scenario, estimator)
    ok = rows[rows["status"] == "ok"]
    position, attitude = (
        measure(ok[name].to_numpy(dtype=np.float64), clusters_of(run, ok), (MEDIAN,))[0] for name in _ERRORS
    )
    # Times are of the trials with an estimate: one that stops early would look fast.
    times = select(run.table("timings"), scenario, estimator)
    own = times[~times["stage"].isin([FRESH_IMAGE, STORED_IMAGE]) & times["trial"].isin(ok["trial"])]
    total = own.groupby(["scenario", "trial"], sort=False)[["seconds"]].sum().reset_index()
    (seconds,) = measure(total["seconds"].to_numpy(dtype=np.float64), clusters_of(run, total), (MEDIAN,))
    failed = share_of(~succeeded(rows), clusters_of(run, rows))
    products = [p for p in run.manifest.products if (p.scenario, p.estimator) == (scenario, estimator)]
    databases = len({product.database for product in products})
    counted = (
        [count for count in counts if count is not None]
        for counts in ([one.n_landmarks for one in products], [one.bytes for one in products])
    )
    landmarks, size_bytes = (round(sum(known) / databases) if known else None for known in counted)
    return Cost(scenario, estimator, position, attitude, len(ok), len(rows), failed, seconds, landmarks, size_bytes)


_PAPER = (
    ("database_landmarks", "database", "count"),
    ("database_facets", "database", "count"),
    ("n_landmarks", "recognition", MEDIAN.name),
    ("position_error_m", "recognition", MEDIAN.name),
    ("attitude_error_deg", "recognition", MEDIAN.name),
)
_SIZE_HEADS = (
    "scenario", "estimator", "landmarks", "facets", "landmarks an image", "position m [95 %]", "attitude deg [95 %]",
    "ok", "failures", "position against the first [95 %]", "attitude against the first [95 %]",
)  # fmt: skip
_SIZE_NOTE = (
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

    ``records`` are of one run, ``pairs`` scenario and estimator of each line, in their order. The values of a ``paper``
    make the first line.
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
    return Grid("Sensitivity of data base and errors", _SIZE_HEADS, tuple(rows), frozenset({0, 1}), _SIZE_NOTE)
