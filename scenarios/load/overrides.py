"""``--set camera.fov_deg=20`` as an entry."""

from __future__ import annotations

from collections.abc import Mapping

from scenarios.errors import BoresightError, printable
from scenarios.load.entry import Entry, entry_of, nested
from scenarios.load.merge import Models, merge
from scenarios.load.yaml_text import parse_yaml


def parse_override(text: str, place: str = "") -> Entry:
    """Parse ``key.key=value``, whose value is YAML; ``place`` is what errors name, ``--set`` and the text unless given.

    Raises
    ------
    BoresightError
        If it is not of that form.
    """
    place = place or f"--set {printable(text)}"
    dotted, equals, value = text.partition("=")
    if not equals or not all(key.strip() for key in dotted.split(".")):
        raise BoresightError(f"{place}: write it as key=value, for example --set camera.fov_deg=20")
    return nested([key.strip() for key in dotted.split(".")], parse_yaml(value, place, place=place))


def settings(value: Entry | Mapping[str, object], models: Models) -> Entry:
    """Read a section of overrides whose keys may be dotted: ``{camera.fov_deg: 20, camera: {width_px: 256}}``."""
    entry = value if isinstance(value, Entry) else entry_of(value, "set")
    result = Entry({}, entry.place)
    for dotted, item in (entry.section or {}).items():
        result = merge(result, nested(dotted.split("."), item), models)
    return result


def apply(base: Entry, layers: list[Entry], models: Models) -> Entry:
    """Lay each layer on the ones before it, keeping the place of the first."""
    for layer in layers:
        base = Entry(merge(base, layer, models).value, base.place)
    return base
