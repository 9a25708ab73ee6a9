"""Registry of data sets: what `boresight fetch` downloads and from where, and what a user must bring."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Annotated, ClassVar, Literal, Self
from urllib.parse import quote

from pydantic import Field, model_validator

from boresight.scenarios.load.files import read, validated
from boresight.scenarios.load.yaml_text import ConfigEntry
from boresight.scenarios.spec.base import SpecModel

REGISTRY = Path(__file__).parent / "datasets.yaml"
RAW_FILES = "https://raw.githubusercontent.com"
"""Server of the raw files of public repositories, below OWNER/NAME/COMMIT/PATH."""
_PART = r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}"
PATH_PATTERN = rf"^{_PART}(/{_PART})*$"
"""Pattern of the path of a fetched file: it cannot leave its folder or replace a hidden file."""
_Path = Annotated[str, Field(pattern=PATH_PATTERN)]


class RawFile(SpecModel):
    """A file of a repository, with its size and checksum."""

    name: _Path = Field(description="Path in the folder of the data set")
    bytes: int = Field(gt=0, description="Size")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="Checksum")
    path: str = Field("", pattern=r"^[^/].*$|^$", description="Path in the repository; the name below the set's path")


class FileSpec(RawFile):
    """A file of a data set: of its repository, derived from such a file, or part of boresight."""

    raw: RawFile | None = Field(None, description="File of the repository from which this one is derived")
    by: Literal["icq", "apophis"] | None = Field(None, description="Function of `campaign.data.fetch` that derives it")
    bundled: str = Field("", description="File of boresight that is copied")

    @model_validator(mode="after")
    def _derived_by_something(self) -> Self:
        if (self.raw is None) != (self.by is None):
            raise ValueError("raw and by belong together: give both, or neither")
        return self


class DataSet(SpecModel):
    """A data set in a public repository, one that a user must bring, or one that a command makes of another."""

    alternatives: ClassVar = (("repository", "published", "made_by"),)

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9._-]*$")
    title: str = Field(min_length=1, description="What it is")
    folder: _Path = Field(description="Folder below the data folder")
    credit: str = Field(min_length=1, description="Whom to credit")
    licence: str = Field(min_length=1, description="Terms of use")
    note: str = Field("", description="What a user must know")
    repository: str | None = Field(None, pattern=r"^[^/\s]+/[^/\s]+$", description="GitHub repository, owner/name")
    commit: str = Field("", pattern=r"^([0-9a-f]{40})?$", description="Commit of the repository")
    path: str = Field("", description="Folder in the repository")
    files: tuple[FileSpec, ...] = Field((), description="Files that are fetched")
    published: str | None = Field(None, description="Where it is published, if it cannot be fetched")
    made_by: str | None = Field(None, description="Command that makes it of another data set")
    needed: tuple[_Path, ...] = Field((), description="Files that a user must bring; none: those of the whole folder")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.repository is not None and not (self.commit and self.files):
            raise ValueError("a repository needs a commit and files")
        names = self.file_names
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"files: two of them are called {', '.join(twice)}")
        return self

    @property
    def source(self) -> str:
        """Who publishes a data set that cannot be fetched, or the command that makes it, in words."""
        return f"published at {self.published}" if self.made_by is None else f"made by {self.made_by}"

    @property
    def file_names(self) -> list[str]:
        """Names of its files; empty for a whole folder."""
        return [*(file.name for file in self.files), *self.needed]

    def url(self, file: RawFile) -> str:
        """Return the address of a raw file at the commit."""
        path = file.path or PurePosixPath(self.path, file.name).as_posix()
        return f"{RAW_FILES}/{self.repository}/{self.commit}/{quote(path)}"

    def provides(self, path: str) -> bool:
        """Return whether a path below the data folder is its folder, one of its files, or in its folder."""
        here, asked = PurePosixPath(self.folder), PurePosixPath(path)
        if asked == here:
            return len(here.parts) > 1  # shapes are in one folder, images and kernels each in their own
        return asked in {here / name for name in self.file_names} if self.file_names else here in asked.parents


def read_registry(path: Path) -> dict[str, DataSet]:
    """Read data sets from a YAML file, by name.

    Raise BoresightError if the file cannot be read or an entry is invalid.
    """
    found = {}
    for name, entry in (read(path).section or {}).items():
        named = {**(entry.section or {}), "name": ConfigEntry(name, entry.place)}
        found[name] = validated(DataSet, ConfigEntry(named, entry.place))
    return found


@lru_cache(maxsize=4)
def _read_once(path: Path) -> dict[str, DataSet]:
    return read_registry(path)


def datasets() -> dict[str, DataSet]:
    """Return all data sets by name."""
    return _read_once(REGISTRY)


def datasets_providing(paths: list[str]) -> list[DataSet]:
    """Return the data sets that provide the first of the paths below the data folder that any provides."""
    for path in paths:
        found = [one for one in datasets().values() if one.provides(path)]
        if found:
            return found
    return []
