"""Description of exported tables as a Frictionless Data Package, ``datapackage.json``: types, units and meanings."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from boresight.reports.schema.column import Column
from boresight.reports.schema.tables import TABLES
from boresight.scenarios.atomic import write_text

_PROFILE = "https://datapackage.org/profiles/2.0/"
_MEDIA_TYPES = {"csv": "text/csv", "parquet": "application/vnd.apache.parquet"}


def write_data_package(tables: Mapping[str, pd.DataFrame], kind: str, manifest: Mapping[str, Any], out: Path) -> Path:
    """Write ``datapackage.json`` of exported tables by name, in files ``NAME.kind``; return its path."""
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
                "path": f"{name}.{kind}",
                "format": kind,
                "mediatype": _MEDIA_TYPES[kind],
                "encoding": "utf-8",
                "schema": {
                    "$schema": f"{_PROFILE}tableschema.json",
                    "fields": _fields(name, table),
                },
            }
            for name, table in tables.items()
        ],
    }
    path = out / "datapackage.json"
    write_text(path, json.dumps(package, indent=1, ensure_ascii=False) + "\n")
    return path


def _fields(name: str, table: pd.DataFrame) -> list[dict[str, str]]:
    columns = {column.name: column for column in TABLES[name]}
    return [_field(columns[str(own)], table) for own in table]


def _field(column: Column, table: pd.DataFrame) -> dict[str, str]:
    described = {"name": column.name, "type": _type(column, table), "description": column.meaning}
    return described | ({"unit": column.stored_unit} if column.stored_unit else {})


def _type(column: Column, table: pd.DataFrame) -> str:
    """Return the type of a field; a column of whole numbers in which some are missing is written with points."""
    values = table[column.name]
    if column.type == pa.int64():
        return "integer" if pd.api.types.is_integer_dtype(values) else "number"
    return {pa.float64(): "number", pa.bool_(): "boolean"}.get(column.type, "string")
