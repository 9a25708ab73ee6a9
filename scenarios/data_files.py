"""Where data that a scenario names may lie."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from scenarios.errors import BoresightError


def find_data(name: str, search_dirs: Sequence[Path], subfolder: str, what: str) -> Path:
    """Find a file or folder of data.

    An absolute path is taken as it is. A relative one is looked for in each of ``search_dirs`` (beside the
    scenario file), then in ``$BORESIGHT_DATA`` and its ``subfolder``.

    Parameters
    ----------
    name
        Path as the scenario writes it.
    search_dirs
        Folders of the scenario file and of those that it extends.
    subfolder
        Folder of this kind of data below ``$BORESIGHT_DATA``: ``shapes`` or ``images``.
    what
        What is looked for, in the error, for example ``images.folder``.

    Raises
    ------
    BoresightError
        If it is in none of these places; the line names them.
    """
    path = Path(name).expanduser()
    root = os.environ.get("BORESIGHT_DATA", "")
    folders = [*search_dirs, *([Path(root), Path(root) / subfolder] if root else [])]
    candidates = [path] if path.is_absolute() else [folder / path for folder in folders]
    for candidate in candidates:
        if candidate.exists():
            return candidate
    looked = ", ".join(str(candidate) for candidate in candidates)
    hint = "" if root or path.is_absolute() else "; set BORESIGHT_DATA to the folder of your data"
    raise BoresightError(f"{what}: {name}: not found; looked at {looked}{hint}")
