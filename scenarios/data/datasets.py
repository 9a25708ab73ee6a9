"""Downloadable data sets: addresses, target folders, credits and licences."""

from __future__ import annotations

import re
import warnings
from pathlib import Path, PurePosixPath
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from scenarios.errors import BoresightError
from scenarios.load.files import validated
from scenarios.load.find import find, name_of, names_in, read
from scenarios.spec.base import SpecModel

CATALOG = Path(__file__).parent / "catalog"
_URL = r"^https?://[^\s]+$"
FILE_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,199}$"
"""Pattern of the name of a fetched file: it cannot leave its folder or replace a hidden file of boresight."""
Url = Annotated[str, Field(pattern=_URL)]


class FileSpec(SpecModel):
    """One file of a data set."""

    url: Url = Field(description="Where it is published")
    name: str | None = Field(None, pattern=FILE_NAME, description="Name here; that of the URL")
    size_bytes: int | None = Field(None, gt=0, description="Size, where it is known")
    sha256: str | None = Field(
        None, pattern=r"^[0-9a-f]{64}$", description="Checksum; left out: that of the first fetch is kept and holds"
    )

    @property
    def file_name(self) -> str:
        """Name of the file in the data set's folder."""
        return self.name or PurePosixPath(self.url).name

    @model_validator(mode="after")
    def _stays_in_its_folder(self) -> Self:
        if not re.fullmatch(FILE_NAME, self.file_name):
            raise ValueError(f"url: {self.url} ends in no plain file name: give one as name")
        return self


class ListingSpec(SpecModel):
    """Files of a folder on a server, by the links of its listing."""

    url: Url = Field(description="The folder, with a slash at its end")
    pattern: str = Field(min_length=1, description="Regular expression of the whole names of the files")

    @model_validator(mode="after")
    def _is_an_expression(self) -> Self:
        try:
            # Warnings of re concern ambiguous expressions, which have an unambiguous form.
            with warnings.catch_warnings(action="error"):
                re.compile(self.pattern)
        except (re.error, OverflowError, RecursionError, Warning) as error:
            raise ValueError(f"pattern: {self.pattern!r} is no regular expression: {error}") from error
        return self


class DataSetSpec(SpecModel):
    """A data set: its files one by one, or those of a folder on a server."""

    alternatives: ClassVar = (("files", "listing"),)

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9._-]*$")
    title: str = Field(min_length=1, description="What it is")
    folder: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._/-]*$", description="Where it goes, below the data folder")
    credit: str = Field(min_length=1, description="Whom to thank, with the reference")
    licence: str = Field(min_length=1, description="What may be done with it")
    note: str = Field("", description="What a user must know")
    files: tuple[FileSpec, ...] | None = Field(None, description="The files")
    listing: ListingSpec | None = Field(None, description="The files of a folder, instead of files")

    @model_validator(mode="after")
    def _names_once(self) -> Self:
        names = [file.file_name for file in self.files or ()]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"files: two of them are called {', '.join(twice)}")
        if ".." in PurePosixPath(self.folder).parts:
            raise ValueError(f"folder: {self.folder} leads out of the data folder")
        return self

    def provides(self, path: str) -> bool:
        """Return whether a path below the data folder is one of its files, or lies in its folder."""
        here = PurePosixPath(self.folder)
        asked = PurePosixPath(path)
        if self.files is None:
            return asked == here or here in asked.parents
        return asked == here or asked in {here / file.file_name for file in self.files}


def dataset_names() -> list[str]:
    """Return the names of the data sets that can be fetched."""
    return names_in(CATALOG)


def load_dataset(name_or_path: str) -> DataSetSpec:
    """Read a data set by its name in the catalogue or from a YAML file.

    Raises
    ------
    BoresightError
        If there is no data set of that name, or the file is invalid.
    """
    path = find(name_or_path, CATALOG, what="data set")
    entry = read(path)
    section = dict(entry.section or {})
    section.setdefault("name", type(entry)(name_of(path), entry.place))
    return validated(DataSetSpec, type(entry)(section, entry.place))


def dataset_providing(paths: list[str]) -> str | None:
    """Return the name of a data set that provides one of the paths below the data folder, or None."""
    try:
        sets = [load_dataset(name) for name in dataset_names()]
    except BoresightError:
        return None  # an error about a missing file must not become one about a data set
    return next((one.name for path in paths for one in sets if one.provides(path)), None)
