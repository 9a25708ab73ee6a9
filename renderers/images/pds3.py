"""PDS3 labels, attached or detached, and the images that they describe."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
import pvl
from numpy.typing import NDArray
from pvl.collections import Quantity
from pvl.decoder import OmniDecoder
from pvl.exceptions import LexerError, ParseError, QuantityError
from pvl.parser import OmniParser

from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.reading import MOST_PIXELS, read_bytes

LABEL_SUFFIXES = (".lbl",)
ATTACHED_SUFFIXES = (".img",)
_FIRST_WORDS = (b"PDS_VERSION_ID", b"CCSD3ZF", b"NJPL1I00")
_END = re.compile(rb"^[ \t]*END[ \t]*\r?$", re.MULTILINE)
_LONGEST_LABEL = 1 << 17  # ten times the longest label of NEAR and Hayabusa; pvl parses it in a few seconds
_MOST_MENDED = 100  # keywords without a value that are replaced before the label is refused
# SAMPLE_TYPE to NumPy's byte order and kind (PDS Standards Reference 3.8, appendix C).
_TYPES = {
    **dict.fromkeys(("UNSIGNED_INTEGER", "MSB_UNSIGNED_INTEGER", "MAC_UNSIGNED_INTEGER", "SUN_UNSIGNED_INTEGER"), ">u"),
    **dict.fromkeys(("LSB_UNSIGNED_INTEGER", "PC_UNSIGNED_INTEGER", "VAX_UNSIGNED_INTEGER"), "<u"),
    **dict.fromkeys(("INTEGER", "MSB_INTEGER", "MAC_INTEGER", "SUN_INTEGER"), ">i"),
    **dict.fromkeys(("LSB_INTEGER", "PC_INTEGER", "VAX_INTEGER"), "<i"),
    **dict.fromkeys(("IEEE_REAL", "REAL", "FLOAT", "MAC_REAL", "SUN_REAL"), ">f"),
    "PC_REAL": "<f",
}
# Keywords of stored numbers that stand for no brightness. A pixel of HIGH_..._SATURATION is bright, and stays.
MARKS = (
    "MISSING_CONSTANT", "INVALID_CONSTANT", "ERROR_CONSTANT", "UNKNOWN_CONSTANT", "NOT_APPLICABLE_CONSTANT",
    "SATURATED_CONSTANT", "LOW_INSTRUMENT_SATURATION", "LOW_REPRESENTATION_SATURATION",
)  # fmt: skip
_LARGEST = 1e39  # above single precision's largest number, 3.4e38: MISSING_CONSTANT is often the lowest number, -3.4e38
_BITS = {"u": (8, 16, 32), "i": (8, 16, 32), "f": (32, 64)}

# Exceptions of pvl's parser: its own, TypeError for a date that it reads as one with a time zone (2005-10-0), and those
# of numbers, dates and nesting beyond Python's bounds.
_PARSER_FAULTS = (
    LexerError, ParseError, QuantityError, ArithmeticError, AttributeError, LookupError, RecursionError, RuntimeError,
    StopIteration, TypeError, ValueError,
)  # fmt: skip


class Pattern(int):
    """A number of a label that gives its bits, as 16#FF7FFFFB#."""


class _LabelDecoder(OmniDecoder):  # type: ignore[misc]
    """Decoder that tells numbers with a base from others."""

    def decode_non_decimal(self, value: str) -> Pattern:
        """Return the number of, for example, ``16#FF7FFFFB#``."""
        return Pattern(super().decode_non_decimal(value))


class _LabelParser(OmniParser):  # type: ignore[misc]
    """Parser that limits the number of replaced missing values: pvl never ends on ``A = 1 = 2`` in an object."""

    def __init__(self, decoder: OmniDecoder) -> None:
        super().__init__(decoder=decoder)
        self._mended = 0

    def parse_module_post_hook(self, module: object, tokens: object) -> object:
        """Replace the value of the last keyword by an empty one, and continue after it."""
        self._mended += 1
        if self._mended > _MOST_MENDED:
            raise ValueError("a keyword has no value, or two")
        return super().parse_module_post_hook(module, tokens)


