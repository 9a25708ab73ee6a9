"""Ellipses in images: conic matrices, least-squares fits, distances, and the projection of circular crater rims."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry.camera import View
from boresight.scenarios.geometry.pose import plane_axes


def fit_conics(points: FloatArray, weights: FloatArray, ridge: float = 1e-12) -> FloatArray:
    """Fit an ellipse to each set of points (m, k, 2) by direct least squares (Halir and Flusser 1998).

    Return conics (m, 3, 3), NaN where there is no ellipse. Algebraic distances under 4 a c - b^2 = 1; points are
    centred and scaled for conditioning. Entries whose ``weights`` (m, k) are 0 are ignored. ``ridge`` times its trace
    is added to the scatter matrix of the linear terms, which is singular for collinear points.
    """
    # The floors keep sets without weight finite; they have no ellipse.
    total = np.maximum(weights.sum(axis=1), 1e-12)
    shift = np.einsum("mk,mki->mi", weights, points) / total[:, None]
    moved = points - shift[:, None]
    scale = np.sqrt(np.einsum("mk,mki->m", weights, moved**2) / total)
    moved = moved / np.maximum(scale, 1e-9)[:, None, None]
    x, y = moved[..., 0], moved[..., 1]
    quadratic = np.stack([x * x, x * y, y * y], axis=-1)
    linear = np.stack([x, y, np.ones_like(x)], axis=-1)
    # S1, S2 and S3 of Halir and Flusser: the scatter matrix of quadratic and linear terms, in blocks.
    s1 = np.einsum("mk,mki,mkj->mij", weights, quadratic, quadratic)
    s2 = np.einsum("mk,mki,mkj->mij", weights, quadratic, linear)
    s3 = np.einsum("mk,mki,mkj->mij", weights, linear, linear)
    best, tail = _constrained(s1, s2, s3, ridge)
    conics = _matrix(best, tail)
    # Back to pixels: with x' = F x the conic is F^T C F.
    frame = np.zeros((len(points), 3, 3))
    frame[:, 0, 0] = frame[:, 1, 1] = 1.0 / np.maximum(scale, 1e-9)
    frame[:, :2, 2] = -shift / np.maximum(scale, 1e-9)[:, None]
    frame[:, 2, 2] = 1.0
    return np.asarray(np.swapaxes(frame, 1, 2) @ conics @ frame, dtype=np.float64)


def _constrained(s1: FloatArray, s2: FloatArray, s3: FloatArray, ridge: float) -> tuple[FloatArray, FloatArray]:
    """Minimise over conics with 4 a c - b^2 = 1: the quadratic and the linear coefficients."""
    added = ridge * np.trace(s3, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
    # The best linear terms for given quadratic ones: -S3^-1 S2^T.
    to_linear = -np.linalg.solve(s3 + added, np.swapaxes(s2, 1, 2))
    reduced = s1 + s2 @ to_linear
    # C1^-1 (S1 - S2 S3^-1 S2^T), with C1 the matrix of 4 a c - b^2: an eigenvalue problem of three unknowns.
    turned = np.stack([reduced[:, 2] / 2.0, -reduced[:, 1], reduced[:, 0] / 2.0], axis=1)
    values, vectors = np.linalg.eig(turned)
    real = vectors.real
    # One eigenvector alone is an ellipse; rounding can make others appear so, of which the least residual counts.
    definite = 4.0 * real[:, 0] * real[:, 2] - real[:, 1] ** 2
    usable = (definite > 0.0) & (np.abs(values.imag) < 1e-8)
    choice = np.argmin(np.where(usable, np.abs(values.real), np.inf), axis=1)
    best = np.take_along_axis(real, choice[:, None, None], axis=2)[:, :, 0]
    best[~usable.any(axis=1)] = np.nan
    return best, np.einsum("mij,mj->mi", to_linear, best)


def _matrix(quadratic: FloatArray, linear: FloatArray) -> FloatArray:
    """Return the symmetric matrix of a x^2 + b x y + c y^2 + d x + e y + f."""
    a, b, c = quadratic.T
    d, e, f = linear.T
    rows = [[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def sampson_distances(points: FloatArray, conics: FloatArray) -> FloatArray:
    """Distances (m, k) of points from conics to first order (Sampson 1982), px; positive outside."""
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    pulled = np.einsum("mij,mkj->mki", conics, homogeneous)
    value = np.einsum("mki,mki->mk", pulled, homogeneous)
    # The gradient of x^T C x by the pixel is twice the first two components of C x.
    slope = 2.0 * np.linalg.norm(pulled[..., :2], axis=-1)
    # A conic is defined up to its sign; with a positive trace the form is negative inside.
    sign = np.where(np.trace(conics[:, :2, :2], axis1=1, axis2=2) < 0.0, -1.0, 1.0)
    return np.asarray(sign[:, None] * value / np.maximum(slope, 1e-12), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """n ellipses of one image: equation (2) of Cheng et al. (2003).

    ``centre_px`` (n, 2) is column and row; ``semi_axes_px`` (n, 2) has the longer one first, ``angle_rad`` (n,) is its
    angle from the column axis towards the row axis, in [0, pi).
    """

    centre_px: FloatArray
    semi_axes_px: FloatArray
    angle_rad: FloatArray

    def __post_init__(self) -> None:
        n = len(self.angle_rad)
        if self.centre_px.shape != (n, 2) or self.semi_axes_px.shape != (n, 2):
            raise BoresightError(
                f"ellipses need (n, 2) centres, (n, 2) semi-axes and (n,) angles, not {self.centre_px.shape},"
                f" {self.semi_axes_px.shape} and {self.angle_rad.shape}"
            )

    def __len__(self) -> int:
        return len(self.angle_rad)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Ellipses:
        return Ellipses(self.centre_px[rows], self.semi_axes_px[rows], self.angle_rad[rows])

    @classmethod
    def none(cls) -> Ellipses:
        """Make an empty set."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))

    @classmethod
    def joined(cls, parts: Sequence[Ellipses]) -> Ellipses:
        """Concatenate sets of ellipses."""
        return cls(
            np.concatenate([part.centre_px for part in parts]),
            np.concatenate([part.semi_axes_px for part in parts]),
            np.concatenate([part.angle_rad for part in parts]),
        )

    @property
    def radius_px(self) -> FloatArray:
        """(n,) geometric mean of the semi-axes: radius of the circle of equal area."""
        return np.asarray(np.sqrt(self.semi_axes_px.prod(axis=1)), dtype=np.float64)

    def points(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Spread points over each rim: (n, count, 2) pixels and (n, count, 2) outward unit normals, by equation (2)."""
        t = np.arange(count) * (2.0 * np.pi / count)
        along = self.semi_axes_px[:, :1] * np.cos(t)
        across = self.semi_axes_px[:, 1:] * np.sin(t)
        # Gradient of (x / a)^2 + (y / b)^2 at (a cos t, b sin t), times a b.
        normal = np.stack([self.semi_axes_px[:, 1:] * np.cos(t), self.semi_axes_px[:, :1] * np.sin(t)], axis=-1)
        turn = self._turns()
        points = np.einsum("nij,nkj->nki", turn, np.stack([along, across], axis=-1)) + self.centre_px[:, None]
        normal = np.einsum("nij,nkj->nki", turn, normal)
        return points, normal / np.linalg.norm(normal, axis=-1, keepdims=True)

    def conics(self) -> FloatArray:
        """(n, 3, 3) symmetric matrices C with x^T C x = 0 on the rim, x = (u, v, 1), and negative inside."""
        turn = self._turns()
        # R diag(1 / a^2, 1 / b^2) R^T.
        shape = turn @ (np.swapaxes(turn, 1, 2) / self.semi_axes_px[:, :, None] ** 2)
        pulled = np.einsum("nij,nj->ni", shape, self.centre_px)
        last = np.einsum("ni,ni->n", pulled, self.centre_px) - 1.0
        return np.concatenate(
            [
                np.concatenate([shape, -pulled[:, :, None]], axis=2),
                np.concatenate([-pulled, last[:, None]], axis=1)[:, None],
            ],
            axis=1,
        )

    @classmethod
    def from_conics(cls, conics: FloatArray) -> Ellipses:
        """Read centres and axes from (n, 3, 3) conics of any scale.

        Raise BoresightError if one of them is not a real ellipse.
        """
        found, real = cls.among(conics)
        if not real.all():
            raise BoresightError(f"conic {int(np.argmin(real))} is not a real ellipse")
        return found

    @classmethod
    def among(cls, conics: FloatArray) -> tuple[Ellipses, BoolArray]:
        """Convert those of (n, 3, 3) conics of any scale that are real ellipses; also return (n,) which they are.

        This is the only test for real ellipses: other tests can differ for conics that are degenerate within rounding.
        """
        conics = np.asarray(conics, dtype=np.float64)
        conics = conics * np.where(np.trace(conics[:, :2, :2], axis1=1, axis2=2) < 0.0, -1.0, 1.0)[:, None, None]
        real = np.asarray(np.isfinite(conics).all(axis=(1, 2)), dtype=np.bool_)
        real[real] = np.linalg.det(conics[real, :2, :2]) > 0.0
        kept = conics[real]
        # The gradient vanishes in the centre; the form's value there is negative for a real ellipse.
        centre = -np.linalg.solve(kept[:, :2, :2], kept[:, :2, 2:])[:, :, 0]
        scale = np.einsum("ni,ni->n", kept[:, 2, :2], centre) + kept[:, 2, 2]
        inside = scale < 0.0
        real[real] = inside
        # Scaled so that (x - c)^T S (x - c) = 1 on the rim: eigenvalues are 1 / semi-axis^2.
        values, vectors = np.linalg.eigh(kept[inside, :2, :2] / -scale[inside, None, None])
        has_axes = values[:, 0] > 0.0
        real[real] = has_axes
        longer = vectors[has_axes, :, 0]  # eigh: ascending eigenvalues, so that the first belongs to the longest axis
        semi_axes = np.asarray(1.0 / np.sqrt(values[has_axes]), dtype=np.float64)
        angle = np.arctan2(longer[:, 1], longer[:, 0]) % np.pi
        return cls(centre[inside][has_axes], semi_axes, angle), real

    def _turns(self) -> FloatArray:
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def project_circles(view: View, centre_body_m: FloatArray, normal_body: FloatArray, radius_m: FloatArray) -> Ellipses:
    """Project circles of the body frame (plane rims of ideal craters) to ellipses in the image of the pinhole.

    Circles have centres (n, 3), unit normals (n, 3) of their planes and radii (n,); distortion of the lens is not
    applied. A point of circle i is H (cos t, sin t, 1) in the image, H = K [r e1, r e2, c] in camera axes, so that its
    conic is H^-T diag(1, 1, -1) H^-1. Raise BoresightError if a circle has no elliptic image: it is seen edge-on or
    reaches behind the camera.
    """
    rotation, translation = view.T_cam_body.rotation, view.T_cam_body.translation_m
    first, second = plane_axes(normal_body)
    radius = np.asarray(radius_m, dtype=np.float64)[:, None]
    columns = [first * radius @ rotation.T, second * radius @ rotation.T, centre_body_m @ rotation.T + translation]
    maps = view.camera.matrix @ np.stack(columns, axis=-1)
    inverse = np.linalg.inv(maps)
    return Ellipses.from_conics(np.swapaxes(inverse, 1, 2) @ np.diag([1.0, 1.0, -1.0]) @ inverse)
