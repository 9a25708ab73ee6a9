"""Published mission images and their metadata: FITS files, PDS3 and PDS4 images, with attached or detached labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pvl.collections import Quantity

from boresight.renderers.images.pds3 import (
    ATTACHED_SUFFIXES,
    LABEL_SUFFIXES,
    Label,
    has_label,
    number,
    parse_label,
    pixel_file,
)
from boresight.renderers.images.pds3 import read_pixels as read_pds3_pixels
from boresight.renderers.images.pds4 import PDS4_SUFFIXES, parse_pds4_label
from boresight.renderers.images.pixels import FITS_SUFFIXES, finite_float32, read_fits, read_image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import LARGEST_NUMBER, read_bytes

_UNKNOWN = ("", "N/A", "NA", "UNK", "UNKNOWN", "NULL")
_SECONDS = {"S": 1.0, "SECOND": 1.0, "SECONDS": 1.0, "SEC": 1.0, "MS": 1e-3, "MILLISECOND": 1e-3, "MILLISECONDS": 1e-3}
# Keywords in order of precedence: those of PDS3, then those of FITS.
_KEYWORDS = {
    "spacecraft": ("INSTRUMENT_HOST_NAME", "SPACECRAFT_NAME", "INSTRUMENT_HOST_ID", "TELESCOP"),
    "instrument": ("INSTRUMENT_ID", "INSTRUME", "INSTRUMENT_NAME"),
    "filter": ("FILTER_NAME", "FILTER_NUMBER", "FILTER"),
    "target": ("TARGET_NAME", "OBJECT"),
    "unit": ("UNIT", "BUNIT"),
}
_START = ("START_TIME", "DATE-OBS")
_EXPOSURE = ("EXPOSURE_DURATION", "EXPTIME", "EXPOSURE")


@dataclass(frozen=True, slots=True)
class ImageMetadata:
    """Metadata from label and FITS header; None where neither gives it.

    ``start_utc`` is the start of the exposure in UTC, ISO 8601 without zone. Names are as the mission writes them;
    ``unit`` is that of the pixels: ``I/F``, ``DN``, ... ``line_display`` is the direction of the stored lines on a
    display (LINE_DISPLAY_DIRECTION). It may show the image mirrored: the direction of the lines in the camera is a
    property of the instrument.
    """

    start_utc: str | None = None
    exposure_s: float | None = None
    spacecraft: str | None = None
    instrument: str | None = None
    filter: str | None = None
    target: str | None = None
    unit: str | None = None
    line_display: Literal["up", "down"] | None = None


def parse_metadata(values: Mapping[str, object], path: Path, exposure_unit_s: float = 1.0) -> ImageMetadata:
    """Extract the metadata from the keywords of label and header; objects of a label are mappings.

    ``path`` is for error messages, ``exposure_unit_s`` the unit of an exposure time without one, in seconds. Raise
    `BoresightError` if a time or an exposure time is invalid.
    """
    # Keywords of the file go before those of the object IMAGE.
    image = values.get("IMAGE")
    flat = {**(image if isinstance(image, Mapping) else {}), **values}
    words = {name: _text(flat, keywords) for name, keywords in _KEYWORDS.items()}
    display = _text(flat, ("LINE_DISPLAY_DIRECTION",))
    return ImageMetadata(
        start_utc=_start(flat, path),
        exposure_s=_exposure_s(flat, path, exposure_unit_s),
        line_display={"UP": "up", "DOWN": "down"}.get((display or "").upper()),  # type: ignore[arg-type]
        **words,
    )


def _first(values: Mapping[str, object], keywords: tuple[str, ...]) -> object:
    """Return the value of the first keyword that has a known one, else None."""
    found = (values.get(keyword) for keyword in keywords)
    return next((value for value in found if value is not None and str(value).strip().upper() not in _UNKNOWN), None)


def _text(values: Mapping[str, object], keywords: tuple[str, ...]) -> str | None:
    value = _first(values, keywords)
    return None if value is None or isinstance(value, Mapping) else " ".join(str(value).split())


def _start(values: Mapping[str, object], path: Path) -> str | None:
    value = _first(values, _START)
    if value is None:
        return None
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value.strip())
        except ValueError as error:
            raise BoresightError(f"{path}: {value!r} is not a time such as 2005-10-01T12:34:56.789") from error
    if not isinstance(value, datetime):
        raise BoresightError(f"{path}: the start of the exposure is {value}, which has no time of the day")
    try:
        # Times without a zone are UTC in both formats.
        utc = value if value.tzinfo is None else value.astimezone(UTC)
    except OverflowError as error:
        raise BoresightError(f"{path}: the start of the exposure is {value}, before or after all years") from error
    return utc.replace(tzinfo=None).isoformat()


def _exposure_s(values: Mapping[str, object], path: Path, unit_s: float) -> float | None:
    value = _first(values, _EXPOSURE)
    if value is None:
        return None
    if isinstance(value, Quantity):
        unit = str(value.units).strip().upper()
        if unit not in _SECONDS:
            raise BoresightError(f"{path}: exposure: {value.units} is not a unit of time that is read")
        value, unit_s = value.value, _SECONDS[unit]
    exposure = number(value)
    if not 0.0 <= exposure <= LARGEST_NUMBER:
        raise BoresightError(f"{path}: exposure: {value!r} is not a number of at least 0")
    return exposure * unit_s


@dataclass(frozen=True, slots=True, eq=False)
class ImageProduct:
    """A published image; its pixels are read on demand from ``path``.

    ``label`` is the PDS3 or PDS4 label, None for a FITS file without one. ``keywords`` are those of the FITS header,
    overridden by those of the label; ``files`` is every file of the product.
    """

    path: Path
    label: Label | None
    keywords: Mapping[str, object]
    files: tuple[Path, ...]

    def metadata(self, exposure_unit_s: float = 1.0) -> ImageMetadata:
        """Return the metadata; exposure times without a unit are in units of ``exposure_unit_s``."""
        return parse_metadata(self.keywords, self.path, exposure_unit_s)

    @property
    def size_px(self) -> tuple[int, int]:
        """Samples and lines stated by label or header; 0 where neither states them."""
        image = self.label.part("IMAGE") if self.label is not None else {}
        sizes = [
            image.get("LINE_SAMPLES", self.keywords.get("NAXIS1")),
            image.get("LINES", self.keywords.get("NAXIS2")),
        ]
        samples, lines = (size if isinstance(size, int) else 0 for size in sizes)
        return samples, lines

    def pixels(self) -> NDArray[np.float32]:
        """Read the pixels, (lines, samples), in the order of the file, with its scaling applied.

        Raise `BoresightError` if they cannot be read, or are not finite.
        """
        if self.path.suffix.lower() in FITS_SUFFIXES:
            return finite_float32(read_fits(read_bytes(self.path), self.path)[0], self.path)
        if self.label is None:
            raise BoresightError(f"{self.path}: no label says how the pixels are stored")
        return finite_float32(read_pds3_pixels(self.label), self.path)


def open_product(path: Path) -> ImageProduct:
    """Open a label, a FITS file or an image of the PDS, with a detached label of the same name if there is one.

    Raise `BoresightError` if a file is missing, damaged, or of another format.
    """
    suffix = path.suffix.lower()
    suffixes = (*FITS_SUFFIXES, *LABEL_SUFFIXES, *ATTACHED_SUFFIXES, *PDS4_SUFFIXES)
    if suffix not in suffixes:
        known = ", ".join(suffixes)
        raise BoresightError(f"{path}: not a format of missions that is read: {known}")
    label = _label(path)
    image = path if label is None or suffix in FITS_SUFFIXES else pixel_file(label)
    is_fits = image.suffix.lower() in FITS_SUFFIXES
    header = read_fits(read_bytes(image), image)[1] if is_fits else {}
    files = dict.fromkeys([image, *([] if label is None else [label.path])])
    return ImageProduct(image, label, {**header, **({} if label is None else label.values)}, tuple(files))


def read_any_image(path: Path) -> NDArray[np.float32]:
    """Read an image of the PDS by its label, or one of `read_image`; (H, W), in the order of rows of the file.

    Raise `BoresightError` if a file is missing, damaged, or of another format.
    """
    return open_product(path).pixels() if _is_of_the_pds(path) else read_image(path)


def image_files(path: Path) -> tuple[Path, ...]:
    """Return the files of an image: its own, or image and label."""
    return open_product(path).files if _is_of_the_pds(path) else (path,)


def _is_of_the_pds(path: Path) -> bool:
    return path.suffix.lower() in (*LABEL_SUFFIXES, *ATTACHED_SUFFIXES, *PDS4_SUFFIXES)


def _label(path: Path) -> Label | None:
    """Parse the attached or detached label of a file; only a FITS file may have none."""
    content = read_bytes(path)
    if path.suffix.lower() in PDS4_SUFFIXES:
        return parse_pds4_label(content, path)
    if has_label(content) or path.suffix.lower() in LABEL_SUFFIXES:
        return parse_label(content, path)
    detached = [other for other in sorted(path.parent.glob(f"{path.stem}.*")) if other.suffix.lower() in LABEL_SUFFIXES]
    if detached:
        return parse_label(read_bytes(detached[0]), detached[0])
    if path.suffix.lower() in FITS_SUFFIXES:
        return None
    if (pds4 := path.with_suffix(".xml")).is_file():
        return parse_pds4_label(read_bytes(pds4), pds4)
    raise BoresightError(f"{path}: has no label of the PDS, neither in it nor beside it ({path.stem}.lbl, .xml)")
