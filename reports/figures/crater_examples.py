"""Images of a run of crater detectors with their true and detected rims, and the stages of a detector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.figures.craters import Marked, draw_found_and_true, draw_stages
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.run.data import RunData
from boresight.scenarios.geometry import Ellipses

_ELLIPSE = ["u_px", "v_px", "major_px", "minor_px", "angle_deg"]


def example_figure(run: RunData, scenario: str, estimator: str, trial: int, image: NDArray[np.float32]) -> NamedFigure:
    """Draw one image of a stored run with its craters and a detector's: figures 2 and 3 of Cheng et al. (2003)."""
    truth = run.table("craters")
    truth = truth[(truth["scenario"] == scenario) & (truth["trial"] == trial)]
    found = run.of(scenario, estimator, "detections")
    found = found[(found["trial"] == trial) & found["kept"].astype(bool)]
    detectable, matched = (values.to_numpy(dtype=np.bool_) for values in (truth["detectable"], found["crater"] >= 0))
    return draw_example(
        image,
        (ellipses_of(truth), detectable),
        (ellipses_of(found), matched),
        file_stem("crater_example", scenario, estimator, str(trial)),
        f"{scenario}, {estimator}, image {trial}",
    )


def draw_example(image: NDArray[np.float32], truth: Marked, found: Marked, stem: str, title: str) -> NamedFigure:
    """Draw an image with its true rims, bright where detectable, and with detected ones, red where none is matched."""
    return NamedFigure(
        stem,
        draw_found_and_true(image, truth, found, title),
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


def ellipses_of(rows: pd.DataFrame | Sequence[Mapping[str, object]]) -> Ellipses:
    """Read rims from rows of a stored table."""
    table = pd.DataFrame(rows)
    # Tables without rows may have no columns; rows that lack one are an error.
    numbers = table[_ELLIPSE].to_numpy(dtype=np.float64) if len(table) else np.empty((0, len(_ELLIPSE)))
    return Ellipses(numbers[:, :2], numbers[:, 2:4], np.radians(numbers[:, 4]))
