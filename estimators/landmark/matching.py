"""Match landmarks with corners by proximity: reciprocal nearest neighbours, equation (14)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.contract import Table
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.projection import project_landmarks
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose

IndexArray = NDArray[np.intp]

_POINT_COLUMNS = ("x_m", "y_m", "z_m", "sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2")


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Matched landmarks (M,), ascending rows of the data base, and corners (M,), rows of the list of corners.

    ``d2`` (M,) are the covariance-weighted squared distances.
    """

    landmark: IndexArray
    corner: IndexArray
    d2: FloatArray

    def __len__(self) -> int:
        return len(self.landmark)

    def same_pairs(self, other: Matches) -> bool:
        """Return whether both contain the same pairs, regardless of distances."""
        return np.array_equal(self.landmark, other.landmark) and np.array_equal(self.corner, other.corner)


def match_landmarks(
    uv_px: FloatArray,
    covariances_px2: FloatArray,
    visible: NDArray[np.bool_],
    corners_px: FloatArray,
    d2_max: float = 36.0,
) -> Matches:
    """Match each visible landmark with its nearest corner, if no other landmark is nearer to that corner.

    ``uv_px`` (N, 2) and ``covariances_px2`` (N, 2, 2) are landmarks in the image, of which those in ``visible`` (N,)
    may be matched, and ``corners_px`` (M, 2) the observed corners. ``d2_max`` is the upper limit of the weighted
    squared distance; 36 is 6 standard deviations.
    """
    candidates = np.flatnonzero(visible)
    if not candidates.size or not len(corners_px):
        none = np.empty(0, dtype=np.intp)
        return Matches(none, none, np.empty(0))
    d2 = weighted_distances(uv_px[candidates], covariances_px2[candidates], corners_px)
    nearest_corner = d2.argmin(axis=1)
    nearest_landmark = d2.argmin(axis=0)
    rows = np.arange(len(candidates))
    best = d2[rows, nearest_corner]
    # Reciprocal, as in section 3.3: the corner does not lie closer to another landmark. Both distances are weighted
    # with the covariance of the landmark in question.
    paired = (nearest_landmark[nearest_corner] == rows) & (best < d2_max)
    return Matches(candidates[paired], nearest_corner[paired], best[paired])


def weighted_distances(uv_px: FloatArray, covariances_px2: FloatArray, corners_px: FloatArray) -> FloatArray:
    """d2 (N, M) of each of N projected landmarks to each of M corners."""
    weight = inverse_2x2(covariances_px2)
    du = corners_px[None, :, 0] - uv_px[:, None, 0]
    dv = corners_px[None, :, 1] - uv_px[:, None, 1]
    a, b, c = (weight[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    d2: FloatArray = a * du * du + 2.0 * b * du * dv + c * dv * dv  # eq. (14)
    return d2


def squared_distances(offsets_px: FloatArray, covariances_px2: FloatArray) -> FloatArray:
    """d2 (N,) of offsets (N, 2) weighted by covariances (N, 2, 2)."""
    d2: FloatArray = np.einsum("ni,nij,nj->n", offsets_px, inverse_2x2(covariances_px2), offsets_px)  # eq. (14)
    return d2


def inverse_2x2(covariances_px2: FloatArray) -> FloatArray:
    """Inverses (..., 2, 2) of symmetric matrices (..., 2, 2)."""
    return inverse_and_determinant(covariances_px2)[0]


def inverse_and_determinant(covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses (..., 2, 2) and determinants (...) of symmetric matrices (..., 2, 2)."""
    a, b, c = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    determinant = a * c - b * b
    # Written out: far faster than LAPACK for many 2 x 2 matrices.
    adjugate = np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    return adjugate / determinant[..., None, None], determinant  # eq. (19)


def matched_table(
    landmark: IndexArray, uv_px: FloatArray, database: LandmarkDatabase, camera: Camera, T_cam_body: Pose
) -> Table:
    """Return the table of matched landmarks that the campaign scores, one row each.

    ``landmark`` (M,) are rows of the data base, ``uv_px`` (M, 2) their corners in the image. Columns: ``landmark``,
    ``u_px, v_px`` (its corner), ``d2_px`` (weighted squared distance of the corner to the landmark at the estimated
    pose), ``x_m, y_m, z_m`` and ``sxx_m2 ... szz_m2`` (the data base's mean and covariance).
    """
    projection = project_landmarks(database, camera, T_cam_body)
    d2 = squared_distances(uv_px - projection.uv_px[landmark], projection.covariances_px2[landmark])
    table: dict[str, NDArray[np.generic]] = {"landmark": landmark, "u_px": uv_px[:, 0], "v_px": uv_px[:, 1]}
    table["d2_px"] = d2
    return table | point_columns(database.means_m[landmark], database.covariances_m2[landmark])


def point_columns(points_m: FloatArray, covariances_m2: FloatArray) -> dict[str, NDArray[np.generic]]:
    """Return points (M, 3) and the upper triangles of their covariances (M, 3, 3) as columns of a table."""
    columns = np.column_stack([points_m, covariances_m2[:, *np.triu_indices(3)]])
    return dict(zip(_POINT_COLUMNS, columns.T, strict=True))