@dataclass(frozen=True, slots=True)
class Label:
    """Keywords of a label and its file; numbers with a decimal point are `Decimal`."""

    path: Path
    values: Mapping[str, object]

    def fault(self, what: str) -> BoresightError:
        """Return an error that names this label's file."""
        return BoresightError(f"{self.path}: {what}")

    def part(self, name: str) -> Mapping[str, object]:
        """Return the object or group of a name; empty if it is missing."""
        found = self.values.get(name)
        return found if isinstance(found, Mapping) else {}


@dataclass(frozen=True, slots=True)
class _Layout:
    """Storage of an image in a file: byte offset, sample type, lines and samples, bytes before and after each line."""

    path: Path
    offset: int
    dtype: np.dtype[np.generic]
    lines: int
    samples: int
    prefix: int
    suffix: int


def has_label(content: bytes) -> bool:
    """Return whether a file starts with a PDS3 label."""
    return content.startswith(_FIRST_WORDS)


def parse_label(content: bytes, path: Path) -> Label:
    """Parse the label that a file starts with; `BoresightError` if there is none, or it cannot be parsed."""
    if not has_label(content):
        raise BoresightError(f"{path}: does not start with a PDS3 label (PDS_VERSION_ID = PDS3)")
    end = _END.search(content, 0, _LONGEST_LABEL)
    if end is None:
        raise BoresightError(f"{path}: the label has no line END within its first {_LONGEST_LABEL >> 10} KiB")
    text = content[: end.end()].decode("latin-1")
    try:
        values = pvl.loads(text, parser=_LabelParser(decoder=_LabelDecoder(real_cls=Decimal)))
    except _PARSER_FAULTS as error:
        reason = one_line(error)[:200] or type(error).__name__
        raise BoresightError(f"{path}: not a readable PDS3 label: {reason}") from error
    # The keywords of an OBJECT = FILE go to the top level, where other labels have them.
    flat = dict(values)
    inner = flat.pop("FILE", None)
    return Label(path, {**flat, **dict(inner)} if isinstance(inner, Mapping) else flat)


def pixel_file(label: Label) -> Path:
    """Return the file with the pixels: the label's own where ^IMAGE names none.

    Case is ignored, as labels often give file names in capitals. Raise `BoresightError` if the label points to no image
    or the file is missing.
    """
    name = next((item for item in _pointer(label) if isinstance(item, str)), None)
    if name is None:
        return label.path
    folder = label.path.parent
    found = [path for path in folder.iterdir() if path.name.casefold() == name.casefold()]
    if not found:
        raise label.fault(f"the file of its image: {name} is not in {folder}")
    return found[0]


def read_pixels(label: Label) -> NDArray[np.float32]:
    """Read the image that a label describes, (lines, samples), in the order of the file, scaled as the label states.

    Raise `BoresightError` if the layout is not supported, the file is too short, or pixels are marked as missing.
    """
    layout, image = _layout(label), label.part("IMAGE")
    stride = layout.prefix + layout.samples * layout.dtype.itemsize + layout.suffix
    content = read_bytes(layout.path)[layout.offset : layout.offset + layout.lines * stride]
    if len(content) < layout.lines * stride:
        raise BoresightError(
            f"{layout.path}: too short: {layout.lines} lines of {stride} bytes from byte {layout.offset} end beyond it"
        )
    rows = np.frombuffer(content, dtype=np.uint8).reshape(layout.lines, stride)
    # Lines are cut out as bytes, as prefix and suffix need not be whole samples.
    samples = rows[:, layout.prefix : stride - layout.suffix if layout.suffix else stride]
    stored = np.ascontiguousarray(samples).view(layout.dtype)
    # The constant is one of the stored numbers, before scaling.
    for name in MARKS:
        mark = _mark(label, image, name, layout.dtype)
        if mark is not None and (gaps := int((stored == mark).sum())):
            raise label.fault(f"{gaps} pixels are marked as missing ({name} = {mark:g})")
    scale, offset = _number(label, image, "SCALING_FACTOR", 1.0), _number(label, image, "OFFSET", 0.0)
    # Results beyond single precision become infinite; the caller refuses them.
    with np.errstate(over="ignore", invalid="ignore"):
        return (stored.astype(np.float64) * (scale or 1.0) + (offset or 0.0)).astype(np.float32)


