"""Images that a user wants to keep: one lossless TIFF for each trial."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scenarios.atomic import write_atomically
from scenarios.errors import BoresightError

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
