"""The result files of the stages of the chain, from which an interrupted chain continues."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import read_json

T = TypeVar("T")

_SECONDS = "seconds.json"


@dataclass(frozen=True, slots=True)
class StageFiles:
    """A folder with one file for each finished part of a stage, and the computing time of the stages."""

    folder: Path

    def subfolder(self, name: str) -> StageFiles:
        """Return the files of a folder within."""
        return StageFiles(self.folder / name)

    def cached(self, name: str, stage: str, make: Callable[[Path], None], read: Callable[[Path], T]) -> T:
        """Read a file; make it first if it does not exist, and add the time to that of the stage."""
        path = self.folder / name
        if not path.exists():
            with self.timed(stage):
                make(path)
        return read(path)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time of the block to that of a stage, unless it raises."""
        started = time.perf_counter()
        yield
        spent = self.seconds()
        spent[stage] = spent.get(stage, 0.0) + time.perf_counter() - started
        write_text(self.folder / _SECONDS, json.dumps(spent))

    def seconds(self) -> dict[str, float]:
        """Return the time that each stage took, over all starts.

        Raise BoresightError if the file of times is damaged.
        """
        path = self.folder / _SECONDS
        spent = read_json(path, "the times of stages") if path.exists() else {}
        if not isinstance(spent, dict) or not all(isinstance(seconds, (int, float)) for seconds in spent.values()):
            raise BoresightError(f"{path}: does not hold the times of stages: remove it, and the run goes on")
        return dict(spent)
