"""Configuration values with the file and line of their definition."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from boresight.scenarios.errors import printable

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
