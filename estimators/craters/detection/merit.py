"""The merit of a rim in the image, equations (3) and (4) of Cheng et al. (2003), and its derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Ellipses, pixel_to_opencv

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class GradientField:
    """A field of vectors over the pixels, (H, W, 2), interpolated bilinearly between their centres."""

    values: FloatArray

    @classmethod
    def of_gradient(cls, along_u: NDArray[np.float32], along_v: NDArray[np.float32], floor: float) -> GradientField:
        """Divide gradients g by sqrt(g^2 + floor^2): unit vectors where ``floor`` is 0."""
        g = np.stack([along_u, along_v], axis=-1).astype(np.float64)
        length = np.sqrt(np.einsum("hwi,hwi->hw", g, g) + floor**2)
        return cls(g / np.maximum(length, 1e-12)[..., None])

    def at(self, uv_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Interpolate at (..., 2) pixels: vectors (..., 2) and their derivatives (..., 2, 2) by the pixel.

        Beyond the outermost pixel centres the field is constant.
        """
        height, width = self.values.shape[:2]
        place = pixel_to_opencv(uv_px)
        top = np.array([width - 1.0, height - 1.0])
        held = np.clip(place, 0.0, top)
        # At the last row or column the cell before it is used, so that its four corners exist.
        cell = np.minimum(np.floor(held), top - 1.0).astype(np.int64)
        f = held - cell
        u, v = cell[..., 0], cell[..., 1]
        a, b = self.values[v, u], self.values[v, u + 1]
        c, d = self.values[v + 1, u], self.values[v + 1, u + 1]
        fu, fv = f[..., :1], f[..., 1:]
        # Bilinear: along the columns in both rows, then along the rows.
        upper, lower = a + fu * (b - a), c + fu * (d - c)
        by_u, by_v = (b - a) + fv * (d - c - b + a), lower - upper
        # Where the place was clipped, the field does not change with the coordinate.
        inside = (place == held)[..., None, :]
        return upper + fv * (lower - upper), np.stack([by_u, by_v], axis=-1) * inside


@dataclass(frozen=True, slots=True, eq=False)
class RimSamples:
    """Points (n, k, 2) of n rims and their outward unit normals (n, k, 2).

    Their derivatives by (u0, v0, a, b, angle), in pixels and radians, are (n, k, 2, 5).
    """

    points: FloatArray
    normals: FloatArray
    points_by: FloatArray
    normals_by: FloatArray

    @classmethod
    def of(cls, ellipses: Ellipses, count: int) -> RimSamples:
        """Sample the rims by equation (2)."""
        t = np.arange(count) * (2.0 * np.pi / count)
        cos, sin = np.cos(t), np.sin(t)
        a, b = ellipses.semi_axes_px[:, :1], ellipses.semi_axes_px[:, 1:]
        c, s = np.cos(ellipses.angle_rad), np.sin(ellipses.angle_rad)
        turn = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        quarter = turn @ np.array([[0.0, -1.0], [1.0, 0.0]])
        points, normals = ellipses.points(count)
        n = len(ellipses)
        by = np.zeros((n, count, 2, 5))
        # Equation (2) is x = x0 + turn (a cos t, b sin t); the derivative of turn by the angle is turn times a quarter
        # turn.
        by[..., 0, 0] = by[..., 1, 1] = 1.0
        by[..., 2] = np.einsum("nij,kj->nki", turn, np.stack([cos, 0 * cos], axis=-1))
        by[..., 3] = np.einsum("nij,kj->nki", turn, np.stack([0 * sin, sin], axis=-1))
        by[..., 4] = np.einsum("nij,nkj->nki", quarter, np.stack([a * cos, b * sin], axis=-1))
        length = np.hypot(b * cos, a * sin)
        # A unit normal changes only along the tangent, by the angle it turns.
        tangent = np.stack([-normals[..., 1], normals[..., 0]], axis=-1)
        # The normal (b cos t, a sin t) turns by d(angle) = (b cos t d(a sin t) - a sin t d(b cos t)) / length^2.
        spin = np.zeros((n, count, 5))
        spin[..., 2] = b * cos * sin / length**2
        spin[..., 3] = -a * sin * cos / length**2
        spin[..., 4] = 1.0
        return cls(points, normals, by, tangent[..., None] * spin[..., None, :])


