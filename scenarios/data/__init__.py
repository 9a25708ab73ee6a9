"""Find the files and folders that a scenario names: shapes, images and kernels of missions."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import platformdirs

from boresight.scenarios.errors import BoresightError

__all__ = ["DATA_VARIABLE", "data_folder", "find_data_file", "find_data_folder", "is_there"]

DATA_VARIABLE = "BORESIGHT_DATA"
_MOST_SHOWN = 60  # letters of a name that is no path


def data_folder() -> Path:
    """Return the data folder: ``$BORESIGHT_DATA``, or the user's data folder if it is not set."""
    data = os.environ.get(DATA_VARIABLE)
    return Path(data).expanduser() if data else Path(platformdirs.user_data_dir("boresight"))


def find_data_file(
    name: str, search_dirs: Sequence[Path], folder: str, key: str, is_wanted: Callable[[Path], bool] = Path.is_file
) -> Path:
    """Find a file: as given if absolute, else in ``search_dirs``, then in ``folder`` of the data folder, then in that.

    Raise BoresightError, which names the scenario's ``key`` and lists where it was looked for.
    """
    candidates = _candidates(name, search_dirs, folder)
    try:
        if (found := next(filter(is_wanted, candidates), None)) is not None:
            return found
        other = next(filter(Path.exists, candidates), None)
    except OSError as error:  # a name that is too long, or a folder that may not be read
        raise BoresightError(f"{key}: {name[:_MOST_SHOWN]}: {error.strerror}: check the path") from error
    if other is not None:
        kind = "a folder" if other.is_dir() else "a file" if other.is_file() else "a device or a pipe"
        wanted = "folder" if is_wanted is Path.is_dir else "file"
        raise BoresightError(f"{key}: {other} is {kind}: give the path of a {wanted}")
    looked = ", ".join(str(candidate) for candidate in candidates)
    raise BoresightError(f"{key}: {name} was not found; looked for {looked}; {_advice(Path(name), folder)}")


def find_data_folder(name: str, search_dirs: Sequence[Path], folder: str, key: str) -> Path:
    """Find a folder as ``find_data_file`` finds a file."""
    return find_data_file(name, search_dirs, folder, key, Path.is_dir)


def is_there(name: str, search_dirs: Sequence[Path], folder: str) -> bool:
    """Return whether a file or folder is where `find_data_file` or `find_data_folder` looks for it."""
    try:
        return any(place.exists() for place in _candidates(name, search_dirs, folder))
    except OSError:  # a name that is too long for a file
        return False


def _candidates(name: str, search_dirs: Sequence[Path], folder: str) -> list[Path]:
    given = Path(name).expanduser()
    places = [*search_dirs, data_folder() / folder, data_folder()]
    return [given] if given.is_absolute() else [place / given for place in places]


def _advice(given: Path, folder: str) -> str:
    # Imported here: the registry of data sets is a YAML file that is read only if a file is missing.
    from boresight.scenarios.data.datasets import datasets_providing

    paths = [f"{folder}/{given.as_posix()}", given.as_posix()]
    for known in [] if given.is_absolute() else datasets_providing(paths):
        if known.made_by is not None:
            return f"to make it: {known.made_by}"
        if known.published is not None:
            return f"bring your own: {known.title}, published at {known.published}; folder {known.folder}"
        return f"to fetch it: boresight fetch {known.name}"
    if DATA_VARIABLE in os.environ or given.is_absolute():
        return "check the path"
    return f"or set {DATA_VARIABLE} to the folder of the data"