def _mark(label: Label, image: Mapping[str, object], name: str, dtype: np.dtype[np.generic]) -> float | None:
    """Return a number that stands for no brightness, as it is stored; None if there is none."""
    value = image.get(name)
    if not isinstance(value, Pattern):
        return _number(label, image, name, None)
    if not 0 <= value < 1 << 8 * dtype.itemsize:
        raise label.fault(f"{name}: {value:#x} is no pattern of {8 * dtype.itemsize} bits")
    return float(np.array(value, f"u{dtype.itemsize}").view(dtype.newbyteorder("=")))


def _pointer(label: Label) -> tuple[object, ...]:
    value = label.values.get("^IMAGE")
    if value is None:
        raise label.fault("^IMAGE: missing: the label points to no image")
    return tuple(value) if isinstance(value, (list, tuple)) and not isinstance(value, Quantity) else (value,)


def _layout(label: Label) -> _Layout:
    image = label.part("IMAGE")
    if not image:
        raise label.fault("OBJECT = IMAGE: missing")
    bands = _whole(label, image, "BANDS", 1)
    if bands != 1:
        raise label.fault(f"BANDS: {bands} is not 1: only grey images are read")
    lines, samples = (_whole(label, image, key, None) for key in ("LINES", "LINE_SAMPLES"))
    if not 0 < lines * samples <= MOST_PIXELS:
        raise label.fault(f"LINES, LINE_SAMPLES: {lines} x {samples} pixels are none, or more than {MOST_PIXELS}")
    return _Layout(
        pixel_file(label),
        _offset(label),
        _dtype(label, image),
        lines,
        samples,
        _whole(label, image, "LINE_PREFIX_BYTES", 0),
        _whole(label, image, "LINE_SUFFIX_BYTES", 0),
    )


def _offset(label: Label) -> int:
    """Bytes before the image: positions in a pointer count from 1, in records unless the unit is BYTES."""
    places = [item for item in _pointer(label) if not isinstance(item, str)]
    place = places[0] if places else 1
    if isinstance(place, Quantity):
        unit, number = str(place.units).upper(), place.value
        size = 1 if unit in ("BYTE", "BYTES") else 0
    else:
        unit, number = "records", place
        # The first record starts at byte 0 for any length, which may then be missing.
        size = _whole(label, label.values, "RECORD_BYTES", None) if place != 1 else 1
    if not isinstance(number, int) or number < 1 or size < 1:
        raise label.fault(f"^IMAGE: {number} {unit} is no place in a file")
    return (number - 1) * size


def _dtype(label: Label, image: Mapping[str, object]) -> np.dtype[np.generic]:
    name, bits = str(image.get("SAMPLE_TYPE", "")).upper(), _whole(label, image, "SAMPLE_BITS", None)
    kind = _TYPES.get(name)
    if kind is None:
        raise label.fault(f"SAMPLE_TYPE: {name or 'missing'} is not read; these are: {', '.join(sorted(_TYPES))}")
    if bits not in _BITS[kind[1]]:
        raise label.fault(f"SAMPLE_BITS: {bits} with SAMPLE_TYPE {name} is not read")
    return np.dtype(f"{kind}{bits // 8}")


def _whole(label: Label, values: Mapping[str, object], key: str, default: int | None) -> int:
    value = values.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise label.fault(f"{key}: {'missing' if value is None else value!r} is not a whole number of at least 0")
    return value


def _number(label: Label, values: Mapping[str, object], key: str, default: float | None) -> float | None:
    value = values.get(key, default)
    if value is None or (isinstance(value, str) and value.upper() in ("N/A", "UNK", "NULL")):
        return default
    found = number(value)
    if isinstance(value, Pattern) or not abs(found) <= _LARGEST:
        raise label.fault(f"{key}: {value!r} is not a finite number of any use")
    return found


def number(value: object) -> float:
    """Convert a value of a label or header to float; NaN if it is no number or overflows."""
    if isinstance(value, bool) or not isinstance(value, (int, float, Decimal)):
        return float("nan")
    try:
        return float(value)
    except (OverflowError, ValueError):  # a whole number of too many digits; a signalling NaN
        return float("nan")
