"""PDS4 labels (XML) of images: their first Array_2D_Image, in the keywords of PDS3."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

from pvl.collections import Quantity

from boresight.renderers.images.pds3 import MARKS, Label, Pattern
from boresight.scenarios.errors import BoresightError, one_line

PDS4_SUFFIXES = (".xml",)
_LONGEST_LABEL = 1 << 24
_MOST_DIGITS = 15
# Data types of PDS4 (Standards Reference 1.22, chapter 5) to SAMPLE_TYPE and SAMPLE_BITS.
_TYPES = MappingProxyType(
    {
        "UnsignedByte": ("UNSIGNED_INTEGER", 8),
        "SignedByte": ("INTEGER", 8),
        **{f"Unsigned{order}{n}": (f"{order}_UNSIGNED_INTEGER", 8 * n) for order in ("LSB", "MSB") for n in (2, 4)},
        **{f"Signed{order}{n}": (f"{order}_INTEGER", 8 * n) for order in ("LSB", "MSB") for n in (2, 4)},
        **{f"IEEE754{order}Single": (name, 32) for order, name in (("LSB", "PC_REAL"), ("MSB", "IEEE_REAL"))},
        **{f"IEEE754{order}Double": (name, 64) for order, name in (("LSB", "PC_REAL"), ("MSB", "IEEE_REAL"))},
    }
)
_ACROSS = "Left to Right"
_DISPLAYS = {"Bottom to Top": "UP", "Top to Bottom": "DOWN"}
_Element = ElementTree.Element


def parse_pds4_label(content: bytes, path: Path) -> Label:
    """Parse a PDS4 label; the keywords are those that a PDS3 label of the same image would have.

    Raise `BoresightError` if it is no PDS4 label, or describes no image of lines and samples.
    """
    if len(content) > _LONGEST_LABEL:
        raise BoresightError(f"{path}: larger than any PDS4 label, {_LONGEST_LABEL >> 20} MiB")
    try:
        root = ElementTree.fromstring(content)  # noqa: S314  expat bounds the expansion of entities, and reads no file
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise BoresightError(f"{path}: not a readable PDS4 label: {one_line(error)}") from error
    if not _name(root).startswith("Product_"):
        raise BoresightError(f"{path}: not a PDS4 label: its root is {_name(root)[:40]!r}, not Product_Observational")
    area = next(
        (one for one in _every(root, "File_Area_Observational") if _first(one, "Array_2D_Image") is not None), None
    )
    image = None if area is None else _first(area, "Array_2D_Image")
    if area is None or image is None:
        raise BoresightError(f"{path}: has no Array_2D_Image: only images of lines and samples are read")
    file_name, offset = _text(area, "file_name"), _whole(path, "offset", _text(image, "offset"))
    unit = next((one.get("unit", "missing") for one in _every(image, "offset")), "missing")
    if unit != "byte":
        raise BoresightError(f"{path}: offset: its unit is {unit[:40]}, not byte")
    if file_name is None:
        raise BoresightError(f"{path}: file_name: missing: the label points to no image")
    own, displays = _text(image, "local_identifier"), _every(root, "Display_Settings")
    display = next((one for one in displays if _text(one, "local_identifier_reference") == own), root)
    across = _text(display, "horizontal_display_direction") or _ACROSS
    if across != _ACROSS:
        raise BoresightError(f"{path}: horizontal_display_direction: {across[:40]!r} is not read: only {_ACROSS}")
    keywords = {
        "^IMAGE": (file_name, Quantity(offset + 1, "BYTES")),
        "IMAGE": _image(path, image, _text(display, "vertical_display_direction")),
        "START_TIME": _text(root, "start_date_time"),
        "TARGET_NAME": _text(_first(root, "Target_Identification"), "name"),
        "FILTER_NAME": _text(root, "filter_name"),
        "EXPOSURE_DURATION": _exposure(_first(root, "exposure_duration")),
    }
    components = {"Spacecraft": "INSTRUMENT_HOST_NAME", "Host": "INSTRUMENT_HOST_NAME", "Instrument": "INSTRUMENT_ID"}
    for component in _every(root, "Observing_System_Component"):
        keyword = components.get(_text(component, "type") or "")
        if keyword is not None:
            keywords.setdefault(keyword, _text(component, "name"))
    return Label(path, {name: value for name, value in keywords.items() if value is not None})


def _image(path: Path, image: _Element, display: str | None) -> dict[str, object]:
    """Return the keywords of the object IMAGE."""
    kind = _text(image, "data_type") or "missing"
    if kind not in _TYPES:
        raise BoresightError(f"{path}: data_type: {kind[:40]} is not read; these are: {', '.join(_TYPES)}")
    if (order := _text(image, "axis_index_order")) != "Last Index Fastest":
        raise BoresightError(f"{path}: axis_index_order: {order!r} is not Last Index Fastest")
    axes = {_text(one, "sequence_number"): one for one in _every(image, "Axis_Array")}
    names = [_text(axes.get(number), "axis_name") or "missing" for number in ("1", "2")]
    if len(axes) != 2 or [name.casefold() for name in names] != ["line", "sample"]:
        raise BoresightError(
            f"{path}: Axis_Array: of {len(axes)} axes, sequence_number 1 is {names[0][:40]} and 2 is {names[1][:40]}:"
            " only images that are stored line by line (1 Line, 2 Sample) are read"
        )
    numbers = {"SCALING_FACTOR": "scaling_factor", "OFFSET": "value_offset"}
    found: dict[str, object] = {
        "LINES": _whole(path, "elements", _text(axes["1"], "elements")),
        "LINE_SAMPLES": _whole(path, "elements", _text(axes["2"], "elements")),
        "UNIT": _text(_first(image, "Element_Array"), "unit"),
        "LINE_DISPLAY_DIRECTION": _DISPLAYS.get(display or ""),
        **dict(zip(("SAMPLE_TYPE", "SAMPLE_BITS"), _TYPES[kind], strict=True)),
        **{keyword: _number(path, name, _text(image, name)) for keyword, name in numbers.items()},
        **{name: _mark(path, name.lower(), _text(image, name.lower())) for name in MARKS},
    }
    return {name: value for name, value in found.items() if value is not None}


def _name(element: _Element) -> str:
    """Return the name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _every(element: _Element | None, name: str) -> Iterator[_Element]:
    return (one for one in (() if element is None else element.iter()) if _name(one) == name)


