"""Report of single images."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from pydantic import ValidationError

from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.designs.figures import design_figures
from boresight.reports.kinds.designs.tables import design_grids
from boresight.reports.kinds.single_image.databases import mesh_variants, sensitivity_grid, trade_grid
from boresight.reports.kinds.single_image.figures import image_figures
from boresight.reports.published import Comparison
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.named_figure import NamedFigure
from boresight.reports.schema.records import CONTROL, DERIVED, Record
from boresight.reports.statistics.consistency import consistency_grid
from boresight.reports.statistics.measured import Measured, Sample
from boresight.reports.statistics.paired import paired_grid
from boresight.reports.statistics.roc import outlier_grid
from boresight.reports.tables import (
    detail_grid,
    diagnostic_brief,
    diagnostic_grid,
    pose_grids,
    reference_grid,
    timing_grid,
)
from boresight.reports.verdicts import comparison_grid
from boresight.scenarios.spec.camera import CameraSpec


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
        for measure, value in values.items() if math.isfinite(range_m) else ():
            yield Sample(str(name), "", DERIVED, 1).record(measure, "value", Measured(value, value, value))


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
        trade_grid(run),
        detail_grid(measured),
        diagnostic_grid(measured),
        paired_grid(measured),
        consistency_grid(measured),
        sensitivity_grid(measured, mesh_variants(run)),
        outlier_grid(measured),
        timing_grid(measured),
    )


def pose_brief(content: Content) -> list[Grid]:
    """List the errors of poses for the terminal."""
    several = len({r.estimator for r in content.records if r.estimator and r.stage != CONTROL}) > 1
    counted = (*(["estimator"] if several else []), "stage", "solved", "success")
    return [grid.keep(*counted, "position m", "attitude deg") for grid in pose_grids(content.records, content.run)]


def brief(content: Content) -> Tables:
    """List what the terminal shows: errors of poses, of other trials the numbers that they report."""
    if content.run.manifest.grid is not None:
        return design_grids(content.run, brief=True)
    return pose_brief(content) or diagnostic_brief(content.records)


def figures(content: Content) -> Iterable[NamedFigure]:
    """Draw the figures of single images, or of the grid that their scenarios are."""
    return image_figures(content) if content.run.manifest.grid is None else design_figures(content.run)


REPORT = ReportKind(records=records, tables=tables, brief=brief, figures=figures)
