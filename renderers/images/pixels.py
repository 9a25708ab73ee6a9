"""One grey image file as an array."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from scenarios.errors import BoresightError

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
    try:
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BoresightError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    if image is None:
        raise BoresightError(f"{path}: not a readable {path.suffix[1:].upper()} image")
    return np.asarray(image)


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


def _fits(content: bytes, path: Path) -> tuple[NDArray[np.generic], dict[str, object]]:
    """Read from memory, as astropy leaves a damaged file open."""
    try:
        with warnings.catch_warnings(action="ignore"), fits.open(BytesIO(content)) as units:
            unit = next((unit for unit in units if unit.is_image and unit.data is not None), None)
            header = {} if unit is None else {**dict(units[0].header), **dict(unit.header)}
            image = None if unit is None else unit.data
    except (OSError, TypeError, ValueError, IndexError, KeyError, fits.VerifyError) as error:
        raise BoresightError(f"{path}: not a readable FITS file: {' '.join(str(error).split())}") from error
    if image is None:
        raise BoresightError(f"{path}: holds no image")
    if np.ndim(image) != 2:
        raise BoresightError(f"{path}: a grey image has rows and columns alone, this one has shape {np.shape(image)}")
    return np.asarray(image), header
