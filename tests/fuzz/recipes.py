"""Containers with checksums, written from texts: an edit of the text is a file that the container's reader accepts.

A line of a recipe of arrays is ``name dtype shape values...``, of a table ``name type values...``. One that says
nothing of that kind is left out, so that any edit leaves something.
"""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
import zlib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

_MOST_VALUES, _MOST_COLUMNS = 65536, 100


def npz(recipe: bytes) -> bytes:
    """Pack arrays; one whose values are fewer than its shape says is cut short in the file."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for line in dict.fromkeys(recipe.split(b"\n")):
            words = line.split(b" ", 3)
            if len(words) == 4 and f"{_member(words[0])}.npy" not in archive.namelist():
                dtype, shape, values = (word.decode("latin-1") for word in words[1:])
                archive.writestr(f"{_member(words[0])}.npy", _npy(dtype, shape, values))
    return packed.getvalue()


def _member(name: bytes) -> str:
    """Cut a name to what the writer of archives takes: it ends names at a zero, and lets none be empty."""
    return name.decode("latin-1").partition("\0")[0][:80] or "_"


def _npy(dtype: str, shape: str, values: str) -> bytes:
    head = repr({"descr": dtype, "fortran_order": False, "shape": "SHAPE"}).replace("'SHAPE'", f"({shape},)")
    head = head.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head) % 65536) + head.encode("latin-1") + _data(dtype, values)


def _data(dtype: str, values: str) -> bytes:
    if values.startswith("{"):
        return values.encode("latin-1")
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
            numbers = np.array([float(word[:30]) for word in values.split()[:_MOST_VALUES]])
            return numbers.astype(np.dtype(dtype)).tobytes()
    except (TypeError, ValueError, SyntaxError, OverflowError):
        return values.encode("latin-1")


def array_line(name: str, array: np.ndarray) -> bytes:
    """Write an array as a line of a recipe."""
    shape = ",".join(map(str, array.shape))
    values = " ".join(map(repr, array.ravel().tolist()))
    if array.dtype == np.uint8 and array.tobytes()[:1] == b"{":
        values = array.tobytes().decode()
    return f"{name} {array.dtype.str} {shape} {values}".encode()


def parquet(recipe: bytes) -> bytes:
    """Write a table; columns of unlike lengths are filled up with nothing. Values of a list stand between bars."""
    columns: dict[str, pa.Array] = {}
    for line in recipe.split(b"\n")[:_MOST_COLUMNS]:
        words = line.decode("utf-8", errors="replace").split(" ", 2)
        if len(words) == 3:
            columns.setdefault(words[0][:80], _column(words[1], words[2].split(" ")[:_MOST_VALUES]))
    longest = max((len(column) for column in columns.values()), default=0)
    filled = {n: pa.concat_arrays([c, pa.nulls(longest - len(c), c.type)]) for n, c in columns.items()}
    written = io.BytesIO()
    pq.write_table(pa.table(filled), written)
    return written.getvalue()


def _column(kind: str, words: list[str]) -> pa.Array:
    """Write values as a type says, as texts where they are none of it."""
    given = [None if word == "null" else word for word in words]
    try:
        if kind.startswith("list<"):
            values = pa.array([None if word is None else word.split("|") for word in given], pa.list_(pa.string()))
            return values.cast(pa.list_(pa.type_for_alias(kind[5:-1])))
        return pa.array(given, pa.string()).cast(kind)
    except (ValueError, TypeError, pa.ArrowException):
        return pa.array(words, pa.string())


def table_recipe(table: pa.Table) -> bytes:
    """Write a table as a recipe."""
    lines = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind = f"list<{column.type.value_type}>" if pa.types.is_list(column.type) else column.type
        lines.append(f"{name} {kind} {' '.join(map(_word, column.to_pylist()))}")
    return "\n".join(lines).encode()


def _word(value: object) -> str:
    if isinstance(value, list):
        return "|".join(map(_word, value)) or "null"
    if isinstance(value, bytes):
        return value.decode("latin-1")
    return "null" if value is None else str(value).lower().replace(" ", "_") or "_"


def fits_file(recipe: bytes) -> bytes:
    """Write FITS units: cards a line, a line ``data``, and its hexadecimal digits up to a line ``unit``."""
    content = b""
    for unit in recipe.split(b"\nunit\n"):
        cards, _, data = unit.partition(b"\ndata\n")
        header = b"".join(card[:80].ljust(80) for card in [*cards.split(b"\n"), b"END"])
        content += _blocks(header, b" ") + _blocks(_unhexed(data), b"\0")
    return content


def _blocks(content: bytes, fill: bytes) -> bytes:
    return content.ljust(-(-len(content) // 2880) * 2880, fill)


def _unhexed(digits: bytes) -> bytes:
    try:
        return bytes.fromhex(digits.decode("ascii"))
    except ValueError:
        return digits


def png(content: bytes) -> bytes:
    """Put the right checksums into the chunks of a PNG."""
    mended, at = content[:8], 8
    while at + 12 <= len(content):
        length = min(int.from_bytes(content[at : at + 4], "big"), len(content) - at - 12)
        chunk = content[at + 4 : at + 8 + length]
        mended += content[at : at + 4] + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        at += 12 + length
    return mended + content[at:]
