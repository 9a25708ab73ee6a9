"""What a report says, worked out once and then written as page, Markdown, CSV, figures and terminal text."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from reports.clusters import image_set
from reports.comparison import ComparedClaim, ComparedValue, compare, compare_claims
from reports.comparison_tables import claim_grid, comparison_grid
from reports.consistency import consistency_grid, consistency_records
from reports.contrasts import ratio_records, reduction_records
from reports.derived import derived_records
from reports.design_figures import design_figures
from reports.designs import design_grids
from reports.detection import DEFINITIONS, Detection, area, detections, outlier_grid, outlier_records, roc_curve
from reports.figures import (
    MOST_CURVES,
    Curve,
    TradeMark,
    draw_centroid_offsets,
    draw_cumulative_errors,
    draw_landmark_counts,
    draw_landmark_errors,
    draw_method_errors,
    draw_pose_errors,
    draw_roc,
    draw_trade_off,
)
from reports.grid import Grid
from reports.labels import stage_label
from reports.measures import CONTROL, Record, errors_by_stage, final_stage, measure_run
from reports.paired import paired_grid, paired_records
from reports.published import Comparison, load_published
from reports.run_data import RunData, read_run, select
from reports.sensitivity import mesh_variants, sensitivity_grid
from reports.sequences import pooled_alone, sequence_figures, sequence_grids
from reports.statistics import LARGE, MEDIAN, FloatArray
from reports.tables import detail_grid, diagnostic_grid, failure_grid, pose_grids, reference_grid, timing_grid
from reports.tradeoff import ATTITUDE, POSITION, costs, prior_medians, trade_grid
from reports.vision import vision_records


@dataclass(frozen=True, slots=True, eq=False)
class NamedFigure:
    """A figure with the stem of its files, its caption and a description for those who cannot see it."""

    stem: str
    figure: Figure
    caption: str
    alt: str


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """A run and all that is said of it.

    Parameters
    ----------
    run
        The stored tables.
    records
        Every measured number.
    comparison, compared
        Published values and our numbers beside them; None and empty if the campaign names none.
    claims
        Published orders and our medians in them.
    notes
        What a reader must know before trusting the numbers.
    """

    run: RunData
    records: tuple[Record, ...]
    comparison: Comparison | None
    compared: tuple[ComparedValue, ...]
    claims: tuple[ComparedClaim, ...]
    notes: tuple[str, ...]

    def grids(self) -> list[Grid]:
        """List the tables of the report, in order; of a grid of scenarios, those of the grid alone."""
        failures = failure_grid(self.run)
        if not self.run.epochs.empty:
            return [*sequence_grids(self.records, self.compared, self.run), *([] if failures is None else [failures])]
        if self.run.manifest.grid is not None:
            return [*design_grids(self.run), *([] if failures is None else [failures])]
        optional = (
            reference_grid(self.records, self.run),
            comparison_grid(self.compared),
            claim_grid(self.claims),
            trade_grid(self.run),
            detail_grid(self.records),
            diagnostic_grid(self.records),
            paired_grid(self.records),
            consistency_grid(self.records),
            sensitivity_grid(self.records, mesh_variants(self.run)),
            outlier_grid(self.records),
            timing_grid(self.records),
            failures,
        )
        return [*pose_grids(self.records), *(grid for grid in optional if grid is not None)]

    def table(self) -> pd.DataFrame:
        """Every measured number, beside the published one where there is one."""
        beside = {id(c.ours): c for c in self.compared if c.ours is not None}
        lines = []
        for record in self.records:
            match = beside.get(id(record))
            published = {
                "published": match.published.value if match else None,
                "tolerance": match.published.tolerance if match else None,
                "verdict": match.verdict if match else "",
                "place": match.published.place if match else "",
            }
            lines.append(asdict(record) | published)
        return pd.DataFrame(lines)


def read_content(folder: Path) -> Content:
    """Read a run folder and work out what is to be said.

    Raises
    ------
    BoresightError
        If the folder is not a run, holds no finished trial, or names unknown published values.
    """
    run = read_run(folder)
    comparison = load_published(run.manifest.report) if run.manifest.report else None
    derived = derived_records(run, comparison.radius_m) if comparison and comparison.radius_m else ()
    reductions = tuple(reduction_records(run, comparison)) if comparison else ()
    beside = (*paired_records(run), *ratio_records(run), *consistency_records(run))
    records = (*measure_run(run), *vision_records(run), *derived, *reductions, *outlier_records(run), *beside)
    compared, claims = beside_published(run, records, comparison) if comparison else ((), ())
    return Content(run, records, comparison, compared, claims, tuple(_notes(run, comparison)))


def beside_published(
    run: RunData, records: Sequence[Record], comparison: Comparison
) -> tuple[tuple[ComparedValue, ...], tuple[ComparedClaim, ...]]:
    """Set published values and orders beside ours; of sets of images that are pooled, beside the pool alone."""
    judged = pooled_alone(run, records)
    return compare(judged, comparison), compare_claims(judged, comparison)


def _notes(run: RunData, comparison: Comparison | None) -> Iterator[str]:
    yield from filter(None, (run.manifest.description, *_scenario_lines(run)))
    done, total = run.progress()
    if done < total:
        yield f"The run is not finished: {done} of {total} trials."
    yield (
        "Intervals are 95 % percentile-bootstrap intervals (2,000 resamples of whole trials"
        " or, for real images, of whole images, because the noise realisations of one image are not independent;"
        f" from {LARGE:,} independent trials on, between order statistics or from the standard error of a mean)."
    )
    yield from _set_lines(run)
    yield (
        "Position error is the difference of camera positions in the body frame, its components turned into the true"
        " camera's axes. Failed trials have no error: statistics after a stage are over the trials that reached it,"
        " beside their number, and the line 'failures at prior' counts every trial."
    )
    if (run.rows["image"] != "").any():
        yield (
            "These are real images. The pose that they are scored against is itself an estimate, and so is every"
            " further reference pose: neither is exact truth, and each error below contains the reference's own error."
        )
    if comparison is not None:
        yield f"Published values: {comparison.source}. {comparison.conditions}"
    absent = [name for name in ("stages", "landmarks", "timings") if getattr(run, name).empty]
    if absent:
        yield f"Not stored in this run, so left out: {', '.join(absent)}."
    yield from run.manifest.notes


def _set_lines(run: RunData) -> Iterator[str]:
    """Say on how many sets of images the sequences of a run begin, where they see images."""
    scenarios = [name for name in dict.fromkeys(run.rows["scenario"]) if image_set(run.manifest.scenarios[name])]
    if scenarios:
        seen = run.rows[run.rows["scenario"].isin(scenarios)]
        starts = len(seen[["scenario", "trial"]].drop_duplicates())
        sets = len({image_set(run.manifest.scenarios[name]) for name in scenarios})
        yield (
            f"{sets} {'set' if sets == 1 else 'sets'} of images (one for each body and texture), {starts} starts."
            " The starts on one set share the errors of its features: intervals and sign tests take the set for what"
            " is independent, and one set by itself has no interval."
        )


def _scenario_lines(run: RunData) -> Iterator[str]:
    """Say what each scenario is, in the words of its file."""
    scenarios = run.manifest.scenarios
    if isinstance(scenarios, dict) and run.manifest.grid is None:
        for name, spec in scenarios.items():
            if isinstance(spec, dict) and spec.get("description"):
                yield f"Scenario {name}: {spec['description']}"


def draw_figures(content: Content) -> Iterator[NamedFigure]:
    """Draw every figure that the run's tables allow; of a grid of scenarios those of the grid alone."""
    run = content.run
    one_at_a_time = run.manifest.grid is not None and run.manifest.grid.design == "one-at-a-time"
    if not run.epochs.empty and not one_at_a_time:
        for stem, figure, caption, alt in sequence_figures(run):
            yield NamedFigure(file_stem(stem), figure, caption, alt)
        return
    if run.manifest.grid is not None:
        for stem, figure, caption, alt in design_figures(run):
            yield NamedFigure(file_stem(stem), figure, caption, alt)
        return
    for scenario in dict.fromkeys(scenario for scenario, _ in run.posed_pairs()):
        for _, estimator in (pair for pair in run.posed_pairs() if pair[0] == scenario and pair[1] != CONTROL):
            yield pose_figure(content, scenario, estimator)
            yield from landmark_figures(content, scenario, estimator)
            yield from _outlier_figures(content, scenario, estimator)
        yield from _method_figures(content, scenario)
        yield from _trade_figures(content, scenario)
        yield _cumulative_figure(content, scenario)
    yield from _centroid_figures(content)


