"""Values with their locations, read from YAML 1.2 (core schema): no code, no tags, no duplicate keys, bounded size."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml
from yaml.error import MarkedYAMLError, YAMLError
from yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
    StreamEndEvent,
)

from boresight.scenarios.errors import BoresightError, one_line, printable

Scalar = str | int | float | bool | None
_LARGEST_EXACT = 2**53  # beyond, not every whole number is a float


@dataclass(frozen=True, slots=True)
class ConfigEntry:
    """A value with the location of its key or list item: ``scenarios/x.yaml:12`` or ``--set camera.fov_deg=20``."""

    value: Scalar | Mapping[str, ConfigEntry] | tuple[ConfigEntry, ...]
    place: str

    @property
    def section(self) -> Mapping[str, ConfigEntry] | None:
        """The keys of a mapping; None for anything else."""
        return self.value if isinstance(self.value, Mapping) else None

    def plain(self) -> object:
        """Return the value without locations: dicts, lists and scalars; whole floats (3.1e6) become integers."""
        if isinstance(self.value, Mapping):
            return {key: entry.plain() for key, entry in self.value.items()}
        if isinstance(self.value, tuple):
            return [entry.plain() for entry in self.value]
        if isinstance(self.value, float) and self.value.is_integer() and abs(self.value) <= _LARGEST_EXACT:
            return int(self.value)
        return self.value


def entry_of(value: object, place: str) -> ConfigEntry:
    """Convert a plain structure to entries with one common location."""
    if isinstance(value, Mapping):
        return ConfigEntry({str(key): entry_of(item, place) for key, item in value.items()}, place)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ConfigEntry(tuple(entry_of(item, place) for item in value), place)
    return ConfigEntry(value if isinstance(value, str | int | float) else None, place)


def nested(keys: Iterable[str], entry: ConfigEntry) -> ConfigEntry:
    """Wrap an entry in sections: keys a, b make ``{a: {b: entry}}``."""
    for key in reversed(list(keys)):
        entry = ConfigEntry({key: entry}, entry.place)
    return entry


def describe(entry: ConfigEntry) -> str:
    """Return a value as one line of YAML, shortened if long."""
    return shortened(_inline(entry))


def shortened(text: str) -> str:
    """Return a printable text of at most 60 characters."""
    text = printable(text)
    return text if len(text) <= 60 else text[:57] + "..."


def _inline(entry: ConfigEntry) -> str:
    value = entry.value
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_inline(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value)


MAX_VALUES = 20_000
MAX_DEPTH = 40

# libyaml, which packages of PyYAML contain, is ten times as fast as the parser in Python.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# Exceptions of the parsers other than YAMLError: half of a surrogate pair in the text is an error of the encoder, an
# escape beyond Unicode ("\\U00110000") one of chr().
_FAULTS = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)

# The tag resolution of YAML 1.2's core schema, section 10.3.2.
_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INT = re.compile(r"[-+]?[0-9]{1,100}")
_OCTAL = re.compile(r"0o[0-7]{1,100}")
_HEX = re.compile(r"0x[0-9a-fA-F]{1,100}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = frozenset({".nan", ".NaN", ".NAN"})


# Scenarios extend each other, so that the same text is parsed many times.
@lru_cache(maxsize=512)
def parse_yaml(text: str, source: str, *, place: str | None = None) -> ConfigEntry:
    """Parse one YAML document; results are cached and immutable.

    Locations are ``source:line``, or ``place`` for all values. Raise BoresightError on a syntax error, a duplicate key,
    a tag, a second document or an excess of values (an alias bomb); one line that names the file and the line.
    """
    try:
        return _Builder(text, source, place).document()
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark is not None else ""
        raise _invalid(place or source + line, error.problem or error.context) from error
    except YAMLError as error:
        raise _invalid(place or source, error) from error


def _events_of(text: str) -> Iterator[Any]:
    """Yield the parser's events; convert its other exceptions to YAMLError."""
    try:
        yield from yaml.parse(text, _LOADER)
    except _FAULTS as error:
        raise YAMLError(one_line(error) or type(error).__name__) from error


