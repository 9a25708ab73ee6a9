"""Table of all trials of the compared runs: the metric of each, the factors of subjects, and which trials are the same.

A metric is a number of each trial; a failure counts with the prior's number where there is one. Two trials are the same
if they have the same seed and trial number and their scenarios agree in everything from which views, priors and tracks
are drawn. Other differences (a reflectance, a detector, knowledge on board) are compared.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import TRIAL_KEY, RunData, in_order_of, value_at
from boresight.reports.run.outcomes import revolution_ends, succeeded
from boresight.reports.schema.column import BORESIGHT, COMPONENTS, LATERAL, POSE_COLUMNS, POSE_METRICS, SIGHT, Measure
from boresight.reports.schema.craters import CENTRE_ERROR, COMMON_CENTRE_ERROR, MISSED, WRONG
from boresight.reports.schema.kinds import ORBIT_COLUMNS, SEQUENCE_COLUMNS
from boresight.reports.schema.records import CONTROL
from boresight.reports.schema.tables import AFTER_REVOLUTIONS, kind_schema, measure_of
from boresight.scenarios.errors import BoresightError


@lru_cache(maxsize=1)
def trial_numbers(run: RunData) -> Mapping[str, pd.Series]:
    """Return all numbers by which trials of a run can be compared, each in the order of its rows; NaN for none.

    They are the errors of poses, what rows hold of whole sequences, ``error_after_K_m`` (of sequences, after K
    revolutions), the errors of orbits, shares and errors of craters, other metrics of the kind of trial that its rows
    have, and the numbers that estimators report. Signed errors count by their size; all but the numbers reported and
    those of sequences are of trials with an estimate.
    """
    rows, epochs, orbits, reported = run.rows, run.table("epochs"), run.table("orbits"), run.table("diagnostics")
    ok, found = rows["status"] == "ok", dict[str, pd.Series]()
    for name in POSE_METRICS:
        size = _size(rows, "", name)
        if size.notna().any():
            found[name] = size.where(ok)
    sight_m = _sight_error_m(rows)
    if sight_m.notna().any():
        found[SIGHT] = sight_m.where(ok)
    found |= {name: rows[name].astype(float) for name in SEQUENCE_COLUMNS if rows[name].notna().any()}
    for k, ends in revolution_ends(epochs):
        found.setdefault(f"error_after_{k}_m", in_order_of(rows, ends, ["position_error_m"])["position_error_m"])
    measured, counts = in_order_of(rows, orbits, list(ORBIT_COLUMNS)), crater_counts(run)
    if counts is not None:
        measured = counts[list(kind_schema(run.manifest.experiment).metrics)]
    for label, values in measured.items():
        if values.notna().any():
            found.setdefault(str(label), values.where(ok).abs())
    for name in kind_schema(run.manifest.experiment).metrics:
        if name in rows and rows[name].notna().any():
            found.setdefault(name, rows[name].astype(float).where(ok).abs())
    once = reported.drop_duplicates([*TRIAL_KEY, "name"])
    numbers = once.pivot(index=TRIAL_KEY, columns="name", values="value")  # noqa: PD010  pivot_table drops NaN
    for label, values in in_order_of(rows, numbers.reset_index(), sorted(map(str, numbers))).items():
        found.setdefault(str(label), values)
    return found


def metric_values(run: RunData, metric: Measure) -> pd.Series:
    """Return the metric of every row of a run, in the order of its rows; NaN where a trial has none."""
    return trial_numbers(run).get(metric.name, pd.Series(np.nan, index=run.rows.index))


def prior_values(run: RunData, metric: Measure) -> pd.Series | None:
    """Return the same of the prior, known of every trial with one; None of a metric that the prior has not.

    The line of sight of the prior is that of the estimator ``prior``, if it is in the run.
    """
    if metric.name == SIGHT and CONTROL in run.manifest.estimators:
        of_prior = run.rows.assign(value=_sight_error_m(run.rows))[run.rows["estimator"] == CONTROL]
        by_trial = of_prior.set_index(["scenario", "trial"])["value"]
        trials = pd.MultiIndex.from_frame(run.rows[["scenario", "trial"]])
        return pd.Series(by_trial.reindex(trials).to_numpy(), index=run.rows.index)
    if metric.name not in POSE_METRICS or run.rows[f"prior_{POSE_COLUMNS[0]}"].isna().all():
        return None
    return _size(run.rows, "prior_", metric.name)


def failures(rows: pd.DataFrame, value: pd.Series, prior: pd.Series | None) -> pd.Series:
    """Return which rows have no value of a metric, or one above that of the prior, see `prior_values`.

    Where that of the prior is not known, the position error decides. A method of the line of sight keeps the attitude,
    which moves the position.
    """
    posed = rows[f"prior_{POSE_COLUMNS[0]}"].notna()
    worse = ~succeeded(rows) if prior is None else value > _ROUNDED * prior
    return value.isna() | (posed & worse)


def nothing_to_find(run: RunData, metric: Measure) -> pd.Series:
    """Return which rows of a run cannot have the metric: no crater could be found, or none was found by all methods."""
    counts = crater_counts(run)
    if counts is None or metric.name not in counts:
        return pd.Series(False, index=run.rows.index)
    there = counts["common" if metric.name == COMMON_CENTRE_ERROR else "there"]
    return (there == 0.0) & (run.rows["status"] != "error") & metric_values(run, metric).isna()


def choose_metric(name: str | None, runs: Sequence[RunData]) -> Measure:
    """Take the named metric; without a name the usual one of the kind of trial, or else the first that a run has.

    Of sequences it is the position error after the last whole revolution. Raises `BoresightError` if a run has no such
    number; the message lists what it has.
    """
    for run in runs:
        known = list(trial_numbers(run))
        if not known:
            raise BoresightError(f"{run.folder}: its trials have no number to go by; see boresight report {run.folder}")
        after = [int(found[1]) for found in map(AFTER_REVOLUTIONS.fullmatch, known) if found]
        usual = kind_schema(run.manifest.experiment).metrics[0]
        if name is None and after and not run.table("epochs").empty:
            name = f"error_after_{max(after)}_m"
        elif name is None:
            name = usual if usual in known else known[0]
        if name not in known:
            raise BoresightError(f"--metric {name}: {run.folder} has no such number: choose one of {', '.join(known)}")
    return measure_of(name or POSE_COLUMNS[0])


def missed_or_wrong(run: RunData) -> pd.Series | None:
    """Count missed and wrong craters of each row of a run, in order; None of a run without detections or matches."""
    counts = crater_counts(run)
    return None if counts is None else counts["missed"] + counts["wrong"]


def crater_counts(run: RunData) -> pd.DataFrame | None:
    """Count craters in images for each row of a run, in order; None of a kind of trial without missed craters.

    Columns: ``there`` (craters that could be found, or matched), ``missed`` of them, ``right`` and ``wrong``
    (detections that reach the detector's own threshold, or matches). Then the metrics of the kind: shares (%), NaN
    where they have a zero denominator, and, of detections, the median errors of the centres of those that are right,
    and of the craters that all methods found, which are ``common``.
    """
    rows, metrics = run.rows, kind_schema(run.manifest.experiment).metrics
    if MISSED not in metrics or run.table("crater_matches" if WRONG in metrics else "crater_images").empty:
        return None
    if WRONG in metrics:
        columns = {"n_common": "there", "n_missed": "missed", "n_correct": "right", "n_wrong": "wrong"}
        counts = in_order_of(rows, run.table("crater_matches"), list(columns)).rename(columns=columns)
    else:
        image, counted = ["scenario", "trial"], ["right", "wrong", "common"]
        kept = run.table("detections")[run.table("detections")["kept"].astype(bool)]
        right, error = kept["detectable"].astype(bool), kept[CENTRE_ERROR].astype(float)
        finders = kept[right].groupby([*image, "crater"])["estimator"].transform("nunique").reindex(kept.index)
        common = finders == kept["scenario"].map(rows.groupby("scenario")["estimator"].nunique())
        centres = {CENTRE_ERROR: error.where(right), COMMON_CENTRE_ERROR: error.where(common)}
        marked = kept.assign(right=right, wrong=kept["crater"] < 0, common=common, **centres)
        how = dict.fromkeys(counted, "sum") | dict.fromkeys(centres, "median")
        counts = in_order_of(rows, marked.groupby(TRIAL_KEY, as_index=False).agg(how), list(how))
        counts[counted] = counts[counted].fillna(0.0)
        counts["there"] = rows[image].merge(run.table("crater_images"), "left", image)["n_detectable"].to_numpy(float)
        counts["missed"] = counts["there"] - counts["right"]
    found = counts["right"] + counts["wrong"]
    counts[MISSED] = 100.0 * counts["missed"] / counts["there"].where(counts["there"] > 0)
    counts[metrics[1]] = 100.0 * counts["wrong"] / found.where(found > 0)
    return counts


def _size(rows: pd.DataFrame, prefix: str, name: str) -> pd.Series:
    """Return the length of an error of poses, from the columns that are its components."""
    columns = [f"{prefix}{column}" for column in COMPONENTS.get(name, (name,))]
    return pd.Series(np.linalg.norm(rows[columns].to_numpy(dtype=np.float64), axis=1), index=rows.index)


def _sight_error_m(rows: pd.DataFrame) -> pd.Series:
    """Return the true range times the angle between the estimated and the true direction to the body's origin, m."""
    columns = ([f"{of}t{axis}_m" for axis in "xyz"] for of in ("", "true_"))
    found, true = (rows.reindex(columns=names).to_numpy(dtype=np.float64) for names in columns)
    sizes = np.linalg.norm(found, axis=1)
    sine_m = np.linalg.norm(np.cross(found, true), axis=1) / sizes
    ranges_m = np.linalg.norm(true, axis=1)
    angles_rad = np.arctan2(sine_m, (found * true).sum(axis=1) / sizes)
    return pd.Series(ranges_m * angles_rad, index=rows.index)


KEY = ["seed", "draws", "rest", "trial"]
"""Columns that are equal in two trials that are the same."""

CONDITIONS = ("range_m", "phase_deg", "latitude_deg", "n_landmarks")

ESTIMATOR, SCENARIO, RUN = "estimator", "scenario", "run"
NAME_FACTORS = (ESTIMATOR, SCENARIO, RUN)
NAMES = ("name", "description")
"""Keys of a scenario that change no result."""
_DRAWN = ("viewpoint", "lighting", "pose_error", "images", "sequence")
_MISSING = object()
_ROUNDED = 1.0 + 1e-9


def tabulate_trials(runs: Sequence[RunData], metric: Measure, factors: Sequence[str]) -> pd.DataFrame:
    """Tabulate the trials of all runs: a row for each trial, scenario and estimator of a run.

    Trials in which there was nothing to find are left out, and the prior where estimators are pooled, as it is none
    (`is_pooled_control`). Columns: the ``factors``, `KEY`, ``value`` of the metric (NaN without one), ``prior`` (the
    same of the prior, NaN where it has none), ``failed``, ``cluster`` (what is independent), and what is known of the
    trial's conditions.
    """
    named = zip(runs, run_names(runs), strict=True)
    table = pd.concat([_of_run(run, name, metric, factors) for run, name in named], ignore_index=True)
    for factor in keys_among(factors):
        levels = list(table[factor].unique())
        kinds = {one: one.split(" ", 1)[0] for one in levels}
        if len(set(kinds.values())) == len(kinds):  # a section's kind alone tells its values apart
            table[factor] = table[factor].map(kinds)
    return table


def _of_run(run: RunData, name: str, metric: Measure, factors: Sequence[str]) -> pd.DataFrame:
    rows, numbers, prior = run.rows, trial_numbers(run), prior_values(run, metric)
    value = numbers.get(metric.name, pd.Series(np.nan, index=rows.index))
    seed = str(run.manifest.seed)

    def by_scenario(text: Callable[[Mapping[str, Any]], str]) -> pd.Series:
        return rows["scenario"].map({name: text(spec) for name, spec in run.manifest.scenarios.items()})

    table = rows[["scenario", "estimator", "trial"]].assign(
        run=name,
        seed=seed,
        draws=by_scenario(drawn_settings),
        rest=by_scenario(lambda spec: remainder(spec, factors)) + ("" if ESTIMATOR in factors else rows["estimator"]),
        value=value,
        prior=np.nan if prior is None else prior,
        failed=failures(rows, value, prior),
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
    """Raise `BoresightError` for the first factor that is neither a name nor a key of every scenario."""
    for factor in keys_among(factors):
        for run in runs:
            for name, spec in run.manifest.scenarios.items():
                if value_at(spec, factor, _MISSING) is _MISSING:
                    sections = ", ".join(key for key in spec if key not in NAMES)
                    raise BoresightError(
                        f"--by {factor}: the scenario {name} of {run.folder} has no such key: give"
                        f" {', '.join(NAME_FACTORS)} or a key of the scenarios ({sections})"
                    )


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
    left = json.loads(json_text({key: value for key, value in spec.items() if key not in NAMES}))
    for factor in keys_among(factors):
        *sections, last = factor.split(".")
        inner = left
        for section in sections:
            inner = inner[section]
        del inner[last]
    return json_text(left)


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
    return json_text({name: spec.get(name) for name in names})


def json_text(value: object) -> str:
    """Write a value as JSON, its keys sorted."""
    return json.dumps(value, sort_keys=True)


def default_factors(trials: pd.DataFrame) -> tuple[str, ...]:
    """Return estimator and scenario, the run before them where several runs have the same ones of both."""
    runs = trials.groupby([ESTIMATOR, SCENARIO])[RUN].nunique()
    return (RUN, ESTIMATOR, SCENARIO) if (runs > 1).any() else (ESTIMATOR, SCENARIO)


def check_pairs(runs: Sequence[RunData]) -> None:
    """Raise `BoresightError` for the first two runs of which no trials are the same, with what makes them differ."""
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
    return next((f"{key} is {' and '.join(map(json_text, values))}" for key, values in differences(pair)), "")


def differences(values: Sequence[object], path: str = "") -> Iterator[tuple[str, Sequence[object]]]:
    """Yield the dotted keys in which sections differ, each with the value in every one of them; None for no value."""
    sections = [value for value in values if isinstance(value, dict)]
    if len(sections) == len(values):
        for key in dict.fromkeys(key for section in sections for key in section):
            yield from differences([section.get(key) for section in sections], f"{path}.{key}" if path else key)
    elif any(value != values[0] for value in values[1:]):
        yield path, values
