"""Tables of numbers that a scenario names: CSV and Parquet files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.data import find_data_file
from boresight.scenarios.limits import LARGEST_NUMBER

if TYPE_CHECKING:
    import pandas as pd


def read_table(file: str, folders: Sequence[Path]) -> pd.DataFrame:
    """Read a CSV or Parquet file from ``folders`` or the data folder."""
    import pandas as pd  # 0.4 s, which most commands do without

    path = find_data_file(file, folders, "tables", "table")
    return pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path, comment="#")


def columns_of(table: pd.DataFrame, names: Sequence[str]) -> FloatArray:
    """Return columns of a table, (n, len(names)).

    Raises
    ------
    ValueError, TypeError
        If a column is missing, or a value is no number of any use.
    """
    absent = [str(name) for name in names if name not in table]
    if absent:
        raise ValueError(f"no column {absent[0]}; it has {', '.join(map(str, table))}")
    try:
        values = table[list(names)].to_numpy(dtype=np.float64)
    except OverflowError:
        raise ValueError(f"a number in {', '.join(names)} is too large") from None
    usable = (np.abs(values) <= LARGEST_NUMBER).all(axis=1)  # False for NaN
    if not usable.all():
        row = int(np.argmin(usable))
        raise ValueError(f"row {row} (from 0) of {', '.join(names)} is not all numbers up to {LARGEST_NUMBER:g}")
    return np.asarray(values, dtype=np.float64)
