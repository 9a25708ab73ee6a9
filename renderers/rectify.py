"""Resampling of images of a distorting lens to those of a pinhole camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, pixel_to_opencv


def rectify(image: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Resample an image of ``camera``, (H, W) and proportional to radiance, to that of ``camera.pinhole``.

    The interpolation is a cubic spline. Through AMICA's lens (1.5 pixels in the corners) its RMS error is 0.6 % of the
    amplitude of a wave of 4 pixels and 0.03 % of one of 8 pixels, and white noise keeps 84 % of its variance. OpenCV's
    remap would round positions to 1/32 pixel. Edge pixels are repeated beyond the edge. Return ``image`` itself for a
    camera without distortion. Raise `BoresightError` if the image is not of the camera's size, or the distortion is not
    defined in a part of the pinhole's field.
    """
    if camera.distortion is None:
        return image
    if image.shape != (camera.height_px, camera.width_px):
        raise BoresightError(
            f"an image of shape {image.shape} is not of the camera, {camera.width_px} x {camera.height_px} pixels"
        )
    # For the centre of each pixel of the result, the place in the distorted image: there are no holes.
    columns, rows = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    seen = pixel_to_opencv(camera.distorted(np.stack([columns, rows], axis=-1)))
    if not np.isfinite(seen).all():
        raise BoresightError(f"the distortion {camera.distortion} has no pixel for a part of the pinhole's field")
    rectified: NDArray[np.float32] = map_coordinates(
        # SciPy's coordinates are array indices, rows first.
        image,
        [seen[..., 1], seen[..., 0]],
        output=np.float32,
        order=3,
        mode="nearest",
    )
    return rectified
