"""What a mission tells about an image beside its pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import Literal

from pvl.collections import Quantity

from scenarios.errors import BoresightError
from scenarios.limits import LARGEST_NUMBER

_UNKNOWN = ("", "N/A", "NA", "UNK", "UNKNOWN", "NULL")
_SECONDS = {"S": 1.0, "SECOND": 1.0, "SECONDS": 1.0, "SEC": 1.0, "MS": 1e-3, "MILLISECOND": 1e-3, "MILLISECONDS": 1e-3}
# PDS3 keywords first, then those of FITS, in the order in which they are believed.
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
    """What label and header say; None where they are silent.

    Parameters
    ----------
    start_utc
        Start of the exposure, UTC, ISO 8601 without zone.
    exposure_s
        Length of the exposure.
    spacecraft, instrument, filter, target
        As the mission names them.
    unit
        Of the pixels: ``I/F``, ``DN``, ...
    line_display
        Which way the stored lines run on a display (LINE_DISPLAY_DIRECTION). It says how the mission likes to look at
        the image, which may be as in a mirror; where the lines run in the camera is the instrument's own.
    """

    start_utc: str | None = None
    exposure_s: float | None = None
    spacecraft: str | None = None
    instrument: str | None = None
    filter: str | None = None
    target: str | None = None
    unit: str | None = None
    line_display: Literal["up", "down"] | None = None


def metadata_of(values: Mapping[str, object], path: Path, exposure_unit_s: float = 1.0) -> ImageMetadata:
    """Find the metadata in the keywords of label and header.

    Parameters
    ----------
    values
        Keywords and values; a label's objects as mappings.
    path
        The file, for errors.
    exposure_unit_s
        Seconds in the unit of an exposure that is given without one.

    Raises
    ------
    BoresightError
        If a time or an exposure is not what it should be.
    """
    flat = {**_inside(values, "IMAGE"), **values}
    words = {name: _text(flat, keywords) for name, keywords in _KEYWORDS.items()}
    display = _text(flat, ("LINE_DISPLAY_DIRECTION",))
    return ImageMetadata(
        start_utc=_start(flat, path),
        exposure_s=_exposure_s(flat, path, exposure_unit_s),
        line_display={"UP": "up", "DOWN": "down"}.get((display or "").upper()),  # type: ignore[arg-type]
        **words,
    )


def _inside(values: Mapping[str, object], name: str) -> Mapping[str, object]:
    found = values.get(name)
    return found if isinstance(found, Mapping) else {}


def _first(values: Mapping[str, object], keywords: tuple[str, ...]) -> object:
    """Return the first keyword that holds something."""
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


def number(value: object) -> float:
    """Return a number of a label or header; NaN where it is none, or beyond any that is used."""
    if isinstance(value, bool) or not isinstance(value, (int, float, Decimal)):
        return float("nan")
    try:
        return float(value)
    except (OverflowError, ValueError):  # a whole number of too many digits; a signalling NaN
        return float("nan")
