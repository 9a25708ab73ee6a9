"""The requirements of a campaign: what its trials say of them, and which conditions of a trial move them most."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, product

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from boresight.reports.compare.trials import nothing_to_find, trial_numbers
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.style import BLUE, ORANGE, finish, grid_figure, styled
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData, in_order_of
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.column import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.grid import NO_VALUE, Grid, chance, number, row_grid
from boresight.reports.schema.records import CONTROLS
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.intervals import Interval, has_quantile, quantile_interval
from boresight.reports.statistics.requirements import SECONDS, YES_OR_NO, Requirement, Verdict, judge, read_requirement
from boresight.scenarios.arrays import FloatArray

_CONDITIONS = ("range_m", "phase_deg", "latitude_deg", "prior_position_error_m", "prior_attitude_error_deg")
_QUANTILES = (0.99, 0.95, 0.9, 0.75, 0.5)
_LEAST_TRIALS = 30
_UNSOLVED = float(np.finfo(float).max)
_NOTE = (
    "Missed: trials beyond the limit, or without the number; no estimate: those of them without an estimate. Reached:"
    " the limit that would just pass. Risk: the consumer's risk, the probability of a result at least as good where the"
    " requirement is just not met. Further: trials without another miss that would pass it. Each verdict has its own"
    " risk. Trials that share a real image, or sequences that share a set of images, count as one, which passes by its"
    " worst and fails by its best. With several data bases a verdict is of these."
)
_LOOKED = (
    " This run was looked at and went on, or is not finished: verdicts are of a test that holds at every look, and"
    " needs more trials than one of a number of trials fixed beforehand."
)
_SWING_NOTE = (
    "The quantile among the third of all trials with the least and among that with the greatest value of a condition,"
    " with 95 % intervals, the widest swing first; trials without an estimate count as worse than any. A condition that"
    " is drawn together with others shows their effect too."
)


@dataclass(frozen=True, slots=True)
class Judged:
    """A requirement on an estimator in a scenario, and the verdict; ``unsolved`` of its misses have no estimate."""

    requirement: Requirement
    scenario: str
    estimator: str
    verdict: Verdict
    unsolved: int


@dataclass(frozen=True, slots=True)
class Swing:
    """A quantile of a measure in the trials with little and with much of a condition.

    ``least`` and ``most`` are the bounds of the condition in the two thirds of trials, ``low`` and ``high`` the
    quantile there with its interval.
    """

    condition: str
    least: tuple[float, float]
    most: tuple[float, float]
    low: tuple[float, Interval]
    high: tuple[float, Interval]

    @property
    def width(self) -> float:
        """The size of the swing."""
        return abs(self.high[0] - self.low[0])


def judged(run: RunData, *, trials: int | None = None, looked: bool = False) -> Iterator[Judged]:
    """Judge every requirement of a run on each estimator but the controls, in each scenario.

    Of the first ``trials``, if they are given. ``looked``: the run may end after each look, as it may if its manifest
    says so, or trials that were asked for are not there.
    """
    again = looked or _could_end_elsewhere(run)
    for requirement, scenario, estimator, values in required_values(run):
        numbers = run.rows.loc[values.index, "trial"]
        own = values.dropna() if trials is None else values[numbers < trials].dropna()
        of_unit = pd.Series(_units(run, run.rows.loc[own.index]), own.index)
        units, failed = own.groupby(of_unit, sort=False), run.rows.loc[own.index, "status"] != "ok"
        worst, best = (np.asarray(part, dtype=np.float64) for part in (units.max(), units.min()))
        verdict = judge(requirement, worst, best=best, looked=again, turns=max(1, run.databases))
        yield Judged(requirement, scenario, estimator, verdict, of_unit[failed].nunique())


def _could_end_elsewhere(run: RunData) -> bool:
    """Tell whether the number of trials was not fixed beforehand: the run was looked at, or is not finished."""
    done, asked = run.progress()
    return run.manifest.looked or done < asked


def required_values(run: RunData) -> Iterator[tuple[Requirement, str, str, pd.Series[float]]]:
    """Yield requirements with each scenario and estimator that they are of, and the measure of its trials (n,)."""
    for asked in run.manifest.requirements:
        requirement = read_requirement(asked.that, run.manifest.experiment)
        values = _values(run, requirement.measure)
        # Also a pair that no trial is stored of yet is asked.
        for scenario, estimator in product(run.manifest.scenarios, map(str, run.manifest.estimators)):
            wanted = not asked.scenarios or scenario in asked.scenarios
            own = estimator in asked.estimators if asked.estimators else estimator not in CONTROLS
            if wanted and own:
                yield requirement, scenario, estimator, values.loc[run.of(scenario, estimator).index]


def _units(run: RunData, rows: pd.DataFrame) -> NDArray[np.generic]:
    # Of trials whose chances differ by data base a binomial test of their mean is on the safe side (W. Hoeffding 1956).
    return rows["trial"].to_numpy() if run.databases > 1 else clusters_of(run, rows)


def _values(run: RunData, measure: str) -> pd.Series[float]:
    """Return the measure of every row of a run, infinite for a failure; of a yes or no 0 for yes.

    NaN where nothing is to be measured: no crater could be found, or the estimator does not tell its time.
    """
    rows = run.rows
    ok = rows["status"] == "ok"
    if measure in YES_OR_NO:
        met = ok if measure == YES_OR_NO[0] else succeeded(rows)
        return pd.Series(np.where(met, 0.0, 1.0), rows.index)
    if measure == SECONDS:
        times = run.table("timings")
        own = times[~times["stage"].isin([FRESH_IMAGE, STORED_IMAGE])]
        total = own.groupby(["scenario", "estimator", "trial"], sort=False)[["seconds"]].sum().reset_index()
        return in_order_of(rows, total, ["seconds"])["seconds"].where(ok, np.inf)
    values = trial_numbers(run).get(measure, rows[measure] if measure in rows else pd.Series(np.nan, rows.index))
    sizes = values.astype(float).abs().where(ok, np.inf).fillna(np.inf)
    return sizes.mask(nothing_to_find(run, measure_of(measure)))


def swings(run: RunData, values: pd.Series[float], quantile: float) -> list[Swing]:
    """Compare a quantile of the measure of some rows between thirds of the trials, the widest swing first.

    Empty where the thirds are too small for the quantile, or no condition varies.
    """
    rows, third = run.rows.loc[values.index], len(values) // 3
    if len(values) < _LEAST_TRIALS or not has_quantile(third, quantile):
        return []
    found = []
    for name in (name for name in _CONDITIONS if name in rows and rows[name].nunique() > third):
        if number(rows[name].min()) == number(rows[name].max()):
            continue
        order = np.argsort(rows[name].to_numpy(dtype=np.float64), kind="stable")
        ends = [rows.iloc[part] for part in (order[:third], order[-third:])]
        bounds = [(float(end[name].min()), float(end[name].max())) for end in ends]
        low, high = (_bounded(run, end, np.asarray(values.loc[end.index], dtype=np.float64), quantile) for end in ends)
        found.append(Swing(name, bounds[0], bounds[1], low, high))
    return sorted(found, key=lambda swing: -swing.width)


def _bounded(run: RunData, rows: pd.DataFrame, values: FloatArray, quantile: float) -> tuple[float, Interval]:
    finite = np.minimum(values, _UNSOLVED)  # between two infinite values nothing can be interpolated
    _, codes = np.unique(_units(run, rows), return_inverse=True)
    value = float(np.quantile(finite, quantile, method="inverted_cdf"))
    return value, quantile_interval(finite, codes, quantile)


def _tornados(run: RunData) -> Iterator[tuple[Requirement, str, float, dict[str, list[Swing]]]]:
    """Yield requirements with a limit, a scenario, a quantile, and what moves it, by estimator; none of a grid."""
    several = () if run.manifest.grid is not None else required_values(run)
    for (requirement, scenario), own in groupby(several, key=lambda one: one[:2]):
        found, quantile = {}, 0.5
        for _, _, estimator, values in own if requirement.limit is not None else ():
            shares = (requirement.share, *(q for q in _QUANTILES if q <= requirement.share))
            quantile = next((q for q in shares if has_quantile(len(values) // 3, q)), quantile)
            if moved := swings(run, values, quantile):
                found[estimator] = moved
        if found:
            yield requirement, scenario, quantile, found


def requirement_grid(run: RunData) -> Grid | None:
    """Tabulate the requirements of a run and their verdicts; None if it has none."""
    rows = [
        {
            "requirement": one.requirement.written,
            "scenario": one.scenario,
            "estimator": one.estimator,
            "verdict": one.verdict.verdict,
            "missed": f"{one.verdict.missed}/{one.verdict.n}",
            "no estimate": str(one.unsolved),
            "reached": _reached(one.verdict.reached, measure_of(one.requirement.measure).unit or ""),
            "risk": chance(one.verdict.risk),
            "further": NO_VALUE if one.verdict.further is None else f"{one.verdict.further:,}",
        }
        for one in judged(run)
    ]
    note = _NOTE + (_LOOKED if _could_end_elsewhere(run) else "")
    return row_grid("Requirements", rows, ("requirement", "scenario", "estimator", "verdict"), note) if rows else None


def _reached(limit: float | None, unit: str) -> str:
    return NO_VALUE if limit is None else f"{number(limit)} {unit}".rstrip() if np.isfinite(limit) else "none"


def swing_grid(run: RunData) -> Grid | None:
    """Tabulate what moves the requirements of a run; None if it has none, or too few trials."""
    rows = [
        {
            "requirement": requirement.written,
            "scenario": scenario,
            "estimator": estimator,
            "quantile": f"{100.0 * quantile:g} %",
            "condition": swing.condition,
            "least": _range(swing.least),
            "there": _printed(swing.low),
            "most": _range(swing.most),
            "then": _printed(swing.high),
        }
        for requirement, scenario, quantile, found in _tornados(run)
        for estimator, moved in found.items()
        for swing in moved
    ]
    text = ("requirement", "scenario", "estimator", "quantile", "condition")
    return row_grid("What moves the requirements", rows, text, _SWING_NOTE) if rows else None


def _range(bounds: tuple[float, float]) -> str:
    return " to ".join(map(number, bounds))


def _printed(quantile: tuple[float, Interval]) -> str:
    value, (low, high) = quantile
    inner = ", ".join(NO_VALUE if end is None or end >= _UNSOLVED else number(end) for end in (low, high))
    return f"{'unsolved' if value >= _UNSOLVED else number(value)} [{inner}]"


def requirement_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw a tornado for each requirement with a limit and each scenario, with a panel for each estimator."""
    for place, (requirement, scenario, quantile, found) in enumerate(_tornados(run)):
        title = f"What moves the {100.0 * quantile:g} % quantile of {requirement.measure}, {scenario}"
        yield NamedFigure(
            file_stem("tornado", str(place + 1), requirement.measure, scenario),
            _draw_tornados(requirement, found, title),
            f"{title}: among the third of the trials with the least and among that with the greatest value of each"
            " condition, with 95 % intervals where there are trials enough. The line is the requirement,"
            f" {requirement.written}. An arrow leads to more than is shown, or to trials that were not solved.",
            "Bars from one quantile to the other for each condition, the widest at the top.",
        )


