"""Crest curves of craters on the surface that is rendered, and the true craters of an image, from geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray, SingleArray
from boresight.scenarios.craters.kernels import edge_crossings
from boresight.scenarios.craters.relief import Craters, crater_frames
from boresight.scenarios.craters.tiles import Tiling
from boresight.scenarios.geometry import Ellipses, View
from boresight.scenarios.geometry.ellipse import fit_conics, sampson_distances

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
        # Smooth and surface points, (K, 6), where edges of facets cross the crater's radius.
        facets, centre_m = tiling.facets(tiles), craters.centre_m[crater]
        ring = np.empty((_PER_FACET * len(facets), 6))
        count = edge_crossings(ring, facets, smooth_m, surface_m, centre_m, float(craters.radius_m[crater]))
        curve = _by_azimuth(ring[:count], centre_m, frame)
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


LEAST_DIAMETER_PX = 12.0
LEAST_VISIBLE, LEAST_IN_FRAME, LEAST_LIT = 0.9, 0.95, 0.5  # shares of the crest
MOST_EMISSION_DEG, INCIDENCE_DEG = 60.0, (20.0, 75.0)
MOST_DEGRADATION, MOST_CUT = 0.6, 0.25  # MOST_CUT: share of the crest that younger craters removed
MOST_DEVIATION, LEAST_AXIS_RATIO = 0.01, 0.5  # of a clean crater; deviation in radii of the ellipse

_FACING = -0.2  # cosine: no point of a crest is visible if its plane faces away by more
_LIFT_M, _LIFT = 1.0, 0.01  # offset of a crest point from the adjacent facets: metres, and in radii
_SAME_M, _SAME = 15.0, 0.03  # tolerance of the distance to a visible crest point: metres, and in radii


class SurfaceRayTracer(Protocol):
    """Ray tracer of the rendered surface."""

    def first_points(self, view: View, uv_px: FloatArray) -> FloatArray:
        """(N, 3) first intersections of the lines of sight at pixels (N, 2) with the body; NaN for misses."""
        ...

    def clear(self, view: View, points_m: FloatArray, direction: FloatArray) -> BoolArray:
        """(N,) whether rays from points (N, 3) along a unit vector (3,) are unobstructed."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CraterTruth:
    """The n craters of an image with a visible crest point, from the oldest to the youngest; arrays are (n,).

    ``crater`` is the number in the population. ``ellipses`` are least-squares fits of the projected crests, without the
    points that younger craters removed if at least half remain; ``deviation`` is the RMS distance of the crest from its
    ellipse, in radii of the ellipse. ``centre_m`` (n, 3) are means of the crest points, body frame. ``visible``,
    ``in_frame``, ``lit`` and ``cut`` are shares of the crest: not occluded, within the image, in sunlight, removed by
    younger craters. The angles of the camera and the Sun are from the normal of the crest's plane.
    """

    crater: IndexArray
    ellipses: Ellipses
    deviation: FloatArray
    centre_m: FloatArray
    diameter_m: FloatArray
    depth_m: FloatArray
    degradation: FloatArray
    visible: FloatArray
    in_frame: FloatArray
    lit: FloatArray
    cut: FloatArray
    emission_deg: FloatArray
    incidence_deg: FloatArray

    def __len__(self) -> int:
        return len(self.crater)

    @property
    def detectable(self) -> BoolArray:
        """(n,) whether size, visibility, illumination, degradation and overlap are within the module's limits."""
        found: BoolArray = (
            (2.0 * self.ellipses.radius_px >= LEAST_DIAMETER_PX)
            & (self.visible >= LEAST_VISIBLE)
            & (self.in_frame >= LEAST_IN_FRAME)
            & (self.lit >= LEAST_LIT)
            & (self.emission_deg < MOST_EMISSION_DEG)
            & (self.incidence_deg >= INCIDENCE_DEG[0])
            & (self.incidence_deg <= INCIDENCE_DEG[1])
            & (self.degradation <= MOST_DEGRADATION)
            & (self.cut <= MOST_CUT)
        )
        return found

    @property
    def clean(self) -> BoolArray:
        """(n,) detectable craters whose crest is within 1 % of an ellipse with an axis ratio above 0.5."""
        ratio = self.ellipses.semi_axes_px[:, 1] / self.ellipses.semi_axes_px[:, 0]
        found: BoolArray = self.detectable & (self.deviation <= MOST_DEVIATION) & (ratio > LEAST_AXIS_RATIO)
        return found


