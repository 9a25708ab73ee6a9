"""Table of all trials of the compared runs, the factors that define subjects, and which trials are the same.

Two trials are the same if they have the same seed and trial number and their scenarios agree in everything from which
views, priors and tracks are drawn. Other differences (a reflectance, a detector, knowledge on board) are compared.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.metrics import Metric, nothing_to_find, prior_values, trial_numbers
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.common import BORESIGHT, LATERAL, POSE_COLUMNS
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


def tabulate_trials(runs: Sequence[RunData], metric: Metric, factors: Sequence[str]) -> pd.DataFrame:
    """Tabulate the trials of all runs.

    Returns
    -------
    trials
        A row for each trial, scenario and estimator of a run, without those in which there was nothing to find, and
        without the prior where estimators are pooled, as it is none (`is_pooled_control`): the
        ``factors``, `KEY`, ``value`` of the metric (NaN without one), ``prior`` (the same of the prior, NaN where it
        has none), ``failed``, ``cluster`` (what is independent), and what is known of the trial's conditions.
    """
    named = zip(runs, run_names(runs), strict=True)
    table = pd.concat([_of_run(run, name, metric, factors) for run, name in named], ignore_index=True)
    for factor in keys_among(factors):
        levels = list(table[factor].unique())
        kinds = {one: one.split(" ", 1)[0] for one in levels}
        if len(set(kinds.values())) == len(kinds):  # a section's kind alone tells its values apart
            table[factor] = table[factor].map(kinds)
    return table


def _of_run(run: RunData, name: str, metric: Metric, factors: Sequence[str]) -> pd.DataFrame:
    rows, numbers, prior = run.rows, trial_numbers(run), prior_values(run, metric)
    value = numbers.get(metric.name, pd.Series(np.nan, index=rows.index))
    posed, seed = rows[f"prior_{POSE_COLUMNS[0]}"].notna().to_numpy(), str(run.manifest.seed)

    def by_scenario(text: Callable[[Mapping[str, Any]], str]) -> pd.Series:
        return rows["scenario"].map({name: text(spec) for name, spec in run.manifest.scenarios.items()})

    table = rows[["scenario", "estimator", "trial"]].assign(
        run=name,
        seed=seed,
        draws=by_scenario(drawn_settings),
        rest=by_scenario(lambda spec: remainder(spec, factors)) + ("" if ESTIMATOR in factors else rows["estimator"]),
        value=value,
        prior=np.nan if prior is None else prior,
        failed=np.where(posed, ~succeeded(rows), value.isna()) | value.isna(),
        cluster=np.char.add(f"{seed}:", clusters_of(run, rows).astype(str)),
        **{one: rows[one].astype(float) if one in rows else np.nan for one in CONDITIONS},
        **{one: numbers.get(one, np.nan) for one in (LATERAL, BORESIGHT, POSE_COLUMNS[1])},
    )
    for factor in keys_among(factors):
        table[factor] = by_scenario(partial(level_text, factor=factor))
    return table[~(nothing_to_find(run, metric) | is_pooled_control(run, factors))]


def run_names(runs: Sequence[RunData]) -> list[str]:
    """Name runs by their folders; by the whole paths where folders have the same name."""
    names = [run.folder.name for run in runs]
    return names if len(set(names)) == len(names) else [str(run.folder) for run in runs]


def keys_among(factors: Sequence[str]) -> list[str]:
    """Return the factors that are keys of the scenarios."""
    return [factor for factor in factors if factor not in NAME_FACTORS]


def is_pooled_control(run: RunData, factors: Sequence[str]) -> NDArray[np.bool_]:
    """Return which rows (n,) are of the control where it would be pooled with estimators; it estimates nothing."""
    control = np.asarray(run.rows["estimator"] == CONTROL)
    return np.asarray(control & (ESTIMATOR not in factors and not control.all()))


def check_factors(factors: Sequence[str], runs: Sequence[RunData]) -> None:
    """Refuse factors that are neither names nor keys of every scenario.

    Raises
    ------
    BoresightError
        The first such factor, and what there is in its place.
    """
    for factor in keys_among(factors):
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


def remainder(spec: Mapping[str, Any], factors: Sequence[str]) -> str:
    """Write the parts of a scenario that are not factors, as JSON; '' where its name is a factor."""
    if SCENARIO in factors:
        return ""
    left = json.loads(_json({key: value for key, value in spec.items() if key not in _NAMES}))
    for factor in keys_among(factors):
        *sections, last = factor.split(".")
        inner = left
        for section in sections:
            inner = inner[section]
        del inner[last]
    return _json(left)


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


def _json(value: object) -> str:
    return json.dumps(value, sort_keys=True)


def default_factors(trials: pd.DataFrame) -> tuple[str, ...]:
    """Return estimator and scenario, the run before them where several runs have the same ones of both."""
    runs = trials.groupby([ESTIMATOR, SCENARIO])[RUN].nunique()
    return (RUN, ESTIMATOR, SCENARIO) if (runs > 1).any() else (ESTIMATOR, SCENARIO)


def check_pairs(runs: Sequence[RunData]) -> None:
    """Refuse runs of which no trials are the same.

    Raises
    ------
    BoresightError
        Which two they are and what makes their trials different.
    """
    for one, other in combinations(runs, 2):
        seeds = one.manifest.seed, other.manifest.seed
        ours, theirs = one.manifest.scenarios, other.manifest.scenarios
        differences = [first_difference(a, b) for a in ours.values() for b in theirs.values()]
        if seeds[0] != seeds[1]:
            reason = f"their seeds are {seeds[0]} and {seeds[1]}"
        elif all(differences):
            named = [first_difference(ours[name], theirs[name]) for name in ours if name in theirs]
            reason = f"the views, priors or tracks of their scenarios differ: {(named or differences)[0]}"
        elif not set(one.rows["trial"]) & set(other.rows["trial"]):
            reason = "they have no trial in common"
        else:
            continue
        raise BoresightError(
            f"{one.folder} and {other.folder} cannot be compared trial by trial: {reason}: give --unpaired to"
            " compare them as independent samples"
        )


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
