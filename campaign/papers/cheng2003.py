"""Figures and tables of Cheng et al. (2003), from the newest finished runs of its campaigns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from boresight.campaign.kinds.crater_detection.show import detected, stages_of
from boresight.campaign.kinds.crater_matching.show import matching_example
from boresight.campaign.papers.page import FinishedRun, Paper, PaperFigure
from boresight.estimators.craters.planning import PLANNER
from boresight.reports.figures.named import NamedFigure
from boresight.reports.kinds import report_grids
from boresight.reports.kinds.crater_navigation import counts_figure
from boresight.reports.kinds.image_survey import survey_figures
from boresight.reports.kinds.orbit_determination import reference_scenarios, residual_figure
from boresight.reports.schema.grid import Grid

_DETECTOR, _FILTER, _CHAIN = "crater-classic", "batch-filter", "crater-navigation"
_MATCHERS = ("invariants", "hybrid")
_TABLES = ("Detection of craters", "Matching", "Diagnostics", "From images to the data base", "Orbit determination")
_TABLES_OF = {"cheng2003-detection": 2}


def _figure_2(run: FinishedRun) -> Iterator[NamedFigure]:
    campaign = run.campaign()
    scenario, label = campaign.scenarios[0].spec.name, run.labels(_DETECTOR)[0]
    yield from stages_of(campaign, run.folder, run.content.run, scenario, label)


def _figure_3(run: FinishedRun) -> Iterator[NamedFigure]:
    campaign = run.campaign()
    scenario = campaign.scenarios[0].spec.name
    found = detected(campaign, run.folder, run.content.run, scenario, campaign.labels)
    yield from (replace(drawn, stem=f"_{number}") for number, drawn in enumerate(found, start=1))


def _figure_6(run: FinishedRun) -> Iterator[NamedFigure]:
    """Draw one image pair matched by the paper's invariants, and one by the hybrid method."""
    campaign, data = run.campaign(), run.content.run
    scenario = campaign.scenarios[0].spec.name
    for label in (label for method in _MATCHERS for label in run.labels(method)[:1]):
        figure = matching_example(campaign, run.folder, data, scenario, label)
        if figure is not None:
            yield replace(figure, stem=f"_{campaign.spec.name}_{label}")


def _survey(run: FinishedRun, wanted: int) -> Iterator[NamedFigure]:
    """Draw one histogram of an arc of planned images."""
    yield list(survey_figures(run.content.run, run.content.comparison))[wanted]


def _figure_9(run: FinishedRun) -> Iterator[NamedFigure]:
    if run.manifest["name"] == "cheng2003-survey":
        yield from _survey(run, 2)
    else:
        yield counts_figure(run.content.run, run.campaign().scenarios[0].spec.name, run.labels(_CHAIN)[0])


def _figure_10(run: FinishedRun) -> Iterator[NamedFigure]:
    data = run.content.run
    for label in (label for method in (_FILTER, _CHAIN) for label in run.labels(method)):
        for scenario in reference_scenarios(data):
            if len(data.of(scenario, label, "residuals")):
                yield replace(residual_figure(data, scenario, label), stem=f"_{scenario}_{label}")


def _grids(run: FinishedRun) -> list[Grid]:
    """Return the tables of a run that accompany the published numbers."""
    name = str(run.manifest["name"])
    grids = [grid for grid in report_grids(run.content) if grid.title.startswith(_TABLES)]
    return [replace(grid, title=f"{name}: {grid.title}") for grid in grids[: _TABLES_OF.get(name)]]


_ORDER = ("detection", "matching", "matching-images", "invariants", "survey", "orbit", "endtoend")
PAPER = Paper(
    title="Cheng et al. (2003): every figure and every number",
    campaigns=tuple(f"cheng2003-{name}" for name in _ORDER),
    methods=(_DETECTOR, *_MATCHERS, PLANNER, _FILTER, _CHAIN),
    figures=(
        PaperFigure("2", ("cheng2003-detection",), _figure_2),
        PaperFigure("3", ("cheng2003-detection",), _figure_3),
        PaperFigure("6", ("cheng2003-matching-images", "cheng2003-matching", "cheng2003-invariants"), _figure_6),
        PaperFigure("8.1", ("cheng2003-survey",), partial(_survey, wanted=0)),
        PaperFigure("8.2", ("cheng2003-survey",), partial(_survey, wanted=1)),
        PaperFigure("9", ("cheng2003-survey", "cheng2003-endtoend"), _figure_9),
        PaperFigure("10", ("cheng2003-orbit", "cheng2003-endtoend"), _figure_10),
    ),
    grids=_grids,
)