def crater_truth(rims: Rims, view: View, sight: SurfaceRayTracer) -> CraterTruth:
    """Find the craters of a view.

    A crest is the curve at the crater's radius on the rendered surface; a point of it is visible if the line of sight
    to it intersects the surface there first.
    """
    # Rims that face the camera with a point in the frame.
    rows = np.flatnonzero(_cosines(rims.normal_body, rims.centre_m, view)[1] > _FACING)
    uv = view.camera.project(view.T_cam_body.transform(rims.crest_m[rows]))
    within = view.camera.contains(uv).any(axis=1) & np.isfinite(uv).all(axis=(1, 2))
    rows, uv = rows[within], uv[within]
    crest_m, n, k = rims.crest_m[rows], len(rows), rims.crest_m.shape[1]
    radius_m = 0.5 * rims.diameter_m[rows]
    met_m = sight.first_points(view, uv.reshape(-1, 2))
    camera_m = view.T_cam_body.camera_position_m
    distance = np.linalg.norm(crest_m - camera_m, axis=2)
    met = np.linalg.norm(met_m - camera_m, axis=1).reshape(n, k)
    # NaN (a miss next to a crest on the limb) compares false, so that the point counts as visible.
    visible = ~(met < distance - (_SAME_M + _SAME * radius_m[:, None]))
    in_frame = view.camera.contains(uv)
    # Above the facets next to the crest, which is interpolated between vertices.
    lifted = crest_m + (rims.normal_body[rows] * (_LIFT_M + _LIFT * radius_m)[:, None])[:, None]
    lit = sight.clear(view, lifted.reshape(-1, 3), view.sun_dir_body).reshape(n, k)
    cosine_i, cosine_e = _cosines(rims.normal_body[rows], crest_m.mean(axis=1), view)
    # A crater whose plane faces away from the Sun counts as dark as a whole.
    lit &= (cosine_i > 0.0)[:, None]
    cut = rims.cut[rows]
    # A crest of which more than half is gone is fitted as a whole.
    used = ~cut | (cut.mean(axis=1) > 0.5)[:, None]
    conics = fit_conics(uv, used.astype(np.float64))
    kept = (visible & in_frame).any(axis=1)
    # Degenerate conics are left out by the same test that reads the ellipses.
    kept[kept] = Ellipses.among(conics[kept])[1]
    ellipses = Ellipses.from_conics(conics[kept])
    return CraterTruth(
        crater=rims.crater[rows][kept],
        ellipses=ellipses,
        deviation=_deviation(ellipses, uv[kept], used[kept]),
        centre_m=np.asarray(crest_m.mean(axis=1)[kept], dtype=np.float64),
        diameter_m=rims.diameter_m[rows][kept],
        depth_m=rims.depth_m[rows][kept],
        degradation=rims.degradation[rows][kept],
        visible=visible.mean(axis=1)[kept],
        in_frame=in_frame.mean(axis=1)[kept],
        lit=lit.mean(axis=1)[kept],
        cut=cut.mean(axis=1)[kept],
        emission_deg=np.degrees(np.arccos(cosine_e))[kept],
        incidence_deg=np.degrees(np.arccos(cosine_i))[kept],
    )


def _cosines(normal: FloatArray, centre_m: FloatArray, view: View) -> tuple[FloatArray, FloatArray]:
    """(n,) cosines of incidence and emission."""
    to_camera = view.T_cam_body.camera_position_m - centre_m
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    cosine_e = np.clip(np.einsum("ni,ni->n", normal, to_camera), -1.0, 1.0)
    return np.clip(normal @ view.sun_dir_body, -1.0, 1.0), cosine_e


def _deviation(ellipses: Ellipses, uv_px: FloatArray, used: BoolArray) -> FloatArray:
    """(n,) RMS distance of the used points of curves (n, K, 2) from their ellipses, in radii."""
    apart = sampson_distances(uv_px, ellipses.conics())
    mean_square = (apart**2 * used).sum(axis=1) / np.maximum(used.sum(axis=1), 1)
    return np.asarray(np.sqrt(mean_square) / ellipses.radius_px, dtype=np.float64)
