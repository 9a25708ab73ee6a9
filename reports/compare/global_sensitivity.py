"""Global sensitivity: the share of an outcome's variance that each varied key of a scenario explains, and its figure.

Sobol's indices by the estimators of Saltelli and Jansen (A. Saltelli et al., Variance based sensitivity analysis of
model output, Computer Physics Communications 181, 2010), as SALib implements them: the first-order index is the share
of the variance that a key explains by itself, the total index the share that remains when all other keys are known.
For a Latin hypercube, the rank correlations of the outcome with each key.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from SALib.analyze import sobol

from boresight.reports.compare.trials import metric_values, nothing_to_find, prior_values
from boresight.reports.figures.style import BLUE, GREY, ORANGE, finish, grid_figure, styled
from boresight.reports.run.data import RunData
from boresight.reports.schema.column import Measure
from boresight.reports.schema.grid import NO_VALUE, Grid, row_grid
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.intervals import LEVEL, RESAMPLES, content_rng
from boresight.reports.statistics.measured import WORST, Measured, Statistic, bounded
from boresight.reports.tables import interval
from boresight.scenarios.arrays import FloatArray

_KEY = ("trial", "scenario")
_CONDITIONS = ("image", "range_m", "phase_deg", "latitude_deg", "view_deg", "sun_deg", "epipolar_offset_px")
_RESULTS = (
    "rows", "stages", "landmarks", "diagnostics", "epochs", "vision", "crater_matches", "detections", "orbits",
    "navigation", "surveyed_images", "surveyed_craters",
)  # fmt: skip
"""Tables of results of methods, over all kinds of trial."""
_LONG = 18
_SHOWN = (-1.1, 1.4)
"""Limits of the axis of indices; wider intervals are cut off."""
FIRST, TOTAL, RANK = "first-order index", "total index", "rank correlation"


@dataclass(frozen=True, slots=True)
class VariedKey:
    """A key of the scenarios and the bounds between which it is varied."""

    key: str
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Sensitivity of one estimator to the varied keys.

    ``base`` is the outcome with no key varied, ``outcomes`` (n,) are those of the samples. ``alone`` has, by key, the
    outcomes at its lower and upper bound with all other keys as in the base. ``shares`` has, by the name of an index,
    its value for each key; it is empty where the outcome does not vary. ``unmoved`` are the keys that change no result
    at either bound, bit for bit.
    """

    estimator: str
    base: float
    outcomes: FloatArray
    alone: Mapping[str, tuple[float, float]]
    shares: Mapping[str, tuple[Measured, ...]]
    unmoved: tuple[str, ...]


def outcome_of(run: RunData, metric: Measure, statistic: Statistic, scenario: str, estimator: str) -> float:
    """Evaluate a statistic over the trials of a scenario; NaN or infinite where too few have a value.

    A failure counts with the error of its prior. Without priors, medians and percentiles count it as worse than any
    error; means are then over the solved trials alone, as the mean with failures does not exist.
    """
    own = (run.rows["scenario"] == scenario) & (run.rows["estimator"] == estimator) & ~nothing_to_find(run, metric)
    values, prior = metric_values(run, metric)[own], prior_values(run, metric)
    if prior is not None:
        values = values.fillna(prior[own])
    elif statistic.quantile is not None and metric.error:
        values = values.fillna(WORST)
    known = values.dropna().to_numpy(dtype=np.float64)
    return bounded(statistic.of(known)) if len(known) else float("nan")


def same_results(run: RunData, one: str, other: str, estimator: str) -> bool:
    """Whether an estimator gives the same results in two scenarios, bit for bit; conditions and truth may differ."""
    tables = [table for table in (run.rows if name == "rows" else run.table(name) for name in _RESULTS) if len(table)]
    return all(_results(table, one, estimator).equals(_results(table, other, estimator)) for table in tables)


def _results(table: pd.DataFrame, scenario: str, estimator: str) -> pd.DataFrame:
    own = table[(table["scenario"] == scenario) & (table["estimator"] == estimator)]
    if "stage" in own:
        own = own[own["stage"] != CONTROL]
    about = [name for name in own if name in (*_KEY, *_CONDITIONS) or str(name).startswith(("prior_", "true_"))]
    return own.drop(columns=about).reset_index(drop=True)


def sobol_shares(varied: Sequence[VariedKey], outcomes: FloatArray, seed: int) -> dict[str, tuple[Measured, ...]]:
    """Estimate Sobol's indices with their 95 % bootstrap intervals; none where the outcomes (n,) are all the same."""
    if float(np.ptp(outcomes)) == 0.0:
        return {}
    found = sobol.analyze(salib_problem(varied), outcomes, calc_second_order=False, conf_level=LEVEL, seed=seed)
    return {
        name: tuple(
            Measured(float(x), float(x - c), float(x + c)) for x, c in zip(found[s], found[f"{s}_conf"], strict=True)
        )
        for name, s in ((FIRST, "S1"), (TOTAL, "ST"))
    }


