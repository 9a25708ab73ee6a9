"""Find YAML files by name or path, and read them."""

from __future__ import annotations

import difflib
import os
from pathlib import Path

from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.load.entry import ConfigEntry, shortened
from boresight.scenarios.load.yaml_text import parse_yaml

SUFFIXES = (".yaml", ".yml")
_MAX_BYTES = 1_000_000


def names_in(catalog: Path) -> list[str]:
    """Return the names of the files of a catalogue folder, sorted: stems, with ``-`` for ``_``."""
    return sorted(_by_name(catalog))


def name_of(path: Path) -> str:
    """Return the default name of a file: ``my-scene`` for ``my_scene.yaml``."""
    return _named(path.name)[0]


def find(name_or_path: str, catalog: Path, near: Path | None = None, what: str = "scenario") -> Path:
    """Find a file by its name in the catalogue, otherwise by its path: ``quickstart``, or ``my/scene.yaml``.

    Relative paths, and names without a suffix, are looked up in ``near`` too, by default the working directory. Raise
    BoresightError if there is none; the message names the kind of file, ``what``, and suggests similar names.
    """
    for folder in (catalog, near):
        found = None if folder is None else _named_in(folder, name_or_path)
        if found is not None:
            return found
    path = (near or Path()) / name_or_path
    if not exists(path):
        raise BoresightError(_not_found(name_or_path, path, names_in(catalog), what))
    return path


def _named_in(folder: Path, name: str) -> Path | None:
    """Return the file of a name in a folder; most are found without listing it."""
    usual = folder / f"{name.replace('-', '_')}{SUFFIXES[0]}"
    if usual.parent == folder and exists(usual):
        return usual
    file = _by_name(folder).get(name.replace("_", "-"))
    return None if file is None else folder / file


def exists(path: Path) -> bool:
    """Return whether a file or folder exists; False for names that are invalid as paths."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def read(path: Path) -> ConfigEntry:
    """Read and parse a file whose top level must be a section of keys.

    Raise BoresightError if it cannot be read, is not UTF-8 text, is empty or is not a mapping.
    """
    shown = display(path)
    try:
        if path.is_dir():
            raise BoresightError(f"{shown}: is a folder, not a YAML file")
        if path.exists() and not path.is_file():
            raise BoresightError(f"{shown}: is a device or a pipe, not a YAML file")
        size = path.stat().st_size
        if size > _MAX_BYTES:
            raise BoresightError(f"{shown}: {size} bytes is too long for a scenario or campaign file")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise BoresightError(f"{shown}: no such file") from error
    except UnicodeDecodeError as error:
        raise BoresightError(f"{shown}: not UTF-8 text (byte {error.start}): save it as UTF-8") from error
    except (OSError, ValueError) as error:
        raise BoresightError(f"{shown}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    root = parse_yaml(text, shown)
    if root.section is None:
        state = "is empty" if root.value is None else "is not a section of keys"
        raise BoresightError(f"{shown}: the file {state}: write 'key: value' lines")
    return root


def _named(file: str) -> tuple[str, str]:
    """Split a file name into the name of what it holds, and the suffix."""
    stem, suffix = os.path.splitext(file)  # noqa: PTH122  no paths are made: this is asked for every file that is read
    return stem.replace("_", "-"), suffix


def _by_name(folder: Path) -> dict[str, str]:
    """Return the file names of a folder by the names of what they hold."""
    try:
        names = sorted(os.listdir(folder))  # noqa: PTH208
    except OSError:
        names = []
    return {name: file for file in names for name, suffix in [_named(file)] if suffix in SUFFIXES}


def _not_found(name_or_path: str, path: Path, known: list[str], what: str) -> str:
    beside = [item.name for item in sorted(path.parent.glob("*")) if item.suffix in SUFFIXES]
    near = difflib.get_close_matches(path.stem, known, n=1) or difflib.get_close_matches(path.name, beside, n=1)
    hint = f"did you mean {near[0]}?" if near else f"give a path, or one of {', '.join(known)}"
    return f"{shortened(name_or_path)}: no such {what}; {hint}"
