"""The file of an image's craters: text, one record a line.

::

    # boresight crater detections 1
    image NUMBER TIME REASON
    crater IMAGE ROW U V SEMI_MAJOR SEMI_MINOR ANGLE CONFIDENCE

``REASON`` says why nothing could be seen, its words joined by underscores; ``-`` where the image was searched. Pixels
and radians; rows count from 0, the most confident first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimators.craters.contract import CraterDetections
from estimators.craters.database.records import read_records, words, write_records
from scenarios.errors import BoresightError
from scenarios.geometry import Ellipses

_HEAD = "boresight crater detections 1"


@dataclass(frozen=True, slots=True, eq=False)
class DetectedImage:
    """What was found in an image, and why nothing could be; '' where it was searched."""

    number: int
    time_s: float
    detections: CraterDetections
    reason: str = ""


def write_detections(path: Path, image: DetectedImage) -> None:
    """Write the craters of an image, whole or not at all."""
    found = image.detections
    lines = [words("image", image.number, image.time_s, "_".join(image.reason.split()) or "-")]
    for row, (centre, axes, angle, confidence) in enumerate(
        zip(
            found.ellipses.centre_px,
            found.ellipses.semi_axes_px,
            found.ellipses.angle_rad,
            found.confidence,
            strict=True,
        )
    ):
        lines.append(words("crater", image.number, row, *centre, *axes, angle, confidence))
    write_records(path, _HEAD, lines)


def read_detections(path: Path) -> DetectedImage:
    """Read the craters of an image.

    Raises
    ------
    BoresightError
        With file and line: a record is malformed, there is not one image, or rows do not count up from 0.
    """
    records = list(read_records(path, _HEAD, {"image": 3, "crater": 8}))
    if [record.kind for record in records].count("image") != 1 or records[0].kind != "image":
        raise BoresightError(f"{path}: a file of craters has one image, in its first record")
    head, craters = records[0], records[1:]
    number = head.integer(0)
    for row, record in enumerate(craters):
        if (record.integer(0), record.integer(1)) != (number, row):
            raise record.wrong(f"row {record.integer(1)} of image {record.integer(0)}, not {row} of {number}")
    values = np.array([record.numbers(2, 8) for record in craters]).reshape(-1, 6)
    found = CraterDetections(Ellipses(values[:, :2], values[:, 2:4], values[:, 4]), values[:, 5])
    reason = "" if head.fields[2] == "-" else head.fields[2].replace("_", " ")
    return DetectedImage(number, head.numbers(1, 2)[0], found, reason)
