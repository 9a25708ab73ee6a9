"""Lessons from images with known rims: proposals, and rims displaced at random, with what is true of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.learned.network import PatchSource, cut_patches, ellipses_of, shape_of, target_outputs
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Ellipses
from training.network_training import Lessons

NEAR, FAR = 0.3, 0.5  # of the radius: within a rim's place is right, beyond it is wrong
ALIKE, UNLIKE = 0.36, 0.55  # of the log ratio of mean radii, the same
REACH = 0.7  # up to which the place of a rim is taught


def nearest(seen: Ellipses, rims: Ellipses) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return of each seen rim the true one that it is most like, the distance over that one's radius, the log ratio."""
    radius = rims.radius_px
    apart = np.linalg.norm(seen.centre_px[:, None] - rims.centre_px[None], axis=2) / radius[None]
    ratio = np.abs(np.log(seen.radius_px[:, None] / radius[None]))
    best = np.argmin(apart / NEAR + ratio / ALIKE, axis=1)
    rows = np.arange(len(seen))
    return best, apart[rows, best], ratio[rows, best]


def lessons_of(source: PatchSource, seen: Ellipses, rims: Ellipses, weight: FloatArray) -> Lessons:
    """Say what is true of seen rims.

    Parameters
    ----------
    rims
        All craters of the image.
    weight
        (k,) of each: 0 for one that nobody could be blamed for finding or missing.
    """
    pixels, scalars = cut_patches(source, seen)
    if len(rims) == 0:
        none = np.zeros(len(seen), dtype=np.float32)
        return Lessons(pixels, scalars, none, none + 1, np.zeros((len(seen), 5), np.float32), none)
    best, apart, ratio = nearest(seen, rims)
    right = (apart < NEAR) & (ratio < ALIKE)
    wrong = (apart > FAR) | (ratio > UNLIKE)
    reach = (apart < REACH) & (ratio < REACH)
    of_rim = weight[best]
    verdict = np.where(right, of_rim, np.where(wrong, 1.0, 0.0))
    return Lessons(
        pixels,
        scalars,
        right.astype(np.float32),
        verdict.astype(np.float32),
        target_outputs(seen, rims[best], source.sun_px).astype(np.float32),
        np.where(reach, of_rim, 0.0).astype(np.float32),
    )


def displaced(rims: Ellipses, sun_px: FloatArray, spread: float, rng: np.random.Generator) -> Ellipses:
    """Displace and scale rims at random, by ``spread`` of their radius (one standard deviation)."""
    radius = rims.radius_px[:, None]
    centre = rims.centre_px + spread * radius * rng.normal(size=(len(rims), 2))
    shape = shape_of(rims, sun_px)
    shape[:, 0] += spread * rng.normal(size=len(rims))
    return ellipses_of(centre, shape, sun_px)


def joined(parts: Sequence[Lessons]) -> Lessons:
    """Join lessons."""
    return Lessons(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("pixels", "scalars", "crater", "weight", "target", "placed")
        )
    )
