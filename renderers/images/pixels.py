"""One grey image file as an array."""

from __future__ import annotations

import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from astropy.io import fits
from astropy.io.fits.hdu.compressed._compression import CfitsioException
from numpy.typing import NDArray

from renderers.images.bitmap_size import bitmap_size
from scenarios.errors import BoresightError, one_line
from scenarios.limits import MOST_PIXELS

FITS_SUFFIXES = (".fits", ".fit", ".fts")
BITMAP_SUFFIXES = (".png", ".tif", ".tiff")
_AXIS = re.compile(rb"(Z?NAXIS[0-9]*) *= *([0-9]+)")
_MOST_AXES, _LONGEST_AXIS = 999, 1 << 31
# What astropy raises for damaged headers and data beside its own; cfitsio's exception, of packed images, has no base.
_FITS_FAULTS = (
    fits.VerifyError, CfitsioException, ArithmeticError, AssertionError, AttributeError, EOFError, LookupError,
    MemoryError, OSError, RecursionError, RuntimeError, TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip


def read_image(path: Path) -> NDArray[np.float32]:
    """Read a grey PNG, TIFF (8 or 16 bit) or FITS image.

    Returns
    -------
    ndarray
        (H, W) float32 in the units of the file, rows in the order of the file.

    Raises
    ------
    BoresightError
        If the file is missing, damaged, of another format, in colour, or holds values that are not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in (*BITMAP_SUFFIXES, *FITS_SUFFIXES):
        raise BoresightError(f"{path}: not a format that is read: {', '.join((*BITMAP_SUFFIXES, *FITS_SUFFIXES))}")
    content = read_bytes(path)
    image = read_fits(content, path) if suffix in FITS_SUFFIXES else _bitmap(content, path)
    if image.ndim != 2:
        raise BoresightError(f"{path}: a grey image has rows and columns alone, this one has shape {image.shape}")
    return finite_float32(image, path)


def read_bytes(path: Path) -> bytes:
    """Read a file whole.

    Raises
    ------
    BoresightError
        If it is missing or cannot be read.
    """
    if not path.is_file():
        raise BoresightError(f"{path}: no such image")
    try:
        return path.read_bytes()
    except OSError as error:
        raise BoresightError(f"{path}: cannot be read: {error.strerror or error}") from error


def finite_float32(image: NDArray[np.generic], path: Path) -> NDArray[np.float32]:
    """Return an image as float32.

    Raises
    ------
    BoresightError
        If a pixel is not finite.
    """
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
    try:
        with _quiet():
            image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BoresightError(f"{path}: cannot be read: {one_line(error)}") from error
    if image is None:
        raise BoresightError(f"{path}: not a readable {path.suffix[1:].upper()} image")
    return np.asarray(image)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep OpenCV from printing beside the one line that is said here."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


def read_fits(content: bytes, path: Path) -> NDArray[np.generic]:
    """Read the first image of a FITS file, (H, W), scaled as its header says.

    Raises
    ------
    BoresightError
        If the file is damaged or holds no image of two dimensions.
    """
    return _fits(content, path)[0]


def read_fits_header(content: bytes, path: Path) -> dict[str, object]:
    """Read the keywords of a FITS file: those of the primary header, overridden by those of the first image.

    Raises
    ------
    BoresightError
        As ``read_fits``.
    """
    return _fits(content, path)[1]


def _check_axes(content: bytes, path: Path) -> None:
    """Refuse headers that promise too much: astropy counts all axes, and a compressed image unfolds to any size."""
    packed = 1
    for card in _AXIS.finditer(content):
        name, value = card.group(1), int(card.group(2)[:30])
        packed = packed * max(value, 1) if name.startswith(b"Z") and name != b"ZNAXIS" else packed
        if value > (_MOST_AXES if name.endswith(b"S") else _LONGEST_AXIS) or packed > MOST_PIXELS:
            raise BoresightError(
                f"{path}: not a readable FITS file: {name.decode()} = {value} is more than an image has"
            )


def _fits(content: bytes, path: Path) -> tuple[NDArray[np.generic], dict[str, object]]:
    """Read from memory, as astropy leaves a damaged file open."""
    _check_axes(content, path)
    try:
        with warnings.catch_warnings(action="ignore"), fits.open(BytesIO(content)) as units:
            unit = next((unit for unit in units if unit.is_image and unit.data is not None), None)
            header = {} if unit is None else {**dict(units[0].header), **dict(unit.header)}
            image = None if unit is None else unit.data
    except _FITS_FAULTS as error:
        raise BoresightError(f"{path}: not a readable FITS file: {one_line(error) or type(error).__name__}") from error
    if image is None:
        raise BoresightError(f"{path}: holds no image")
    if np.ndim(image) != 2:
        raise BoresightError(f"{path}: a grey image has rows and columns alone, this one has shape {np.shape(image)}")
    return np.asarray(image), header
