"""Containers with checksums, written from texts: an edit of the text is a file that the container's reader accepts.

A line of a recipe of arrays is ``name dtype shape values...``. One that says nothing of that kind is left out, so that
any edit leaves something.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib

import numpy as np

_MOST_VALUES = 4096


def npz(recipe: bytes) -> bytes:
    """Pack arrays; one whose values are fewer than its shape says is cut short in the file."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for line in dict.fromkeys(recipe.split(b"\n")):
            words = line.split(b" ", 3)
            if len(words) == 4 and f"{words[0].decode('latin-1')[:80]}.npy" not in archive.namelist():
                name, dtype, shape, values = (word.decode("latin-1") for word in words)
                archive.writestr(f"{name[:80]}.npy", _npy(dtype, shape, values))
    return packed.getvalue()


def _npy(dtype: str, shape: str, values: str) -> bytes:
    head = repr({"descr": dtype, "fortran_order": False, "shape": "SHAPE"}).replace("'SHAPE'", f"({shape},)")
    head = head.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head) % 65536) + head.encode("latin-1") + _data(dtype, values)


def _data(dtype: str, values: str) -> bytes:
    if values.startswith("{"):
        return values.encode("latin-1")
    try:
        with np.errstate(all="ignore"):
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
