"""Errors on real images and tracks next to the simulated ones: one table over the campaigns on real data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import pandas as pd
from matplotlib.figure import Figure

from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds.single_image.show import credit_lines
from boresight.campaign.papers.page import FinishedRun, Paper, PaperFigure
from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.pose import draw_cumulative_errors
from boresight.reports.figures.style import PlotStyle, finish, grid_figure, image_panel, plot_styles, styled
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.reality import levels_of, reality_grid, reality_rows
from boresight.scenarios.errors import BoresightError

_IMAGES = {"compare-navcam67p": "67P, 60 images"}
_SHOWN = 3
_TRACKS, _SIMULATED = "vesta-real-slam", "vesta-simulated-slam"


def _rows(found: Mapping[str, FinishedRun]) -> Iterator[dict[str, str]]:
    for name, seen in _IMAGES.items():
        if name in found:
            run = found[name].data
            real_images, rendered = _levels(run)
            yield from reality_rows(seen, (run, real_images), (run, rendered))
    if _TRACKS in found and _SIMULATED in found:
        real, simulated = found[_TRACKS].data, found[_SIMULATED].data
        scenarios = levels_of(real, {})
        for errors in ("white", "fit-1-32", "fit-33-65"):
            for levels, scenario in levels_of(simulated, {"errors": errors}).items():
                if levels not in scenarios:
                    continue
                tracks, every = levels
                ranges = "one range" if every == "0" else f"a range every {every} frames"
                seen = f"Vesta, {tracks} tracks, {ranges}; simulated: {errors}"
                yield from reality_rows(seen, (real, scenarios[levels]), (simulated, scenario), shared=True)


def _views(run: FinishedRun) -> Iterator[NamedFigure]:
    yield NamedFigure(
        "_views", _pictures(run), "Real images (above), and renderings of their views with what the spacecraft does not"
        " know (below).", "Images of a body above renderings that look alike.",
    )  # fmt: skip


@styled
def _pictures(run: FinishedRun) -> Figure:
    """Draw some real images above the renderings of their views."""
    campaign = run.campaign()
    scenarios = [campaign.scenario(name) for name in _levels(run.data)]
    count = run.data.image_of_trial.nunique()
    trials = sorted({count * shown // _SHOWN for shown in range(_SHOWN)})
    figure, panels = grid_figure(2, len(trials), 2.5 * len(trials), 5.4)
    for row, scenario, what in zip(panels, scenarios, ("real", "rendered"), strict=True):
        source = open_world(scenario, campaign.variant).source
        for axes, trial in zip(row, trials, strict=True):
            drawn = source.trial_image(campaign.seed, trial)
            image_panel(axes, drawn.image, f"{what}, trial {trial}")
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
    campaigns=(*_IMAGES, _TRACKS, _SIMULATED),
    methods=(),
    figures=(PaperFigure("1", tuple(_IMAGES), _views), PaperFigure("2", tuple(_IMAGES), _shares)),
    grids=lambda run: [],
    table=_table,
)
