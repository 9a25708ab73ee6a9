"""Description of tables as a Frictionless Data Package, ``datapackage.json``: types, units and meanings."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from boresight.reports.schema.column import Column
from boresight.reports.schema.tables import TABLES, columns_of
from boresight.scenarios.atomic import write_text

if TYPE_CHECKING:
    import pandas as pd

FILE = "datapackage.json"
Fields = list[dict[str, str]]

_TYPES = {pa.int64(): "integer", pa.float64(): "number", pa.bool_(): "boolean"}
_PROFILE = "https://datapackage.org/profiles/2.0/"
_MEDIA_TYPES = {"csv": "text/csv", "parquet": "application/vnd.apache.parquet"}


def write_data_package(
    tables: Mapping[str, tuple[str | list[str], Fields]], kind: str, manifest: Mapping[str, Any], out: Path
) -> Path:
    """Write ``datapackage.json`` of tables by name; return its path.

    Each table has its file or files, csv or parquet as ``kind`` says, below ``out``, and the description of its fields.
    """
    package = {
        "$schema": f"{_PROFILE}datapackage.json",
        # Names of packages have small letters, digits and some signs.
        "name": re.sub(r"[^-a-z0-9._]+", "-", str(manifest.get("name")).lower()),
        "title": manifest.get("title"),
        "id": manifest.get("digest"),
        "description": f"Tables of a run of boresight with the seed {manifest.get('seed')}.",
        "resources": [
            {
                "name": name,
                "type": "table",
                "path": path,
                "format": kind,
                "mediatype": _MEDIA_TYPES[kind],
                "encoding": "utf-8",
                "schema": {
                    "$schema": f"{_PROFILE}tableschema.json",
                    "fields": fields,
                },
            }
            for name, (path, fields) in tables.items()
        ],
    }
    written = out / FILE
    write_text(written, json.dumps(package, indent=1, ensure_ascii=False) + "\n")
    return written


def stored_fields(name: str, experiment: str) -> Fields:
    """Describe the columns of a table as a run of a kind of trial stores it.

    Readers by way of pandas have whole numbers with gaps as floats.
    """
    return [
        _field(column, "number" if column.gaps else _TYPES.get(column.type, "string"))
        for column in columns_of(name, experiment)
    ]


def exported_fields(name: str, table: pd.DataFrame) -> Fields:
    """Describe the columns of an exported table; whole numbers of which some are missing are written with points."""
    columns, found = {column.name: column for column in TABLES[name]}, []
    for column in (columns[str(own)] for own in table):
        with_points = column.type == pa.int64() and table[column.name].dtype.kind not in "iu"
        found.append(_field(column, "number" if with_points else _TYPES.get(column.type, "string")))
    return found


def _field(column: Column, kind: str) -> dict[str, str]:
    described = {"name": column.name, "type": kind, "description": column.meaning}
    return described | ({"unit": column.stored_unit} if column.stored_unit else {})
