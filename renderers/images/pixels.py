"""Readers of single grey image files: PNG, TIFF and FITS."""

from __future__ import annotations

import re
import struct
import warnings
import zlib
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.bitmap import read_bitmap
from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.reading import MOST_PIXELS, read_bytes

if TYPE_CHECKING:
    from astropy.io import fits

FITS_SUFFIXES = (".fits", ".fit", ".fts")
BITMAP_SUFFIXES = (".png", ".tif", ".tiff")

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


def read_image(path: Path) -> NDArray[np.float32]:
    """Read a grey PNG, TIFF (8 or 16 bit) or FITS image, (H, W), in the units and with the order of rows of the file.

    The colours of a bitmap must be equal, and a fourth channel constant. Raise `BoresightError` if the file is missing,
    damaged, of another format or in colour, or a value is not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in (*BITMAP_SUFFIXES, *FITS_SUFFIXES):
        raise BoresightError(f"{path}: not a format that is read: {', '.join((*BITMAP_SUFFIXES, *FITS_SUFFIXES))}")
    content = read_bytes(path)
    image = read_fits(content, path)[0] if suffix in FITS_SUFFIXES else read_bitmap(content, path)
    if image.ndim != 2:
        raise BoresightError(f"{path}: a grey image has rows and columns alone, this one has shape {image.shape}")
    return finite_float32(image, path)


def finite_float32(image: NDArray[np.generic], path: Path) -> NDArray[np.float32]:
    """Convert an image to float32; `BoresightError` if a pixel is not finite."""
    with np.errstate(over="ignore"):
        values = np.ascontiguousarray(image, dtype=np.float32)
    bad = ~np.isfinite(values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise BoresightError(f"{path}: {int(bad.sum())} pixels are not finite, the first in row {row}, column {column}")
    return values
