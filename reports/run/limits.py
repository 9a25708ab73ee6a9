"""Statements that limit the results of a run: what was known exactly on board, and what was drawn only once."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from boresight.reports.run.data import RunData, value_at
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import count_of
from boresight.reports.schema.tables import kind_schema
from boresight.scenarios.known import Known, merged

KNOWLEDGE_UNREADABLE = (
    "What was known exactly on board cannot be stated: the scenarios are of another version of boresight."
)
_FEW = 4

_INTERVAL = re.compile(r"\[\S+, \S+\]")


_CRATERS = ("craters", "crater_pairs.craters", "orbit.imaging.craters", "orbit.sightings.craters")
"""Keys of the craters that all trials of a scenario share; the first that a scenario has counts."""


def single_draws(run: RunData) -> str:
    """Name what a run has only one of: its intervals leave out that variation; '' where there is nothing."""
    # The orbit of an approach needs no craters, and the a priori shape is that of the gravity alone.
    specs = [] if run.manifest.experiment == "approach-orbit" else run.manifest.scenarios.values()
    shapes = [value_at(spec, "orbit.knowledge.shape_degree") for spec in specs]
    paths = [value_at(spec, "viewpoint.trajectory") for spec in specs]
    found = [_one_of("a priori shape", shapes), _one_of("trajectory", paths)]
    if run.databases <= 1:
        craters = [next(filter(None, (value_at(spec, key) for key in _CRATERS)), None) for spec in specs]
        found = [_one_of("world of craters", craters), "one data base" if run.manifest.products else "", *found]
    return " and ".join(filter(None, found))


def _one_of(what: str, values: Iterable[object]) -> str:
    """Name a thing of the scenarios that have it: one for all, or one each."""
    different = {str(value) for value in values if value is not None}
    return "" if not different else f"one {what}" if len(different) == 1 else f"one {what} each"


def limited_title(title: str, run: RunData) -> str:
    """Add to a title what a run has only one of."""
    return ", of ".join(filter(None, (title, single_draws(run))))


def limited(grid: Grid, run: RunData) -> Grid:
    """Add what intervals are conditional on to the title of a table that has some."""
    told = any(_INTERVAL.search(cell) for row in grid.rows for cell in row)
    return replace(grid, title=limited_title(grid.title, run)) if told else grid


def database_line(run: RunData) -> str:
    """Return the sentence on data bases and intervals; '' where a run has no data base."""
    if run.databases > 1:
        return kind_schema(run.manifest.experiment).databases_note.format(n=run.databases)
    once = single_draws(run)
    return (
        f"Intervals are of {once}: another one would give other errors, and they do not include that variation."
        if once
        else ""
    )


def short_line(*runs: RunData, scenario: str = "") -> str:
    """Return what was known on board in a scenario, or in all scenarios of some runs, in one short sentence."""
    found = [run.known for run in runs]
    told = [one for known in found if known is not None for name, one in known.items() if scenario in ("", name)]
    return merged(told).line(short=True) if told and None not in found else KNOWLEDGE_UNREADABLE


def known_lines(run: RunData) -> Iterator[str]:
    """Yield what was known on board in full: a line for each group of scenarios, or one if there are many groups."""
    if run.known is None:
        yield KNOWLEDGE_UNREADABLE
        return
    groups: dict[Known, list[str]] = {}
    for name, one in run.known.items():
        groups.setdefault(one, []).append(name)
    if len(groups) > _FEW:
        yield merged(list(groups)).line()
        return
    for one, names in groups.items():
        further = f" and {count_of(len(names) - _FEW, 'further scenario')}" if len(names) > _FEW else ""
        yield f"{', '.join(names[:_FEW])}{further}: {one.line()}" if len(groups) > 1 else one.line()