def rank_shares(samples: FloatArray, outcomes: FloatArray) -> dict[str, tuple[Measured, ...]]:
    """Estimate Spearman's correlation of the outcomes (n,) with each key of the samples (n, k), with its interval."""
    if float(np.ptp(outcomes)) == 0.0:
        return {}
    # Imported here, as it takes 1 s and no other table needs it.
    from scipy.stats import spearmanr

    rng = content_rng(samples, outcomes)
    drawn = rng.integers(0, len(outcomes), (RESAMPLES // 4, len(outcomes)))
    found = []
    for column in samples.T:
        draws = [spearmanr(column[pick], outcomes[pick]).statistic for pick in drawn if np.ptp(outcomes[pick]) > 0.0]
        low, high = np.percentile(draws, [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)])
        found.append(Measured(float(spearmanr(column, outcomes).statistic), float(low), float(high)))
    return {RANK: tuple(found)}


def salib_problem(varied: Sequence[VariedKey]) -> dict[str, object]:
    """Describe the varied keys in SALib's format."""
    return {"num_vars": len(varied), "names": [v.key for v in varied], "bounds": [[v.low, v.high] for v in varied]}


def sensitivity_grid(
    found: Sequence[Sensitivity], varied: Sequence[VariedKey], metric: Measure, statistic: str
) -> Grid:
    """Tabulate the indices of every estimator and key."""
    names = list(dict.fromkeys(name for one in found for name in one.shares))
    unit, rows = f", {metric.unit}" if metric.unit else "", []
    for one in found:
        for i, key in enumerate(varied):
            outcomes = zip(("base", "at from", "at to"), (one.base, *one.alone[key.key]), strict=True)
            rows.append(
                {"estimator": one.estimator, "key": key.key, "from": f"{key.low:g}", "to": f"{key.high:g}"}
                | {f"{head}{unit}": interval(Measured(outcome)) for head, outcome in outcomes}
                | {f"{n} [95 %]": interval(one.shares[n][i]) if n in one.shares else NO_VALUE for n in names}
                | {"": "changes no result" if key.key in one.unmoved else ""}
            )
    note = (
        f"Outcome: {statistic} of the {metric.label} over the trials of a sample, with the same draws in all samples. A"
        " failure counts with the error of its prior; without priors, medians and percentiles count it as worse than"
        " any error. 'at from' and 'at to': this key alone at its bounds. 'changes no result': at both bounds every"
        " number of the estimator is that of the base, bit for bit. An index whose interval is wider than 1 says"
        " nothing: take more --samples."
    )
    return row_grid("Sensitivity", rows, ("estimator", "key", ""), note)


@styled
def draw_sensitivity(found: Sequence[Sensitivity], keys: Sequence[str], samples: FloatArray, axis: str) -> Figure:
    """Draw a row of panels for each estimator: the indices of all keys, and the outcome against each key.

    ``samples`` (n, K) are the values of the K ``keys``; ``axis`` names the outcome, with its unit.
    """
    width_in, height_in = 3.2 + 2.1 * len(keys), 0.9 + 2.3 * len(found)
    figure, places = grid_figure(len(found), 1 + len(keys), width_in=width_in, height_in=height_in)
    for one, panels in zip(found, places, strict=True):
        _indices(panels[0], one.shares, keys)
        panels[0].set_title(one.estimator, loc="left")
        for axes, key, values in zip(panels[1:], keys, samples.T, strict=True):
            axes.plot(values, one.outcomes, "o", color=BLUE, markersize=2.5, alpha=0.6)
            axes.axhline(one.base, color=GREY, linestyle="--", linewidth=1.0)
            axes.set_xlabel("\n".join(_wrapped(key)), fontsize=8)
            axes.xaxis.set_major_locator(MaxNLocator(4))
        panels[1].set_ylabel(axis, fontsize=8)
        for axes in panels[2:]:
            axes.sharey(panels[1])
            axes.tick_params(labelleft=False)
    return finish(figure, "Sensitivity (dashed: base)")


def _indices(axes: Axes, shares: Mapping[str, Sequence[Measured]], keys: Sequence[str]) -> None:
    places = np.arange(len(keys))
    height = 0.8 / max(len(shares), 1)
    for i, ((name, own), colour) in enumerate(zip(shares.items(), (BLUE, ORANGE), strict=False)):
        values, low, high = np.array([[x or 0.0 for x in (one.value, one.low, one.high)] for one in own]).T
        axes.barh(places + i * height, values, height, color=colour, alpha=0.75, label=name)
        axes.errorbar(
            values, places + i * height, xerr=[values - low, high - values], fmt="none", ecolor=GREY, capsize=2
        )
    axes.set_yticks(places + 0.4 - 0.5 * height, ["\n".join(_wrapped(key)) for key in keys], fontsize=7)
    axes.set_ylim(len(keys) - 0.1 - 0.5 * height, -0.1 - 0.5 * height)
    left, right = axes.get_xlim()
    axes.set_xlim(max(left, _SHOWN[0]), min(right, _SHOWN[1]))
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    if shares:
        legend = axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=7.5)
        legend.set_in_layout(True)
    else:
        axes.text(0.5, 0.5, "does not vary", transform=axes.transAxes, ha="center")


def _wrapped(key: str) -> list[str]:
    """Break a long dotted key into lines at its dots."""
    lines = [""]
    for part in key.replace(".", ".\0").split("\0"):
        if lines[-1] and len(lines[-1]) + len(part) > _LONG:
            lines.append("")
        lines[-1] += part
    return lines
