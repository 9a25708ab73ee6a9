"""Figures and tables of Delpech et al. (2015), from the newest finished runs of its campaigns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.kinds.sequence.images import OrbitImages
from boresight.campaign.papers.page import FinishedRun, Paper, PaperFigure
from boresight.reports.figures.followed import revolution_figure, revolution_series, start_figure, trace_figure
from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.sequences import LANDMARKS, POSITION, draw_sightings
from boresight.reports.kinds.designs import design_grids
from boresight.reports.kinds.sequence import ratio_grids, sequence_grid, sign_grids, vision_grid, without_pooled
from boresight.reports.schema.grid import Grid
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario

_STRONGEST = 30
_SENSITIVITY = "delpech2015-sensitivity"


def first_image(
    scenario: LoadedScenario, variant: str, seed: int, count: int
) -> tuple[NDArray[np.float32], NDArray[np.float64], int]:
    """Return the image (H, W) of trial 0, its ``count`` strongest features (n, 2), px, and their total number."""
    images = OrbitImages.open(scenario, variant, seed)
    features = images.found(0, 0).features
    return images.image(0, 0), features.uv_px[:count], len(features)


def _trace(run: FinishedRun, method: str, panel: str) -> Iterator[NamedFigure]:
    """Draw one panel of the errors of a method over the frames."""
    data, labels = run.content.run, run.labels(method)
    scenario = next(scenario for scenario, name in data.pairs() if name in labels)
    yield trace_figure(data, scenario, labels, (panel,))


def _series(run: FinishedRun, abscissa: str) -> Iterator[NamedFigure]:
    """Draw the errors after one and two revolutions over a series."""
    data = run.content.run
    series = revolution_series(data)
    if not series:
        raise BoresightError(f"{run.folder.path}: it is no series by {abscissa}, or no trial came round once")
    yield revolution_figure(data, series, abscissa)


def _starts(run: FinishedRun, method: str) -> Iterator[NamedFigure]:
    """Draw the errors of a method for all starting images."""
    data, label = run.content.run, run.labels(method)[0]
    scenario = next(scenario for scenario, name in data.pairs() if name == label)
    yield start_figure(data, scenario, label)


def _image(run: FinishedRun, features: int) -> Iterator[NamedFigure]:
    """Draw the first image with its strongest features (0 for none)."""
    campaign = run.campaign()
    scenario = campaign.scenarios[0]
    image, uv_px, found = first_image(scenario, campaign.variant, campaign.seed, _STRONGEST)
    name = scenario.spec.name
    shown = f"the {len(uv_px)} strongest of {found} features" if features else "the first image"
    yield NamedFigure(
        "", draw_sightings(image, uv_px[:features], f"{name}: {shown}"),
        f"The body as the camera sees it over the terminator, {name}: {shown}.",
        f"A half-lit textured sphere, {shown}.",
    )  # fmt: skip


def _grids(run: FinishedRun) -> list[Grid]:
    """Return the tables that accompany the published numbers: statistics, and ratios between the methods."""
    content = run.content
    records = without_pooled(content.run, content.records)
    found = [*ratio_grids(records), *sign_grids(records, content.run)]
    found += design_grids(content.run) if run.manifest["name"] == _SENSITIVITY else []
    tables = (sequence_grid(records), vision_grid(records))
    return [replace(grid, title=f"{run.manifest['name']}: {grid.title}") for grid in (*tables, *found) if grid]


_ORDER = (
    "ba-trace", "ba-landmarks", "ba-views", "ekf-trace", "comparison", "images", "images-textures", "sensitivity",
)  # fmt: skip
PAPER = Paper(
    title="Delpech et al. (2015): every figure and every number",
    campaigns=(*(f"delpech2015-{name}" for name in _ORDER), "trade-slam"),
    methods=("ba-slam", "ekf-slam"),
    figures=(
        PaperFigure("3.1", ("delpech2015-ba-trace",), partial(_trace, method="ba-slam", panel=POSITION)),
        PaperFigure("3.2", ("delpech2015-ba-trace",), partial(_trace, method="ba-slam", panel=LANDMARKS)),
        PaperFigure("4.1", ("delpech2015-ba-landmarks",), partial(_series, abscissa="landmarks a frame")),
        PaperFigure("4.2", ("delpech2015-ba-views",), partial(_series, abscissa="views")),
        PaperFigure("5.1", ("delpech2015-ekf-trace",), partial(_trace, method="ekf-slam", panel=POSITION)),
        PaperFigure("5.2", ("delpech2015-ekf-trace",), partial(_trace, method="ekf-slam", panel=LANDMARKS)),
        PaperFigure("6.1", ("delpech2015-images",), partial(_image, features=0)),
        PaperFigure("6.2", ("delpech2015-images",), partial(_image, features=_STRONGEST)),
        PaperFigure("7.1", ("delpech2015-images",), partial(_starts, method="ba-slam")),
        PaperFigure("7.2", ("delpech2015-images",), partial(_starts, method="ekf-slam")),
    ),
    grids=_grids,
)
