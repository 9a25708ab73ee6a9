"""What the accuracy of single-image estimators costs: time an image and size of what they read, and who dominates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.column import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.grid import NO_VALUE, Grid, number, row_grid
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, share_of
from boresight.reports.statistics.paired import rate_difference
from boresight.reports.tables import interval

POSITION, ATTITUDE = ERRORS = "position_error_m", "attitude_error_deg"


@dataclass(frozen=True, slots=True)
class Cost:
    """An estimator of a scenario: what it attains, and what it takes.

    Errors are medians over the trials with an estimate, ``n_ok`` of ``n``; ``failed`` is the share without one or with
    a position error above the prior's. ``seconds`` is the median wall time of all its own stages of a trial.
    ``landmarks`` and ``size_bytes`` are of all that it reads, as it is stored, the mean over several data bases; None
    where it reads none. ``dominated_by`` is the first estimator that is better in every respect; '' if none is.
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
    dominated_by: str = ""


def costs(run: RunData) -> list[Cost]:
    """List the estimators of each scenario in which several are compared and a data base is read, in their order."""
    if all(product.bytes is None for product in run.manifest.products):
        return []
    pairs = [pair for pair in run.posed_pairs() if pair[1] != CONTROL]
    found = [_cost(run, *pair) for pair in sorted(pairs, key=lambda pair: run.place_of(pair[1]))]
    shown = []
    for scenario in dict.fromkeys(cost.scenario for cost in found):
        here = [cost for cost in found if cost.scenario == scenario]
        if len(here) > 1 and any(cost.size_bytes is not None for cost in here):
            own = {cost.estimator: _by_trial(run, cost) for cost in here}
            better = {
                one.estimator: [by.estimator for by in here if by is not one and _dominates(run, by, one, own)]
                for one in here
            }
            for one in here:
                # One that is on the front, if any: domination beyond intervals is not transitive.
                named = sorted(better[one.estimator], key=lambda name: bool(better[name]))
                shown.append(replace(one, dominated_by=next(iter(named), "")))
    return shown


def _by_trial(run: RunData, cost: Cost) -> pd.DataFrame:
    rows = run.of(cost.scenario, cost.estimator).set_index("trial", drop=False)
    return rows.assign(seconds=_seconds(run, cost.scenario, cost.estimator))


def _dominates(run: RunData, one: Cost, other: Cost, own: Mapping[str, pd.DataFrame]) -> bool:
    """Whether an estimator is better than another of its scenario, beyond the interval of each paired difference.

    Compared are both errors and the time, over the trials that both solved, the failure rate, and the size of the data
    base, which is exact. What is alike in every trial, as without any failure, decides nothing. One that reads a data
    base and one that reads none are not compared: what else is on board is not known.
    """
    sizes = one.size_bytes, other.size_bytes
    if (sizes[0] is None) != (sizes[1] is None) or (sizes[0] or 0) > (sizes[1] or 0):
        return False
    better = sizes[0] != sizes[1]
    for difference in _differences(run, own[one.estimator], own[other.estimator]):
        if difference.high is None or difference.high >= 0.0:
            return False
        better = True
    return better


def _differences(run: RunData, mine: pd.DataFrame, theirs: pd.DataFrame) -> Iterator[Measured]:
    """Yield the paired differences of errors, time and failure rate that are not 0 in every trial."""
    trials = mine.index.intersection(theirs.index)
    mine, theirs = mine.loc[trials], theirs.loc[trials]
    both = ((mine["status"] == "ok") & (theirs["status"] == "ok")).to_numpy()
    clusters = clusters_of(run, mine[["scenario", "trial"]])
    for name in (*ERRORS, "seconds"):
        difference = (mine[name] - theirs[name]).to_numpy(dtype=np.float64)
        known = both & np.isfinite(difference)
        if difference[known].any() or not known.any():
            yield from measure(difference[known], clusters[known], (MEDIAN,))
    failures = ~succeeded(mine), ~succeeded(theirs)
    if (failures[0] != failures[1]).any():
        yield rate_difference(*failures, clusters)


_NOTE = (
    "Medians over the trials with an estimate. Failures: no estimate, or a position error above the prior's. Time:"
    " median of all the estimator's own stages on the run's machine, the camera's image left out. Data base: its"
    " landmarks, maplets or features (each as often as it is in an image), and its size as it is stored: corners as"
    " text, maplets and features packed. Dominated by: an estimator that is better in both errors, failures and time,"
    " each beyond the 95 % interval of the difference over the same trials, with a data base that is no larger. What"
    " is alike in every trial decides nothing; one with a data base and one without are not compared. '-': on the"
    " Pareto front, or not shown to be off it."
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
            "dominated by": cost.dominated_by or NO_VALUE,
        })  # fmt: skip
    text = ("scenario", "estimator", "dominated by")
    return row_grid("Accuracy and its cost", rows, text, _NOTE) if rows else None


def _seconds(run: RunData, scenario: str, estimator: str) -> pd.Series[float]:
    """Sum the estimator's own stages by trial, s."""
    times = run.of(scenario, estimator, "timings")
    own = times[~times["stage"].isin([FRESH_IMAGE, STORED_IMAGE])]
    return own.groupby("trial", sort=False)["seconds"].sum()


def _cost(run: RunData, scenario: str, estimator: str) -> Cost:
    rows = run.of(scenario, estimator)
    ok = rows[rows["status"] == "ok"]
    position, attitude = (
        measure(ok[name].to_numpy(dtype=np.float64), clusters_of(run, ok), (MEDIAN,))[0] for name in ERRORS
    )
    # Times are of the trials with an estimate: one that stops early would look fast.
    total = _seconds(run, scenario, estimator)
    total = total[total.index.isin(ok["trial"])]
    units = clusters_of(run, pd.DataFrame({"scenario": scenario, "trial": total.index}))
    (seconds,) = measure(np.asarray(total, dtype=np.float64), units, (MEDIAN,))
    failed = share_of(~succeeded(rows), clusters_of(run, rows))
    products = [p for p in run.manifest.products if (p.scenario, p.estimator) == (scenario, estimator)]
    databases = len({product.database for product in products})
    counted = (
        [count for count in counts if count is not None]
        for counts in ([one.n_landmarks for one in products], [one.bytes for one in products])
    )
    landmarks, size_bytes = (round(sum(known) / databases) if known else None for known in counted)
    return Cost(scenario, estimator, position, attitude, len(ok), len(rows), failed, seconds, landmarks, size_bytes)
