"""Accuracy and cost of each estimator: error, failures, time an image and size of the data base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData, StoredProduct, select
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.common import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.grid import NO_VALUE, Grid, number
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, share_of
from boresight.reports.tables import interval

POSITION, ATTITUDE = _ERRORS = "position_error_m", "attitude_error_deg"


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
    return {name: float(np.median(rows[f"prior_{name}"])) for name in _ERRORS}


_HEADS = (
    "scenario", "estimator", "ok", "position m [95 %]", "attitude deg [95 %]", "failures % [95 %]",
    "time an image ms", "landmarks", "data base kB", "bytes a landmark",
)  # fmt: skip
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
        rows.append((
            cost.scenario,
            cost.estimator,
            f"{cost.n_ok}/{cost.n}",
            interval(cost.position_m),
            interval(cost.attitude_deg),
            interval(cost.failed, 100.0),
            number(None if seconds is None else 1e3 * seconds),
            NO_VALUE if cost.landmarks is None else str(cost.landmarks),
            number(None if size is None else size / 1e3),
            number(None if size is None or not cost.landmarks else size / cost.landmarks),
        ))  # fmt: skip
    return Grid("Accuracy and its cost", _HEADS, tuple(rows), frozenset({0, 1}), _NOTE) if rows else None


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
    landmarks = _mean_of(products, [product.n_landmarks for product in products])
    size_bytes = _mean_of(products, [product.bytes for product in products])
    return Cost(
        scenario, estimator, position, attitude, len(ok), len(rows), failed, seconds, landmarks, size_bytes
    )  # fmt: skip


def _mean_of(products: Sequence[StoredProduct], counts: Sequence[int | None]) -> int | None:
    """Add a count up over the products of a data base, and take the mean over several data bases."""
    known = [number for number in counts if number is not None]
    return round(sum(known) / len({product.database for product in products})) if known else None
