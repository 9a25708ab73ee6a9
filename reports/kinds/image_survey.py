"""Report of an arc of planned images: their coverage, and the craters in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from boresight.reports.figures.orbit import draw_count_histogram
from boresight.reports.kinds import ReportKind
from boresight.reports.published import Comparison
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.named_figure import NamedFigure, file_stem
from boresight.reports.schema.records import DIAGNOSTICS, Record
from boresight.reports.tables import diagnostic_brief, diagnostic_grid
from boresight.reports.verdicts import ComparedValue, comparison_grid

_MEAN, _FEW = ("detections_an_image", "mean"), ("few_craters_share", 7.0)


def survey_grids(records: Sequence[Record], compared: Sequence[ComparedValue]) -> list[Grid]:
    """List the tables of a run that surveys images."""
    return [grid for grid in (comparison_grid(compared), diagnostic_grid(records)) if grid is not None]


def survey_figures(run: RunData, comparison: Comparison | None) -> Iterator[NamedFigure]:
    """Draw, for each scenario, similar images, craters an image and hits of a crater, in the first arc."""
    for scenario in dict.fromkeys(run.table("surveyed_images")["scenario"]):
        first = run.table("surveyed_images")["trial"].min()
        images, craters = (
            table[(table["scenario"] == scenario) & (table["trial"] == first)]
            for table in (run.table("surveyed_images"), run.table("surveyed_craters"))
        )
        one = images["estimator"].iloc[0]
        images, craters = images[images["estimator"] == one], craters[craters["estimator"] == one]
        counts = {name: images[name].to_numpy(dtype=np.int64) for name in ("n_similar", "n_detections")}
        what = f"{len(images)} images, {scenario}"
        share = 100.0 * float((counts["n_similar"] > 0).mean())
        yield NamedFigure(
            file_stem("similar_images", scenario),
            draw_count_histogram(
                counts["n_similar"], "other images of the same area, Suns within 10 deg", "images", {},
                f"Photometrically similar images: {what}",
            ),
            f"Histogram of the photometrically similar images of each image: others that share a tenth of a lit"
            f" region with it, with the direction of the Sun within 10 deg in the body's axes; {what}."
            f" {share:.1f} % have one.",
            "Histogram of the number of similar images.",
        )  # fmt: skip
        yield NamedFigure(
            file_stem("craters_an_image", scenario),
            draw_count_histogram(
                counts["n_detections"], "craters detected in an image", "images", _published(comparison),
                f"{counts['n_detections'].sum():,} craters detected: {what}",
            ),
            f"Distribution of the number of craters detected in an image: {what}."
            f" {100.0 * float((counts['n_detections'] <= 7).mean()):.1f} % have 7 or fewer.",
            "Histogram of the number of craters in an image.",
        )  # fmt: skip
        hits = craters["hits"].to_numpy(dtype=np.int64)
        yield NamedFigure(
            file_stem("hits", scenario),
            draw_count_histogram(
                hits, "images in which a crater is detected", "craters", {}, f"{len(hits):,} craters: {what}"
            ),
            f"Histogram of the number of hits: in how many images each of {len(hits):,} craters is detected; {what}.",
            "Histogram of the number of images that show a crater.",
        )


def _published(comparison: Comparison | None) -> dict[str, float]:
    """Return the published numbers of craters in an image that the histogram can mark."""
    if comparison is None:
        return {}
    mean = comparison.find(_MEAN[0], DIAGNOSTICS, "median")
    few = comparison.find(_FEW[0], DIAGNOSTICS, "median")
    return ({"mean": mean.value} if mean else {}) | ({"median": _FEW[1]} if few else {})


REPORT = ReportKind(
    tables=lambda content: survey_grids(content.records, content.compared),
    brief=lambda content: diagnostic_brief(content.records),
    figures=lambda content: survey_figures(content.run, content.comparison),
)
