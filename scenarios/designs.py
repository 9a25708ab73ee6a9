"""Experimental designs: the combinations of axis levels that a campaign's grid runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from pydantic import JsonValue

from boresight.scenarios.spec.campaign import GridSpec


@dataclass(frozen=True, slots=True)
class GridCell:
    """One scenario of a grid: the level of each axis by name, and the overrides of each in the order of the axes.

    ``suffix`` is added to the name of the varied scenario; '' for the reference of ``one-at-a-time``.
    """

    suffix: str
    levels: Mapping[str, str]
    overrides: tuple[Mapping[str, JsonValue], ...]


@dataclass(frozen=True, slots=True)
class GridVariation:
    """Origin of a scenario of a grid: the scenario that it varies, and its level of each axis."""

    base: str
    levels: Mapping[str, str]


def grid_cells(grid: GridSpec) -> tuple[GridCell, ...]:
    """List the scenarios of a grid, the reference first."""
    names = {axis: tuple(spec.overrides) for axis, spec in grid.axes.items()}
    if grid.design == "full":
        return tuple(_cell(grid, levels, "-".join(levels)) for levels in product(*names.values()))
    if grid.design == "two-level":
        runs = two_level_runs(len(names))
        chosen = [tuple(own[-1 if high else 0] for own, high in zip(names.values(), run, strict=True)) for run in runs]
        return tuple(_cell(grid, levels, f"run{i:02d}") for i, levels in enumerate(chosen, start=1))
    reference = tuple(own[0] for own in names.values())
    found = [_cell(grid, reference, "")]
    for place, (axis, own) in enumerate(names.items()):
        for level in own[1:]:
            found.append(_cell(grid, (*reference[:place], level, *reference[place + 1 :]), f"{axis}-{level}"))
    return tuple(found)


def two_level_runs(factors: int) -> tuple[tuple[bool, ...], ...]:
    """Return the runs of a two-level design of resolution IV: whether each factor is at its high level.

    The rows of a Hadamard matrix of order 2^m, at least the number of factors, and their negatives (fold-over). Main
    effects are orthogonal to each other and to two-factor interactions. The first run has all factors low.
    """
    matrix = np.ones((1, 1))
    while len(matrix) < factors:
        matrix = np.block([[matrix, matrix], [matrix, -matrix]])
    # Columns of a Hadamard matrix are orthogonal. The fold-over cancels the product of two columns with any third one:
    # main effects are clear of two-factor interactions.
    columns = matrix[:, :factors]
    return tuple(tuple(bool(sign < 0) for sign in row) for half in (columns, -columns) for row in half)


def _cell(grid: GridSpec, levels: tuple[str, ...], suffix: str) -> GridCell:
    overrides = tuple(axis.overrides[level] for axis, level in zip(grid.axes.values(), levels, strict=True))
    return GridCell(suffix, dict(zip(grid.axes, levels, strict=True)), overrides)
