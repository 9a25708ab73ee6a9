"""What every estimator asks of an image before it looks at it."""

from __future__ import annotations

import numpy as np

from scenarios.errors import BoresightError
from scenarios.geometry import Camera
from scenarios.observation import Frame


def image_fault(frame: Frame, camera: Camera) -> str:
    """Say why the image of a frame tells nothing; '' where it can be looked at.

    Raises
    ------
    BoresightError
        If it is not of the camera's size: no estimate can be made of it, whatever it shows.
    """
    expected = (camera.height_px, camera.width_px)
    if frame.image.shape != expected:
        raise BoresightError(
            f"the image has shape {frame.image.shape}, but the camera's is {expected}: hand in the camera's own image"
        )
    return "" if np.isfinite(frame.image).all() else "the image holds NaN or infinite pixels"
