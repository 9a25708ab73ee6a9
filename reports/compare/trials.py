"""Table of all trials of the compared runs, the factors that define subjects, and which trials are the same.

Two trials are the same if they have the same seed and trial number and their scenarios agree in everything from which
views, priors and tracks are drawn. Other differences (a reflectance, a detector, knowledge on board) are compared.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.metrics import Metric, metric_values, nothing_to_find, prior_values
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.common import BORESIGHT, COMPONENTS, LATERAL, POSE_COLUMNS
from boresight.reports.schema.records import CONTROL
from boresight.scenarios.errors import BoresightError

KEY = ["seed", "draws", "rest", "trial"]
"""Columns that are equal in two trials that are the same."""

CONDITIONS = ("range_m", "phase_deg", "latitude_deg", "n_landmarks")

ESTIMATOR, SCENARIO, RUN = "estimator", "scenario", "run"
NAME_FACTORS = (ESTIMATOR, SCENARIO, RUN)
_NAMES = ("name", "description")
_DRAWN = ("viewpoint", "lighting", "pose_error", "images", "sequence")
_MISSING = object()


def check_factors(factors: Sequence[str], runs: Sequence[RunData]) -> None:
    """Refuse factors that are neither names nor keys of every scenario.

    Raises
    ------
    BoresightError
        The first such factor, and what there is in its place.
    """
    for factor in factors:
        if factor in NAME_FACTORS:
            continue
        for run in runs:
            for name, spec in run.manifest.scenarios.items():
                if value_at(spec, factor) is _MISSING:
                    sections = ", ".join(key for key in spec if key not in _NAMES)
                    raise BoresightError(
                        f"--by {factor}: the scenario {name} of {run.folder} has no such key: give"
                        f" {', '.join(NAME_FACTORS)} or a key of the scenarios ({sections})"
                    )


def value_at(spec: Mapping[str, Any], key: str) -> object:
    """Look a dotted key up; `_MISSING` where there is none."""
    value: object = spec
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return _MISSING
        value = value[part]
    return value


def level_text(spec: Mapping[str, Any], factor: str) -> str:
    """Print a scenario's value of a key: a section by its kind and its other keys."""
    value = value_at(spec, factor)
    if not isinstance(value, Mapping):
        return str(value)
    rest = [f"{name} {part}" for name, part in value.items() if name != "kind" and part is not None]
    return " ".join(filter(None, (str(value.get("kind", "")), ", ".join(rest))))


def short_levels(levels: Sequence[str]) -> dict[str, str]:
    """Shorten values of sections to their kinds where these alone tell them apart."""
    kinds = {one: one.split(" ", 1)[0] for one in levels}
    return kinds if len(set(kinds.values())) == len(kinds) else {one: one for one in levels}


def remainder(spec: Mapping[str, Any], factors: Sequence[str]) -> str:
    """Write the parts of a scenario that are not factors, as JSON; '' where its name is a factor."""
    if SCENARIO in factors:
        return ""
    left = {key: value for key, value in spec.items() if key not in _NAMES}
    for factor in (factor for factor in factors if factor not in NAME_FACTORS):
        left = _without(left, factor.split("."))
    return _json(left)


def _without(spec: Mapping[str, Any], path: Sequence[str]) -> dict[str, Any]:
    first, *further = path
    left = dict(spec)
    inner = left.pop(first)
    return {**left, first: _without(inner, further)} if further else left


def drawn_settings(spec: Mapping[str, Any]) -> str:
    """Write the parts of a scenario on which the random draws of its trials depend, as JSON.

    The camera is part of it where views or priors are drawn in its pixels, the body where landmarks or views are.
    """
    viewpoint, pose_error = (spec.get(name) or {} for name in ("viewpoint", "pose_error"))
    sequence = spec.get("sequence") or {}
    in_sight = viewpoint.get("keep_clear_px") is not None
    in_pixels = in_sight or pose_error.get("position_cam_px") is not None or bool(sequence)
    on_body = in_sight or (bool(sequence) and sequence.get("sphere_radius_m") is None)
    names = (*_DRAWN, *(["camera"] if in_pixels else []), *(["body"] if on_body else []))
    return _json({name: spec.get(name) for name in names})


def first_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return the first key in which the draws of two scenarios differ, with both values; '' if none."""
    pair = (json.loads(drawn_settings(one)), json.loads(drawn_settings(other)))
    return next(_differences(*pair), "")


def _differences(one: object, other: object, path: str = "") -> Iterator[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys([*one, *other]):
            yield from _differences(one.get(key), other.get(key), f"{path}.{key}" if path else key)
    elif one != other:
        yield f"{path} is {_json(one)} and {_json(other)}"


def _json(value: object) -> str:
    return json.dumps(value, sort_keys=True)


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
    """Return which rows (n,) are of the control where it would be pooled with estimators; it estimates nothing."""
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
