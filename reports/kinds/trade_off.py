"""What accuracy costs: the Pareto front of estimators over error, failures, time and what they hold on board.

A cell is an estimator in a scenario. Its front is that of its scenario and, in a grid, also that of all scenarios that
vary the same one. Cells are compared trial by trial, each trial with the one of its number: random streams do not
depend on the scenario, so that most draws are shared, and pairs of independent trials are independent in any case.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.trials import choose_metric, failures, prior_values, trial_numbers
from boresight.reports.figures.comparison import Traded, draw_trade_off
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.kinds.pooled import MOST_CELLS, is_huge
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import TRIAL_KEY, RunData, in_order_of
from boresight.reports.run.outcomes import keeping_attitude, succeeded
from boresight.reports.schema.column import FRESH_IMAGE, POSE_COLUMNS, SIGHT, STORED_IMAGE
from boresight.reports.schema.craters import CENTRE_ERROR, MISSED
from boresight.reports.schema.grid import NO_VALUE, Grid, number, row_grid
from boresight.reports.schema.records import CONTROL
from boresight.reports.schema.tables import kind_schema, measure_of
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, share_of
from boresight.reports.statistics.paired import rate_difference
from boresight.reports.tables import interval
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError

_SECONDS, _FAILED = "seconds", "failed"
_MOST_NAMED = 2
NO_ESTIMATE, ON, OFF, UNDECIDED = "no estimate", "on it", "off it", "not shown to be off it"


@dataclass(frozen=True, slots=True)
class Standing:
    """Where a cell is: `ON` the front, `OFF` it, `UNDECIDED`, or without an estimate at all.

    ``beside`` are the cells that dominate it, those on the front first, or from which it is not told apart.
    """

    verdict: str
    beside: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Cost:
    """A cell: an estimator in a scenario, what it attains, and what it takes.

    ``errors`` are medians over the trials with an error, ``n_ok`` of ``n`` trials have an estimate, ``failed`` is the
    share without one, or with an error of the position, or of the line of sight, above the prior's. ``seconds`` is the
    median wall time of all its own stages of a trial. ``landmarks`` are those of its data base, None without one;
    ``size_bytes`` is the memory on board: the stored data base, of several their mean, and the shape. It is None where
    the run does not say it.
    ``over_grid`` is None outside a grid.
    """

    scenario: str
    estimator: str
    errors: Mapping[str, Measured]
    n_ok: int
    n: int
    failed: Measured
    seconds: Measured
    landmarks: int | None
    size_bytes: int | None
    in_scenario: Standing = Standing(UNDECIDED)
    over_grid: Standing | None = None


def traded_errors(run: RunData) -> tuple[str, ...]:
    """Name the errors that are compared: both of poses, the rates and centres of craters, else the usual one.

    Where all methods keep the prior's attitude, it is that of the line of sight.
    """
    metrics = kind_schema(run.manifest.experiment).metrics
    if run.posed_pairs():
        own = run.rows[run.rows["estimator"] != CONTROL]
        solved = set(own.loc[own["status"] == "ok", "estimator"])
        keep = SIGHT in metrics and solved and solved <= keeping_attitude(own)
        names = (SIGHT,) if keep else POSE_COLUMNS[:2]
    elif MISSED in metrics:
        names = tuple(name for name in metrics if name != CENTRE_ERROR)
    else:
        try:
            names = (choose_metric(None, [run]).name,)
        except BoresightError:
            names = ()
    return tuple(name for name in names if measure_of(name).error)


@lru_cache(maxsize=1)
def costs(run: RunData) -> tuple[Cost, ...]:
    """List the cells of each front that has two or more with an error and a time, in the order of the campaign.

    Of a grid of too many cells to show, those alone that no other one of the grid beats in every median. Empty for a
    two-level design, which asks what moves an error and offers no choice, and for a grid too large to measure.
    """
    design, names = run.manifest.grid, traded_errors(run)
    if not names or (design is not None and design.design == "two-level") or is_huge(run):
        return ()
    table, shown = _numbers(run, names), list[Cost]()
    for own in _groups(run):
        cells = [_cost(run, table, names, *pair) for pair in own]
        if sum(_is_known(one) for one in cells) > 1:
            tested = _undominated(cells) if len(cells) > MOST_CELLS else cells
            shown += _Front(run, table, names, tested).placed(over_grid=len({scenario for scenario, _ in own}) > 1)
    return tuple(shown)


def _groups(run: RunData) -> list[list[tuple[str, str]]]:
    """Group scenarios and estimators by the scenario that a grid varies, or else by their own."""
    base = {} if run.manifest.grid is None else {one.name: one.base for one in run.manifest.grid.scenarios}
    places = {name: place for place, name in enumerate(run.manifest.scenarios)}
    groups: dict[str, list[tuple[str, str]]] = {}
    for scenario, estimator in sorted(run.pairs(), key=lambda pair: (places[pair[0]], run.place_of(pair[1]))):
        if estimator != CONTROL:
            groups.setdefault(base.get(scenario, scenario), []).append((scenario, estimator))
    return list(groups.values())


def _is_known(cost: Cost) -> bool:
    return cost.seconds.value is not None and all(error.value is not None for error in cost.errors.values())


def _undominated(cells: Sequence[Cost]) -> list[Cost]:
    """Keep the cells that no other one beats, or equals, in every number while it is better in one."""
    known = [one for one in cells if _is_known(one)]
    numbers = np.array(
        [[*(e.value for e in c.errors.values()), c.failed.value, c.seconds.value, c.size_bytes or 0] for c in known],
        dtype=np.float64,
    )
    beaten = [((numbers <= own).all(axis=1) & (numbers < own).any(axis=1)).any() for own in numbers]
    return [one for one, off in zip(known, beaten, strict=True) if not off]


def _numbers(run: RunData, names: Sequence[str]) -> pd.DataFrame:
    """Tabulate all trials: `TRIAL_KEY`, the errors, ``seconds`` of trials with an estimate, ``failed``, ``unit``."""
    rows, numbers, times = run.rows, trial_numbers(run), run.table("timings")
    own = times[~times["stage"].isin([FRESH_IMAGE, STORED_IMAGE])]
    total = own.groupby(["scenario", "estimator", "trial"], sort=False)[[_SECONDS]].sum().reset_index()
    # Times are of the trials with an estimate: one that stops early would look fast.
    seconds = in_order_of(rows, total, [_SECONDS])[_SECONDS].where(rows["status"] == "ok")
    nothing, failed = pd.Series(np.nan, index=rows.index), ~succeeded(rows)
    if SIGHT in names:
        failed = failures(rows, numbers.get(SIGHT, nothing), prior_values(run, measure_of(SIGHT))).to_numpy()
    return rows[[*TRIAL_KEY, "status"]].assign(
        **{name: numbers.get(name, nothing) for name in names},
        seconds=seconds,
        failed=failed,
        unit=clusters_of(run, rows[TRIAL_KEY]),
    )


def _cost(run: RunData, table: pd.DataFrame, names: Sequence[str], scenario: str, estimator: str) -> Cost:
    own = table.iloc[run.place_in_rows(scenario, estimator)]
    units = own["unit"].to_numpy()

    def median(name: str) -> Measured:
        values = own[name].to_numpy(dtype=np.float64)
        known = np.isfinite(values)
        return measure(values[known], units[known], (MEDIAN,))[0]

    def mine(owner: object) -> bool:
        return (getattr(owner, "scenario", ""), getattr(owner, "estimator", "")) == (scenario, estimator)

    products = [product for product in run.manifest.products if mine(product)]
    databases = len({product.database for product in products})
    counts, sizes = (
        [count for count in found if count is not None]
        for found in ([one.n_landmarks for one in products], [one.bytes for one in products])
    )
    shapes = None if run.manifest.shapes is None else [shape.bytes for shape in run.manifest.shapes if mine(shape)]
    size = None if shapes is None and not sizes else round(sum(sizes) / max(databases, 1)) + sum(shapes or ())
    landmarks = round(sum(counts) / databases) if counts else None
    errors, failed = {name: median(name) for name in names}, share_of(own["failed"].to_numpy(), units)
    n_ok = int((own["status"] == "ok").sum())
    return Cost(scenario, estimator, errors, n_ok, len(own), failed, median(_SECONDS), landmarks, size)


class _Front:
    """Comparisons of cells, trial by trial; a cell is given by its place among them."""

    def __init__(self, run: RunData, table: pd.DataFrame, names: Sequence[str], cells: Sequence[Cost]) -> None:
        self._cells = cells
        places = [run.place_in_rows(cell.scenario, cell.estimator) for cell in cells]
        trials = np.unique(table["trial"].to_numpy())
        self._values = {name: np.full((len(cells), len(trials)), np.nan) for name in (*names, _SECONDS, _FAILED)}
        self._units = np.full((len(cells), len(trials)), "", dtype=object)
        for row, place in enumerate(places):
            own = table.iloc[place]
            at = np.searchsorted(trials, own["trial"].to_numpy())
            for name, values in self._values.items():
                values[row, at] = own[name].to_numpy(dtype=np.float64)
            self._units[row, at] = own["unit"].to_numpy()

    def placed(self, over_grid: bool) -> list[Cost]:
        """Return the cells with their standings."""
        cells, every = self._cells, range(len(self._cells))
        of_scenario: dict[str, list[int]] = {}
        for i in every:
            of_scenario.setdefault(cells[i].scenario, []).append(i)
        alone = {i: one for among in of_scenario.values() for i, one in self._standings(among).items()}
        wide = self._standings(every) if over_grid else {}
        return [replace(cells[i], in_scenario=alone[i], over_grid=wide.get(i)) for i in every]

    def _standings(self, among: Collection[int]) -> dict[int, Standing]:
        able = [i for i in among if self._cells[i].n_ok]
        better = {i: [j for j in able if j != i and self._dominates(j, i)] for i in able}
        found = {}
        for i in among:
            if i not in better:
                found[i] = Standing(NO_ESTIMATE)
            elif better[i]:
                # One that is on the front, if any: domination beyond intervals is not transitive.
                found[i] = Standing(OFF, self._named(sorted(better[i], key=lambda j: bool(better[j]))))
            else:
                near = [j for j in able if j != i and not self._excels(i, j)]
                found[i] = Standing(UNDECIDED if near else ON, self._named(near))
        return found

    def _named(self, places: Sequence[int]) -> tuple[tuple[str, str], ...]:
        return tuple((self._cells[j].scenario, self._cells[j].estimator) for j in places)

    def _dominates(self, i: int, j: int) -> bool:
        """Whether a cell is better than another beyond the interval of each paired difference.

        Compared are errors and time, over the trials that both solved, the failure rate, and the bytes on board, which
        are exact. What is alike in every trial, as without any failure, decides nothing. A cell whose bytes are not
        known is compared with its like alone. Time alone decides nothing between scenarios: these run at different
        times, on a machine that may do something else.
        """
        one, other = self._cells[i].size_bytes, self._cells[j].size_bytes
        if (one is None) != (other is None) or (one or 0) > (other or 0):
            return False
        differences = {name: self._difference(name, i, j) for name in self._values}
        if any(not len(found) or np.median(found) > 0.0 for found in differences.values()):
            return False
        told = [name for name, found in differences.items() if found.any()]
        if told == [_SECONDS] and one == other and self._cells[i].scenario != self._cells[j].scenario:
            return False
        return all(self._is_better(name, i, j) for name in told) and (bool(told) or one != other)

    def _excels(self, i: int, j: int) -> bool:
        """Whether a cell is better than another in something: it is not dominated by that one."""
        one, other = self._cells[i].size_bytes, self._cells[j].size_bytes
        smaller = one is not None and other is not None and one < other
        return smaller or any(self._is_better(name, i, j) for name in self._values)

    def _difference(self, name: str, i: int, j: int) -> FloatArray:
        found = self._values[name][i] - self._values[name][j]
        return np.asarray(found[np.isfinite(found)], dtype=np.float64)

    def _is_better(self, name: str, i: int, j: int) -> bool:
        """Whether the interval of the median, or of the rate, of paired differences is below 0."""
        mine, theirs = self._values[name][i], self._values[name][j]
        known = np.isfinite(mine - theirs)
        difference = (mine - theirs)[known]
        if not len(difference) or (np.mean if name == _FAILED else np.median)(difference) >= 0.0:
            return False
        units = _coarser(self._units[i][known], self._units[j][known])
        if name == _FAILED:
            found = rate_difference(mine[known] > 0.0, theirs[known] > 0.0, units)
        else:
            (found,) = measure(difference, units, (MEDIAN,))
        return found.high is not None and found.high < 0.0


def _coarser(mine: NDArray[np.object_], theirs: NDArray[np.object_]) -> NDArray[np.str_]:
    """Label pairs of trials by the independent units of the cell that has fewer of them."""
    one, other = mine.astype(str), theirs.astype(str)
    return one if len(np.unique(one)) <= len(np.unique(other)) else other


_NOTE = (
    "Medians over the trials with an estimate, with 95 % intervals. Failures: no estimate, or a position error above"
    " the prior's. Time: median of all the estimator's own stages on the run's machine, of a sequence the mean of a"
    " frame, the camera's image left out.{} Off the front: the named one is better in every error, failures and time,"
    " each beyond the 95 % interval of the difference trial by trial, and holds no more on board; what is alike in"
    " every trial decides nothing. On the front: better than each other one in something, by the same intervals. Not"
    " shown to be off it: neither, for want of trials, against the named ones. Intervals are not widened for the number"
    " of comparisons."
)
_ON_BOARD = (
    " On board: data bases as they are stored (corners as text, maplets and features packed) and the shape, 12 bytes"
    " for each vertex and facet; 0 without either. Weights of networks and catalogues of stars are not counted."
)
_OF_GRID = (
    " The front of the grid compares all its cells; an axis of conditions, such as the phase angle, is no choice: read"
    " the front of the scenario there. Time alone, which follows the load of the machine, puts nothing off it."
)
_OF_WIDE = (
    " Of {n} cells those are listed that no other one of the grid beats in every number, and compared with each other."
)


def trade_grid(run: RunData) -> Grid | None:
    """Tabulate accuracy, cost and the Pareto front; None without two estimators or cells with an error and a time."""
    found, design = costs(run), run.manifest.grid
    if not found:
        return None
    levels = {} if design is None else {one.name: one for one in design.scenarios}
    axes = () if design is None else design.axes
    several = len({levels[c.scenario].base if c.scenario in levels else c.scenario for c in found}) > 1
    based, heavy = any(cost.landmarks is not None for cost in found), any(cost.size_bytes for cost in found)
    rows = []
    for cost in found:
        own, size = levels.get(cost.scenario), cost.size_bytes
        place = {"scenario": own.base if own else cost.scenario} if several or not own else {}
        row = place | {axis.label: own.levels[axis.name] for axis in axes if own}
        row |= {"estimator": cost.estimator, "ok": f"{cost.n_ok}/{cost.n}"}
        row |= {_head(name): interval(error) for name, error in cost.errors.items()}
        row |= {
            "failures % [95 %]": interval(cost.failed, 100.0),
            "time ms [95 %]": interval(cost.seconds, 1e3),
        }
        row |= {"on board kB": number(None if size is None else size / 1e3)} if heavy else {}
        row |= {"landmarks": NO_VALUE if cost.landmarks is None else str(cost.landmarks)} if based else {}
        row["front of the scenario"] = _in_words(run, cost, cost.in_scenario)
        row |= {"front of the grid": _in_words(run, cost, cost.over_grid)} if cost.over_grid else {}
        rows.append(row)
    heads = list(dict.fromkeys(head for row in rows for head in row))
    rows = [{head: row.get(head, NO_VALUE) for head in heads} for row in rows]
    text = ("scenario", *(axis.label for axis in axes), "estimator", "front of the scenario", "front of the grid")
    note = _NOTE.format(_ON_BOARD if heavy else "") + (_OF_GRID if any(cost.over_grid for cost in found) else "")
    many = sum(len(own) for own in _groups(run) if len(own) > MOST_CELLS)
    note += _OF_WIDE.format(n=many) if many else ""
    return row_grid("Accuracy and its cost: the Pareto front", rows, text, note)


def _head(name: str) -> str:
    return f"{measure_of(name).label.replace(' error', '')} {measure_of(name).unit or ''} [95 %]".replace("  ", " ")


def _in_words(run: RunData, cost: Cost, standing: Standing | None) -> str:
    """Write a standing: of the cells that it is due to the first ones, with their levels if they are others."""
    if standing is None:
        return NO_VALUE
    levels = {} if run.manifest.grid is None else {one.name: one.levels for one in run.manifest.grid.scenarios}
    places = standing.beside[: 1 if standing.verdict == OFF else _MOST_NAMED]
    names = [
        label if scenario == cost.scenario else f"{label} at {', '.join(levels[scenario].values())}"
        for scenario, label in places
    ]
    more = len(standing.beside) - len(names)
    if standing.verdict == OFF:
        return f"{OFF}: dominated by {names[0]}"
    rest = f" and {more} more" if more else ""
    return standing.verdict + (f", against {' and '.join(names) if not more else ', '.join(names)}{rest}" * bool(names))


def trade_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw each front: errors over time and over what is on board, a colour for each estimator."""
    design = run.manifest.grid
    levels = {} if design is None else {one.name: one for one in design.scenarios}
    groups: dict[str, list[Cost]] = {}
    for cost in costs(run):
        own = levels.get(cost.scenario)
        groups.setdefault(own.base if own else cost.scenario, []).append(cost)
    for name, found in groups.items():
        over_grid = any(cost.over_grid for cost in found)
        points = []
        for cost in found:
            standing = cost.over_grid or cost.in_scenario
            told = ", ".join(levels[cost.scenario].levels.values()) if over_grid and standing.verdict != OFF else ""
            spent = {"time, ms": cost.seconds.value, "on board, kB": cost.size_bytes}
            scales = {"time, ms": 1e3, "on board, kB": 1e-3}
            costed = {label: scales[label] * value for label, value in spent.items() if value}
            points.append(Traded(cost.estimator, cost.errors, costed, standing.verdict == OFF, told))
        once = run.rows[run.rows["scenario"] == found[0].scenario].drop_duplicates("trial")
        prior = {
            error: float(np.median(once[f"prior_{error}"]))
            for error in found[0].errors
            if not over_grid and f"prior_{error}" in once and once[f"prior_{error}"].notna().all()
        }
        axes = {error: measure_of(error).axis for error in found[0].errors}
        title = f"Accuracy and its cost, {name}"
        dashed = " Dashed: the prior." if prior else ""
        labels = " Labelled: the levels of those that are not." if over_grid else ""
        yield NamedFigure(
            file_stem("trade_off", name),
            draw_trade_off(points, axes, prior, title, run.manifest.credits),
            f"{title}: median errors with their 95 % intervals against time, and against what is on board if anything"
            f" is. Open: off the Pareto front of the table, which is over failures too.{labels}{dashed}",
            f"Median errors of {', '.join(dict.fromkeys(cost.estimator for cost in found))} against time and size.",
        )
