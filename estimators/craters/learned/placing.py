"""From what the network says to rims, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Ellipses

FloatArray = NDArray[np.float64]
_LARGEST_STEP = 0.6  # of the radius or of its logarithm: what the network was taught


def shape_of(ellipses: Ellipses, sun_px: FloatArray) -> FloatArray:
    """Describe shapes smoothly: (n, 3) log mean radius, and half the log ratio of the axes as a vector.

    The vector (e cos 2p, e sin 2p) has p the angle from the Sun's direction to the longer axis; a circle's is 0.
    """
    axes = np.log(ellipses.semi_axes_px)
    elongation = 0.5 * (axes[:, 0] - axes[:, 1])
    angle = 2.0 * (ellipses.angle_rad - np.arctan2(sun_px[1], sun_px[0]))
    return np.stack([axes.mean(axis=1), elongation * np.cos(angle), elongation * np.sin(angle)], axis=1)


def ellipses_of(centre_px: FloatArray, shape: FloatArray, sun_px: FloatArray) -> Ellipses:
    """Turn (n, 2) centres and (n, 3) shapes, as ``shape_of`` describes them, into rims."""
    elongation = np.hypot(shape[:, 1], shape[:, 2])
    angle = 0.5 * np.arctan2(shape[:, 2], shape[:, 1]) + np.arctan2(sun_px[1], sun_px[0])
    axes = np.exp(shape[:, :1] + elongation[:, None] * np.array([1.0, -1.0]))
    return Ellipses(centre_px, axes, angle % np.pi)


def frame_of(sun_px: FloatArray) -> FloatArray:
    """Return the (2, 2) matrix whose rows are the axes of patches: towards the Sun, and a quarter turn on."""
    return np.array([sun_px, [-sun_px[1], sun_px[0]]])


def targets(seen: Ellipses, truth: Ellipses, sun_px: FloatArray) -> FloatArray:
    """Return what the network should say (n, 5) of patches about ``seen`` where the rims are ``truth``."""
    radius = seen.radius_px[:, None]
    moved = (truth.centre_px - seen.centre_px) @ frame_of(sun_px).T / radius
    shape = shape_of(truth, sun_px)
    shape[:, 0] -= np.log(radius[:, 0])
    return np.concatenate([moved, shape], axis=1)


def placed(seen: Ellipses, said: FloatArray, sun_px: FloatArray) -> Ellipses:
    """Place rims as the network says (n, 5) of patches about ``seen``: the inverse of ``targets``."""
    radius = seen.radius_px[:, None]
    said = np.asarray(said, dtype=np.float64)
    step = np.clip(said[:, :2], -_LARGEST_STEP, _LARGEST_STEP)
    centre = seen.centre_px + radius * step @ frame_of(sun_px)
    shape = said[:, 2:].copy()
    shape[:, 0] = np.clip(shape[:, 0], -_LARGEST_STEP, _LARGEST_STEP) + np.log(radius[:, 0])
    return ellipses_of(centre, shape, sun_px)
