"""Readers of single grey image files: PNG, TIFF and FITS."""

from __future__ import annotations

import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.reading import MOST_PIXELS

if TYPE_CHECKING:
    from astropy.io import fits

FITS_SUFFIXES = (".fits", ".fit", ".fts")
BITMAP_SUFFIXES = (".png", ".tif", ".tiff")

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # by colour type; a palette (3) is expanded to colours
_ORDERS = {b"II": "<", b"MM": ">"}
_WIDTH, _HEIGHT, _SAMPLES = 256, 257, 277  # TIFF tags ImageWidth, ImageLength and SamplesPerPixel
_BIG = 43  # version number of BigTIFF; 42 is that of classic TIFF
# TIFF field types BYTE, SHORT, LONG and LONG8.
_NUMBER = {1: "B", 3: "H", 4: "I", 16: "Q"}

_COUNT = re.compile(rb"(Z?NAXIS[0-9]*|TFIELDS) *= *([0-9]+)")
_MOST_AXES, _LONGEST_AXIS = 999, 1 << 31
# Exceptions that astropy raises for damaged headers and data, apart from its own.
_FAULTS = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError, OSError, RecursionError,
    RuntimeError, TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip


def _check_axes(content: bytes, path: Path) -> None:
    """Refuse headers with excessive sizes, for which astropy would loop or allocate without bound."""
    packed = 1
    for card in _COUNT.finditer(content):
        name, value = card.group(1), int(card.group(2)[:30])
        # The axes of a compressed image: their product is what astropy would allocate.
        packed = packed * max(value, 1) if name.startswith(b"Z") and name != b"ZNAXIS" else packed
        if value > (_MOST_AXES if name.endswith(b"S") else _LONGEST_AXIS) or packed > MOST_PIXELS:
            raise BoresightError(
                f"{path}: not a readable FITS file: {name.decode()} = {value} is more than an image has"
            )


def _keywords(header: fits.Header) -> dict[str, object]:
    """Values of a header by keyword; the first where a keyword is repeated.

    Not looked up by name, as astropy takes a damaged name with an asterisk for a pattern.
    """
    return dict(reversed(list(header.items())))


def read_fits(content: bytes, path: Path) -> tuple[NDArray[np.generic], dict[str, object]]:
    """Read the first image of a FITS file, (H, W), scaled as its header says, and the keywords.

    These are those of the primary header, overridden by those of the image. The file is read from memory, as astropy
    leaves a damaged one open. Raise `BoresightError` if it is damaged or holds no image of two dimensions.
    """
    # Imported here, as astropy takes an eighth of the start-up time and most runs read no FITS file.
    from astropy.io import fits
    from astropy.io.fits.hdu.compressed._compression import CfitsioException  # derives from Exception directly

    _check_axes(content, path)
    try:
        with warnings.catch_warnings(action="ignore"), fits.open(BytesIO(content)) as units:
            unit = next((unit for unit in units if unit.is_image and unit.data is not None), None)
            header = {} if unit is None else {**_keywords(units[0].header), **_keywords(unit.header)}
            image = None if unit is None else unit.data
    except (*_FAULTS, fits.VerifyError, CfitsioException) as error:
        raise BoresightError(f"{path}: not a readable FITS file: {one_line(error) or type(error).__name__}") from error
    if image is None:
        raise BoresightError(f"{path}: holds no image")
    if np.ndim(image) != 2:
        raise BoresightError(f"{path}: a grey image has rows and columns alone, this one has shape {np.shape(image)}")
    return np.asarray(image), header


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


def read_image(path: Path) -> NDArray[np.float32]:
    """Read a grey PNG, TIFF (8 or 16 bit) or FITS image, (H, W), in the units and with the order of rows of the file.

    The colours of a bitmap must be equal, and a fourth channel constant. Raise `BoresightError` if the file is missing,
    damaged, of another format or in colour, or a value is not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in (*BITMAP_SUFFIXES, *FITS_SUFFIXES):
        raise BoresightError(f"{path}: not a format that is read: {', '.join((*BITMAP_SUFFIXES, *FITS_SUFFIXES))}")
    content = read_bytes(path)
    image = read_fits(content, path)[0] if suffix in FITS_SUFFIXES else _bitmap(content, path)
    if image.ndim != 2:
        raise BoresightError(f"{path}: a grey image has rows and columns alone, this one has shape {image.shape}")
    return finite_float32(image, path)


def read_bytes(path: Path) -> bytes:
    """Read a whole file; `BoresightError` if it is missing or cannot be read."""
    if not path.is_file():
        raise BoresightError(f"{path}: no such image")
    try:
        return path.read_bytes()
    except OSError as error:
        raise BoresightError(f"{path}: cannot be read: {error.strerror or error}") from error


def finite_float32(image: NDArray[np.generic], path: Path) -> NDArray[np.float32]:
    """Convert an image to float32; `BoresightError` if a pixel is not finite."""
    with np.errstate(over="ignore"):
        values = np.ascontiguousarray(image, dtype=np.float32)
    bad = ~np.isfinite(values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise BoresightError(f"{path}: {int(bad.sum())} pixels are not finite, the first in row {row}, column {column}")
    return values


def _bitmap(content: bytes, path: Path) -> NDArray[np.generic]:
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
