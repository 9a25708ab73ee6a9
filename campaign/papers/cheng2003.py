"""Figures and tables of Cheng et al. (2003), from the newest finished runs of its campaigns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from boresight.campaign.kinds.crater_detection.show import detected, stages_of
from boresight.campaign.kinds.crater_matching.show import matching_example
from boresight.campaign.papers.gather import FinishedRun
from boresight.campaign.papers.page import Draw, Paper, PaperFigure, Runs
from boresight.estimators.craters.planning import PLANNER
from boresight.reports.kinds import report_grids
from boresight.reports.kinds.crater_navigation import counts_figure
from boresight.reports.kinds.image_survey import survey_figures
from boresight.reports.kinds.orbit_determination import reference_scenarios, residual_figure
from boresight.reports.run.data import select
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.named_figure import NamedFigure

_DETECTOR, _FILTER, _CHAIN = "crater-classic", "batch-filter", "crater-navigation"
_MATCHERS = ("invariants", "hybrid")
_TABLES = ("Detection of craters", "Matching", "Diagnostics", "From images to the data base", "Orbit determination")
_TABLES_OF = {"cheng2003-detection": 2}


def _figure_2(runs: Runs, jobs: int | None) -> Iterator[NamedFigure]:
    del jobs
    run = runs["cheng2003-detection"]
    campaign, label = run.campaign(), run.labels(_DETECTOR)[0]
    scenario = campaign.scenarios[0].spec.name
    yield from stages_of(campaign, run.folder, run.content.run, scenario, label)


def _figure_3(runs: Runs, jobs: int | None) -> Iterator[NamedFigure]:
    del jobs
    run = runs["cheng2003-detection"]
    campaign, data = run.campaign(), run.content.run
    for number, drawn in enumerate(
        detected(campaign, run.folder, data, campaign.scenarios[0].spec.name, campaign.labels)
    ):
        yield replace(drawn, stem=f"_{number + 1}")


def _figure_6(runs: Runs, jobs: int | None) -> Iterator[NamedFigure]:
    del jobs
    for run in runs.values():
        yield from _matched(run)


def _matched(run: FinishedRun) -> Iterator[NamedFigure]:
    """Draw one image pair matched by the paper's invariants, and one by the hybrid method."""
    campaign, data = run.campaign(), run.content.run
    scenario = campaign.scenarios[0].spec.name
    for label in (label for method in _MATCHERS for label in run.labels(method)[:1]):
        figure = matching_example(campaign, run.folder, data, scenario, label)
        if figure is not None:
            yield replace(figure, stem=f"_{campaign.spec.name}_{label}")


def _survey(wanted: int) -> Draw:
    """Return the drawing function of one histogram of an arc of planned images."""

    def draw(runs: Runs, jobs: int | None) -> Iterator[NamedFigure]:
        del jobs
        run = runs["cheng2003-survey"].content
        yield list(survey_figures(run.run, run.comparison))[wanted]

    return draw


def _figure_9(runs: Runs, jobs: int | None) -> Iterator[NamedFigure]:
    for name, run in runs.items():
        if name == "cheng2003-survey":
            yield from _survey(2)(runs, jobs)
        else:
            scenario = run.campaign().scenarios[0].spec.name
            yield counts_figure(run.content.run, scenario, run.labels(_CHAIN)[0])


def _figure_10(runs: Runs, jobs: int | None) -> Iterator[NamedFigure]:
    del jobs
    solved = [
        (data, scenario, label)
        for run in runs.values()
        for data in (run.content.run,)
        for label in (label for method in (_FILTER, _CHAIN) for label in run.labels(method))
        for scenario in reference_scenarios(data)
        if len(select(data.table("residuals"), scenario, label))
    ]
    for data, scenario, label in solved:
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
        PaperFigure("8.1", ("cheng2003-survey",), _survey(0)),
        PaperFigure("8.2", ("cheng2003-survey",), _survey(1)),
        PaperFigure("9", ("cheng2003-survey", "cheng2003-endtoend"), _figure_9),
        PaperFigure("10", ("cheng2003-orbit", "cheng2003-endtoend"), _figure_10),
    ),
    grids=_grids,
)
