"""Trials with several data bases or worlds of craters: trial t uses number t modulo their count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.campaign.pool.steps import report_progress
from boresight.campaign.trial.kind import Records, Trials, Witness, add_records
from boresight.scenarios.atomic import write_atomically
from boresight.scenarios.errors import BoresightError

ImageSink = Callable[[int, NDArray[np.float32]], None]


def image_sink(folder: Path) -> ImageSink:
    """Return a function that keeps the image of a trial in ``folder``."""
    return lambda trial, image: write_image(folder / f"{trial:07d}.tiff", image)


def write_image(path: Path, image: NDArray[np.float32]) -> None:
    """Write an image (H, W) as TIFF; every bit comes back.

    Raises
    ------
    BoresightError
        If it cannot be encoded or written.
    """
    ok, encoded = cv2.imencode(".tiff", image)
    if not ok:
        raise BoresightError(f"{path}: the image could not be encoded as TIFF")
    write_atomically(path, lambda temporary: _write_bytes(temporary, encoded.tobytes()))


def _write_bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)


class Part(Protocol):
    """The trials with one data base."""

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the trials of one method, which pass its stages to a witness."""
        ...

    def trial(self, trial: int) -> Records:
        """Run one trial; return the records of each stored table."""
        ...

    def flush(self) -> None:
        """Store the rendered images."""
        ...


PartT = TypeVar("PartT", bound=Part)
T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class PerDatabase(Generic[PartT]):
    """Trials of one scenario with each of its data bases; most have one."""

    parts: tuple[PartT, ...]

    def of(self, trial: int) -> PartT:
        """Return the trials that share the data base of one trial."""
        return self.parts[trial % len(self.parts)]

    def watched(self, label: str, witness: Witness) -> PerDatabase[PartT]:
        """Return the trials of one method, which pass its stages to a witness."""
        return PerDatabase(tuple(part.watched(label, witness) for part in self.parts))

    def run(self, trials: range) -> Records:
        """Run trials in their order."""
        records: Records = {}
        for number, trial in enumerate(trials):
            add_records(records, self.of(trial).trial(trial))
            report_progress("trials of a block", number + 1, len(trials))
        for part in self.parts:
            part.flush()
        return records


def part_of(trials: Trials, kind: type[T], trial: int) -> T | None:
    """Return the trials that one trial is of; None where they are of another class."""
    own = trials.of(trial) if isinstance(trials, PerDatabase) else trials
    return own if isinstance(own, kind) else None
