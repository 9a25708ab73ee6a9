"""The image-planning file: text, one record a line.

::

    # boresight image plan 1
    image NUMBER TIME KIND TX TY TZ P11 P12 P13 P21 P22 P23 P31 P32 P33 A11 .. A33 SX SY SZ

``TIME`` is that of the shutter in seconds, ``T`` the ground that the boresight is to meet, in metres and body axes,
``P`` and ``A`` the planned and the telemetered rotation from inertial to camera axes, row by row, and ``S`` the
direction of the Sun in axes of a camera that looks to the nadir.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from estimators.craters.database.records import Record, read_records, words, write_records
from estimators.craters.planning.plan import PlannedImage
from scenarios.draw import TargetKind

_HEAD = "boresight image plan 1"


def write_plan(path: Path, images: Sequence[PlannedImage]) -> None:
    """Write a plan, whole or not at all."""
    lines = []
    for image in images:
        pointing = (*image.planned_R_cam_inertial.ravel(), *image.actual_R_cam_inertial.ravel())
        lines.append(
            words(
                "image", image.number, image.time_s, image.kind, *image.target_body_m, *pointing, *image.sun_dir_nadir
            )
        )
    write_records(path, _HEAD, lines)


def read_plan(path: Path) -> tuple[PlannedImage, ...]:
    """Read a plan.

    Raises
    ------
    BoresightError
        With file and line: a record is malformed, or a number stands twice.
    """
    images: list[PlannedImage] = []
    seen: set[int] = set()
    for record in read_records(path, _HEAD, {"image": 27}):
        image = _image(record)
        if image.number in seen:
            raise record.wrong(f"image {image.number} stands twice")
        seen.add(image.number)
        images.append(image)
    return tuple(images)


def _image(record: Record) -> PlannedImage:
    kinds: tuple[TargetKind, ...] = get_args(TargetKind)
    kind = next((one for one in kinds if one == record.fields[2]), None)
    if kind is None:
        raise record.wrong(f"{record.fields[2]!r} is no kind of image; there are: {', '.join(kinds)}")
    time_s, values = record.numbers(1, 2)[0], np.array(record.numbers(3, 27))
    planned, actual = values[3:12].reshape(3, 3), values[12:21].reshape(3, 3)
    return PlannedImage(record.integer(0), time_s, kind, values[:3], planned, actual, values[21:])
