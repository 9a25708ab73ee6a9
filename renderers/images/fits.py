"""FITS files, as arrays and keywords."""

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

from scenarios.errors import BoresightError, one_line
from scenarios.limits import MOST_PIXELS

if TYPE_CHECKING:
    from astropy.io import fits

_COUNT = re.compile(rb"(Z?NAXIS[0-9]*|TFIELDS) *= *([0-9]+)")
_MOST_AXES, _LONGEST_AXIS = 999, 1 << 31
# What astropy raises for damaged headers and data beside its own.
_FAULTS = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError, OSError, RecursionError,
    RuntimeError, TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip


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
    """Refuse headers that promise too much: astropy counts axes and fields, and a packed image unfolds to any size."""
    packed = 1
    for card in _COUNT.finditer(content):
        name, value = card.group(1), int(card.group(2)[:30])
        packed = packed * max(value, 1) if name.startswith(b"Z") and name != b"ZNAXIS" else packed
        if value > (_MOST_AXES if name.endswith(b"S") else _LONGEST_AXIS) or packed > MOST_PIXELS:
            raise BoresightError(
                f"{path}: not a readable FITS file: {name.decode()} = {value} is more than an image has"
            )


def _keywords(header: fits.Header) -> dict[str, object]:
    """List the values of a header, of a keyword that is there twice the first.

    It is not asked for them by name, as astropy takes a damaged name that holds an asterisk for a pattern.
    """
    return dict(reversed(list(header.items())))


def _fits(content: bytes, path: Path) -> tuple[NDArray[np.generic], dict[str, object]]:
    """Read from memory, as astropy leaves a damaged file open."""
    # Imported here: astropy takes an eighth of the start-up, and most runs read no FITS file.
    from astropy.io import fits
    from astropy.io.fits.hdu.compressed._compression import CfitsioException  # has no base of its own

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
