"""Report of orbit determination: errors in inertial space, and residuals over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from boresight.reports.figures.axes import band_label
from boresight.reports.figures.orbit import draw_orbit_errors, draw_residuals
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.designs import REPORT as DESIGN_REPORT
from boresight.reports.published import Comparison, within_statistic
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import TRIAL_KEY, RunData, in_order_of, select
from boresight.reports.schema.grid import Grid, value_of_ended
from boresight.reports.schema.labels import count_of
from boresight.reports.schema.named_figure import NamedFigure, file_stem
from boresight.reports.schema.records import Record, find
from boresight.reports.schema.tables import unit_of
from boresight.reports.statistics.consistency import AT_EPOCH, consistency_grid
from boresight.reports.statistics.measured import MEAN, MEDIAN, RMS, Statistic, measure, share_of
from boresight.reports.tables import diagnostic_grid, timing_grid
from boresight.reports.verdicts import ComparedValue, comparison_grid

ORBIT = "orbit"
"""Stage of what a trial of orbit determination comes to."""
P90 = Statistic("90th percentile", 0.90)
_ERRORS = ("epoch_error_m", "arc_rms_m", "arc_median_m", "predicted_error_m")
_RATIOS = ("epoch_nees", "arc_nees")
_SHARES = ("residual_rms_px", "wrong_left_share", "right_edited_share", "solar_pressure_error", "gm_error")
_NOTE = (
    "Errors of the position in inertial space; of the arc: the root mean square of a trial over its epochs, every 6 h;"
    " predicted: at the end of the predicted days. Each over the trials that converged, which the second column counts:"
    " a rejected or diverged solution has no error. NEES over 6 is 1 on average where the covariance is right."
)


def orbit_records(run: RunData, comparison: Comparison | None) -> list[Record]:
    """Compute error statistics under the stage ``orbit``, and the share of trials within a paper's bound."""
    records: list[Record] = []
    if run.table("orbits").empty:
        return records
    for scenario, estimator in run.pairs():
        table = select(run.table("orbits"), scenario, estimator)
        n = len(select(run.rows, scenario, estimator))
        for names, statistics in ((_ERRORS, (MEDIAN, RMS, P90)), (_RATIOS, (MEAN,)), (_SHARES, (MEDIAN, RMS))):
            for name in names:
                numbers = table[name].to_numpy(dtype=np.float64)
                known = np.isfinite(numbers)
                found = measure(numbers[known], clusters_of(run, table)[known], statistics)
                records += [
                    Record(
                        scenario, estimator, ORBIT, "", name, unit_of(name), statistic.name, one.value, one.low,
                        one.high, int(known.sum()), n,
                    )
                    for statistic, one in zip(statistics, found, strict=True)
                ]  # fmt: skip
        records += _within_bounds(run, scenario, estimator, comparison)
    return records


def _within_bounds(run: RunData, scenario: str, estimator: str, comparison: Comparison | None) -> Iterator[Record]:
    """Count the trials, of all, whose error keeps a bound of a published statement."""
    rows = select(run.rows, scenario, estimator)
    bounds = {(claim.measure, claim.within) for claim in (comparison.claims if comparison else ()) if claim.within}
    for name, bound in sorted(bounds):
        within = in_order_of(rows, run.table("orbits").set_index(TRIAL_KEY)[name]) <= bound
        share = share_of(within, clusters_of(run, rows))
        value, low, high = (None if end is None else 100.0 * end for end in (share.value, share.low, share.high))
        yield Record(
            scenario, estimator, ORBIT, "", name, "%", within_statistic(bound), value, low, high,
            int(within.sum()), len(rows),
        )  # fmt: skip


def orbit_grids(records: Sequence[Record], compared: Sequence[ComparedValue], run: RunData) -> list[Grid]:
    """List the tables of a run of orbit determination."""
    claims = consistency_grid([record for record in records if record.measure == AT_EPOCH])
    found = (comparison_grid(compared), _grid(records, run), claims, timing_grid(records))
    several = run.manifest.grid is not None
    return [grid for grid in (*found, None if several else diagnostic_grid(records)) if grid is not None]


