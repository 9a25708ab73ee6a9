"""Stars as point sources through a Gaussian point spread function."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.stars import StarCatalog

_MARGIN_PX = 32.0  # of stars beyond the edge, whose light reaches into the image


def star_pixels(camera: Camera, R_cam_inertial: FloatArray, catalog: StarCatalog) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) of the stars in or near the image, through the lens, and their light (n,).

    The light is 1 for a star of magnitude 0. ``R_cam_inertial`` (3, 3) takes inertial to camera axes.
    """
    uv = camera.project(catalog.directions @ R_cam_inertial.T)
    inside = camera.contains(uv, -_MARGIN_PX)  # False for NaN
    return uv[inside], 10.0 ** (-0.4 * catalog.magnitudes[inside])


def point_sources(camera: Camera, uv_px: FloatArray, rates: FloatArray, psf_sigma_px: float) -> FloatArray:
    """Spread point sources over pixels: (H, W) in the unit of ``rates`` (n,), at positions ``uv_px`` (n, 2).

    A pixel has the integral of the Gaussian over its square. This is the mean over the pixel that a rendered surface
    has, blurred by as much: its variance is sigma^2 + 1/12. With sigma 0 all light is in one pixel.
    """
    image = np.zeros((camera.height_px, camera.width_px))
    reach = min(int(np.ceil(6.0 * psf_sigma_px)) + 1, int(_MARGIN_PX))
    steps = np.arange(-reach, reach + 1)
    first = np.floor(uv_px).astype(np.int64)
    shares = []
    for axis in (0, 1):
        edges = first[:, axis, None] + np.append(steps, reach + 1) - uv_px[:, axis, None]
        # Where sigma is 0 the share is that of a step.
        below = ndtr(edges / psf_sigma_px) if psf_sigma_px > 0.0 else (edges > 0.0).astype(np.float64)
        shares.append(np.diff(below, axis=1))
    rows, columns = first[:, 1, None, None] + steps[:, None], first[:, 0, None, None] + steps
    light = rates[:, None, None] * shares[1][:, :, None] * shares[0][:, None, :]
    inside = (rows >= 0) & (rows < camera.height_px) & (columns >= 0) & (columns < camera.width_px)
    at = tuple(np.broadcast_to(index, light.shape)[inside] for index in (rows, columns))
    np.add.at(image, at, light[inside])
    return image
