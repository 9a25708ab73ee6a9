"""Report of crater matching: correct, wrong and missed matches by the difference of the two views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pandas as pd

from boresight.reports.figures.craters import ShareCurve, draw_shares
from boresight.reports.kinds import ReportKind
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import NO_VALUE, Grid, value_of
from boresight.reports.schema.named_figure import NamedFigure, file_stem
from boresight.reports.schema.records import Record
from boresight.reports.schema.tables import unit_of
from boresight.reports.statistics.measured import MEDIAN, P95, measure, measure_share
from boresight.reports.verdicts import comparison_grid

RECALL, WRONG, SECONDS = "matching_recall_share", "matching_wrong_share", "matching_seconds"
OFFSET = "epipolar_offset_px"
MATCHING = "matching"
_OFFSETS = (MEDIAN, P95)
_VIEWS = ((0.0, 10.0), (10.0, 20.0), (0.0, 20.0), (20.0, 30.0), (30.0, 90.0))
_SUNS = ((0.0, 10.0), (10.0, 30.0), (0.0, 30.0), (30.0, 50.0), (50.0, 60.0), (60.0, 90.0))
_DRAWN = (0.0, 20.0)
_FEW = 7
"""Craters of an image in which context is "not suitable" (Cheng et al. 2003)."""
_BRIEF_SUNS = ((0.0, 10.0), (0.0, 30.0), (50.0, 60.0))
_ANGLE_HEADS = ("views apart", "Suns apart")
_CRATER_HEADS = ("craters in the image that shows fewer",)
_BRIEF = ("Suns apart", "mode", "image pairs", "recall, %", "wrong, %")
_NOTE = (
    "Recall: correct matches over the craters of the truth that both images detect. Wrong: over all matches, without"
    " those of two detections that may be a crater too small for the list of the truth. Intervals are 95 % intervals"
    " over pairs of images; a pair that a mode rejects has missed all its craters."
)


class _PairSelection(Protocol):
    """Some of the pairs of images: what they are called, and which they are."""

    @property
    def stage(self) -> str: ...

    @property
    def cells(self) -> tuple[str, ...]: ...

    def of(self, table: pd.DataFrame) -> pd.DataFrame: ...


@dataclass(frozen=True, slots=True)
class _AngleRange:
    """Ranges of the two angles, deg."""

    view: tuple[float, float]
    sun: tuple[float, float]

    @property
    def cells(self) -> tuple[str, ...]:
        return (_span(self.view), _span(self.sun))

    @property
    def stage(self) -> str:
        return f"{MATCHING}, views {_span(self.view)}, Suns {_span(self.sun)}"

    def of(self, table: pd.DataFrame) -> pd.DataFrame:
        """Select the pairs of images in both ranges."""
        inside = table["view_deg"].between(*self.view) & table["sun_deg"].between(*self.sun)
        return table[inside]


@dataclass(frozen=True, slots=True)
class _CraterCountRange:
    """A range of the craters that are detected in that image of a pair that shows fewer."""

    name: str
    least: float
    most: float

    @property
    def cells(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def stage(self) -> str:
        return f"{MATCHING}, {self.name}"

    def of(self, table: pd.DataFrame) -> pd.DataFrame:
        """Select the pairs of images of which the poorer one shows so many."""
        return table[table[["n_first", "n_second"]].min(axis=1).between(self.least, self.most)]


_BY_CRATERS = (
    _CraterCountRange("all pairs", 0, np.inf),
    _CraterCountRange(f"{_FEW} craters or fewer", 0, _FEW),
    _CraterCountRange(f"{_FEW + 1} craters or more", _FEW + 1, np.inf),
)


def matching_records(run: RunData) -> list[Record]:
    """Measure recall, share of wrong matches and time of each matcher, scenario and part of the pairs of images."""
    if run.table("crater_matches").empty:
        return []
    timed = run.table("timings")[run.table("timings")["stage"] == MATCHING]
    table = run.table("crater_matches").merge(timed, on=["trial", "scenario", "estimator"], how="left")
    found: list[Record] = []
    for (scenario, estimator), own in table.groupby(["scenario", "estimator"], sort=False):
        found += _offset(str(scenario), str(estimator), own)
        parts: list[_PairSelection] = [*_cells(run, own), *_by_craters(run, own)]
        found += [r for part in parts for r in _measured(str(scenario), str(estimator), part, part.of(own))]
    return found


def _offset(scenario: str, estimator: str, pairs: pd.DataFrame) -> Iterator[Record]:
    """Measure how far craters lie from their epipolar lines, over all pairs of images that have one in common."""
    known = pairs[pairs["epipolar_offset_px"].notna()]
    offsets, trials = known["epipolar_offset_px"].to_numpy(float), known["trial"].to_numpy()
    for statistic, found in zip(_OFFSETS, measure(offsets, trials, _OFFSETS), strict=True):
        yield Record(
            scenario, estimator, MATCHING, "", OFFSET, unit_of(OFFSET), statistic.name, found.value, found.low,
            found.high, len(known), len(pairs),
        )  # fmt: skip


def matching_grids(records: Sequence[Record], run: RunData) -> list[Grid]:
    """Tabulate each scenario: a line for each cell of angles, or range of craters, and matcher."""
    found = []
    for scenario, own in run.table("crater_matches").groupby("scenario", sort=False):
        found.append(_grid(str(scenario), own, records, _cells(run, own)))
        counted = _by_craters(run, own)
        if counted:
            found.append(_grid(str(scenario), own, records, counted, _CRATER_HEADS))
    return found


def matching_brief(records: Sequence[Record], run: RunData) -> list[Grid]:
    """Tabulate what fits a terminal: three cells of angles of each scenario, or the scenarios of a grid."""
    each = run.table("crater_matches").groupby("scenario", sort=False)
    if run.manifest.grid is None:
        cells = [_AngleRange(_DRAWN, sun) for sun in _BRIEF_SUNS]
        found = [_grid(str(scenario), own, records, [c for c in cells if len(c.of(own))]) for scenario, own in each]
        return [replace(grid.keep(*_BRIEF), title=f"{grid.title}, views {_span(_DRAWN)} apart") for grid in found]
    axes = run.manifest.grid.axes
    rows = []
    for variation in run.manifest.grid.scenarios:
        if variation.name in each.groups:
            own = _grid(variation.name, each.get_group(variation.name), records, [_everything()]).keep(*_BRIEF[1:])
            rows += [(*(variation.levels[axis.name] for axis in axes), *row) for row in own.rows]
    heads = (*(axis.label or axis.name for axis in axes), *_BRIEF[1:])
    return [Grid("Matching", heads, tuple(rows), frozenset(range(len(axes) + 1)))]


def matching_figures(records: Sequence[Record], run: RunData) -> Iterator[NamedFigure]:
    """Draw recall and wrong share: along the Sun's angle, or along a campaign's grid."""
    if run.manifest.grid is not None:
        axis = run.manifest.grid.axes[0]
        places = {variation.name: variation.levels[axis.name] for variation in run.manifest.grid.scenarios}
        curves = _curves(records, [(name, level, _everything().stage) for name, level in places.items()])
        label = axis.label or axis.name
        yield NamedFigure(
            file_stem("matching", axis.name), draw_shares(curves, label), f"Matching by {label}.",
            f"Recall and share of wrong matches by {label}.",
        )  # fmt: skip
        return
    for scenario in dict.fromkeys(run.table("crater_matches")["scenario"]):
        cells = [_AngleRange(_DRAWN, sun) for sun in _SUNS if sun != (0.0, 30.0)]
        curves = _curves(records, [(scenario, _span(cell.sun), cell.stage) for cell in cells])
        caption = f"Matching by the angle between the directions of the Sun, views {_span(_DRAWN)} apart, {scenario}."
        label = "angle between the directions of the Sun, deg"
        yield NamedFigure(file_stem("matching", str(scenario)), draw_shares(curves, label), caption, caption)


def _cells(run: RunData, own: pd.DataFrame) -> list[_AngleRange]:
    """List the cells that hold pairs of images; one for all in a grid of scenarios."""
    if run.manifest.grid is not None:
        return [_everything()]
    cells = [_AngleRange(view, sun) for view in _VIEWS for sun in _SUNS]
    return [cell for cell in cells if len(cell.of(own))]


def _by_craters(run: RunData, own: pd.DataFrame) -> list[_CraterCountRange]:
    """List the ranges of craters that hold pairs of images; none in a grid of scenarios."""
    return [] if run.manifest.grid is not None else [part for part in _BY_CRATERS if len(part.of(own))]


def _everything() -> _AngleRange:
    return _AngleRange((0.0, 90.0), (0.0, 90.0))


def _measured(scenario: str, estimator: str, part_of: _PairSelection, pairs: pd.DataFrame) -> Iterator[Record]:
    correct, wrong, common = (pairs[name].to_numpy(float) for name in ("n_correct", "n_wrong", "n_common"))
    trials = pairs["trial"].to_numpy()
    for name, part, whole in ((RECALL, correct, common), (WRONG, wrong, correct + wrong)):
        found = measure_share(part, whole, trials)
        yield Record(
            scenario, estimator, part_of.stage, "", name, unit_of(name), "share", found.value, found.low, found.high,
            int(part.sum()), int(whole.sum()),
        )  # fmt: skip
    seconds = pairs["seconds"].dropna().to_numpy(float)
    found = measure(seconds, trials[pairs["seconds"].notna().to_numpy()], (MEDIAN,))[0]
    yield Record(
        scenario, estimator, part_of.stage, "", SECONDS, "s", MEDIAN.name, found.value, found.low, found.high,
        len(seconds), len(pairs),
    )  # fmt: skip


def _grid(
    scenario: str,
    own: pd.DataFrame,
    records: Sequence[Record],
    parts: Sequence[_PairSelection],
    by: Sequence[str] = _ANGLE_HEADS,
) -> Grid:
    rows = []
    for part in parts:
        for estimator in dict.fromkeys(own["estimator"]):
            here = {
                r.measure: r for r in records if (r.scenario, r.estimator, r.stage) == (scenario, estimator, part.stage)
            }
            pairs = part.of(own[own["estimator"] == estimator])
            totals = [int(pairs[name].sum()) for name in ("n_common", "n_correct", "n_wrong", "n_missed")]
            shares = [value_of(here.get(name), interval=True) for name in (RECALL, WRONG)]
            time = here.get(SECONDS)
            numbers = (len(pairs), *totals)
            seconds = NO_VALUE if time is None else value_of(time)
            rows.append((*part.cells, str(estimator), *map(str, numbers), *shares, seconds))
    heads = (
        *by, "mode", "image pairs", "craters in both", "correct", "wrong", "missed",
        "recall, %", "wrong, %", "median time",
    )  # fmt: skip
    title = f"Matching, {scenario}" if by == _ANGLE_HEADS else f"Matching by the number of craters, {scenario}"
    return Grid(title, heads, tuple(rows), frozenset(range(len(by) + 1)), _NOTE)


def _curves(records: Sequence[Record], places: Sequence[tuple[str, str, str]]) -> list[ShareCurve]:
    """Gather a curve for each matcher over (scenario, label, stage)."""
    known = {(r.scenario, r.estimator, r.stage, r.measure): r for r in records if r.measure in (RECALL, WRONG)}
    curves = []
    for estimator in dict.fromkeys(r.estimator for r in records if r.measure == RECALL):
        labels = [(s, label, stage) for s, label, stage in places if (s, estimator, stage, RECALL) in known]
        values = {
            name: np.array([_bounded(known[(s, estimator, stage, name)]) for s, _, stage in labels]).reshape(-1, 3)
            for name in (RECALL, WRONG)
        }
        curves.append(ShareCurve(estimator, tuple(label for _, label, _ in labels), values[RECALL], values[WRONG]))
    return curves


def _bounded(record: Record) -> tuple[float, float, float]:
    value = np.nan if record.value is None else record.value
    return (value, value if record.low is None else record.low, value if record.high is None else record.high)


def _span(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:g} to {bounds[1]:g} deg"


REPORT = ReportKind(
    records=lambda run, comparison: matching_records(run),
    tables=lambda content: (*matching_grids(content.records, content.run), comparison_grid(content.compared)),
    brief=lambda content: matching_brief(content.records, content.run),
    figures=lambda content: matching_figures(content.records, content.run),
)
