"""What came about between an image and its pose, and the table of the maplets that were found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.contract import Stage, Table
from estimators.landmark.pose.posterior import Posterior
from estimators.maplets.database import MapletDatabase
from estimators.maplets.matching import MapletMatches
from scenarios.geometry import Camera

FloatArray = NDArray[np.float64]

_POSITION_NAMES = ("x_m", "y_m", "z_m")
_COVARIANCE_NAMES = ("sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2")


@dataclass(frozen=True, slots=True, eq=False)
class MapletFit:
    """One round: the maplets that were found and the pose from them."""

    found: MapletMatches
    posterior: Posterior


@dataclass(frozen=True, slots=True, eq=False)
class MapletRecognition:
    """What came about between one image and its pose.

    Parameters
    ----------
    stages
        Poses after the alignment, the correlation and the refinement, as far as it came.
    fits
        Rounds of correlating and solving: the correlation, then the refinement.
    timings_s
        Wall time by stage.
    failure
        Why there is no pose; empty when there is one.
    """

    stages: tuple[Stage, ...]
    fits: tuple[MapletFit, ...]
    timings_s: Mapping[str, float]
    failure: str = ""


def maplet_table(fit: MapletFit, database: MapletDatabase, camera: Camera) -> Table:
    """One row for each maplet that a round found.

    Columns: ``landmark`` (row of the data base), ``u_px, v_px`` (where its anchor was found), ``correlation``,
    ``d2_px`` (weighted squared distance to the anchor at the estimated pose), ``x_m, y_m, z_m`` (the anchor) and
    ``sxx_m2 ... szz_m2`` (covariance of the surface point that is seen there, about the anchor).
    """
    found = fit.found
    table: dict[str, NDArray[np.generic]] = {
        "landmark": found.maplet,
        "u_px": found.uv_px[:, 0],
        "v_px": found.uv_px[:, 1],
        "correlation": found.correlation,
        "d2_px": fit.posterior.d2,
    }
    table |= {name: database.anchors_m[found.maplet, axis] for axis, name in enumerate(_POSITION_NAMES)}
    upper = surface_covariances(fit, database, camera)[:, *np.triu_indices(3)]
    return table | {name: upper[:, axis] for axis, name in enumerate(_COVARIANCE_NAMES)}


def surface_covariances(fit: MapletFit, database: MapletDatabase, camera: Camera) -> FloatArray:
    """Covariances (M, 3, 3), body frame, m^2, of the surface points that are seen where the anchors were found.

    A displacement in the image moves the point on the plane of its maplet: across the line of sight by its own size,
    and along it by what the slope of the plane adds. Across the plane the uncertainty of the heights counts.
    """
    pose, maplet = fit.posterior.T_cam_body, fit.found.maplet
    points = pose.transform(database.anchors_m[maplet])
    normals = pose.rotate(database.axes[maplet, 2])
    sight = points / np.linalg.norm(points, axis=1, keepdims=True)
    across = np.zeros((len(maplet), 3, 2))
    across[:, 0, 0], across[:, 1, 1] = points[:, 2] / camera.fx_px, points[:, 2] / camera.fy_px
    slope = np.einsum("ni,nij->nj", normals, across) / np.einsum("ni,ni->n", normals, sight)[:, None]
    in_plane = across - sight[:, :, None] * slope[:, None, :]
    in_image = fit.posterior.scale2 * fit.found.covariances_px2
    height = fit.found.height_sigma_m**2 * normals[:, :, None] * normals[:, None, :]
    in_camera = in_plane @ in_image @ np.swapaxes(in_plane, 1, 2) + height
    covariances: FloatArray = pose.rotation.T @ in_camera @ pose.rotation
    return covariances