@styled
def _draw_tornados(requirement: Requirement, found: Mapping[str, Sequence[Swing]], title: str) -> Figure:
    bars = max(map(len, found.values()))
    figure, axes = grid_figure(len(found), 1, 7.5, 0.6 + (0.5 + 0.35 * bars) * len(found))
    values = [value for moved in found.values() for swing in moved for value, _ in (swing.low, swing.high)]
    most = 1.3 * max(requirement.limit or 0.0, *(value for value in values if value < _UNSOLVED), 0.0)
    for ax, (estimator, moved) in zip(axes[:, 0], found.items(), strict=True):
        for place, swing in enumerate(reversed(moved)):
            ends = (swing.low, BLUE, "least third", 0.1), (swing.high, ORANGE, "greatest third", -0.1)
            left, right = sorted(min(value, most) for (value, _), *_ in ends)
            ax.barh(place, right - left, left=left, height=0.5, color="0.85")
            for (value, bounds), colour, label, shift in ends:
                low, high = (most if end is None else min(end, most) for end in bounds)
                if any(end is not None for end in bounds):
                    ax.plot([0.0 if bounds[0] is None else low, high], [place + shift] * 2, color=colour, lw=1.2)
                marker = "o" if value < most else ">"
                ax.plot(
                    min(value, most), place + shift, marker, color=colour, ms=5, label=label if place == 0 else None
                )
        ax.axvline(requirement.limit or 0.0, color="0.2", lw=1.0, ls="--")
        ax.set_yticks(range(len(moved)), [swing.condition for swing in reversed(moved)])
        ax.set(title=estimator, xlim=(0.0, 1.02 * most))
    axes[-1, 0].set_xlabel(measure_of(requirement.measure).axis or requirement.measure)
    return finish(figure, title, legend=axes[0, 0])