def published_medians(content: Content, scenario: str, estimator: str) -> dict[tuple[str, str], float]:
    """Medians of the paper by (stage, measure), for the figures of one scenario and estimator."""
    return {
        (c.published.stage, c.published.measure): c.published.value
        for c in content.compared
        if (c.scenario, c.estimator) == (scenario, estimator) and c.published.statistic == MEDIAN.name
        if c.verdict != "context"
    }


def pose_figure(content: Content, scenario: str, estimator: str) -> NamedFigure:
    """Draw the errors of an estimator after each of its stages."""
    run = content.run
    errors = {stage_label(name): table for name, table in errors_by_stage(run, scenario, estimator).items()}
    medians = published_medians(content, scenario, estimator)
    published = {(stage_label(stage), measure): value for (stage, measure), value in medians.items()}
    title = f"Pose error, {scenario}, {estimator}"
    triangles = " Open triangles on the axis: medians of the paper." if published else ""
    return NamedFigure(
        file_stem("pose_errors", scenario, estimator),
        draw_pose_errors(errors, title, published, run.manifest.credits),
        f"{title}: attitude and translation error before and after each stage, normalised; dotted lines: medians."
        f"{triangles}",
        f"Two histograms of the errors of attitude and position for the stages {', '.join(errors)}.",
    )


