"""True craters of an image, from geometry: ellipses, visibility, illumination and degradation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.craters.rims import Rims
from boresight.scenarios.geometry import Ellipses, View
from boresight.scenarios.geometry.ellipse import fit_conics, sampson_distances

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
    rows, uv = _in_frame_at_all(rims, view)
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


def _in_frame_at_all(rims: Rims, view: View) -> tuple[IndexArray, FloatArray]:
    """Rows of the rims that face the camera with a point in the frame, and their pixels (n, K, 2)."""
    _, cosine_e = _cosines(rims.normal_body, rims.centre_m, view)
    rows = np.flatnonzero(cosine_e > _FACING)
    uv = view.camera.project(view.T_cam_body.transform(rims.crest_m[rows]))
    within = view.camera.contains(uv).any(axis=1) & np.isfinite(uv).all(axis=(1, 2))
    return rows[within], uv[within]


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
