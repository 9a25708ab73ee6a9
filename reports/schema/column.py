"""A measure, a column of a stored table, and what a kind of trial stores and reports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import pyarrow as pa

# Units by the end of a name: of columns, and of numbers that estimators report.
_SUFFIXES = {"_px": "px", "_m": "m", "_deg": "deg", "_s": "s", "_bytes": "bytes"}


def unit_by_suffix(name: str) -> str:
    """Return the unit that the end of a name says, '' where it says none."""
    return next((unit for end, unit in _SUFFIXES.items() if name.endswith(end)), "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """A number that reports print, by its name in tidy tables, comparisons and files of published values.

    ``label`` is in words, without the unit; '' for the name without its unit. ``unit`` None is that of the end of the
    name. Of an ``error`` smaller is better. A stored column that is not ``printed`` is there for users alone; one with
    ``detail`` is listed in the table of details, others in tables of their kind.
    """

    name: str
    label: str = ""
    unit: str | None = None
    error: bool = False
    printed: bool = True
    detail: bool = False

    @property
    def axis(self) -> str:
        """In words, with the unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label


@dataclass(frozen=True, slots=True, kw_only=True)
class Column(Measure):
    """A column of a stored table: a measure, if reports print it, with its Arrow type and meaning."""

    type: pa.DataType
    meaning: str
    printed: bool = False


Columns = tuple[Column, ...]


def text(name: str, meaning: str) -> Column:
    """Make a column of texts."""
    return Column(name=name, type=pa.string(), meaning=meaning)


def count(name: str, meaning: str, label: str = "") -> Column:
    """Make a column of whole numbers; one with a label is a measure of the table of details."""
    return Column(name=name, type=pa.int64(), meaning=meaning, label=label, printed=bool(label), detail=bool(label))


def flag(name: str, meaning: str) -> Column:
    """Make a column of truth values."""
    return Column(name=name, type=pa.bool_(), meaning=meaning)


def number(name: str, meaning: str) -> Column:
    """Make a column of numbers that no report prints by its name."""
    return Column(name=name, type=pa.float64(), meaning=meaning)


def measured(name: str, meaning: str, label: str = "", *, error: bool = False, detail: bool = True) -> Column:
    """Make a column of numbers that is a measure."""
    return Column(name=name, type=pa.float64(), meaning=meaning, label=label, error=error, printed=True, detail=detail)


def names(columns: Iterable[Measure]) -> tuple[str, ...]:
    """Return the names of measures or columns."""
    return tuple(column.name for column in columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class KindSchema:
    """Stored columns and reported measures of a kind of trial.

    ``row`` has the columns of its rows after those that all kinds have, ``tables`` its further tables, ``measures``
    what is worked out of them. ``metrics`` are measures of each trial that comparisons may go by before there is a run,
    the usual one first. ``nees`` is the table of the normalised squared errors: ``rows`` of poses, ``epochs`` of
    positions frame by frame, ``orbits`` of states at an epoch. ``frames``: a trial consists of frames, one of which the
    reason of a failure names. ``databases_note`` says what intervals rest on where ``{n}`` data bases take turns.
    """

    row: Columns = ()
    tables: Mapping[str, Columns] = field(default_factory=dict)
    measures: tuple[Measure, ...] = ()
    metrics: tuple[str, ...]
    nees: Literal["rows", "epochs", "orbits"] = "rows"
    frames: bool = False
    databases_note: str = (
        "Each estimator's data base was drawn {n} times, with the errors of the shape on board where it has some, and"
        " with another world of craters where there is one; trials have them in turn. Intervals and tests take the"
        " data base for what is independent (Student's t over them), so that they tell of other data bases too."
    )
