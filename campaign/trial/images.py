"""The image of a trial with what methods see of it, and images as files."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import TrialImage, World
from boresight.campaign.trial.kind import Records
from boresight.reports.schema.column import FRESH_IMAGE, STORED_IMAGE
from boresight.scenarios.atomic import write_atomically
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.observation import Observation


@dataclass(frozen=True, slots=True, eq=False)
class ImageDraw:
    """The image of a trial, the observation made of it, and the time that the image took, s."""

    trial: int
    trial_image: TrialImage
    observation: Observation
    seconds: float

    @property
    def timings(self) -> Records:
        """Time of the image, which all methods share."""
        stage = STORED_IMAGE if self.trial_image.from_store else FRESH_IMAGE
        return {"timings": [{"stage": stage, "seconds": self.seconds}]}


def draw_image(world: World, seed: int, trial: int, folder: Path | None) -> ImageDraw:
    """Draw the image of a trial, and keep it in a folder where one is given."""
    started = time.perf_counter()
    trial_image = world.source.trial_image(seed, trial)
    seconds = time.perf_counter() - started
    if folder is not None:
        write_image(folder / f"{trial:07d}.tiff", trial_image.image)
    return ImageDraw(trial, trial_image, observe(world, trial_image, seed, trial), seconds)


def write_image(path: Path, image: NDArray[np.float32]) -> None:
    """Write an image (H, W) as TIFF; every bit comes back.

    Raise BoresightError if it cannot be encoded or written.
    """
    ok, encoded = cv2.imencode(".tiff", image)
    if not ok:
        raise BoresightError(f"{path}: the image could not be encoded as TIFF")
    write_atomically(path, lambda temporary: temporary.write_bytes(encoded.tobytes()))
