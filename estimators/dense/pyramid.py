"""Images and cameras at a lower resolution, and the band of scales that is compared."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.dense.options import LevelOptions
from scenarios.geometry import Camera

Image = NDArray[np.float32]


def reduced_camera(camera: Camera, reduction: int) -> Camera:
    """Return the camera whose pixels are squares of ``reduction`` pixels; edges that do not fill one are cut off."""
    return Camera(
        camera.width_px // reduction,
        camera.height_px // reduction,
        camera.fx_px / reduction,
        camera.fy_px / reduction,
        camera.cx_px / reduction,
        camera.cy_px / reduction,
    )


def reduced_image(image: Image, reduction: int) -> Image:
    """Average squares of ``reduction`` pixels."""
    height, width = (side // reduction for side in image.shape)
    whole = np.ascontiguousarray(image[: height * reduction, : width * reduction])
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def band(image: Image, level: LevelOptions) -> Image:
    """Blur an image and take out what is smoother than the level's background."""
    smooth = cv2.GaussianBlur(image, (0, 0), level.blur_px) if level.blur_px > 0.0 else image
    if level.background_px > 0.0:
        smooth = smooth - cv2.GaussianBlur(smooth, (0, 0), level.background_px)
    return np.asarray(smooth, dtype=np.float32)
