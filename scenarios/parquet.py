"""Robust reading of Parquet files: plain columns only, bounded memory, one-line errors for damaged files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import MOST_FOLD, may_unfold, unreadable

if TYPE_CHECKING:
    import pandas as pd

PARQUET_FAULTS = (
    pa.ArrowException, AttributeError, LookupError, MemoryError, OSError, OverflowError, RecursionError, TypeError,
    ValueError,
)  # fmt: skip
"""Exceptions of pyarrow and pandas for damaged files: a wrong byte may be in a name, a type, a length or a page."""

_AT_ONCE = 500


class TableLayout(NamedTuple):
    """Expected columns of a table.

    ``keys`` are required columns without missing values; numeric ones hold integers. ``is_text`` takes the name of a
    column to whether it holds text (True), numbers (False) or either (None).
    """

    keys: tuple[str, ...]
    is_text: Callable[[str], bool | None]


def read_table(folder: Path, layout: TableLayout) -> pa.Table:
    """Read the files ``*.parquet`` of a folder (at least one) as one table, in the order of their names.

    Raise BoresightError if a file is damaged, does not have the layout, or would expand to far more than its size.
    """
    with _explained(folder):
        return _table(folder, sorted(folder.glob("*.parquet")), layout)


def read_frame(folder: Path, layout: TableLayout) -> pd.DataFrame:
    """Read a folder as `read_table` does, as a frame; metadata of pandas in the files is ignored.

    Raise BoresightError as `read_table` does.
    """
    table = read_table(folder, layout)
    with _explained(folder):
        frame: pd.DataFrame = table.to_pandas(ignore_metadata=True)
        return frame


def read_where(path: Path, layout: TableLayout, values: Mapping[str, object]) -> pa.Table:
    """Read the rows of a file whose key columns have the given values.

    All rows are read and then filtered: filters of pyarrow use the column statistics of the file and abort the process
    if these are damaged. Raise BoresightError as `read_table` does.
    """
    with _explained(path):
        table = _table(path, [path], layout)
        for name, value in values.items():
            if name in layout.keys:
                table = table.filter(pc.equal(table.column(name), value))
        return table


def read_column(path: Path, name: str) -> list[Any]:
    """Read one column of a file; raise BoresightError as `read_table` does."""
    with _explained(path):
        (table,) = _tables([path], [name])
        values: list[Any] = table.column(name).to_pylist()
        return values


@contextmanager
def _explained(place: Path) -> Iterator[None]:
    try:
        yield
    except PARQUET_FAULTS as error:
        raise unreadable(place, "a stored table", error) from error


def _table(place: Path, files: Sequence[Path], layout: TableLayout) -> pa.Table:
    table = _joined(_tables(files))
    table.validate(full=True)  # invalid UTF-8, for example, would be detected only when it is printed
    missing = [name for name in layout.keys if name not in table.column_names]
    if missing:
        raise BoresightError(f"{place}: columns {', '.join(missing)} are missing: no such table of boresight")
    for name, column in zip(table.column_names, table.columns, strict=True):
        _check_column(f"{place}: column {name}", column, layout.is_text(name), name in layout.keys)
    return table


def _check_column(what: str, column: pa.ChunkedArray, is_text: bool | None, is_key: bool) -> None:
    """Raise an error for text in a numeric column, numbers in a text column, or a key with missing values."""
    if is_text is not None and is_text != _is_text(column.type) and not pa.types.is_null(column.type):
        raise BoresightError(f"{what} does not hold {'texts' if is_text else 'numbers'}: no table of boresight")
    if is_key and (column.null_count or not (is_text or pa.types.is_integer(column.type))):
        raise BoresightError(f"{what} does not tell of every row which it is: no table of boresight")


def _joined(tables: Iterable[pa.Table]) -> pa.Table:
    """Concatenate tables; intermediate copies release the per-table overhead of many small ones."""
    joined, few = [], []
    for table in tables:
        few.append(table)
        if len(few) == _AT_ONCE:
            joined.append(pa.concat_tables(few, promote_options="default").combine_chunks())
            few = []
    return pa.concat_tables([*joined, *few], promote_options="default")


def _tables(files: Sequence[Path], columns: list[str] | None = None) -> Iterator[pa.Table]:
    """Read files one by one: pyarrow needs ten times the memory of the values when it reads very many at once.

    Raise an error for column types that no table of boresight has, and for implausible expansion ratios.
    """
    size = unfolded = 0
    for path in files:
        if not path.is_file():
            raise BoresightError(f"{path}: is no file: run the campaign again")
        with pq.ParquetFile(path) as file:
            schema = file.schema_arrow
            if len(set(schema.names)) < len(schema.names) or not all(_is_plain(kind) for kind in schema.types):
                raise BoresightError(f"{path}: a column is there twice, or holds neither numbers nor texts")
            size += path.stat().st_size
            unfolded += _unfolded_bytes(file, path)
            if not may_unfold(size, unfolded):
                raise BoresightError(
                    f"{path}: {size} bytes that would unfold to {unfolded}: no table of boresight does"
                )
            yield file.read(columns=columns, use_threads=False)


def _is_plain(kind: pa.DataType) -> bool:
    is_number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
    return is_number or _is_text(kind) or pa.types.is_null(kind)


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _unfolded_bytes(file: pq.ParquetFile, path: Path) -> int:
    """Estimate the memory that the columns need; dictionary-encoded text counts at each occurrence.

    Column metadata of the footer is not read: if it is damaged, pyarrow aborts the process.
    """
    about = file.metadata
    groups = [about.row_group(number) for number in range(about.num_row_groups)]
    size, rows = path.stat().st_size, max(about.num_rows, sum(group.num_rows for group in groups))
    stored = sum(group.total_byte_size for group in groups)
    # Eight bytes a value, and the pages as they are stored.
    total = int(rows * 8 * about.num_columns + stored)
    texts = [field.name for field in file.schema_arrow if _is_text(field.type)]
    longest = max(stored, MOST_FOLD * size)
    if may_unfold(size, total) and not may_unfold(size, total + longest * rows * len(texts)):
        total += _text_bytes(path, texts)
    return total


def _text_bytes(path: Path, texts: list[str]) -> int:
    """Sum the lengths of the values of text columns without expanding their dictionaries."""
    with pq.ParquetFile(path, read_dictionary=texts) as file:
        columns = file.read(columns=texts, use_threads=False).columns
    chunks = [chunk for column in columns for chunk in column.chunks]
    return sum(int(pc.sum(pc.take(pc.binary_length(c.dictionary), c.indices)).as_py() or 0) for c in chunks)
