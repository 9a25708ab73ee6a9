"""Crest curves of craters on the surface that is rendered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray, SingleArray
from boresight.scenarios.craters.kernels import edge_crossings
from boresight.scenarios.craters.population import Craters
from boresight.scenarios.craters.relief import crater_frames
from boresight.scenarios.craters.tiles import Tiling

RIM_POINTS = 72
_PER_FACET = 2  # a sphere that separates corners of a facet crosses two of its edges


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """True rims of n craters above a minimum diameter, from the oldest to the youngest.

    ``crater`` (n,) is the number in the population, ``crest_m`` (n, 72, 3) the crest on the rendered surface, every 5
    deg of azimuth, ``cut`` (n, 72) whether a younger crater has removed it, ``normal_body`` (n, 3) the outward unit
    normal of its least-squares plane. The others are (n,).
    """

    crater: IndexArray
    crest_m: FloatArray
    cut: BoolArray
    normal_body: FloatArray
    diameter_m: FloatArray
    depth_m: FloatArray
    degradation: FloatArray

    def __len__(self) -> int:
        return len(self.crater)

    @property
    def centre_m(self) -> FloatArray:
        """(n, 3) mean of each crest's points."""
        return np.asarray(self.crest_m.mean(axis=1), dtype=np.float64)


def find_rims(craters: Craters, least_m: float, tiling: Tiling, smooth_m: FloatArray, surface_m: SingleArray) -> Rims:
    """Trace the crests of craters of diameter ``least_m`` or more by vertices (N, 3) without and with the relief."""
    chosen = np.flatnonzero(2.0 * craters.radius_m >= least_m)
    frames = crater_frames(craters)[chosen]
    faces = tiling.mesh.faces
    corners_m = tiling.mesh.vertices_m[faces]
    middles = corners_m.mean(axis=1)
    facing = tiling.up[faces].mean(axis=1)
    tree = cKDTree(middles)
    smooth_rims, crests, whole = [], [], []
    for crater, frame in zip(chosen, frames, strict=True):
        # Every vertex of a tile is within reach_m of its middle.
        near = tree.query_ball_point(craters.centre_m[crater], craters.radius_m[crater] + tiling.reach_m)
        tiles = np.sort(np.asarray(near, dtype=np.int64))
        far = np.linalg.norm(corners_m[tiles] - craters.centre_m[crater], axis=2) - craters.radius_m[crater]
        # A tile that intersects the rim has corners on both sides of it or within the bulge of a curved tile.
        across = (far.min(axis=1) < tiling.bulge_m) & (far.max(axis=1) > -tiling.bulge_m)
        tiles = tiles[across & (facing[tiles] @ frame[2] > 0.0)]
        ring = _ring(tiles, tiling, smooth_m, surface_m, craters.centre_m[crater], float(craters.radius_m[crater]))
        curve = _by_azimuth(ring, craters.centre_m[crater], frame)
        whole.append(curve is not None)
        if curve is not None:
            smooth_rims.append(curve[:, :3])
            crests.append(curve[:, 3:])
    kept = chosen[np.array(whole, dtype=bool)]
    crest_m = np.array(crests).reshape(-1, RIM_POINTS, 3)
    return Rims(
        kept,
        crest_m,
        _cut(craters, kept, np.array(smooth_rims).reshape(-1, RIM_POINTS, 3)),
        _plane_normals(crest_m, craters.axis_body[kept]),
        2.0 * craters.radius_m[kept],
        2.0 * craters.radius_m[kept] * craters.depth_ratio[kept],
        craters.degradation[kept],
    )


def _ring(
    tiles: IndexArray,
    tiling: Tiling,
    smooth_m: FloatArray,
    surface_m: SingleArray,
    centre_m: FloatArray,
    radius_m: float,
) -> FloatArray:
    """(K, 6) smooth and surface points where facet edges cross the crater's radius."""
    facets = tiling.facets(tiles)
    found = np.empty((_PER_FACET * len(facets), 6))
    count = edge_crossings(found, facets, smooth_m, surface_m, centre_m, radius_m)
    return found[:count]


def _by_azimuth(ring: FloatArray, centre_m: FloatArray, frame: FloatArray) -> FloatArray | None:
    """(72, 6) the ring interpolated at even azimuths; None if it has gaps, as at a thin end of a body."""
    if len(ring) < 8:
        return None
    offset = ring[:, :3] - centre_m
    # Sorted, and each point once: edges are visited from both facets.
    azimuth, order = np.unique(np.arctan2(offset @ frame[1], offset @ frame[0]), return_index=True)
    gaps = np.diff(np.concatenate([azimuth, azimuth[:1] + 2.0 * np.pi]))
    if gaps.max() > np.pi / 6.0:
        return None
    wanted = np.arange(RIM_POINTS) * (2.0 * np.pi / RIM_POINTS) - np.pi
    points = ring[order]
    return np.stack([np.interp(wanted, azimuth, column, period=2.0 * np.pi) for column in points.T], axis=1)


def _cut(craters: Craters, chosen: IndexArray, rims_m: FloatArray) -> BoolArray:
    """(n, 72) whether a point of a rim lies within the rim of a younger crater of the population."""
    cut = np.zeros(len(chosen) * RIM_POINTS, dtype=bool)
    if len(chosen):
        owner = np.repeat(chosen, RIM_POINTS)
        # Distances on the smooth surface, on which the radii of the craters are defined.
        within = cKDTree(rims_m.reshape(-1, 3)).query_ball_point(craters.centre_m, craters.radius_m)
        for younger, points in enumerate(within):
            rows = np.asarray(points, dtype=np.int64)
            # Craters are in the order of age: a higher number is younger.
            cut[rows[owner[rows] < younger]] = True
    return cut.reshape(-1, RIM_POINTS)


def _plane_normals(crest_m: FloatArray, up: FloatArray) -> FloatArray:
    """(n, 3) unit normals of least-squares planes through curves (n, K, 3), on the side of ``up``."""
    if len(crest_m) == 0:
        return np.zeros((0, 3))
    _, _, axes = np.linalg.svd(crest_m - crest_m.mean(axis=1, keepdims=True), full_matrices=False)
    # The right singular vector of the least singular value; its sign is arbitrary.
    normal = axes[:, 2]
    return np.asarray(normal * np.where(np.einsum("ni,ni->n", normal, up) < 0.0, -1.0, 1.0)[:, None])