def orbit_brief(records: Sequence[Record], run: RunData) -> list[Grid]:
    """Tabulate what fits a terminal: how many converged, and the errors over the arc and of the prediction."""
    whole = _grid(records, run)
    several = len({scenario for scenario, _ in run.pairs()}) > 1
    return [whole.keep(*(["scenario"] if several else []), "estimator", "converged", "arc m", "predicted m")]


def _grid(records: Sequence[Record], run: RunData) -> Grid:
    heads = (
        "scenario", "estimator", "converged", "epoch m", "90 %", "arc m", "RMS", "90 %", "predicted m", "90 %",
        "NEES / 6", "residual px", "wrong left",
    )  # fmt: skip
    rows = []
    for scenario, estimator in run.pairs():

        def cell(
            name: str,
            statistic: Statistic = MEDIAN,
            interval: bool = False,
            where: tuple[str, str] = (scenario, estimator),
        ) -> str:
            key = {"scenario": where[0], "estimator": where[1], "stage": ORBIT, "measure": name}
            return value_of_ended(find(records, **key, statistic=statistic.name), interval=interval)

        own = select(run.rows, scenario, estimator)
        converged = f"{(own['status'] == 'ok').sum()}/{len(own)}"
        errors = (
            cell("epoch_error_m", interval=True),
            cell("epoch_error_m", P90),
            cell("arc_rms_m", interval=True),
            cell("arc_rms_m", RMS),
            cell("arc_rms_m", P90, interval=True),
            cell("predicted_error_m", interval=True),
            cell("predicted_error_m", P90),
        )
        others = (cell("epoch_nees", MEAN, interval=True), cell("residual_rms_px"), cell("wrong_left_share"))
        rows.append((scenario, estimator, converged, *errors, *others))
    return Grid("Orbit determination", heads, tuple(rows), frozenset({0, 1}), _NOTE)


def orbit_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw residuals and errors over time; of a grid, those of the scenarios that it varies."""
    for scenario in reference_scenarios(run):
        errors = run.table("orbit_errors")[run.table("orbit_errors")["scenario"] == scenario]
        for estimator in dict.fromkeys(errors["estimator"]):
            if len(select(run.table("residuals"), scenario, estimator)):
                yield residual_figure(run, scenario, estimator)
        if len(errors):
            title = f"Position error in inertial space, {scenario}"
            yield NamedFigure(
                file_stem("orbit_errors", scenario),
                draw_orbit_errors(errors, title),
                f"{title}: median over {count_of(errors['trial'].nunique(), 'trial')} and"
                f" {band_label(errors['trial'].nunique())}; dashed: what the covariance foretells; behind the line the"
                " orbit is predicted.",
                "Position error against time for each estimator.",
            )


def residual_figure(run: RunData, scenario: str, estimator: str) -> NamedFigure:
    """Draw the optical data residuals of the first trial."""
    title = f"Optical data residuals, {scenario}, {estimator}, first trial"
    return NamedFigure(
        file_stem("residuals", scenario, estimator),
        draw_residuals(select(run.table("residuals"), scenario, estimator), title),
        f"{title}: seen less predicted of the sightings that were not edited (figure 10 of Cheng et al. 2003).",
        "Residuals of columns and rows in pixels against time.",
    )


def reference_scenarios(run: RunData) -> list[str]:
    """List the scenarios of a run, of a grid those that it varies."""
    every = dict.fromkeys(name for name, _ in run.pairs())
    return [name for name in every if run.manifest.grid is None or _is_reference(run, name)]


def _is_reference(run: RunData, scenario: str) -> bool:
    """Return whether a scenario of a grid has the first level of every axis."""
    design = run.manifest.grid
    levels = next((one.levels for one in design.scenarios if one.name == scenario), None) if design else None
    return levels is None or all(levels[axis.name] == axis.levels[0] for axis in (design.axes if design else ()))


def brief(content: Content) -> Tables:
    """List what the terminal shows: of a grid of scenarios its axes."""
    if content.run.manifest.grid is not None:
        return DESIGN_REPORT.brief(content)
    return orbit_brief(content.records, content.run)


REPORT = ReportKind(
    records=orbit_records,
    tables=lambda content: orbit_grids(content.records, content.compared, content.run),
    brief=brief,
    figures=lambda content: orbit_figures(content.run),
)