def _invalid(place: str, what: object) -> BoresightError:
    return BoresightError(f"{place}: not valid YAML: {one_line(what)}")


def resolve_scalar(text: str) -> Scalar:
    """Convert a plain scalar by the core schema: null, bool, int, float or text."""
    if text in _NULL:
        return None
    if text in _BOOL:
        return _BOOL[text]
    if _INT.fullmatch(text):
        return int(text)
    if _OCTAL.fullmatch(text) or _HEX.fullmatch(text):
        return int(text, base=0)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _INFINITY.fullmatch(text):
        return float(text.replace(".", ""))
    return float("nan") if text in _NAN else text


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writer of plain values for readers of YAML 1.2."""


def _quoted(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if resolve_scalar(text) == text else "'")


_Dumper.add_representer(str, _quoted)


def dump_yaml(value: object) -> str:
    """Write mappings, lists and scalars as YAML, innermost lists and mappings on one line."""
    return str(yaml.dump(value, Dumper=_Dumper, default_flow_style=None, sort_keys=False, allow_unicode=True))


class _Builder:
    """Builder of entries from the parser's events; an alias shares the entry of its anchor."""

    def __init__(self, text: str, source: str, place: str | None) -> None:
        self._events = _events_of(text)
        self._source = source
        self._place = place
        self._anchors: dict[str, tuple[ConfigEntry, int]] = {}
        self._values = 0
        self._depth = 0

    def document(self) -> ConfigEntry:
        root = ConfigEntry(None, self._place or f"{self._source}:1")
        documents = 0
        for event in self._events:
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self._error(event, "a second YAML document starts here: write one a file")
                root = self._build(next(self._events), root.place)
            elif isinstance(event, StreamEndEvent):
                break
        return root

    def _build(self, event: Any, place: str) -> ConfigEntry:
        if isinstance(event, AliasEvent):
            return self._alias(event, place)
        if event.tag is not None and str(event.tag) != "!":
            raise self._error(event, f"the tag {event.tag} is not read here: write the plain value")
        before = self._values
        self._count(event, 1)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise self._error(event, f"values are nested more than {MAX_DEPTH} deep")
        value: Any
        if isinstance(event, MappingStartEvent):
            value = self._mapping()
        elif isinstance(event, SequenceStartEvent):
            value = []
            while not isinstance(item := next(self._events), SequenceEndEvent):
                value.append(self._build(item, self._at(item)))
            value = tuple(value)
        elif any("\ud800" <= char <= "\udfff" for char in event.value):
            raise self._error(event, "half of a surrogate pair is no character: write the character itself")
        else:
            value = resolve_scalar(event.value) if event.implicit[0] and not event.style else event.value
        self._depth -= 1
        entry = ConfigEntry(value, place)
        if event.anchor:
            self._anchors[str(event.anchor)] = (entry, self._values - before)
        return entry

    def _mapping(self) -> dict[str, ConfigEntry]:
        section: dict[str, ConfigEntry] = {}
        while not isinstance(event := next(self._events), MappingEndEvent):
            if not isinstance(event, ScalarEvent):
                raise self._error(event, "a key must be a word")
            key = event.value
            place = self._at(event)
            if key in section:
                raise self._error(event, f"{key}: duplicate key, first given at {section[key].place}")
            section[key] = self._build(next(self._events), place)
        return section

    def _alias(self, event: Any, place: str) -> ConfigEntry:
        if event.anchor not in self._anchors:
            raise self._error(event, f"the alias *{event.anchor} has no anchor before it")
        entry, size = self._anchors[event.anchor]
        self._count(event, size)
        return ConfigEntry(entry.value, place)

    def _count(self, event: Any, values: int) -> None:
        self._values += values
        if self._values > MAX_VALUES:
            raise self._error(event, f"more than {MAX_VALUES} values, aliases expanded")

    def _at(self, event: Any) -> str:
        return self._place or f"{self._source}:{event.start_mark.line + 1}"

    def _error(self, event: Any, what: str) -> BoresightError:
        return BoresightError(f"{self._at(event)}: {what}")
