"""Ellipses in images, as crater rims appear: points, conics and the projection of a plane rim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.errors import BoresightError
from scenarios.geometry.vectors import plane_axes
from scenarios.geometry.view import View

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """Ellipses of one image: equation (2) of Cheng et al. (2003).

    Parameters
    ----------
    centre_px
        (n, 2) column and row.
    semi_axes_px
        (n, 2) the longer one first.
    angle_rad
        (n,) from the column axis to the longer one, towards the row axis: in [0, pi).
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
        """No ellipse at all."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))

    @classmethod
    def joined(cls, parts: Sequence[Ellipses]) -> Ellipses:
        """All ellipses of some sets, one set after the other."""
        return cls(
            np.concatenate([part.centre_px for part in parts]),
            np.concatenate([part.semi_axes_px for part in parts]),
            np.concatenate([part.angle_rad for part in parts]),
        )

    @property
    def radius_px(self) -> FloatArray:
        """(n,) geometric mean of the semi-axes: that of the circle of equal area."""
        return np.asarray(np.sqrt(self.semi_axes_px.prod(axis=1)), dtype=np.float64)

    def points(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Spread points over each rim: (n, count, 2) pixels and (n, count, 2) outward unit normals, by equation (2)."""
        t = np.arange(count) * (2.0 * np.pi / count)
        along = self.semi_axes_px[:, :1] * np.cos(t)
        across = self.semi_axes_px[:, 1:] * np.sin(t)
        normal = np.stack([self.semi_axes_px[:, 1:] * np.cos(t), self.semi_axes_px[:, :1] * np.sin(t)], axis=-1)
        turn = self._turns()
        points = np.einsum("nij,nkj->nki", turn, np.stack([along, across], axis=-1)) + self.centre_px[:, None]
        normal = np.einsum("nij,nkj->nki", turn, normal)
        return points, normal / np.linalg.norm(normal, axis=-1, keepdims=True)

    def conics(self) -> FloatArray:
        """(n, 3, 3) symmetric matrices C with x^T C x = 0 on the rim, x = (u, v, 1), and negative inside."""
        turn = self._turns()
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

        Raises
        ------
        BoresightError
            If one of them is not a real ellipse.
        """
        found, real = cls.among(conics)
        if not real.all():
            raise BoresightError(f"conic {int(np.argmin(real))} is not a real ellipse")
        return found

    @classmethod
    def among(cls, conics: FloatArray) -> tuple[Ellipses, BoolArray]:
        """Read those of (n, 3, 3) conics of any scale that are real ellipses, and tell (n,) which they are.

        What rounding leaves without a real point or an axis is none: no other test of a conic agrees with this one.
        """
        conics = np.asarray(conics, dtype=np.float64)
        conics = conics * np.where(np.trace(conics[:, :2, :2], axis1=1, axis2=2) < 0.0, -1.0, 1.0)[:, None, None]
        real = np.asarray(np.isfinite(conics).all(axis=(1, 2)), dtype=np.bool_)
        real[real] = np.linalg.det(conics[real, :2, :2]) > 0.0
        kept = conics[real]
        centre = -np.linalg.solve(kept[:, :2, :2], kept[:, :2, 2:])[:, :, 0]
        scale = np.einsum("ni,ni->n", kept[:, 2, :2], centre) + kept[:, 2, 2]
        inside = scale < 0.0
        real[real] = inside
        values, vectors = np.linalg.eigh(kept[inside, :2, :2] / -scale[inside, None, None])
        has_axes = values[:, 0] > 0.0
        real[real] = has_axes
        longer = vectors[has_axes, :, 0]  # eigh: ascending, so that the first has the longest axis
        semi_axes = np.asarray(1.0 / np.sqrt(values[has_axes]), dtype=np.float64)
        angle = np.arctan2(longer[:, 1], longer[:, 0]) % np.pi
        return cls(centre[inside][has_axes], semi_axes, angle), real

    def _turns(self) -> FloatArray:
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def project_circles(view: View, centre_body_m: FloatArray, normal_body: FloatArray, radius_m: FloatArray) -> Ellipses:
    """Project circles of the body frame into an image: the plane rims of ideal craters.

    A point of circle i is H (cos t, sin t, 1) in the image with H = K [r e1, r e2, c] in camera axes, so that its
    conic is H^-T diag(1, 1, -1) H^-1.

    Parameters
    ----------
    centre_body_m, normal_body, radius_m
        (n, 3), (n, 3) unit vectors across the rims, and (n,). All circles must lie in front of the camera.

    Raises
    ------
    BoresightError
        If a circle has no elliptic image: it is seen edge-on or reaches behind the camera.
    """
    rotation, translation = view.T_cam_body.rotation, view.T_cam_body.translation_m
    first, second = plane_axes(normal_body)
    radius = np.asarray(radius_m, dtype=np.float64)[:, None]
    columns = [first * radius @ rotation.T, second * radius @ rotation.T, centre_body_m @ rotation.T + translation]
    maps = view.camera.matrix @ np.stack(columns, axis=-1)
    inverse = np.linalg.inv(maps)
    return Ellipses.from_conics(np.swapaxes(inverse, 1, 2) @ np.diag([1.0, 1.0, -1.0]) @ inverse)
