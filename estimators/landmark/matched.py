"""The table of matched landmarks that landmark estimators hand to the campaign for scoring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.contract import Table
from estimators.landmark.database import LandmarkDatabase
from estimators.landmark.matching import squared_distances
from estimators.landmark.projection import project_landmarks
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]

_COVARIANCE_NAMES = ("sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2")


@dataclass(frozen=True, slots=True, eq=False)
class MatchedFrame:
    """Matches of a frame: its pose, (M,) rows of the data base and (M, 2) corners in the image."""

    T_cam_body: Pose
    landmark: NDArray[np.intp]
    uv_px: FloatArray


def matched_table(found: MatchedFrame, database: LandmarkDatabase, camera: Camera) -> Table:
    """One row for each matched landmark.

    Columns: ``landmark`` (row of the data base), ``u_px, v_px`` (its corner), ``d2_px`` (weighted squared distance of
    the corner to the landmark at the estimated pose), ``x_m, y_m, z_m`` and ``sxx_m2 ... szz_m2`` (the data base's
    mean and covariance).
    """
    landmark, uv = found.landmark, found.uv_px
    covariances = database.covariances_m2[landmark][:, *np.triu_indices(3)]
    table: dict[str, NDArray[np.generic]] = {"landmark": landmark, "u_px": uv[:, 0], "v_px": uv[:, 1]}
    table["d2_px"] = _distances(found, database, camera)
    table |= {name: database.means_m[landmark, axis] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
    table |= {name: covariances[:, axis] for axis, name in enumerate(_COVARIANCE_NAMES)}
    return table


def _distances(found: MatchedFrame, database: LandmarkDatabase, camera: Camera) -> FloatArray:
    projection = project_landmarks(database, camera, found.T_cam_body)
    offsets = found.uv_px - projection.uv_px[found.landmark]
    return squared_distances(offsets, projection.covariances_px2[found.landmark])
