"""Report of crater matching: correct, wrong and missed matches by the difference of the two views."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from boresight.reports.figures.craters import Bar, draw_shares
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.kinds import ReportKind
from boresight.reports.run.data import TRIAL_KEY, RunData
from boresight.reports.schema.grid import Grid, GridColumn, record_column, record_grid, text_column
from boresight.reports.schema.records import Key, Record, by_key
from boresight.reports.statistics.measured import MEDIAN, P95, Measured, Sample, measure_share
from boresight.reports.verdicts import comparison_grid

RECALL, WRONG, SECONDS = "matching_recall_share", "matching_wrong_share", "matching_seconds"
OFFSET = "epipolar_offset_px"
MATCHING = "matching"
_VIEWS = ((0.0, 10.0), (10.0, 20.0), (0.0, 20.0), (20.0, 30.0), (30.0, 90.0))
_SUNS = ((0.0, 10.0), (10.0, 30.0), (0.0, 30.0), (30.0, 50.0), (50.0, 60.0), (60.0, 90.0))
_DRAWN = (0.0, 20.0)
_FEW = 7
"""Craters of an image in which context is "not suitable" (Cheng et al. 2003)."""
_FEWER = "n_fewer"
"""Column of the craters that are detected in that image of a pair that shows fewer."""
_BRIEF_SUNS = ((0.0, 10.0), (0.0, 30.0), (50.0, 60.0))
_ANGLE_HEADS = ("views apart", "Suns apart")
_CRATER_HEADS = ("craters in the image that shows fewer",)
_BRIEF = (*_ANGLE_HEADS, "mode", "image pairs", "recall, %", "wrong, %")
_NOTE = (
    "Recall: correct matches over the craters of the truth that both images detect. Wrong: over all matches, without"
    " those of two detections that may be a crater too small for the list of the truth. Intervals are 95 % intervals"
    " over pairs of images; a pair that a mode rejects has missed all its craters."
)


def _span(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:g} to {bounds[1]:g} deg"


@dataclass(frozen=True, slots=True)
class _Part:
    """Some of the pairs of images: their stage and cells in a table, and the columns whose ranges they are in."""

    stage: str
    cells: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]

    def of(self, table: pd.DataFrame) -> pd.DataFrame:
        """Select these pairs of images."""
        return table[np.logical_and.reduce([table[name].between(*ends) for name, ends in self.ranges.items()])]


def _angles(view: tuple[float, float], sun: tuple[float, float]) -> _Part:
    """Return the pairs in ranges of both angles, deg."""
    cells = (_span(view), _span(sun))
    return _Part(f"{MATCHING}, views {cells[0]}, Suns {cells[1]}", cells, {"view_deg": view, "sun_deg": sun})


def _craters(name: str, least: float, most: float) -> _Part:
    """Return the pairs whose poorer image shows so many craters."""
    return _Part(f"{MATCHING}, {name}", (name,), {_FEWER: (least, most)})


_ALL_PAIRS = "all pairs"
_ALL = replace(_craters(_ALL_PAIRS, 0, np.inf), cells=("all", "all"))
_EVERYTHING = _angles((0.0, 90.0), (0.0, 90.0))
_BY_CRATERS = (
    _craters(_ALL_PAIRS, 0, np.inf),
    _craters(f"{_FEW} craters or fewer", 0, _FEW),
    _craters(f"{_FEW + 1} craters or more", _FEW + 1, np.inf),
)
_BY_ANGLES = tuple(_angles(view, sun) for view in _VIEWS for sun in _SUNS)


def _pairs(run: RunData) -> pd.DataFrame:
    """Read the matches of all pairs of images, with the craters of the image that shows fewer."""
    table = run.table("crater_matches")
    return table.assign(**{_FEWER: table[["n_first", "n_second"]].min(axis=1)})


def _parts(run: RunData, own: pd.DataFrame, of: Sequence[_Part]) -> list[_Part]:
    """List the parts that hold pairs of images; of a grid of scenarios one for all."""
    if run.manifest.grid is not None:
        return [_EVERYTHING] if of is _BY_ANGLES else []
    return [part for part in of if len(part.of(own))]


def matching_records(run: RunData) -> list[Record]:
    """Measure recall, share of wrong matches and time of each matcher, scenario and part of the pairs of images.

    And how far craters lie from their epipolar lines, over all pairs of images that have one in common.
    """
    timed = run.table("timings")[run.table("timings")["stage"] == MATCHING]
    table = _pairs(run).merge(timed, on=TRIAL_KEY, how="left")
    found: list[Record] = []
    for (scenario, estimator), own in table.groupby(["scenario", "estimator"], sort=False):
        sample = Sample(str(scenario), str(estimator), MATCHING, len(own))
        found += sample.records(OFFSET, own[OFFSET], own["trial"].to_numpy(), (MEDIAN, P95))
        for part in (*_parts(run, own, _BY_ANGLES), *_parts(run, own, _BY_CRATERS)):
            pairs = part.of(own)
            trials = pairs["trial"].to_numpy()
            correct, wrong, common = (pairs[name].to_numpy(float) for name in ("n_correct", "n_wrong", "n_common"))
            for name, some, whole in ((RECALL, correct, common), (WRONG, wrong, correct + wrong)):
                counted = replace(sample, stage=part.stage, n=int(whole.sum()))
                found.append(counted.record(name, "share", measure_share(some, whole, trials), int(some.sum())))
            timed_pairs = replace(sample, stage=part.stage, n=len(pairs), unit="s")
            found += timed_pairs.records(SECONDS, pairs["seconds"], trials, (MEDIAN,))
    return found


def matching_grids(records: Sequence[Record], run: RunData) -> list[Grid]:
    """Tabulate each scenario: a line for each cell of angles, or range of craters, and matcher."""
    found = []
    for scenario, own in _pairs(run).groupby("scenario", sort=False):
        found.append(_grid(str(scenario), own, records, _parts(run, own, _BY_ANGLES)))
        title = f"Matching by the number of craters, {scenario}"
        found.append(_grid(title, own, records, _parts(run, own, _BY_CRATERS), _CRATER_HEADS))
    return [grid for grid in found if grid is not None]


def matching_brief(records: Sequence[Record], run: RunData) -> list[Grid]:
    """Tabulate what fits a terminal: cells of angles and all pairs of each scenario, or the scenarios of a grid."""
    each = {str(scenario): own for scenario, own in _pairs(run).groupby("scenario", sort=False)}
    if run.manifest.grid is None:
        cells = [_angles(_DRAWN, sun) for sun in _BRIEF_SUNS]
        found = [_grid(name, own, records, [*_parts(run, own, cells), _ALL]) for name, own in each.items()]
        return [one.keep(*_BRIEF) for one in found if one is not None]
    axes = run.manifest.grid.axes
    rows = []
    for variation in run.manifest.grid.scenarios:
        if variation.name in each:
            own = _grid(variation.name, each[variation.name], records, [_EVERYTHING])
            levels = tuple(variation.levels[axis.name] for axis in axes)
            rows += [(*levels, *row) for row in (own.keep(*_BRIEF[2:]).rows if own else ())]
    heads = (*(axis.label or axis.name for axis in axes), *_BRIEF[2:])
    return [Grid("Matching", heads, tuple(rows), frozenset(range(len(axes) + 1)))]


def _grid(
    title: str, own: pd.DataFrame, records: Sequence[Record], parts: Sequence[_Part], by: Sequence[str] = _ANGLE_HEADS
) -> Grid | None:
    """Tabulate the matches of a scenario, a line for each part and matcher; without another title, by the scenario."""
    of_stage = {part.stage: part for part in parts}
    scenario = str(own["scenario"].iloc[0])

    def pairs(key: Key) -> pd.DataFrame:
        return of_stage[key.stage].of(own[own["estimator"] == key.estimator])

    def place(i: int, head: str) -> GridColumn:
        return text_column(head, lambda key: of_stage[key.stage].cells[i])

    def total(column: str, head: str) -> GridColumn:
        return GridColumn(head, lambda key, _: str(int(pairs(key)[column].sum())))

    columns = (
        *(place(i, head) for i, head in enumerate(by)),
        text_column("mode", lambda key: key.estimator),
        GridColumn("image pairs", lambda key, _: str(len(pairs(key)))),
        total("n_common", "craters in both"),
        total("n_correct", "correct"),
        total("n_wrong", "wrong"),
        total("n_missed", "missed"),
        record_column("recall, %", RECALL, "share", interval=True),
        record_column("wrong, %", WRONG, "share", interval=True),
        record_column("median time", SECONDS, MEDIAN.name),
    )
    modes = list(dict.fromkeys(own["estimator"]))
    lines = [Key(scenario, estimator, part.stage) for part in parts for estimator in modes]
    return record_grid(f"Matching, {title}" if by is _ANGLE_HEADS else title, columns, records, lines, _NOTE)


def matching_figures(records: Sequence[Record], run: RunData) -> Iterator[NamedFigure]:
    """Draw recall and wrong share: along the Sun's angle, or along a campaign's grid."""
    if run.manifest.grid is not None:
        axis = run.manifest.grid.axes[0]
        places = {variation.name: variation.levels[axis.name] for variation in run.manifest.grid.scenarios}
        curves = _curves(records, [(name, level, _EVERYTHING.stage) for name, level in places.items()])
        label = axis.label or axis.name
        yield NamedFigure(
            file_stem("matching", axis.name), draw_shares(curves, label), f"Matching by {label}.",
            f"Recall and share of wrong matches by {label}.",
        )  # fmt: skip
        return
    for scenario in dict.fromkeys(run.table("crater_matches")["scenario"]):
        cells = [_angles(_DRAWN, sun) for sun in _SUNS if sun != (0.0, 30.0)]
        curves = _curves(records, [(scenario, cell.cells[1], cell.stage) for cell in cells])
        caption = f"Matching by the angle between the directions of the Sun, views {_span(_DRAWN)} apart, {scenario}."
        label = "angle between the directions of the Sun, deg"
        yield NamedFigure(file_stem("matching", str(scenario)), draw_shares(curves, label), caption, caption)


def _curves(records: Sequence[Record], places: Sequence[tuple[str, str, str]]) -> dict[str, list[tuple[str, Bar, Bar]]]:
    """Gather recall and wrong share of each matcher over (scenario, label, stage)."""
    known = {key: Measured(one.value, one.low, one.high).bar for key, one in by_key(records).items()}
    curves: dict[str, list[tuple[str, Bar, Bar]]] = {}
    for estimator in dict.fromkeys(r.estimator for r in records if r.measure == RECALL):
        keys = [(label, Key(scenario, estimator, stage, "", RECALL, "share")) for scenario, label, stage in places]
        curves[estimator] = [
            (label, known[key], known[key._replace(measure=WRONG)]) for label, key in keys if key in known
        ]
    return curves


REPORT = ReportKind(
    records=lambda run, comparison: matching_records(run),
    tables=lambda content: (*matching_grids(content.records, content.run), comparison_grid(content.compared)),
    brief=lambda content: matching_brief(content.records, content.run),
    figures=lambda content: matching_figures(content.records, content.run),
)
