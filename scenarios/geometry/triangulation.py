"""Triangulation of points from several lines of sight: the normal equations, and the distances of the lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class LinesOfSight:
    """K lines in one frame: camera positions (K, 3), and unit vectors (K, 3) from the camera towards the point."""

    origins_m: FloatArray
    directions: FloatArray

    def projectors(self) -> FloatArray:
        """(K, 3, 3) matrices ``I - d d^T``, which project onto the plane across each line."""
        return np.asarray(np.eye(3) - self.directions[:, :, None] * self.directions[:, None, :])

    def distances(self, points_m: FloatArray) -> FloatArray:
        """(K,) distances, m, of each line from its point (K, 3)."""
        offsets = np.einsum("kij,kj->ki", self.projectors(), points_m - self.origins_m)
        return np.asarray(np.linalg.norm(offsets, axis=1))


def triangulation_equations(
    lines: LinesOfSight,
    point: IndexArray,
    prior: tuple[FloatArray, FloatArray],
    weights: Sequence[FloatArray] = (),
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations, (L, 3, 3) and (L, 3), of the points that lie nearest their lines of sight.

    Each point x minimises the sum of ``w |(I - d d^T) (x - c)|^2`` over its lines, which start at c along d, plus its
    prior: ``(sum w (I - d d^T) + A) x = sum w (I - d d^T) c + b``. With one line alone, or with parallel lines, the
    matrix is singular unless the prior holds the point along them. Where w is the information of a line, 1 / m^2, the
    inverse of the matrix is the covariance of the point, m^2.

    ``point`` (K,) is the row of the point of each line. ``prior`` are A (L, 3, 3) and b (L, 3), zeros where nothing is
    known beforehand. ``weights`` are factors (K,) of w, multiplied in their order; none for w = 1.
    """
    # An error along a line of sight costs nothing: d is in the null space of I - d d^T.
    information = lines.projectors()
    for weight in weights:
        information = information * weight[:, None, None]
    matrix, right = prior[0].copy(), prior[1].copy()
    # add.at, because a point has several lines: plain indexing would keep the last of them alone.
    np.add.at(matrix, point, information)
    np.add.at(right, point, np.einsum("kij,kj->ki", information, lines.origins_m))
    return matrix, right
