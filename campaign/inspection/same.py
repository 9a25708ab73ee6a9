"""Whether a recomputed trial is the stored one, bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from campaign.inspection.case import Case
from campaign.store import TABLES, RunFolder
from campaign.trial.kind import Records
from reports.schema.tables import schema

NOT_REPRODUCIBLE = ("timings", "tracebacks", "said")
"""Times are never the same, a trace names the files of the checkout that it was made in, and methods say anything."""


@dataclass(frozen=True, slots=True)
class Sameness:
    """What came out of the comparison of a recomputed trial with the stored one.

    Parameters
    ----------
    values
        How many values were compared.
    differences
        One line for each table and column that is not the same.
    """

    values: int
    differences: tuple[str, ...]

    def __str__(self) -> str:
        if self.differences:
            return f"NOT the same as stored: {'; '.join(self.differences)}"
        return f"the same as stored, bit for bit ({self.values:,} values)"


def compare_with_stored(folder: RunFolder, case: Case, records: Records) -> Sameness:
    """Compare every stored table of a case with what was recomputed, but for times and traces."""
    values, differences = 0, []
    for name in (name for name in TABLES if name not in NOT_REPRODUCIBLE):
        stored = folder.of_trial(name, case.scenario, case.estimator, case.trial)
        again = pa.Table.from_pylist([dict(record) for record in records.get(name, [])], schema=schema(name))
        if stored.num_rows != again.num_rows:
            differences.append(f"{name}: {again.num_rows} rows, {stored.num_rows} stored")
            continue
        values += stored.num_rows * len(stored.column_names)
        differences += _differences(name, stored, again)
    return Sameness(values, tuple(differences))


def _differences(name: str, stored: pa.Table, again: pa.Table) -> Sequence[str]:
    """Say which columns differ, and in how many rows; one that an earlier version did not store is no difference."""
    found = []
    for column in (column for column in again.column_names if column in stored.column_names):
        rows = np.count_nonzero(_differs(stored[column], again[column]))
        if rows:
            found.append(f"{name}.{column} in {rows} of {stored.num_rows} rows")
    return found


def _differs(one: pa.ChunkedArray, other: pa.ChunkedArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(n,) where two columns differ: numbers by their bits, so that NaN is itself and -0 is not 0."""
    left, right = (_bits(column) for column in (one, other))
    return np.array([a != b for a, b in zip(left, right, strict=True)], dtype=np.bool_)


def _bits(column: pa.ChunkedArray) -> list[object]:
    values = column.to_pylist()
    return [value.hex() if isinstance(value, float) else value for value in values]
