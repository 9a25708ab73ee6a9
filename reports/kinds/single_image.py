"""Report of single images, and of data bases of landmarks: accuracy and cost of the estimators that read them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from pydantic import ValidationError

from boresight.reports.figures.comparison import draw_roc
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.pose import (
    draw_centroid_offsets,
    draw_cumulative_errors,
    draw_landmark_counts,
    draw_landmark_errors,
    draw_method_errors,
    draw_pose_errors,
)
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.designs import design_figures, design_grids
from boresight.reports.kinds.ranges import range_figures
from boresight.reports.published import Comparison
from boresight.reports.run.data import RunData
from boresight.reports.run.outcomes import errors_by_stage, final_stage
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, value_of
from boresight.reports.schema.records import CONTROL, DERIVED, Key, Record, by_key, stage_label
from boresight.reports.statistics.consistency import consistency_grid
from boresight.reports.statistics.measured import MEDIAN, Measured, Sample
from boresight.reports.statistics.paired import (
    DIFFERENCES,
    FAILURE_RATE,
    OWN,
    PAIRED,
    THEIRS,
    paired_grid,
)
from boresight.reports.statistics.roc import DEFINITIONS, OutlierScore, outlier_grid, outlier_scores
from boresight.reports.tables import (
    detail_grid,
    diagnostic_brief,
    diagnostic_grid,
    pose_grids,
    reference_grid,
    timing_grid,
)
from boresight.reports.verdicts import comparison_grid
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.spec.camera import CameraSpec

_PAPER = (
    ("database_landmarks", "database", "count"),
    ("database_facets", "database", "count"),
    ("n_landmarks", "recognition", MEDIAN.name),
    ("position_error_m", "recognition", MEDIAN.name),
    ("attitude_error_deg", "recognition", MEDIAN.name),
)
_SIZE_HEADS = (
    "scenario", "estimator", "landmarks", "facets", "landmarks an image", "position m [95 %]", "attitude deg [95 %]",
    "ok", "failures", "position against the first [95 %]", "attitude against the first [95 %]",
)  # fmt: skip
_SIZE_NOTE = (
    "Size of each data base, medians of the number of recognised landmarks and of the errors after recognition,"
    " failures (no estimate, or a position error above the prior's), and the medians of the differences to the first"
    " line, trial by trial (negative is better)."
)


def mesh_variants(run: RunData) -> list[tuple[str, str]]:
    """List the scenario and estimator of each landmark mesh, in the order of the campaign, where there are several."""
    meshes = [product for product in run.manifest.products if product.n_facets is not None and product.database == 0]
    several = [
        scenario
        for scenario in dict.fromkeys(product.scenario for product in meshes)
        if len({product.folder for product in meshes if product.scenario == scenario}) > 1
    ]
    return [(product.scenario, product.estimator) for product in meshes if product.scenario in several]


def sensitivity_grid(
    records: Sequence[Record], pairs: Sequence[tuple[str, str]], paper: Comparison | None = None
) -> Grid | None:
    """Tabulate the size of several data bases and the errors that follow; None where there are not at least two.

    ``records`` are of one run, ``pairs`` scenario and estimator of each line, in their order. The values of a ``paper``
    make the first line.
    """
    if len(pairs) < 2:
        return None
    known = by_key(records)
    found = [paper.find(*key) for key in _PAPER] if paper is not None else []
    rows = [("", "the paper", *(one.printed if one else NO_VALUE for one in found), *[NO_VALUE] * 4)] if found else []
    for scenario, label in pairs:
        own = [key for key in known if (key.scenario, key.estimator) == (scenario, label)]
        first = (key.stage for key in own if (key.measure, key.statistic) == ("n_landmarks", MEDIAN.name))
        solved = Key(scenario, label, next(first, "recognition"), "", "n_landmarks", MEDIAN.name)
        sizes = (Key(scenario, label, "database", "", f"database_{name}", "count") for name in ("landmarks", "facets"))
        errors = [known.get(solved._replace(measure=name)) for name in POSE_COLUMNS[:2]]
        against = next((key.reference for key in own if key.stage == PAIRED), "")
        paired = Key(scenario, label, PAIRED, against, FAILURE_RATE, OWN)
        # The first line has no rate of its own: it is with those of the others, which are held against it.
        theirs = (key for key in known if key[0] == scenario and key[2:] == (PAIRED, label, FAILURE_RATE, THEIRS))
        rates = known.get(paired) or next(map(known.get, theirs), None)
        differences = (known.get(paired._replace(measure=name, statistic=MEDIAN.name)) for name in DIFFERENCES)
        rows.append((
            scenario,
            label,
            *(value_of(known.get(key)) for key in (*sizes, solved)),
            *(value_of(one, interval=True) for one in errors),
            counts(errors[0]),
            value_of(rates),
            *(value_of(one, interval=True) for one in differences),
        ))  # fmt: skip
    return Grid("Sensitivity of data base and errors", _SIZE_HEADS, tuple(rows), frozenset({0, 1}), _SIZE_NOTE)


def image_figures(content: Content) -> Iterator[NamedFigure]:
    """Draw every figure that the tables of a run of single images allow."""
    pairs = content.run.posed_pairs()
    yield from range_figures(content.run)
    for scenario in dict.fromkeys(scenario for scenario, _ in pairs):
        for estimator in (name for where, name in pairs if where == scenario and name != CONTROL):
            yield pose_figure(content, scenario, estimator)
            yield from landmark_figures(content, scenario, estimator)
            yield from _outlier_figures(content.run, scenario, estimator)
        yield from _scenario_figures(content, scenario, [name for where, name in pairs if where == scenario])
    told = content.run.table("diagnostics")
    for estimator in dict.fromkeys(told.loc[told["name"] == "centroid_du_px", "estimator"]):
        title = f"Offset of the brightness centroid, observed minus rendered, {estimator}"
        yield NamedFigure(
            file_stem("centroid_offsets", str(estimator)),
            draw_centroid_offsets(centroid_offsets(content.run, str(estimator)), title),
            f"{title}: one point a trial; ellipses: one standard deviation of the sample.",
            "Scatter of the offsets of the brightness centroid along the columns and rows of the image.",
        )


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
    marks = run.of(scenario, estimator, "landmarks")
    error, chi_square = (marks[name].dropna().to_numpy(dtype=np.float64) for name in ("error_m", "chi_square"))
    if len(error) and len(chi_square):
        title = f"Landmark recognition error, {scenario}, {estimator}"
        yield NamedFigure(
            file_stem("landmark_errors", scenario, estimator),
            draw_landmark_errors(error, chi_square, title, credit_lines),
            f"{title}: distance from the landmark of the data base to the surface point that was matched with it, and"
            " the same weighted by the landmark's covariance, with the distribution that a Gaussian error would give.",
            "Histogram of landmark errors in metres, and histogram of chi-square with its theoretical curve.",
        )
    rows = run.of(scenario, estimator)
    counts = rows.loc[rows["status"] == "ok", "n_landmarks"].dropna().to_numpy(dtype=np.float64)
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


def _outlier_figures(run: RunData, scenario: str, estimator: str) -> Iterator[NamedFigure]:
    panels: dict[str, list[OutlierScore]] = {}
    for one in outlier_scores(run):
        if (one.scenario, one.estimator) == (scenario, estimator):
            panel = f"{DEFINITIONS[one.definition]} ({int(one.bad.sum())} of {len(one.bad)})"
            panels.setdefault(panel, []).append(one)
    if panels:
        title = f"What tells bad solutions, {scenario}, {estimator}"
        yield NamedFigure(
            file_stem("outliers", scenario, estimator),
            draw_roc(panels, title, run.manifest.credits),
            f"{title}: share of the bad solutions against that of the good ones beyond a threshold on a number that the"
            " estimator reports; the diagonal is chance.",
            f"Receiver operating characteristics for {' and '.join(panels)}.",
        )


def _scenario_figures(content: Content, scenario: str, labels: Sequence[str]) -> Iterator[NamedFigure]:
    """Draw all estimators of a scenario: their final errors over each other, and their shares."""
    run = content.run
    rows = {label: run.of(scenario, label) for label in labels}
    final = {label: own for label, own in rows.items() if label != CONTROL}
    if len(final) > 1:
        title = f"Final pose error by estimator, {scenario}"
        yield NamedFigure(
            file_stem("method_errors", scenario),
            draw_method_errors({"": final}, title, run.manifest.credits),
            f"{title}: normalised histograms over the trials with an estimate; what lies beyond the axis is said in the"
            " legend.",
            f"Two histograms of the errors of attitude and position of {', '.join(final)}.",
        )
    title = f"Cumulative error, {scenario}"
    solved = {label: (own[own["status"] == "ok"], len(own)) for label, own in rows.items()}
    yield NamedFigure(
        file_stem("cumulative_errors", scenario),
        draw_cumulative_errors(solved, title, run.manifest.credits),
        f"{title}: share of all trials with an error below the abscissa; a curve ends at the share of trials with an"
        " estimate.",
        f"Cumulative shares of attitude and position error for {', '.join(rows)}.",
    )


def centroid_offsets(run: RunData, estimator: str) -> dict[str, FloatArray]:
    """Collect the offsets (n, 2) of the brightness centroid that an estimator reports, px, scenario by scenario."""
    numbers = run.table("diagnostics")[run.table("diagnostics")["estimator"] == estimator]
    axes = numbers[numbers["name"].isin(["centroid_du_px", "centroid_dv_px"])]
    wide = axes.pivot_table(index=["scenario", "trial"], columns="name", values="value")
    return {
        str(name): table[["centroid_du_px", "centroid_dv_px"]].dropna().to_numpy(dtype=np.float64)
        for name, table in wide.groupby("scenario", sort=False)
    }


def derived_records(run: RunData, radius_m: float) -> Iterator[Record]:
    """Work out, for each scenario, what one pixel on the boresight amounts to at the median range of its trials.

    ``pixel_scale_m`` on the near side of a ball of that radius; ``pixel_rotation_deg``, the turn of the ball that moves
    its near side by a pixel; ``pixel_displacement_m``, the camera's own displacement in the body frame that looks the
    same (Rowell et al. 2015, sections 4.2 and 4.3).
    """
    for name, scenario in run.manifest.scenarios.items():
        try:
            camera = CameraSpec.model_validate(scenario.get("camera", {})).camera()
        except (AttributeError, ValidationError):
            continue
        range_m = float(run.rows.loc[run.rows["scenario"] == name, "range_m"].median())
        scale_m = camera.pixel_angle_rad * (range_m - radius_m)
        values = {
            "pixel_scale_m": scale_m,
            "pixel_rotation_deg": math.degrees(scale_m / radius_m),
            "pixel_displacement_m": scale_m / radius_m * range_m,
        }
        sample = Sample(str(name), "", DERIVED, 1)
        for quantity, value in values.items() if math.isfinite(range_m) else ():
            yield sample.record(quantity, "value", Measured(value, value, value))


def records(run: RunData, comparison: Comparison | None) -> Iterable[Record]:
    """Compute what follows from the scenario alone, where the paper names the body's radius."""
    return derived_records(run, comparison.radius_m) if comparison is not None and comparison.radius_m else ()