def landmark_figures(content: Content, scenario: str, estimator: str) -> Iterator[NamedFigure]:
    """Draw the errors of recognised landmarks, and their number an image, where there are any."""
    run = content.run
    credit_lines = run.manifest.credits
    marks = select(run.landmarks, scenario, estimator)
    error, chi_square = (_finite(marks[name]) for name in ("error_m", "chi_square"))
    if len(error) and len(chi_square):
        title = f"Landmark recognition error, {scenario}, {estimator}"
        yield NamedFigure(
            file_stem("landmark_errors", scenario, estimator),
            draw_landmark_errors(error, chi_square, title, credit_lines),
            f"{title}: distance from the landmark of the data base to the surface point that was matched with it, and"
            " the same weighted by the landmark's covariance, with the distribution that a Gaussian error would give.",
            "Histogram of landmark errors in metres, and histogram of chi-square with its theoretical curve.",
        )
    rows = select(run.rows, scenario, estimator)
    counts = _finite(rows.loc[rows["status"] == "ok", "n_landmarks"])
    if len(set(counts)) > 1:
        title = f"Landmarks an image, {scenario}, {estimator}"
        medians = published_medians(content, scenario, estimator)
        median = medians.get((final_stage(run, scenario, estimator), "n_landmarks"))
        yield NamedFigure(
            file_stem("landmark_counts", scenario, estimator),
            draw_landmark_counts(counts, title, median, credit_lines),
            f"{title}: number of recognised landmarks in each image with an estimate.",
            "Histogram of the number of recognised landmarks in each image.",
        )


def _outlier_figures(content: Content, scenario: str, estimator: str) -> Iterator[NamedFigure]:
    run = content.run
    found = [d for d in detections(run) if (d.scenario, d.estimator) == (scenario, estimator)]
    if found:
        title = f"What tells bad solutions, {scenario}, {estimator}"
        yield NamedFigure(
            file_stem("outliers", scenario, estimator),
            draw_roc(_curves(found), title, run.manifest.credits),
            f"{title}: share of the bad solutions against that of the good ones beyond a threshold on a number that the"
            " estimator reports; the diagonal is chance.",
            f"Receiver operating characteristics for {' and '.join(_curves(found))}.",
        )