def _first(element: _Element | None, name: str) -> _Element | None:
    return next(_every(element, name), None)


def _text(element: _Element | None, name: str) -> str | None:
    """Return the text of the first element of a name below another; None if there is none or it is empty."""
    found = _first(element, name)
    return " ".join((found.text or "").split()) or None if found is not None else None


def _whole(path: Path, name: str, text: str | None) -> int:
    if text is None or not re.fullmatch(rf"[0-9]{{1,{_MOST_DIGITS}}}", text):
        raise BoresightError(f"{path}: {name}: {(text or 'missing')[:40]!r} is not a whole number of at least 0")
    return int(text)


def _number(path: Path, name: str, text: str | None) -> float | None:
    if text is None:
        return None
    try:
        return float(text)
    except ValueError:
        raise BoresightError(f"{path}: {name}: {text[:40]!r} is not a number") from None


def _mark(path: Path, name: str, text: str | None) -> float | None:
    """Return a number that stands for no brightness, or its bits."""
    bits = re.fullmatch(r"16#([0-9A-Fa-f]{1,16})#", text or "")
    return Pattern(bits[1], 16) if bits else _number(path, name, text)


def _exposure(element: _Element | None) -> Quantity | str | None:
    """Return an exposure time with its unit; its text if it is no number, which the caller refuses."""
    text = None if element is None else (element.text or "").strip()
    if element is None or not text:
        return None
    try:
        return Quantity(float(text), element.get("unit", "s"))
    except ValueError:
        return text