def tables(content: Content) -> Tables:
    """List the tables of single images, or of the grid that their scenarios are."""
    measured, run = content.records, content.run
    if run.manifest.grid is not None:
        return design_grids(run)
    return (
        *pose_grids(measured, run),
        reference_grid(measured, run),
        comparison_grid(content.compared),
        detail_grid(measured),
        diagnostic_grid(measured),
        paired_grid(measured),
        consistency_grid(measured),
        sensitivity_grid(measured, mesh_variants(run)),
        outlier_grid(measured),
        timing_grid(measured),
    )


def brief(content: Content) -> Tables:
    """List what the terminal shows: errors of poses, of other trials the numbers that they report."""
    if content.run.manifest.grid is not None:
        return design_grids(content.run, brief=True)
    several = len({r.estimator for r in content.records if r.estimator and r.stage != CONTROL}) > 1
    heads = (*(["estimator"] if several else []), "stage", "solved", "success", "position m", "attitude deg")
    poses = [grid.keep(*heads) for grid in pose_grids(content.records, content.run)]
    return poses or diagnostic_brief(content.records)


def figures(content: Content) -> Iterable[NamedFigure]:
    """Draw the figures of single images, or of the grid that their scenarios are."""
    return image_figures(content) if content.run.manifest.grid is None else design_figures(content.run)


REPORT = ReportKind(records=records, tables=tables, brief=brief, figures=figures)
