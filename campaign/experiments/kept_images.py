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

    def keep(trial: int, image: NDArray[np.float32]) -> None:
        ok, encoded = cv2.imencode(".tiff", image)
        if not ok:
            raise BoresightError(f"{folder}: the image of trial {trial} could not be encoded as TIFF")
        write_atomically(folder / f"{trial:07d}.tiff", lambda path: _write_bytes(path, encoded.tobytes()))

    return keep


def _write_bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)
