"""Statements that limit the results of a run: what was known exactly on board, and what was drawn only once."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from reports.run.data import RunData
from reports.schema.grid import Grid
from reports.schema.tables import kind_schema
from scenarios.known import Known, merged

KNOWLEDGE_UNREADABLE = (
    "What was known exactly on board cannot be stated: the scenarios are of another version of boresight."
)
_FEW = 4

_INTERVAL = re.compile(r"\[\S+, \S+\]")


def single_draws(run: RunData) -> str:
    """Name what was drawn only once in a run: its intervals leave out that variation; '' where nothing was."""
    if run.databases > 1:
        return ""
    worlds = {str(spec["craters"]) for spec in run.manifest.scenarios.values() if spec.get("craters")}
    world = "one world of craters" if len(worlds) == 1 else "one world of craters each" if worlds else ""
    return " and ".join(filter(None, (world, "one data base" if run.manifest.products else "")))


def with_single_draws(grids: Iterable[Grid], run: RunData) -> Iterator[Grid]:
    """Add what intervals are conditional on to the title of every table that has some."""
    once = single_draws(run)
    for grid in grids:
        told = once and any(_INTERVAL.search(cell) for row in grid.rows for cell in row)
        yield replace(grid, title=f"{grid.title}, of {once}") if told else grid


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
        yield f"{', '.join(names)}: {one.line()}" if len(groups) > 1 else one.line()
