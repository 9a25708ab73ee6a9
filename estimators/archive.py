"""Store data bases of maplets and descriptors as NumPy archives with a JSON header."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import CONTENT_FAULTS, read_arrays

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Archive:
    """The archive format of one kind of data base: file, format and version; ``what`` names the content in messages."""

    file: str
    what: str
    format: str
    version: int

    def save(self, folder: Path, head: Mapping[str, object], arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Write a data base into ``folder``, which is made if absent."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"format": self.format, "version": self.version, **head})
        every = {"head": np.frombuffer(text.encode(), dtype=np.uint8), **arrays}
        np.savez_compressed(folder / self.file, allow_pickle=False, **every)

    def load(self, folder: Path, make: Callable[[dict[str, Any], dict[str, NDArray[Any]]], T]) -> T:
        """Read an archive written by ``save`` and construct the data base by ``make(head, arrays)``.

        Raise `BoresightError` if the file is missing, has another format or its content is wrong; the message gives its
        path.
        """
        path = folder / self.file
        try:
            arrays = read_arrays(path)
            head = json.loads(bytes(arrays["head"]).decode())
            if (head.get("format"), head.get("version")) != (self.format, self.version):
                raise BoresightError(f"it is not format {self.format!r} version {self.version}")
            return make(head, arrays)
        except CONTENT_FAULTS as error:
            raise BoresightError(
                f"{path}: cannot be read as a data base of {self.what}: {error}; build it again"
            ) from error
