"""Reports of the kinds of trial, and their look-up by name."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from typing import cast

import pandas as pd

from boresight.reports.figures.named import NamedFigure
from boresight.reports.kinds.requirements import requirement_grid
from boresight.reports.kinds.tornado import swing_grid, tornado_figures
from boresight.reports.kinds.trade_off import trade_figures, trade_grid
from boresight.reports.published import Comparison
from boresight.reports.run.data import RunData
from boresight.reports.run.limits import limited, short_line
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import Record
from boresight.reports.tables import failure_grid
from boresight.reports.verdicts import ComparedClaim, ComparedValue, claim_grid, verdict_grid

_BESIDE = ["published", "tolerance", "verdict", "place"]
_KINDS = "boresight.reports.kinds"
_USUAL = "single-image"
"""The kind whose report trials have that have none of their own: poses, or numbers alone."""


def report_grids(content: Content) -> list[Grid]:
    """List the tables of a report, in order; of a grid of scenarios, those of the grid alone."""
    return content.grids


def report_figures(content: Content) -> Iterable[NamedFigure]:
    """List the figures of a report, in order."""
    yield from tornado_figures(content.run)
    yield from report_kind(content.run).figures(content)
    yield from trade_figures(content.run)


def brief_grids(content: Content) -> list[Grid]:
    """List what the terminal shows at the end of a run."""
    return content.brief


def told_grids(content: Content) -> list[Grid]:
    """List the last tables of `brief_grids`: published values and statements with ours."""
    claims = [one for one in content.claims if not one.claim.unmeasured]
    return [grid for grid in (verdict_grid(content.compared), claim_grid(claims)) if grid is not None]


def _headed(run: RunData, grids: Tables) -> list[Grid]:
    """Add the conditions of intervals to titles, and the a priori knowledge to the first table."""
    found = [limited(grid, run) for grid in grids if grid is not None]
    if found and not any(grid.known for grid in found):
        found[0] = replace(found[0], known=short_line(run))
    return found


@dataclass(frozen=True, eq=False)
class Content:
    """A run and all that is said of it.

    ``records`` are all measured numbers; ``comparison`` are the published values and ``compared`` ours beside them,
    None and empty if the campaign names none; ``claims`` are published orders and our medians in them. ``notes`` are
    what a reader must know before trusting the numbers.
    """

    run: RunData
    records: tuple[Record, ...]
    comparison: Comparison | None
    compared: tuple[ComparedValue, ...]
    claims: tuple[ComparedClaim, ...]
    notes: tuple[str, ...]

    @cached_property
    def grids(self) -> list[Grid]:
        """Tables of the report: see `report_grids`."""
        found = report_kind(self.run).tables(self)
        first = (requirement_grid(self.run), swing_grid(self.run))
        last = (trade_grid(self.run), claim_grid(self.claims), failure_grid(self.run))
        return _headed(self.run, (*first, *found, *last))

    @cached_property
    def brief(self) -> list[Grid]:
        """Tables for the terminal: see `brief_grids`."""
        found = report_kind(self.run).brief(self)
        return _headed(self.run, (requirement_grid(self.run), *found, *told_grids(self)))

    def table(self, records: Sequence[Record] | None = None) -> pd.DataFrame:
        """All measured numbers, or those of some of the records, with the published ones if there are any."""
        beside = {
            id(c.ours): (c.published.value, c.published.tolerance, c.verdict, c.published.place)
            for c in self.compared
            if c.ours is not None
        }
        own = operator.attrgetter(*(field.name for field in fields(Record)))
        records = self.records if records is None else records
        lines = [(*own(record), *beside.get(id(record), (None, None, "", ""))) for record in records]
        return pd.DataFrame(lines, columns=[field.name for field in fields(Record)] + _BESIDE)


Tables = Sequence[Grid | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportKind:
    """Tables and figures of a kind of trial.

    ``records`` measures what this kind alone has; the published values are those that the campaign names. ``tables``
    come before the Pareto front and the failures, and ``brief``, what the terminal shows, before the verdicts.
    """

    records: Callable[[RunData, Comparison | None], Iterable[Record]] = lambda run, comparison: ()
    tables: Callable[[Content], Tables]
    brief: Callable[[Content], Tables]
    figures: Callable[[Content], Iterable[NamedFigure]]


def report_kind(run: RunData) -> ReportKind:
    """Return the report kind of a run."""
    module = f"{_KINDS}.{run.manifest.experiment.replace('-', '_')}"
    found = module if run.manifest.experiment and find_spec(module) else f"{_KINDS}.{_USUAL.replace('-', '_')}"
    return cast("ReportKind", import_module(found).REPORT)