def side_weights(toward_sun: FloatArray, gap: float) -> tuple[FloatArray, FloatArray]:
    """Weight rim points by the cosine between their normal and the Sun: 0 in the transition arcs, +1 and -1 beyond.

    Parameters
    ----------
    toward_sun
        (...) the cosines.
    gap
        Cosine at the end of the transition arcs: sin 30 deg for arcs of 30 deg on each side.

    Returns
    -------
    weights, slopes
        (...) odd and smooth (a quintic step over the outer half of the arcs), and their derivatives.
    """
    start = 0.5 * gap
    # A quintic step has continuous first and second derivatives: conjugate gradients need a smooth merit when points of
    # a turning rim pass from a transition arc to a side.
    x = np.clip((np.abs(toward_sun) - start) / (gap - start), 0.0, 1.0)
    step = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    slope = 30.0 * x**2 * (1.0 - x) ** 2 / (gap - start)
    return np.sign(toward_sun) * step, slope


def merit(
    ellipses: Ellipses, field: GradientField, sun_px: FloatArray, gap: float, count: int = 72
) -> tuple[FloatArray, FloatArray]:
    """Return the mean over both sides of a rim of the field's component along the signed normal, equation (3).

    On the side towards the Sun the brightness falls inwards, on the other it rises: with the normal signed by the side
    both contribute positively. Each side has the weight one half, whatever its number of points.

    Returns
    -------
    merit, derivatives
        (n,) and (n, 5) by u0, v0, a, b and the angle.
    """
    value, by = _side_merits(ellipses, field, sun_px, gap, count)
    return value.mean(axis=1), by.mean(axis=1)


def side_merits(
    ellipses: Ellipses, field: GradientField, sun_px: FloatArray, gap: float, count: int = 72
) -> FloatArray:
    """Return the means (n, 2) of the shaded and the lit side of a rim, as in ``merit``."""
    return _side_merits(ellipses, field, sun_px, gap, count)[0]


def _side_merits(
    ellipses: Ellipses, field: GradientField, sun_px: FloatArray, gap: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return the merits (n, 2) of both sides and their derivatives (n, 2, 5)."""
    rim = RimSamples.of(ellipses, count)
    g, g_by_uv = field.at(rim.points)
    cosine = rim.normals @ sun_px
    weight, slope = side_weights(cosine, gap)
    # The component g . n, and its derivatives by the normals and by the places of the points.
    along = np.einsum("nki,nki->nk", rim.normals, g)
    along_by = np.einsum("nkip,nki->nkp", rim.normals_by, g)
    along_by += np.einsum("nki,nkij,nkjp->nkp", rim.normals, g_by_uv, rim.points_by)
    weight_by = slope[..., None] * np.einsum("nkip,i->nkp", rim.normals_by, sun_px)
    values, derivatives = [], []
    for sign in (1.0, -1.0):
        side = np.where(sign * cosine > 0.0, weight, 0.0)
        side_by = np.where((sign * cosine > 0.0)[..., None], weight_by, 0.0)
        # The weights are negative on the far side, where the gradient points inwards: the ratio is positive for a rim.
        total = np.maximum(sign * side.sum(axis=1), 1e-9)
        value = np.einsum("nk,nk->n", side, along) / total
        by = np.einsum("nk,nkp->np", side, along_by) + np.einsum("nkp,nk->np", side_by, along)
        # Quotient rule: the sum of the weights changes with the shape too.
        by = (by - value[:, None] * sign * side_by.sum(axis=1)) / total[:, None]
        values.append(value)
        derivatives.append(by)
    return np.stack(values, axis=1), np.stack(derivatives, axis=1)
