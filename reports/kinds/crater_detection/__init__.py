"""Report of crater detection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.crater_detection.figures import crater_figures
from boresight.reports.kinds.crater_detection.rates import (
    DetectorResults,
    crater_brief,
    crater_grids,
    crater_records,
    detector_results,
)
from boresight.reports.schema.grid import NO_VALUE, Grid, row_grid
from boresight.reports.tables import timing_grid
from boresight.reports.verdicts import comparison_grid

_OF_NORMAL = 1.4826
_SIZES = 10
_LEAST = 5 * _SIZES
_EMISSION_DEG, _INCIDENCE_DEG, _IN_FRAME = 65.0, 80.0, 0.95
_HEADS = ("centre_sigma_px", "centre_sigma_radii", "size_sigma", "axes_sigma", "redetected")
_NOTE = (
    "Deviations under the names that `association` has for them, of detections that reach the detector's threshold and"
    " are matched. A coordinate of the centre has the variance centre_sigma_px^2 + (centre_sigma_radii r)^2, fitted to"
    " tenths of the detections by their radius r; each tenth's is the median absolute deviation times 1.4826, as those"
    " who use it leave out what is far off. Size and axes are logarithms of the ratios of radii and of ratios of axes,"
    " weighed by a normal law: standard deviations. redetected: of craters that two other images show detected, the"
    f" share detected where they are in the frame, emission under {_EMISSION_DEG:g} deg and incidence under"
    f" {_INCIDENCE_DEG:g} deg. A campaign whose methods are given these must show other craters."
)


def rim_scatter(one: DetectorResults) -> dict[str, float] | None:
    """Measure the scatter of detected rims about true ones, as the note of `rim_grid` says; None with too few matches.

    The keys are `_HEADS`.
    """
    found = one.detections
    found = found[found["kept"].to_numpy(dtype=bool) & (found["crater"].to_numpy() >= 0)]
    if len(found) < _LEAST:
        return None
    axes = found[["major_px", "minor_px"]].to_numpy(dtype=np.float64)
    true = axes - found[["major_error_px", "minor_error_px"]].to_numpy(dtype=np.float64)
    square, ratios = true.prod(axis=1), np.log(axes / true)
    # The variance of a coordinate of the centre is fitted to tenths of the radii, each counting by its relative error.
    centre = found[["centre_error_u_px", "centre_error_v_px"]].to_numpy(dtype=np.float64)
    tenths = np.array_split(np.argsort(np.sqrt(square), kind="stable"), _SIZES)
    spread = [np.median(np.abs(centre[rows] - np.median(centre[rows]))) for rows in tenths]
    variance = (_OF_NORMAL * np.array(spread)) ** 2
    weight = 1.0 / np.maximum(variance, np.finfo(np.float64).tiny)
    squares = np.array([square[rows].mean() for rows in tenths])
    fitted, _ = nnls(np.column_stack([weight, weight * squares]), weight * variance)
    size, shape = 0.5 * ratios.sum(axis=1), ratios[:, 1] - ratios[:, 0]
    numbers = (*np.sqrt(fitted), size.std(), shape.std(), _redetected(one.craters))
    return dict(zip(_HEADS, map(float, numbers), strict=True))


def _redetected(craters: pd.DataFrame) -> float:
    """Share of the looks at known craters, those that two other images show detected, in which they are detected."""
    kept = craters["kept"].to_numpy(dtype=bool)
    elsewhere = craters.groupby(["world", "crater"])["kept"].transform("sum").to_numpy(dtype=np.int64) - kept
    looks = (
        (elsewhere >= 2)
        & (craters["in_frame"].to_numpy() >= _IN_FRAME)
        & (craters["emission_deg"].to_numpy() <= _EMISSION_DEG)
        & (craters["incidence_deg"].to_numpy() <= _INCIDENCE_DEG)
    )
    return float(kept[looks].mean()) if looks.any() else 0.0


def rim_grid(ones: Sequence[DetectorResults]) -> Grid:
    """Tabulate the scatter of each detector."""
    rows = []
    for one in ones:
        scatter = rim_scatter(one) or {}
        cells = {head: f"{scatter[head]:.3g}" if head in scatter else NO_VALUE for head in _HEADS}
        rows.append({"scenario": one.scenario, "detector": one.estimator} | cells)
    return row_grid("Scatter of detected rims", rows, ("scenario", "detector"), _NOTE)


def tables(content: Content) -> Tables:
    """List the tables of a report."""
    return (
        *crater_grids(content.records, content.run),
        rim_grid(list(detector_results(content.run))),
        comparison_grid(content.compared),
        timing_grid(content.records),
    )


REPORT = ReportKind(
    records=lambda run, comparison: crater_records(run),
    tables=tables,
    brief=lambda content: crater_brief(content.records),
    figures=lambda content: () if content.run.table("craters").empty else crater_figures(content.run),
)
