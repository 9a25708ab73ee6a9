"""Parquet files of any origin: invalid content is refused before it is expanded."""

from __future__ import annotations

import os

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from boresight.scenarios.checksums import refuse_damaged
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.parquet import TableLayout, read_column, read_frame, read_where
from boresight.scenarios.reading import read_json

LAYOUT = TableLayout(("trial", "name"), {"trial": False, "name": True, "value": False}.get)
MANY = 40_000_000


def store(folder, columns, file="a.parquet"):
    pq.write_table(pa.table(columns), folder / file, store_schema=False)  # texts kept once are texts to a reader


def sound(trials):
    return {"trial": list(trials), "name": ["a"] * len(trials), "value": [0.5] * len(trials)}


def test_the_frame_is_that_of_pandas(tmp_path):
    store(tmp_path, sound(range(3)))
    store(tmp_path, sound(range(3, 5)), "b.parquet")
    pd.testing.assert_frame_equal(read_frame(tmp_path, LAYOUT), pd.read_parquet(tmp_path))
    assert read_where(tmp_path / "b.parquet", LAYOUT, {"trial": 4, "name": "a", "other": 1}).num_rows == 1
    assert read_column(tmp_path / "b.parquet", "trial") == [3, 4]


def test_very_many_files_are_one_table_in_the_order_of_their_names(tmp_path):
    store(tmp_path, sound([0]), "0000.parquet")
    for number in range(1, 1101):
        store(tmp_path, sound([number]) | {"later": [number / 2]}, f"{number:04d}.parquet")
    frame = read_frame(tmp_path, LAYOUT)
    assert frame["trial"].tolist() == list(range(1101))
    assert frame["later"].isna().tolist() == [True] + [False] * 1100, "a column that the first file has not"
    assert frame["later"].tolist()[1:] == [number / 2 for number in range(1, 1101)]


def test_an_index_of_pandas_is_ignored(tmp_path):
    pd.DataFrame(sound([5, 2, 3])).set_index("trial").to_parquet(tmp_path / "a.parquet")
    assert read_frame(tmp_path, LAYOUT)["trial"].tolist() == [5, 2, 3]


BOMBS = {
    "numbers": lambda: {"trial": pa.array(np.zeros(MANY, np.int64))},
    "texts": lambda: {"name": pa.DictionaryArray.from_arrays(np.zeros(4000, np.int32), ["x" * 100_000])},
    "nothing": lambda: {"none": pa.nulls(MANY)},
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_small_file_does_not_fill_the_memory(tmp_path, bomb):
    store(tmp_path, BOMBS[bomb]())
    size = (tmp_path / "a.parquet").stat().st_size
    assert size < 2**20
    before = pa.total_allocated_bytes()
    with pytest.raises(BoresightError, match=f"{size} bytes that would unfold to [0-9]+"):
        read_frame(tmp_path, LAYOUT)
    assert pa.total_allocated_bytes() - before < 2**20


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"name": ["a"]}, "columns trial are missing"),
        (sound([0]) | {"value": ["many"]}, "column value does not hold numbers"),
        (sound([0]) | {"name": [1]}, "column name does not hold texts"),
        (sound([0]) | {"trial": pa.array([None], pa.int64())}, "column trial does not tell of every row"),
        (sound([0]) | {"trial": [0.5]}, "column trial does not tell of every row"),
        (sound([0]) | {"value": [[1.0]]}, "holds neither numbers nor texts"),
    ],
)
def test_invalid_tables_are_refused(tmp_path, columns, said):
    store(tmp_path, columns)
    with pytest.raises(BoresightError, match=said):
        read_frame(tmp_path, LAYOUT)


def test_no_flipped_bit_of_a_footer_aborts_the_process(tmp_path):
    """Reading the column metadata of a damaged footer aborts pyarrow, so that it is not read."""
    store(tmp_path, {"trial": [0]})
    file, layout = tmp_path / "a.parquet", TableLayout(("trial",), LAYOUT.is_text)
    content = file.read_bytes()
    footer = int.from_bytes(content[-8:-4], "little")
    refused = 0
    for place in range(len(content) - 8 - footer, len(content) - 8):
        for bit in (0, 1, 4):
            file.write_bytes(content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :])
            for read in (lambda: read_frame(tmp_path, layout), lambda: read_where(file, layout, {"trial": 0})):
                try:
                    read()
                except BoresightError:
                    refused += 1
    assert refused > 2 * footer


def test_invalid_utf8_is_refused(tmp_path):
    """pyarrow itself accepts them until they are decoded."""
    wrong = pa.Array.from_buffers(pa.string(), 1, pa.array([b"\xff"], pa.binary()).buffers())
    store(tmp_path, sound([0]) | {"name": wrong})
    for read in (lambda: read_frame(tmp_path, LAYOUT), lambda: read_where(tmp_path / "a.parquet", LAYOUT, {})):
        with pytest.raises(BoresightError, match="UTF8"):
            read()


def test_pipes_and_devices_are_not_read(tmp_path):
    """Opening a pipe without a writer blocks; each of these calls must return."""
    (tmp_path / "rows").mkdir()
    os.mkfifo(tmp_path / "rows" / "a.parquet")
    (tmp_path / "checksums").mkdir()
    (tmp_path / "checksums" / "a.sha256").write_text(f"{'0' * 64}  rows/a.parquet\n")
    with pytest.raises(BoresightError, match="damaged"):
        refuse_damaged(tmp_path)
    with pytest.raises(BoresightError, match="is no file"):
        read_frame(tmp_path / "rows", LAYOUT)
    with pytest.raises(BoresightError, match="it is a folder, a device or a pipe"):
        read_json(tmp_path / "rows" / "a.parquet", "a manifest")
