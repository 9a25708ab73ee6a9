"""What a PNG or TIFF states of its size: known before memory is taken for its pixels."""

from __future__ import annotations

import struct

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
_ORDERS = {b"II": "<", b"MM": ">"}
_WIDTH, _HEIGHT, _SAMPLES = 256, 257, 277
_BIG = 43
_NUMBER = {1: "B", 3: "H", 4: "I", 16: "Q"}


def bitmap_size(content: bytes) -> tuple[int, int, int]:
    """Return width, height and channels as the header states them; (0, 0, 1) where there is no such header.

    TIFF: the first directory, classic or BigTIFF (TIFF 6.0, section 2).
    """
    try:
        if content.startswith(_PNG):
            width, height, _, colour = struct.unpack_from(">IIBB", content, 16)
            return int(width), int(height), _PNG_CHANNELS.get(colour, 4)
        order = _ORDERS.get(content[:2])
        return (0, 0, 1) if order is None else _tiff_size(content, order)
    except (struct.error, OverflowError):
        return 0, 0, 1


def is_cut_short(content: bytes) -> bool:
    """Tell whether a chunk of a PNG is longer than what is left of the file; others are never."""
    place = len(_PNG)
    while content.startswith(_PNG) and place + 12 <= len(content):
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
    layout, first, step = ("HHQ8s", 8, 20) if big else ("HHI4s", 2, 12)
    found = {_WIDTH: 0, _HEIGHT: 0, _SAMPLES: 1}
    for index in range(min(entries, len(content) // step)):
        tag, kind, _, value = struct.unpack_from(order + layout, content, place + first + index * step)
        if tag in found and kind in _NUMBER:
            found[tag] = int(struct.unpack_from(order + _NUMBER[kind], value)[0])
    return found[_WIDTH], found[_HEIGHT], found[_SAMPLES]
