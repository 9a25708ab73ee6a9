"""Accuracy and cost of each estimator: error, failures, time an image and size of the data base."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData, StoredProduct, select
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.grid import NO_VALUE, Grid, number
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, share_of
from boresight.reports.tables import interval

POSITION, ATTITUDE = "position_error_m", "attitude_error_deg"
_IMAGE_STAGES = ("image", "stored_image")
_KILO = 1e3


@dataclass(frozen=True, slots=True)
class Cost:
    """An estimator of a scenario: what it attains, and what it takes.

    Parameters
    ----------
    scenario, estimator
        Whose.
    position_m, attitude_deg
        Medians of the errors with their intervals, over the trials with an estimate.
    n_ok, n
        Trials with an estimate, and all.
    failed
        Share of trials without an estimate or with a position error above the prior's.
    seconds
        Median wall time of all its own stages of a trial.
    landmarks, size_bytes
        Of all that it reads, as it is stored, the mean over several data bases; None where it reads none.
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
    order = {str(label): place for place, label in enumerate(run.manifest.estimators)}
    pairs = [pair for pair in run.posed_pairs() if pair[1] != CONTROL]
    found = [_cost(run, *pair) for pair in sorted(pairs, key=lambda pair: order.get(pair[1], len(order)))]
    shown = []
    for scenario in dict.fromkeys(cost.scenario for cost in found):
        here = [cost for cost in found if cost.scenario == scenario]
        if len(here) > 1 and any(cost.size_bytes is not None for cost in here):
            shown += here
    return shown


def prior_medians(run: RunData, scenario: str) -> dict[str, float]:
    """Medians of the prior's errors over all trials of a scenario, by `POSITION` and `ATTITUDE`."""
    rows = run.rows[run.rows["scenario"] == scenario].drop_duplicates("trial")
    return {name: float(np.median(rows[f"prior_{name}"])) for name in (POSITION, ATTITUDE)}


def trade_grid(run: RunData) -> Grid | None:
    """Tabulate accuracy and cost; None without two estimators of which one has a data base."""
    rows = tuple(tuple(_cells(cost)) for cost in costs(run))
    heads = (
        "scenario", "estimator", "ok", "position m [95 %]", "attitude deg [95 %]", "failures % [95 %]",
        "time an image ms", "landmarks", "data base kB", "bytes a landmark",
    )  # fmt: skip
    note = (
        "Medians over the trials with an estimate. Failures: no estimate, or a position error above the prior's. Time:"
        " median of all the estimator's own stages, the camera's image left out. Data base: its landmarks, maplets or"
        " features (each as often as it is in an image), and its size as it is stored: corners as text, maplets and"
        " features packed."
    )
    return Grid("Accuracy and its cost", heads, rows, frozenset({0, 1}), note) if rows else None


def _cost(run: RunData, scenario: str, estimator: str) -> Cost:
    rows = select(run.rows, scenario, estimator)
    ok = rows[rows["status"] == "ok"]
    position, attitude = (
        measure(ok[name].to_numpy(dtype=np.float64), clusters_of(run, ok), (MEDIAN,))[0]
        for name in (POSITION, ATTITUDE)
    )
    products = [p for p in run.manifest.products if (p.scenario, p.estimator) == (scenario, estimator)]
    return Cost(
        scenario,
        estimator,
        position,
        attitude,
        len(ok),
        len(rows),
        share_of(~succeeded(rows), clusters_of(run, rows)),
        _seconds(run, ok),
        _mean_of(products, lambda product: product.n_landmarks),
        _mean_of(products, lambda product: product.bytes),
    )


def _seconds(run: RunData, ok: pd.DataFrame) -> Measured:
    """Median over the trials with an estimate; one that stops early would look fast."""
    if ok.empty:
        return Measured(None)
    times = select(run.table("timings"), str(ok["scenario"].iloc[0]), str(ok["estimator"].iloc[0]))
    own = times[~times["stage"].isin(_IMAGE_STAGES) & times["trial"].isin(ok["trial"])]
    total = own.groupby(["scenario", "trial"], sort=False)[["seconds"]].sum().reset_index()
    return measure(total["seconds"].to_numpy(dtype=np.float64), clusters_of(run, total), (MEDIAN,))[0]


def _mean_of(products: Sequence[StoredProduct], count: Callable[[StoredProduct], int | None]) -> int | None:
    """Add a count up over the products of a data base, and take the mean over several data bases."""
    known = [number for number in map(count, products) if number is not None]
    return round(sum(known) / len({product.database for product in products})) if known else None


def _cells(cost: Cost) -> Iterator[str]:
    size = cost.size_bytes
    yield from (cost.scenario, cost.estimator, f"{cost.n_ok}/{cost.n}")
    yield from (interval(cost.position_m), interval(cost.attitude_deg), interval(cost.failed, 100.0))
    yield number(None if cost.seconds.value is None else 1e3 * cost.seconds.value)
    yield NO_VALUE if cost.landmarks is None else str(cost.landmarks)
    yield number(None if size is None else size / _KILO)
    yield number(None if size is None or not cost.landmarks else size / cost.landmarks)
