"""Report of crater detection, and figures of detected craters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.reports.figures.craters import (
    FALSE_COLOUR,
    FOUND_COLOUR,
    OTHER_COLOUR,
    TRUE_COLOUR,
    draw_confidence_curves,
    draw_found_and_true,
    draw_rates,
    draw_stages,
)
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.crater_detection.rates import (
    BINNINGS,
    DetectorResults,
    binned_rates,
    confidence_curve,
    crater_brief,
    crater_grids,
    crater_records,
    detector_results,
    rim_grid,
)
from boresight.reports.run.data import RunData, select
from boresight.reports.tables import timing_grid
from boresight.reports.verdicts import comparison_grid
from boresight.scenarios.geometry import Ellipses

_ELLIPSE = ["u_px", "v_px", "major_px", "minor_px", "angle_deg"]


def crater_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw, for each scenario, the curves over confidence and the rates by what craters are like."""
    of_scenario: dict[str, list[DetectorResults]] = {}
    for one in detector_results(run):
        if len(one.detections):
            of_scenario.setdefault(one.scenario, []).append(one)
    for scenario, ones in of_scenario.items():
        title = f"Craters found over false alarms, {scenario}"
        yield NamedFigure(
            file_stem("crater_curves", scenario),
            draw_confidence_curves({one.estimator: confidence_curve(one) for one in ones}, title),
            f"{title}: as the threshold on the confidence falls. Detections of listed craters that are not"
            " detectable count neither way. Circles: at the detector's own threshold."
            " Star: what the paper claims, without a definition.",
            "Curves that rise from the left: the share of craters found against the share of false alarms.",
        )
        panels = {
            what: {
                one.estimator: [
                    (f"{low:g}-{high:g}" if np.isfinite(high) else f"{low:g}+", rate.bar)
                    for (low, high), (rate, _) in binned_rates(one, column, edges).items()
                    if rate.value is not None
                ]
                for one in ones
            }
            for what, column, edges in BINNINGS
        }
        title = f"Detectable craters found, {scenario}"
        yield NamedFigure(
            file_stem("crater_rates", scenario),
            draw_rates(panels, title),
            f"{title}: by diameter, degradation and incidence, at each detector's threshold; bars: 95 %, by images.",
            "Rates with error bars in bins of diameter, degradation and incidence.",
        )


def example_figure(run: RunData, scenario: str, estimator: str, trial: int, image: NDArray[np.float32]) -> NamedFigure:
    """Draw one image of a stored run with its craters and a detector's: figures 2 and 3 of Cheng et al. (2003)."""
    truth = run.table("craters")
    truth = truth[(truth["scenario"] == scenario) & (truth["trial"] == trial)]
    found = select(run.table("detections"), scenario, estimator)
    found = found[(found["trial"] == trial) & found["kept"].astype(bool)]
    detectable, matched = (values.to_numpy(dtype=np.bool_) for values in (truth["detectable"], found["crater"] >= 0))
    return draw_example(
        image,
        (ellipses_of(truth.to_dict("records")), detectable),
        (ellipses_of(found.to_dict("records")), matched),
        file_stem("crater_example", scenario, estimator, str(trial)),
        f"{scenario}, {estimator}, image {trial}",
    )


Marked = tuple[Ellipses, NDArray[np.bool_]]
"""Rims, and which of them are detectable or matched."""


def draw_example(image: NDArray[np.float32], truth: Marked, found: Marked, stem: str, title: str) -> NamedFigure:
    """Draw an image with its true rims, bright where detectable, and with detected ones, red where none is matched."""
    (true_rims, detectable), (found_rims, matched) = truth, found
    figure = draw_found_and_true(
        image,
        [(true_rims[~detectable], OTHER_COLOUR), (true_rims[detectable], TRUE_COLOUR)],
        [(found_rims[matched], FOUND_COLOUR), (found_rims[~matched], FALSE_COLOUR)],
        title,
    )
    return NamedFigure(
        stem,
        figure,
        f"{title}: left, the image; middle, the true rims, bright where they are detectable; right, detections, blue"
        " where a crater is matched and red where none is.",
        "A cratered surface three times: plain, with the true rims, and with the detected ones.",
    )


def stages_figure(
    image: NDArray[np.float32],
    edges: NDArray[np.bool_],
    arcs: Mapping[str, Sequence[NDArray[np.float64]]],
    found: Ellipses,
    what: str,
) -> NamedFigure:
    """Draw the stages of a detector of rims: figure 2 of Cheng et al. (2003)."""
    return NamedFigure(
        file_stem("crater_stages", what),
        draw_stages(image, edges, arcs, found),
        f"Results of the stages of detection, {what}: (a) the image; (b) Canny edges of both passes; (c) the convex rim"
        " edges that are left, those of the shaded side blue and those of the lit side orange; (d) detected craters.",
        "A cratered surface, its edges, those of them that are rims, and the detected craters.",
    )


def ellipses_of(rows: Sequence[Mapping[Any, object]]) -> Ellipses:
    """Read rims from rows of a stored table."""
    numbers = np.array([[float(str(row[name])) for name in _ELLIPSE] for row in rows]).reshape(-1, len(_ELLIPSE))
    return Ellipses(numbers[:, :2], numbers[:, 2:4], np.radians(numbers[:, 4]))


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
