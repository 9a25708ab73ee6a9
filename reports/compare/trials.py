"""All trials of the runs that are compared, in one table."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.compare.factors import (
    ESTIMATOR,
    NAME_FACTORS,
    RUN,
    drawn_settings,
    first_difference,
    level_text,
    remainder,
    short_levels,
)
from reports.compare.metrics import Metric, metric_values, nothing_to_find, prior_values
from reports.run.clusters import clusters_of
from reports.run.data import RunData
from reports.run.success import succeeded
from reports.schema.common import BORESIGHT, COMPONENTS, LATERAL, POSE_COLUMNS
from reports.schema.records import CONTROL
from scenarios.errors import BoresightError

KEY = ["seed", "draws", "rest", "trial"]
"""What is equal in two trials that are the same."""

CONDITIONS = ("range_m", "phase_deg", "latitude_deg", "n_landmarks")


def tabulate_trials(runs: Sequence[RunData], metric: Metric, factors: Sequence[str]) -> pd.DataFrame:
    """Lay the trials of runs side by side.

    Returns
    -------
    trials
        A row for each trial, scenario and estimator of a run, without those in which there was nothing to find, and
        without the prior where estimators are pooled, as it is none (`is_pooled_control`): the
        ``factors``, `KEY`, ``value`` of the metric (NaN without one), ``prior`` (the same of the prior, NaN where it
        has none), ``failed``, ``cluster`` (what is independent), and what is known of the trial's conditions.
    """
    table = pd.concat([_of_run(run, metric, factors) for run in runs], ignore_index=True)
    for factor in (factor for factor in factors if factor not in NAME_FACTORS):
        table[factor] = table[factor].map(short_levels(list(table[factor].unique())))
    return table


def _of_run(run: RunData, metric: Metric, factors: Sequence[str]) -> pd.DataFrame:
    rows, specs = run.rows, run.manifest.scenarios
    prior, value = prior_values(run, metric), metric_values(run, metric)
    posed = rows[f"prior_{POSE_COLUMNS[0]}"].notna().to_numpy()
    seed = str(run.manifest.seed)
    drawn = {name: drawn_settings(spec) for name, spec in specs.items()}
    rest = {name: remainder(spec, factors) for name, spec in specs.items()}
    beside = "" if "estimator" in factors else rows["estimator"]
    table = pd.DataFrame(
        {
            "run": run.folder.name,
            "scenario": rows["scenario"],
            "estimator": rows["estimator"],
            "trial": rows["trial"],
            "seed": seed,
            "draws": rows["scenario"].map(drawn),
            "rest": rows["scenario"].map(rest) + beside,
            "value": value,
            "prior": np.nan if prior is None else prior,
            "failed": np.where(posed, ~succeeded(rows), value.isna()) | value.isna(),
            "cluster": np.char.add(f"{seed}:", clusters_of(run, rows).astype(str)),
        }
    )
    for factor in (factor for factor in factors if factor not in NAME_FACTORS):
        table[factor] = rows["scenario"].map({name: level_text(spec, factor) for name, spec in specs.items()})
    for name in CONDITIONS:
        table[name] = rows[name].astype(float) if name in rows else np.nan
    for name in (LATERAL, BORESIGHT, POSE_COLUMNS[1]):
        known = all(column in rows for column in COMPONENTS.get(name, (name,)))
        table[name] = metric_values(run, Metric(name)) if known else np.nan
    return table[~(nothing_to_find(run, metric) | is_pooled_control(run, factors))]


def is_pooled_control(run: RunData, factors: Sequence[str]) -> NDArray[np.bool_]:
    """Tell the rows (n,) of the control, which estimates nothing, where it would be pooled with estimators."""
    control = np.asarray(run.rows["estimator"] == CONTROL)
    return np.asarray(control & (ESTIMATOR not in factors and not control.all()))


def all_factors(factors: Sequence[str], trials: pd.DataFrame) -> tuple[str, ...]:
    """Return the factors, the run before them where several runs hold the same trials of a subject."""
    twice = trials.duplicated([*factors, *KEY]).any()
    return (RUN, *factors) if twice and RUN not in factors else tuple(factors)


def check_pairs(runs: Sequence[RunData]) -> None:
    """Refuse runs of which no trials are the same.

    Raises
    ------
    BoresightError
        Which two they are and what makes their trials different.
    """
    for one, other in combinations(runs, 2):
        reason = _why_different(one, other)
        if reason:
            raise BoresightError(
                f"{one.folder} and {other.folder} cannot be compared trial by trial: {reason}: give --unpaired to"
                " compare them as independent samples"
            )


def _why_different(one: RunData, other: RunData) -> str:
    seeds = one.manifest.seed, other.manifest.seed
    if seeds[0] != seeds[1]:
        return f"their seeds are {seeds[0]} and {seeds[1]}"
    ours, theirs = one.manifest.scenarios, other.manifest.scenarios
    differences = [first_difference(a, b) for a in ours.values() for b in theirs.values()]
    if all(differences):
        named = [first_difference(ours[name], theirs[name]) for name in ours if name in theirs]
        return f"the views, priors or tracks of their scenarios differ: {(named or differences)[0]}"
    return "" if set(one.rows["trial"]) & set(other.rows["trial"]) else "they have no trial in common"
