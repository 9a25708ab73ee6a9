"""The kinds of runs: which tables and figures the report of each has, and what a terminal of 80 columns shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from reports.clusters import pools
from reports.comparison_tables import claim_grid, comparison_grid, verdict_grid
from reports.conditional import of_what_was_drawn
from reports.consistency import consistency_grid
from reports.content import Content
from reports.crater_figures import crater_figures
from reports.crater_matching import matching_brief, matching_figures, matching_grids
from reports.craters import crater_brief, crater_grids, shown
from reports.design_figures import design_figures
from reports.designs import design_grids
from reports.detection import outlier_grid
from reports.grid import Grid
from reports.known import short_line
from reports.named_figure import NamedFigure, file_stem
from reports.navigation import navigation_figures, navigation_grid
from reports.orbits import orbit_brief, orbit_figures, orbit_grids
from reports.paired import paired_grid
from reports.records import CONTROL
from reports.rims import rim_grid
from reports.run_data import RunData
from reports.run_figures import image_figures
from reports.sensitivity import mesh_variants, sensitivity_grid
from reports.sequences import sequence_figures, sequence_grid, sequence_grids
from reports.surveys import survey_brief, survey_figures, survey_grids
from reports.tables import detail_grid, diagnostic_grid, failure_grid, pose_grids, reference_grid, timing_grid
from reports.tradeoff import trade_grid

Tables = Sequence[Grid | None]
Figures = Iterable[NamedFigure]


@dataclass(frozen=True, slots=True)
class _Kind:
    """A kind of run.

    Parameters
    ----------
    holds
        Tells whether a run is of this kind, by what is stored of it.
    report
        The tables of its report, in order, before that of failures.
    brief
        What the terminal shows, before the verdicts.
    figures
        The figures of its report.
    """

    holds: Callable[[RunData], bool]
    report: Callable[[Content], Tables]
    brief: Callable[[Content], Tables]
    figures: Callable[[Content], Figures]


def report_grids(content: Content) -> list[Grid]:
    """List the tables of a report, in order; of a grid of scenarios, those of the grid alone."""
    found = _kind_of(content.run).report(content)
    grids = (grid for grid in (*found, claim_grid(content.claims), failure_grid(content.run)) if grid is not None)
    return _headed(content.run, list(of_what_was_drawn(grids, content.run)))


def brief_grids(content: Content) -> list[Grid]:
    """List what the terminal shows at the end of a run."""
    found = _kind_of(content.run).brief(content)
    told = (verdict_grid(content.compared), claim_grid([one for one in content.claims if not one.claim.unmeasured]))
    grids = (grid for grid in (*found, *told) if grid is not None)
    return _headed(content.run, list(of_what_was_drawn(grids, content.run)))


def _headed(run: RunData, grids: list[Grid]) -> list[Grid]:
    """Put what was known on board beside the headline: the first table, if it does not say so already."""
    if not grids or grids[0].known:
        return grids
    return [replace(grids[0], known=short_line(run)), *grids[1:]]


def draw_figures(content: Content) -> Iterator[NamedFigure]:
    """Draw every figure that the run's tables allow; of a grid of scenarios those of the grid alone."""
    yield from _kind_of(content.run).figures(content)


def _kind_of(run: RunData) -> _Kind:
    return next(kind for kind in _KINDS if kind.holds(run))


def _of_images(content: Content) -> Tables:
    records, run = content.records, content.run
    return (
        *pose_grids(records, run),
        reference_grid(records, run),
        comparison_grid(content.compared),
        trade_grid(run),
        detail_grid(records),
        diagnostic_grid(records),
        paired_grid(records),
        consistency_grid(records),
        sensitivity_grid(records, mesh_variants(run)),
        outlier_grid(records),
        timing_grid(records),
    )


def _of_craters(content: Content) -> Tables:
    return (
        *crater_grids(content.records, content.run),
        rim_grid(list(shown(content.run))),
        comparison_grid(content.compared),
        timing_grid(content.records),
    )


def _of_orbits(content: Content) -> Tables:
    orbits = orbit_grids(content.records, content.compared, content.run)
    return (navigation_grid(content.records, content.run), *orbits)


def _brief_of_poses(content: Content) -> Tables:
    several = len({r.estimator for r in content.records if r.estimator and r.stage != CONTROL}) > 1
    counted = (*(["estimator"] if several else []), "stage", "solved", "success")
    return [grid.keep(*counted, "position m", "attitude deg") for grid in pose_grids(content.records, content.run)]


def _brief_of_designs(content: Content) -> Tables:
    own = [pool.name for pool in pools(content.run)]
    pooled = sequence_grid([record for record in content.records if record.scenario in own])
    found = [*([] if pooled is None else [pooled]), *design_grids(content.run)]
    return [grid.keep(*(column for column in grid.columns if column != "change")) for grid in found]


def _designs_or(brief: Callable[[Content], Tables]) -> Callable[[Content], Tables]:
    """Tell of a grid of scenarios by its axes, and of one scenario as ``brief`` does."""
    return lambda content: (brief if content.run.manifest.grid is None else _brief_of_designs)(content)


def _figures_of_sequences(content: Content) -> Figures:
    grid = content.run.manifest.grid
    if grid is not None and grid.design == "one-at-a-time":
        return _figures_of_designs(content)
    return _named(sequence_figures(content.run))


def _named(drawn: Iterable[tuple[str, Figure, str, str]]) -> Figures:
    return (NamedFigure(file_stem(stem), figure, caption, alt) for stem, figure, caption, alt in drawn)


def _figures_of_designs(content: Content) -> Figures:
    return _named(design_figures(content.run))


_KINDS = (
    _Kind(
        lambda run: not run.epochs.empty,
        lambda content: sequence_grids(content.records, content.compared, content.run),
        _designs_or(_brief_of_poses),
        _figures_of_sequences,
    ),
    _Kind(
        lambda run: not run.crater_matches.empty,
        lambda content: (*matching_grids(content.records, content.run), comparison_grid(content.compared)),
        lambda content: matching_brief(content.records, content.run),
        lambda content: matching_figures(content.records, content.run),
    ),
    _Kind(
        lambda run: not run.crater_images.empty,
        _of_craters,
        lambda content: crater_brief(content.records),
        lambda content: () if content.run.craters.empty else crater_figures(content.run),
    ),
    _Kind(
        lambda run: not run.surveyed_images.empty,
        lambda content: survey_grids(content.records, content.compared),
        lambda content: survey_brief(content.records),
        lambda content: survey_figures(content.run, content.comparison),
    ),
    _Kind(
        lambda run: not (run.orbits.empty and run.navigation.empty),
        _of_orbits,
        _designs_or(lambda content: orbit_brief(content.records, content.run)),
        lambda content: (*navigation_figures(content.run), *orbit_figures(content.run)),
    ),
    _Kind(
        lambda run: run.manifest.grid is not None,
        lambda content: design_grids(content.run),
        _brief_of_designs,
        _figures_of_designs,
    ),
    _Kind(lambda run: True, _of_images, _brief_of_poses, image_figures),
)
