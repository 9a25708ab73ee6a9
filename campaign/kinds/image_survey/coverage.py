"""Which images of an arc show the same ground, and which of them in similar light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import Ground
from estimators.craters.matching.preliminary import lit_points
from scenarios.geometry import View

SIMILAR_DEG = 10.0
"""Directions of the Sun, in body axes, that differ by no more are similar, as Cheng et al. (2003) print."""

OVERLAP = 0.1
"""Share of a lit region that the other image shows where two cover the same area, as preliminary matching asks."""

_SIDE = 6


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """How many others of n images cover an image's area, (n,), and how many of these in similar light."""

    overlapping: NDArray[np.int64]
    similar: NDArray[np.int64]


def coverage(views: Sequence[View], ground: Ground) -> Coverage:
    """Count, for each of n views of one camera, the others that show the same lit ground.

    A point of an image's grid is shown by another where that faces it and has it in the frame; what stands between and
    shadows are left out of account.
    """
    n = len(views)
    rotations = np.array([view.T_cam_body.rotation for view in views]).reshape(n, 3, 3)
    shifts = np.array([view.T_cam_body.translation_m for view in views]).reshape(n, 3)
    positions = np.array([view.T_cam_body.camera_position_m for view in views]).reshape(n, 3)
    suns = np.array([view.sun_dir_body for view in views]).reshape(n, 3)
    shown = np.zeros((n, n))
    for i, view in enumerate(views):
        points, normals = lit_points(view.camera, view.T_cam_body, view.sun_dir_body, ground, _SIDE)
        if not len(points):
            continue
        seen = points @ np.swapaxes(rotations, 1, 2) + shifts[:, None]
        inside = view.camera.contains(view.camera.project(seen.reshape(-1, 3))).reshape(n, -1)
        facing = np.einsum("ki,nki->nk", normals, positions[:, None] - points) > 0.0
        shown[i] = (inside & facing & (suns @ normals.T > 0.0)).mean(axis=1)
    same = np.maximum(shown, shown.T) >= OVERLAP
    np.fill_diagonal(same, False)
    alike = suns @ suns.T >= np.cos(np.radians(SIMILAR_DEG))
    return Coverage(same.sum(axis=1), (same & alike).sum(axis=1))
