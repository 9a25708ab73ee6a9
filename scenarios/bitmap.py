"""Reader of single grey PNG and TIFF files."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.reading import MOST_PIXELS

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # by colour type; a palette (3) is expanded to colours
_ORDERS = {b"II": "<", b"MM": ">"}
_WIDTH, _HEIGHT, _SAMPLES = 256, 257, 277  # TIFF tags ImageWidth, ImageLength and SamplesPerPixel
_BIG = 43  # version number of BigTIFF; 42 is that of classic TIFF
# TIFF field types BYTE, SHORT, LONG and LONG8.
_NUMBER = {1: "B", 3: "H", 4: "I", 16: "Q"}


def bitmap_size(content: bytes) -> tuple[int, int, int]:
    """Return width, height and channels stated in a PNG or TIFF header; (0, 0, 1) where there is none.

    TIFF: the first directory, classic or BigTIFF (TIFF 6.0, section 2).
    """
    try:
        if content.startswith(_PNG):
            # The IHDR chunk comes first: its data start after the signature, a length and a name.
            width, height, _, colour = struct.unpack_from(">IIBB", content, 16)
            return int(width), int(height), _PNG_CHANNELS.get(colour, 4)
        order = _ORDERS.get(content[:2])
        return (0, 0, 1) if order is None else _tiff_size(content, order)
    except (struct.error, OverflowError):
        return 0, 0, 1


def is_cut_short(content: bytes) -> bool:
    """Return whether a chunk of a PNG extends beyond the end of the file; False for other formats."""
    place = len(_PNG)
    while content.startswith(_PNG) and place + 12 <= len(content):
        # A chunk: length of the data, name, data, checksum.
        length, kind = struct.unpack_from(">I4s", content, place)
        place += 12 + length
        if place > len(content):
            return True
        if kind == b"IEND":
            break
    return False


def _tiff_size(content: bytes, order: str) -> tuple[int, int, int]:
    big = struct.unpack_from(f"{order}H", content, 2)[0] == _BIG
    place = struct.unpack_from(f"{order}{'Q' if big else 'I'}", content, 8 if big else 4)[0]
    entries = struct.unpack_from(f"{order}{'Q' if big else 'H'}", content, place)[0]
    # An entry: tag, field type, count, and a value that is short enough to stand in it.
    layout, first, step = ("HHQ8s", 8, 20) if big else ("HHI4s", 2, 12)
    found = {_WIDTH: 0, _HEIGHT: 0, _SAMPLES: 1}
    # A damaged count cannot lead to more entries than the file has room for.
    for index in range(min(entries, len(content) // step)):
        tag, kind, _, value = struct.unpack_from(order + layout, content, place + first + index * step)
        if tag in found and kind in _NUMBER:
            found[tag] = int(struct.unpack_from(order + _NUMBER[kind], value)[0])
    return found[_WIDTH], found[_HEIGHT], found[_SAMPLES]


def read_bitmap(content: bytes, path: Path) -> NDArray[np.generic]:
    """Decode a PNG or TIFF image, (H, W), or (H, W, channels) if it is in colour.

    Colours that are equal are grey, with a constant fourth channel or without. Raise `BoresightError` if it is damaged,
    or larger than `MOST_PIXELS`. ``path`` is the file, for messages.
    """
    width, height, channels = bitmap_size(content)
    if width * height * channels > MOST_PIXELS:
        raise BoresightError(
            f"{path}: {width} x {height} pixels of {channels} channels are more than the {MOST_PIXELS} that are read"
        )
    if is_cut_short(content):  # OpenCV allocates the size that a chunk states
        raise BoresightError(f"{path}: not a readable {path.suffix[1:].upper()} image: it is cut short")
    try:
        with _quiet():
            image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BoresightError(f"{path}: cannot be read: {one_line(error)}") from error
    if image is None:
        raise BoresightError(f"{path}: not a readable {path.suffix[1:].upper()} image")
    # Grey images are also stored in colour, with three equal channels, and a fourth that is opaque everywhere.
    if image.ndim == 3 and not np.ptp(image[..., :3], axis=2).any() and not np.ptp(image[..., 3:], axis=(0, 1)).any():
        return np.asarray(image[..., 0])
    return np.asarray(image)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence OpenCV's log, as an error is reported as one line."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)
