"""Report of an arc of planned images: their coverage, and the craters in them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from boresight.reports.figures.craters import draw_count_histogram
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.kinds import ReportKind
from boresight.reports.published import Comparison
from boresight.reports.run.data import RunData
from boresight.reports.schema.records import DIAGNOSTICS
from boresight.reports.tables import diagnostic_brief, diagnostic_grid
from boresight.reports.verdicts import comparison_grid

_FEW = 7
"""Craters of an image that the paper calls few: its median."""


def survey_figures(run: RunData, comparison: Comparison | None) -> Iterator[NamedFigure]:
    """Draw, for each scenario, similar images, craters an image and hits of a crater, in the first arc."""
    surveyed = run.table("surveyed_images"), run.table("surveyed_craters")
    names = ("detections_an_image", "few_craters_share")
    mean, few = (comparison and comparison.find(name, DIAGNOSTICS, "median") for name in names)
    published = ({"mean": mean.value} if mean else {}) | ({"median": float(_FEW)} if few else {})
    for scenario in dict.fromkeys(surveyed[0]["scenario"]):
        first = surveyed[0]["trial"].min()
        images, craters = (one[(one["scenario"] == scenario) & (one["trial"] == first)] for one in surveyed)
        images, craters = (one[one["estimator"] == images["estimator"].iloc[0]] for one in (images, craters))
        similar, found = (images[name].to_numpy(dtype=np.int64) for name in ("n_similar", "n_detections"))
        hits = craters["hits"].to_numpy(dtype=np.int64)
        what = f"{len(images)} images, {scenario}"
        for stem, counts, abscissa, of, marks, title, caption, alt in (
            (
                "similar_images", similar, "other images of the same area, Suns within 10 deg", "images", {},
                f"Photometrically similar images: {what}",
                "Histogram of the photometrically similar images of each image: others that share a tenth of a lit"
                " region with it, with the direction of the Sun within 10 deg in the body's axes;"
                f" {what}. {100.0 * float((similar > 0).mean()):.1f} % have one.",
                "Histogram of the number of similar images.",
            ),
            (
                "craters_an_image", found, "craters detected in an image", "images", published,
                f"{found.sum():,} craters detected: {what}",
                f"Distribution of the number of craters detected in an image: {what}."
                f" {100.0 * float((found <= _FEW).mean()):.1f} % have {_FEW} or fewer.",
                "Histogram of the number of craters in an image.",
            ),
            (
                "hits", hits, "images in which a crater is detected", "craters", {},
                f"{len(hits):,} craters: {what}",
                f"Histogram of the number of hits: in how many images each of {len(hits):,} craters is detected;"
                f" {what}.",
                "Histogram of the number of images that show a crater.",
            ),
        ):  # fmt: skip
            drawn = draw_count_histogram(counts, abscissa, of, marks, title)
            yield NamedFigure(file_stem(stem, scenario), drawn, caption, alt)


REPORT = ReportKind(
    tables=lambda content: (comparison_grid(content.compared), diagnostic_grid(content.records)),
    brief=lambda content: diagnostic_brief(content.records),
    figures=lambda content: survey_figures(content.run, content.comparison),
)
