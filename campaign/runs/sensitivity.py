"""Scenarios with keys varied together over a design of samples, run as one campaign with the same draws in all."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from SALib.sample import sobol
from scipy.stats import qmc

from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.read import CATALOG, read_source, sources
from boresight.reports.compare.global_sensitivity import (
    Sensitivity,
    VariedKey,
    outcome_of,
    rank_shares,
    salib_problem,
    same_results,
    sobol_shares,
)
from boresight.reports.run.data import RunData
from boresight.reports.schema.column import Measure
from boresight.reports.statistics.measured import Statistic
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_campaign, parse_override
from boresight.scenarios.spec.scenario import ScenarioSpec

BASE = "base"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_OVER = re.compile(rf"(?P<key>[\w.]+)=(?P<low>{_NUMBER}):(?P<high>{_NUMBER})")
_BOUNDS = ("min", "max")


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """Samples (n, K) of K varied keys, ``sobol`` or ``latin-hypercube``, and the campaign of their scenarios.

    The scenarios are the base, each key alone at its bounds, and the samples.
    """

    varied: tuple[VariedKey, ...]
    samples: FloatArray
    method: str
    campaign: ResolvedCampaign


def parse_over(text: str) -> VariedKey:
    """Read ``KEY=LOW:HIGH``; raise BoresightError if it is written otherwise or the range is empty."""
    found = _OVER.fullmatch(text.strip())
    if found is None:
        raise BoresightError(f"--over {text}: write it as KEY=LOW:HIGH, for example detector.read_noise_e=0:10")
    low, high = float(found["low"]), float(found["high"])
    if not low < high:
        raise BoresightError(f"--over {text}: {low:g} is not below {high:g}")
    return VariedKey(found["key"], low, high)


def draw_samples(varied: Sequence[VariedKey], n: int, method: str, seed: int) -> FloatArray:
    """Draw the samples, (n (K + 2), K) after Saltelli or (n, K) of a Latin hypercube.

    Raise BoresightError if Sobol's sequence is not balanced over so many.
    """
    if method == "latin-hypercube":
        unit = qmc.LatinHypercube(len(varied), rng=np.random.default_rng(seed)).random(n)
        return np.asarray(qmc.scale(unit, [v.low for v in varied], [v.high for v in varied]), dtype=np.float64)
    if n & (n - 1):
        raise BoresightError(f"--samples {n}: Sobol's sequence wants a power of two: give 8, 16, 32, ...")
    return np.asarray(sobol.sample(salib_problem(varied), n, calc_second_order=False, seed=seed), dtype=np.float64)


def make_design(
    name: str, resolved: ResolvedCampaign, chosen: str | None, varied: Sequence[VariedKey], n: int, method: str
) -> Design:
    """Make the scenarios of a design from one scenario of a campaign: the ``chosen`` one, or the only one.

    Raise BoresightError if it is unknown or not chosen, a key is unknown or named twice, or a value not allowed.
    """
    names = [one.spec.name for one in resolved.scenarios]
    if chosen is not None and chosen not in names:
        raise BoresightError(f"--scenario {chosen}: {name} has no such scenario; choose one of {', '.join(names)}")
    if chosen is None and len(names) > 1:
        raise BoresightError(f"{name}: has {len(names)} scenarios: vary one, by --scenario: {', '.join(names)}")
    number = 0 if chosen is None else names.index(chosen)
    keys = [one.key for one in varied]
    if len(set(keys)) < len(keys):
        raise BoresightError(f"--over {next(key for key in keys if keys.count(key) > 1)}: named twice")
    base = resolved.scenarios[number]
    samples = draw_samples(varied, n, method, resolved.seed)
    for column, one in zip(samples.T, varied, strict=True):
        if _is_whole(base.spec, one.key):
            column[:] = np.round(column)
    cells: dict[str, dict[str, float]] = {BASE: {}}
    for i, one in enumerate(varied):
        low, high = _ends(i)
        cells |= {low: {one.key: one.low}, high: {one.key: one.high}}
    cells |= {_sample(i): dict(zip(keys, row.tolist(), strict=True)) for i, row in enumerate(samples)}
    loaded = load_campaign(name, CATALOG)
    source, scenarios = sources(loaded.spec)[number], []
    for cell, values in cells.items():
        changes = [
            parse_override(_setting(base.spec, one, values[one.key]), f"--over {one.key}={one.low:g}:{one.high:g}")
            for one in varied
            if one.key in values
        ]
        found, _ = read_source(loaded, source, [*resolved.overrides, *changes])
        scenarios.append(replace(found, spec=found.spec.model_copy(update={"name": cell})))
    spec = resolved.spec.model_copy(update={"scenarios": (source.file,), "grid": None})
    campaign = replace(resolved, spec=spec, scenarios=tuple(scenarios), variations={})
    return Design(tuple(varied), samples, method, campaign)


def _ends(index: int) -> tuple[str, str]:
    """Name the scenarios with one key alone at its lower and at its upper bound."""
    return f"key-{index + 1}-low", f"key-{index + 1}-high"


def _sample(index: int) -> str:
    return f"sample-{index + 1:05d}"


def _value_at(spec: ScenarioSpec, key: str) -> object:
    value: object = spec.model_dump(mode="python")
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _is_whole(spec: ScenarioSpec, key: str) -> bool:
    value = _value_at(spec, key)
    return isinstance(value, int) and not isinstance(value, bool)


def _setting(spec: ScenarioSpec, one: VariedKey, value: float) -> str:
    """Write a value as ``--set`` does; ``KEY.max`` and ``KEY.min`` are bounds of a uniform distribution.

    A distribution that is symmetric about zero stays so.
    """
    key, _, last = one.key.rpartition(".")
    law = _value_at(spec, key) if last in _BOUNDS else None
    if isinstance(law, Mapping) and "uniform" in law:
        low, high = law["uniform"]
        if low == -high:
            low, high = -abs(value), abs(value)
        else:
            low, high = (value, high) if last == "min" else (low, value)
        return f"{key}={{uniform: [{low!r}, {high!r}]}}"
    number = int(value) if _is_whole(spec, one.key) else value
    return f"{one.key}={number!r}"


def analyse(
    run: RunData, design: Design, metric: Measure, statistic: Statistic, labels: Sequence[str]
) -> list[Sensitivity]:
    """Work out what the varied keys do to every estimator.

    Raise BoresightError if one failed in too many trials of a sample, and there is no prior to count them with.
    """
    ends, found = {one.key: _ends(i) for i, one in enumerate(design.varied)}, []
    for label in labels:
        value = {}
        for cell in (one.spec.name for one in design.campaign.scenarios):
            value[cell] = outcome_of(run, metric, statistic, cell, label)
            if not np.isfinite(value[cell]):
                raise BoresightError(
                    f"{run.folder}: {label} has no {statistic.name} of {metric.name} in {cell}, as it failed in too"
                    " many trials: narrow the ranges of --over, or give more --trials"
                )
        outcomes = np.array([value[_sample(i)] for i in range(len(design.samples))])
        alone = {key: (value[low], value[high]) for key, (low, high) in ends.items()}
        unmoved = [key for key, cells in ends.items() if all(same_results(run, BASE, c, label) for c in cells)]
        if design.method == "sobol":
            shares = sobol_shares(design.varied, outcomes, run.manifest.seed)
        else:
            shares = rank_shares(design.samples, outcomes)
        found.append(Sensitivity(label, value[BASE], outcomes, alone, shares, tuple(unmoved)))
    return found
