"""The documented columns of every stored table, and units and labels of every measure.

Raise FORMAT_VERSION when a column is renamed, moved, or changes its meaning.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path

import pyarrow as pa

from boresight.reports.schema.column import (
    COMMON_ROW,
    KEY,
    SHARED_MEASURES,
    SHARED_TABLES,
    Columns,
    KindSchema,
    Measure,
    names,
    unit_by_suffix,
)
from boresight.reports.schema.kinds import SCHEMAS
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.parquet import TableLayout

FORMAT_VERSION = 3
AFTER_REVOLUTIONS = re.compile(r"error_after_([1-9]\d*)_m")
"""Names of the position errors of sequences after so many revolutions."""
ALL_ROW_COLUMNS: Columns = tuple(
    {column.name: column for column in chain(COMMON_ROW, *(kind.row for kind in SCHEMAS.values()))}.values()
)
TABLES: dict[str, Columns] = {
    "rows": ALL_ROW_COLUMNS,
    **{name: columns for kind in SCHEMAS.values() for name, columns in kind.tables.items()},
    **SHARED_TABLES,
}
"""Columns of each table; of ``rows`` those of all kinds of trial, of which a run has those of its own."""


def kind_schema(experiment: str) -> KindSchema:
    """Return what a kind of trial stores and reports; raise BoresightError if there is no such kind."""
    if experiment not in SCHEMAS:
        raise BoresightError(f"experiment: {experiment!r} has no columns; known are {', '.join(SCHEMAS)}")
    return SCHEMAS[experiment]


def columns_of(table: str, experiment: str = "") -> Columns:
    """Return the columns of a table in a run of a kind of trial; without a kind, those of all kinds."""
    if table == "rows" and experiment:
        return (*COMMON_ROW, *kind_schema(experiment).row)
    return TABLES[table]


def schema(table: str, experiment: str = "") -> pa.Schema:
    """Return the Arrow schema of a table in a run of a kind of trial, with the meanings as field metadata."""
    fields = [pa.field(c.name, c.type, metadata={"meaning": c.meaning}) for c in columns_of(table, experiment)]
    return pa.schema(fields, metadata={"boresight_table": table, "boresight_format": str(FORMAT_VERSION)})


def layout(table: str, experiment: str = "") -> TableLayout:
    """Return what a reader of a table requires: its key, and text where the columns are text."""
    texts = {c.name: c.type == pa.string() for c in columns_of(table, experiment)}
    keys = {*names(KEY), *({"status"} if table == "rows" else ())}
    return TableLayout(tuple(name for name in texts if name in keys), texts.get)


@cache
def measures() -> dict[str, Measure]:
    """Return every measure that reports print, by its name."""
    found: Iterator[Measure] = chain(
        SHARED_MEASURES, *(kind.measures for kind in SCHEMAS.values()), *(columns for columns in TABLES.values())
    )
    return {measure.name: measure for measure in reversed([one for one in found if one.printed])}


@cache
def measure_of(name: str) -> Measure:
    """Return a measure, or a number that an estimator reports, with its words and its unit."""
    turns = AFTER_REVOLUTIONS.fullmatch(name)
    known = measures().get(name, Measure(name=name, error=turns is not None))
    unit = unit_by_suffix(name) if known.unit is None else known.unit
    words = name.removesuffix(f"_{(unit or '').replace('/', '_')}").replace("_", " ")
    return replace(known, label=known.label or (f"position {words} revolutions" if turns else words), unit=unit)


def unit_of(name: str) -> str:
    """Return the unit of a measure, or of a number that an estimator reports, by the end of its name."""
    return measure_of(name).unit or ""


def measure_label(name: str) -> str:
    """Return the words for a measure, without its unit."""
    return measure_of(name).label


def refuse_older(manifest: object, path: Path) -> None:
    """Raise `BoresightError` if a run is stored in another format than this version of boresight reads."""
    stored = manifest.get("format", "unknown") if isinstance(manifest, Mapping) else FORMAT_VERSION
    if stored != FORMAT_VERSION:
        raise BoresightError(
            f"{path.parent}: stored in format {stored}, and this version of boresight reads {FORMAT_VERSION}: run the"
            " campaign again, into another folder (--out)"
        )
