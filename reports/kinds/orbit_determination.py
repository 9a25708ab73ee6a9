"""Report of orbit determination: errors in inertial space, and residuals over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from boresight.reports.figures.craters import draw_orbit_errors, draw_residuals
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.style import band_label
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.designs import design_grids
from boresight.reports.published import Comparison, within_statistic
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData, in_order_of
from boresight.reports.schema.grid import ESTIMATOR, SCENARIO, Grid, GridColumn, record_column, record_grid
from boresight.reports.schema.records import Key, Record, count_of
from boresight.reports.statistics.consistency import AT_EPOCH, consistency_grid
from boresight.reports.statistics.measured import MEAN, MEDIAN, RMS, Sample, Statistic, percent, share_of, table_records
from boresight.reports.tables import diagnostic_grid, timing_grid
from boresight.reports.verdicts import comparison_grid

ORBIT = "orbit"
"""Stage of what a trial of orbit determination comes to."""
P90 = Statistic("90th percentile", 0.90)
_STATISTICS = {
    **dict.fromkeys(("epoch_error_m", "arc_rms_m", "arc_median_m", "predicted_error_m"), (MEDIAN, RMS, P90)),
    **dict.fromkeys(("epoch_nees", "arc_nees"), (MEAN,)),
    **dict.fromkeys(
        ("residual_rms_px", "wrong_left_share", "right_edited_share", "solar_pressure_error", "gm_error"), (MEDIAN, RMS)
    ),
}
_COLUMNS = (
    record_column("epoch m", "epoch_error_m", MEDIAN.name, interval=True, ended=True),
    record_column("90 %", "epoch_error_m", P90.name, ended=True),
    record_column("arc m", "arc_rms_m", MEDIAN.name, interval=True, ended=True),
    record_column("RMS", "arc_rms_m", RMS.name, ended=True),
    record_column("90 %", "arc_rms_m", P90.name, interval=True, ended=True),
    record_column("predicted m", "predicted_error_m", MEDIAN.name, interval=True, ended=True),
    record_column("90 %", "predicted_error_m", P90.name, ended=True),
    record_column("NEES / 6", "epoch_nees", MEAN.name, interval=True, ended=True),
    record_column("residual px", "residual_rms_px", MEDIAN.name, ended=True),
    record_column("wrong left", "wrong_left_share", MEDIAN.name, ended=True),
)
_NOTE = (
    "Errors of the position in inertial space; of the arc: the root mean square of a trial over its epochs, every 6 h;"
    " predicted: at the end of the predicted days. Each over the trials that converged, which the second column counts:"
    " a rejected or diverged solution has no error. NEES over 6 is 1 on average where the covariance is right."
)


def orbit_records(run: RunData, comparison: Comparison | None) -> list[Record]:
    """Compute error statistics under the stage ``orbit``, and the share of trials within a paper's bound."""
    records: list[Record] = []
    orbits = run.table("orbits")
    bounds = {(claim.measure, claim.within) for claim in (comparison.claims if comparison else ()) if claim.within}
    for pair in run.pairs() if len(orbits) else ():
        records += table_records(run, orbits, ORBIT, _STATISTICS, [pair])
        rows = run.of(*pair)
        for name, bound in sorted(bounds):
            within = (in_order_of(rows, orbits, [name])[name] <= bound).to_numpy()
            share = percent(share_of(within, clusters_of(run, rows)))
            sample = Sample(*pair, ORBIT, len(rows), unit="%")
            records.append(sample.record(name, within_statistic(bound), share, int(within.sum())))
    return records


def tables(content: Content) -> Tables:
    """List the tables of a run of orbit determination."""
    records, run = content.records, content.run
    return (
        comparison_grid(content.compared),
        orbit_grid(records, run),
        consistency_grid([record for record in records if record.measure == AT_EPOCH]),
        timing_grid(records),
        None if run.manifest.grid is not None else diagnostic_grid(records),
    )


def brief(content: Content) -> Tables:
    """Tabulate what fits a terminal: how many converged, and the errors; of a grid of scenarios its axes."""
    if content.run.manifest.grid is not None:
        return design_grids(content.run, brief=True)
    whole = orbit_grid(content.records, content.run)
    scenario = ["scenario"] if len({name for name, _ in content.run.pairs()}) > 1 else []
    return [whole.keep(*scenario, "estimator", "converged", "arc m", "predicted m")] if whole else []


def orbit_grid(records: Sequence[Record], run: RunData) -> Grid | None:
    """Tabulate the errors of the orbits of each scenario and estimator."""

    def converged(key: Key) -> str:
        own = run.of(key.scenario, key.estimator)
        return f"{(own['status'] == 'ok').sum()}/{len(own)}"

    columns = (SCENARIO, ESTIMATOR, GridColumn("converged", lambda key, _: converged(key)), *_COLUMNS)
    lines = [Key(*pair, ORBIT) for pair in run.pairs()]
    return record_grid("Orbit determination", columns, records, lines, _NOTE)


def orbit_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw residuals and errors over time; of a grid, those of the scenarios that it varies."""
    for scenario in reference_scenarios(run):
        errors = run.table("orbit_errors")[run.table("orbit_errors")["scenario"] == scenario]
        for estimator in dict.fromkeys(errors["estimator"]):
            if len(run.of(scenario, estimator, "residuals")):
                yield residual_figure(run, scenario, estimator)
        if len(errors):
            title, trials = f"Position error in inertial space, {scenario}", errors["trial"].nunique()
            yield NamedFigure(
                file_stem("orbit_errors", scenario),
                draw_orbit_errors(errors, title),
                f"{title}: median over {count_of(trials, 'trial')} and {band_label(trials)}; dashed: what the"
                " covariance foretells; behind the line the orbit is predicted.",
                "Position error against time for each estimator.",
            )


def residual_figure(run: RunData, scenario: str, estimator: str) -> NamedFigure:
    """Draw the optical data residuals of the first trial."""
    title = f"Optical data residuals, {scenario}, {estimator}, first trial"
    return NamedFigure(
        file_stem("residuals", scenario, estimator),
        draw_residuals(run.of(scenario, estimator, "residuals"), title),
        f"{title}: seen less predicted of the sightings that were not edited (figure 10 of Cheng et al. 2003).",
        "Residuals of columns and rows in pixels against time.",
    )


def reference_scenarios(run: RunData) -> list[str]:
    """List the scenarios of a run, of a grid those that it varies: at the first level of every axis."""
    design = run.manifest.grid
    varied = {
        one.name
        for one in (design.scenarios if design else ())
        if design and any(one.levels[axis.name] != axis.levels[0] for axis in design.axes)
    }
    return [name for name in dict.fromkeys(name for name, _ in run.pairs()) if name not in varied]


REPORT = ReportKind(
    records=orbit_records, tables=tables, brief=brief, figures=lambda content: orbit_figures(content.run)
)
