"""One grey image file as an array."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from renderers.images.bitmap_size import bitmap_size, is_cut_short
from renderers.images.fits import read_fits
from scenarios.errors import BoresightError, one_line
from scenarios.limits import MOST_PIXELS

FITS_SUFFIXES = (".fits", ".fit", ".fts")
BITMAP_SUFFIXES = (".png", ".tif", ".tiff")


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
    if is_cut_short(content):  # OpenCV takes memory for as much as a chunk says that it holds
        raise BoresightError(f"{path}: not a readable {path.suffix[1:].upper()} image: it is cut short")
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
