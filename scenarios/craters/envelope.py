"""A coarse body below the relief: what a camera meets where nothing is cut finely."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.craters.kernels import least_heights
from scenarios.craters.tiles import Tiling

FloatArray = NDArray[np.float64]

_CLEARANCE_M = 0.5


def lower_envelope(tiling: Tiling, vertices_m: NDArray[np.float32]) -> FloatArray:
    """(V, 3) corners of tiles moved inward until no flat tile rises above the relief of its own cuts.

    Where fine tiles end, their edges lie above the coarse body, which is closed: there is no gap to look or shine
    through. What is coarse is low by the relief within a tile, so that limbs and shadows that come from there are
    short by that.
    """
    mesh = tiling.mesh
    normals = mesh.normals
    least = np.empty(len(mesh.faces))
    least_heights(least, vertices_m, mesh.corners_m[:, 0], normals, tiling.layout)
    corner_least = np.full(len(mesh.vertices_m), np.inf)
    steep = np.einsum("tki,ti->tk", tiling.up[mesh.faces], normals)
    # A corner that moves by h along its own direction moves by h times the cosine along the tile's normal.
    for k in range(3):
        np.minimum.at(corner_least, mesh.faces[:, k], np.minimum(least / np.maximum(steep[:, k], 0.2), least))
    return np.asarray(mesh.vertices_m + (corner_least - _CLEARANCE_M)[:, None] * tiling.up)