def _curves(found: Sequence[Detection]) -> dict[str, list[Curve]]:
    """Choose the scores whose area is farthest from chance, for each definition of bad."""
    curves: dict[str, list[Curve]] = {}
    for one in found:
        sign = -1.0 if one.low_is_bad else 1.0
        false, true, _ = roc_curve(sign * one.score, one.bad)
        size = area(sign * one.score, one.bad)
        name = f"{one.name} (low)" if one.low_is_bad else one.name
        panel = f"{DEFINITIONS[one.definition]} ({int(one.bad.sum())} of {len(one.bad)})"
        curves.setdefault(panel, []).append(Curve(name, false, true, size))
    return {panel: sorted(lines, key=lambda line: -line.area)[:MOST_CURVES] for panel, lines in curves.items()}


def _method_figures(content: Content, scenario: str) -> Iterator[NamedFigure]:
    """Lay the final errors of several estimators over each other."""
    run = content.run
    labels = [name for where, name in run.posed_pairs() if where == scenario and name != CONTROL]
    if len(labels) > 1:
        errors = {label: select(run.rows, scenario, label) for label in labels}
        title = f"Final pose error by estimator, {scenario}"
        yield NamedFigure(
            file_stem("method_errors", scenario),
            draw_method_errors({"": errors}, title, run.manifest.credits),
            f"{title}: normalised histograms over the trials with an estimate; what lies beyond the axis is said in the"
            " legend.",
            f"Two histograms of the errors of attitude and position of {', '.join(labels)}.",
        )


def _trade_figures(content: Content, scenario: str) -> Iterator[NamedFigure]:
    """Set accuracy against what it costs."""
    run = content.run
    marks = {
        cost.estimator: TradeMark(
            {POSITION: cost.position_m, ATTITUDE: cost.attitude_deg}, cost.seconds.value, cost.size_bytes
        )
        for cost in costs(run)
        if cost.scenario == scenario
    }
    if marks:
        title = f"Accuracy and its cost, {scenario}"
        yield NamedFigure(
            file_stem("trade_off", scenario),
            draw_trade_off(marks, prior_medians(run, scenario), title, run.manifest.credits),
            f"{title}: median errors with their 95 % intervals against time and size of the data base; dashed: the"
            " prior. What reads no data base stands in the panels of time alone.",
            f"Median errors of {', '.join(marks)} against time an image and size of the data base.",
        )


def centroid_offsets(run: RunData, estimator: str) -> dict[str, FloatArray]:
    """Collect the offsets (n, 2) of the brightness centroid that an estimator reports, px, scenario by scenario."""
    numbers = run.diagnostics[run.diagnostics["estimator"] == estimator]
    axes = numbers[numbers["name"].isin(["centroid_du_px", "centroid_dv_px"])]
    wide = axes.pivot_table(index=["scenario", "trial"], columns="name", values="value")
    return {
        str(name): table[["centroid_du_px", "centroid_dv_px"]].dropna().to_numpy(dtype=np.float64)
        for name, table in wide.groupby("scenario", sort=False)
    }


def _centroid_figures(content: Content) -> Iterator[NamedFigure]:
    run = content.run
    for estimator in dict.fromkeys(run.diagnostics.loc[run.diagnostics["name"] == "centroid_du_px", "estimator"]):
        title = f"Offset of the brightness centroid, observed minus rendered, {estimator}"
        yield NamedFigure(
            file_stem("centroid_offsets", str(estimator)),
            draw_centroid_offsets(centroid_offsets(run, str(estimator)), title),
            f"{title}: one point a trial; ellipses: one standard deviation of the sample.",
            "Scatter of the offsets of the brightness centroid along the columns and rows of the image.",
        )


def _cumulative_figure(content: Content, scenario: str) -> NamedFigure:
    run = content.run
    found = {}
    for estimator in (name for where, name in run.posed_pairs() if where == scenario):
        rows = select(run.rows, scenario, estimator)
        found[estimator] = (rows[rows["status"] == "ok"], len(rows))
    title = f"Cumulative error, {scenario}"
    return NamedFigure(
        file_stem("cumulative_errors", scenario),
        draw_cumulative_errors(found, title, run.manifest.credits),
        f"{title}: share of all trials with an error below the abscissa; a curve ends at the share of trials with an"
        " estimate.",
        f"Cumulative shares of attitude and position error for {', '.join(found)}.",
    )


def _finite(values: pd.Series) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray(values.dropna(), dtype=np.float64)


def file_stem(*parts: str) -> str:
    """Make a file name that is valid on every system."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", "_".join(parts))
