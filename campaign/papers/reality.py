"""Errors on real images and tracks next to the simulated ones: one table over the campaigns on real data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from boresight.campaign.data.crater_pictures import OPTIONS, RADIUS_MIN_PX
from boresight.campaign.data.known_ground import detect_labelled, moon_pictures
from boresight.campaign.imaging.credits import credit_lines
from boresight.campaign.imaging.real_images import open_tracks
from boresight.campaign.imaging.world import open_world
from boresight.campaign.papers.page import FinishedRun, Paper, PaperFigure
from boresight.estimators.craters.learned.heat_map_detector import CraterHeatMap
from boresight.reports.figures.craters import draw_detections
from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.pose import draw_cumulative_errors
from boresight.reports.figures.style import (
    BLUE,
    VERMILION,
    PlotStyle,
    finish,
    grid_figure,
    image_panel,
    new_figure,
    plot_styles,
    styled,
)
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid, number, row_grid
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.reality import levels_of, reality_grid, reality_rows
from boresight.scenarios.arrays import Image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.reading import CONTENT_FAULTS

_IMAGES = {"compare-navcam67p": "67P, 60 images"}
_SHOWN, _MOST_PERCENT = 3, 99.5
_TRACKS = "vesta-real-slam"
_SIMULATED = {"vesta-simulated-slam": "simulated", "vesta-simulated-loops": "simulated, landmarks found again"}
_ERRORS = "white", "fit-1-32", "fit-33-65", "1-32-by-33-65", "33-65-by-1-32"
SCORES = Path("figures/craters-real/scores.csv")
_GAP, _CELLS, _LEAST_TRACKS = 4, 10, 30
_RECALL = (
    "Share of the labels from 4 px radius that are found. On rendered ground it is of the craters that can be detected."
    " Six images of the Moon and a tile of Mars are too few for an interval."
)


def _rows(found: Mapping[str, FinishedRun]) -> Iterator[dict[str, str]]:
    for name, seen in _IMAGES.items():
        if name in found:
            run = found[name].data
            real_images, rendered = _levels(run)
            yield from reality_rows(seen, (run, real_images), (run, rendered))
    for name, how in _SIMULATED.items():
        if _TRACKS not in found or name not in found:
            continue
        real, simulated = found[_TRACKS].data, found[name].data
        for errors in _ERRORS:
            scenarios = levels_of(real, {"frames": errors.partition("-by-")[0] if "-by-" in errors else "all"})
            for levels, scenario in levels_of(simulated, {"errors": errors}).items():
                if levels not in scenarios:
                    continue
                tracks, every = levels
                ranges = "one range" if every == "0" else f"a range every {every} frames"
                seen = f"Vesta, {tracks} tracks, {ranges}; {how}: {errors}"
                yield from reality_rows(seen, (real, scenarios[levels]), (simulated, scenario), shared=True)


def _views(run: FinishedRun) -> Iterator[NamedFigure]:
    yield NamedFigure(
        "_views", _pictures(run), "Real images (above), renderings of their views with what the spacecraft does not"
        " know (middle), and their difference, grey where they agree (below).",
        "Images of a body, renderings that look alike, and differences that are largest on its outline.",
    )  # fmt: skip


@styled
def _pictures(run: FinishedRun) -> Figure:
    """Draw some real images above the renderings of their views, and below what is left of them."""
    campaign = run.campaign()
    scenarios = [campaign.scenario(name) for name in _levels(run.data)]
    count = run.data.image_of_trial.nunique()
    trials = sorted({count * shown // _SHOWN for shown in range(_SHOWN)})
    figure, panels = grid_figure(3, len(trials), 2.5 * len(trials), 8.0)
    pairs: list[list[Image]] = [[] for _ in trials]
    for row, scenario, what in zip(panels, scenarios, ("real", "rendered"), strict=False):
        source = open_world(scenario, campaign.variant).source
        for axes, trial, pair in zip(row, trials, pairs, strict=True):
            pair.append(source.trial_image(campaign.seed, trial).image)
            image_panel(axes, pair[-1], f"{what}, trial {trial}")
    for axes, (real, rendered) in zip(panels[2], pairs, strict=True):
        smooth, model = (cv2.GaussianBlur(image.astype(np.float64), (0, 0), 1.0) for image in (real, rendered))
        # The rendering in the unit of the image: background and gain by least squares.
        scale = np.polyfit(model.ravel(), smooth.ravel(), 1)
        left = smooth - np.polyval(scale, model)
        limit = float(np.percentile(np.abs(left), _MOST_PERCENT))
        image_panel(axes, np.clip(left, -limit, limit) + limit, "real less rendered")
    return finish(figure, "Real images and renderings of their views", credit_lines(scenarios[0].spec))


def _shares(run: FinishedRun) -> Iterator[NamedFigure]:
    """Draw the position errors on real images next to those on renderings, a curve for each method and half."""
    errors: dict[str, tuple[pd.DataFrame, int]] = {}
    styles: dict[str, PlotStyle] = {}
    labels = [label for label in run.data.manifest.estimators if label != CONTROL]
    for scenario, what in zip(_levels(run.data), ("real", "rendered"), strict=True):
        rows = run.data.rows[run.data.rows["scenario"] == scenario]
        for label, style in plot_styles(labels).items():
            own = rows[rows["estimator"] == label]
            errors[f"{label}, {what}"] = own[own["status"] == "ok"], len(own)
            styles[f"{label}, {what}"] = replace(style, line="-" if what == "real" else "--")
    title, panel = "Errors on real images and on renderings of their views", {"position_error_m": "position error, m"}
    yield NamedFigure(
        "_errors", draw_cumulative_errors(errors, title, (), panel, styles),
        "Share of all trials whose position error is below the abscissa, on real images (full) and on renderings of"
        " their views (dashed).", "Two curves for each method, alike where the simulation predicts the real errors.",
    )  # fmt: skip


def _tracks(run: FinishedRun) -> Iterator[NamedFigure]:
    yield NamedFigure(
        "_tracks", _followed(run), f"Left: tracks of a real frame over the next {_GAP} frames. Right: how far tracks"
        f" drift in {_GAP} frames from the places of their landmarks, triangulated with the reference poses; the median"
        " over all frames in each part of the image, which independent noise would leave near 0.",
        "Lines across the image, and arrows that point towards its centre.",
    )  # fmt: skip


@styled
def _followed(run: FinishedRun) -> Figure:
    """Draw the tracks of the middle frame, and the mean drift of all tracks over the image."""
    (scenario, *_) = run.campaign().scenarios
    table, camera = open_tracks(scenario), scenario.spec.camera.camera().pinhole
    if table is None:
        raise BoresightError(f"{run.folder.path}: has no real tracks")
    uv = table.rays * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
    to_cam = Rotation.from_quat(np.array(table.states.attitude), scalar_first=True).as_matrix()
    away = table.points_m[table.tracks] - np.array(table.states.position_m)[table.frames]
    residual = uv - camera.project(np.einsum("sij,sj->si", to_cam[table.frames], away))
    # Sightings are in the order of tracks and of frames.
    pairs = (table.tracks[_GAP:] == table.tracks[:-_GAP]) & (table.frames[_GAP:] - table.frames[:-_GAP] == _GAP)
    before = np.flatnonzero(pairs)
    figure, (left, right) = new_figure(2, width_in=8.6, height_in=4.4)
    middle = before[table.frames[before] == len(table.states) // 2]
    for first in middle:
        left.plot(*uv[first : first + _GAP + 1].T, color=BLUE, linewidth=0.4)
    left.set_title(f"{len(middle)} tracks of frame {len(table.states) // 2}")
    arrows: dict[str, Any] = {"angles": "xy", "scale": 8.0, "width": 0.004}
    cells, drift = (uv[before] // (camera.width_px / _CELLS)).astype(int), residual[before + _GAP] - residual[before]
    for cell in np.unique(cells, axis=0):
        inside = (cells == cell).all(axis=1)
        if inside.sum() >= _LEAST_TRACKS:
            arrow = *uv[before[inside]].mean(axis=0), *np.median(drift[inside], axis=0)
            right.quiver(*arrow, color=VERMILION, **arrows)
    right.quiver(0.06 * camera.width_px, 0.05 * camera.height_px, 1.0, 0.0, **arrows)
    right.text(0.2 * camera.width_px, 0.06 * camera.height_px, "1 px", fontsize=8)
    right.set_title(f"median drift of {len(before)} pairs of sightings")
    for axes in (left, right):
        axes.set(xlim=(0, camera.width_px), ylim=(camera.height_px, 0), aspect="equal", xlabel="u, px", ylabel="v, px")
    return finish(figure, "Tracks of real images", credit_lines(scenario.spec))


def _rims() -> Iterator[NamedFigure]:
    detector = CraterHeatMap.from_options(OPTIONS[CraterHeatMap.name])
    found = detect_labelled(detector, *moon_pictures("report")[0])
    title = f"{found.name}: {len(found.detections.ellipses)} craters by {detector.name}, labels dashed"
    labels = found.labels or Ellipses.none()
    labels = labels[np.flatnonzero(labels.radius_px >= RADIUS_MIN_PX)]
    yield NamedFigure(
        "_craters", draw_detections(found.image, found.detections.ellipses, labels, [""] * len(labels), title),
        f"Craters found in a real image of the Moon, the first of the report, and its labels from {RADIUS_MIN_PX:g} px"
        " radius (dashed).", "An image of the Moon with rims drawn over it.",
    )  # fmt: skip


def _craters(found: Mapping[str, FinishedRun]) -> list[Grid]:
    """Tabulate the recall of `boresight craters-real` at 10 % false detections, on real and rendered ground."""
    del found
    try:
        scores = pd.read_csv(SCORES)
        rows_of = scores[scores["labels"] == "all"]
        keys = zip(rows_of["least_px"].astype(float), rows_of["ground"].astype(str), strict=True)
        recall = dict(zip(keys, rows_of["recall_10"].astype(float), strict=True))
        rendered = {least_px: recall[least_px, "rendered"] for least_px, _ in recall}
        (detector,), (chosen,) = scores["detector"].unique(), scores["set"].unique()
    except FileNotFoundError:
        raise BoresightError(f"craters: no {SCORES}: to make it: boresight craters-real") from None
    except CONTENT_FAULTS as error:
        raise BoresightError(f"{SCORES}: cannot be read: {error}: boresight craters-real makes it again") from error
    rows = [
        {
            "ground": ground,
            "labels from, px radius": number(least_px),
            "recall": number(value),
            "recall, rendered": number(rendered[least_px]),
            "ratio": number(value / rendered[least_px]),
        }
        for (least_px, ground), value in recall.items()
        if ground != "rendered"
    ]
    title = f"Craters found at 10 % false detections: {detector}, images of the Moon for {chosen}"
    return [row_grid(title, rows, ("ground", "labels from, px radius"), _RECALL)]


def _levels(run: RunData) -> list[str]:
    """Name the scenarios of the real and of the rendered images; raise BoresightError if the run has not both."""
    found = [levels_of(run, {"images": level}) for level in ("real", "rendered")]
    if not all(found):
        raise BoresightError(f"{run.folder}: has not both real images and renderings of their views: run it again")
    return [next(iter(names.values())) for names in found]


def _table(found: Mapping[str, FinishedRun]) -> list[Grid]:
    rows = list(_rows(found))
    return [reality_grid(rows)] if rows else []


PAPER = Paper(
    title="Real images and tracks next to simulated ones",
    campaigns=(*_IMAGES, _TRACKS, *_SIMULATED),
    methods=(),
    figures=(
        PaperFigure("1", tuple(_IMAGES), _views),
        PaperFigure("2", tuple(_IMAGES), _shares),
        PaperFigure("3", (_TRACKS,), _tracks),
        PaperFigure("4", (), _rims),
    ),
    grids=lambda run: [],
    tables=(_table, _craters),
)
