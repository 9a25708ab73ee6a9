"""Refinement of ellipses by the merit of Cheng et al. (2003), equation (3), confidence (4), removal of duplicates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.detection.preparation import Gradient, PreparedImage, gradient_of
from boresight.estimators.craters.kernels import RIM_POINTS, best_of_each, climb, divide_softly, rim_merits
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Ellipses

SCALES_PX = ((5, 14.0), (9, 40.0), (17, np.inf))  # kernel, and the radius up to which it is used


@dataclass(frozen=True, slots=True, eq=False)
class GradientScales:
    """Gradient fields of increasing kernels, each for rims up to a radius.

    ``locating`` are fields with softened lengths: steep edges determine the rim. ``pointing`` are fields of unit
    vectors, for the confidence. ``up_to_px`` is the largest mean radius of each; the last has no limit.
    """

    locating: tuple[FloatArray, ...]
    pointing: tuple[FloatArray, ...]
    up_to_px: tuple[float, ...]

    def of(self, radius_px: FloatArray) -> NDArray[np.int64]:
        """Return the rows of the fields for given radii."""
        return np.searchsorted(np.array(self.up_to_px[:-1]), radius_px)


def gradient_scales(
    picture: PreparedImage, kernels_px: Sequence[int], up_to_px: Sequence[float], soft: float
) -> GradientScales:
    """Differentiate the image at each kernel.

    ``soft`` is the softening length of the gradients in ``locating``, in units of their median over the ground.
    """
    locating, pointing = [], []
    for kernel in kernels_px:
        gradient = gradient_of(picture.even, kernel)
        # Softened by the typical gradient: weak edges count less where the rim is placed, but their direction counts in
        # full for the confidence.
        middle = float(np.median(gradient.strength[picture.ground]))
        locating.append(softened(gradient, soft * middle))
        pointing.append(softened(gradient, 1e-3 * middle))
    return GradientScales(tuple(locating), tuple(pointing), tuple(up_to_px))


def softened(gradient: Gradient, floor: float) -> FloatArray:
    """Divide gradients g by sqrt(g^2 + floor^2), (H, W, 2): unit vectors where ``floor`` is 0."""
    field = np.empty((*gradient.along_u.shape, 2))
    divide_softly(field, gradient.along_u, gradient.along_v, floor)
    return field


def refine(ellipses: Ellipses, scales: GradientScales, sun_px: FloatArray, gap: float, rounds: int) -> Ellipses:
    """Maximise each rim's merit over its centre, axes and angle, by the gradient field of its size.

    A rim that moves by more than a third of its radius, or changes its axes by more than a factor of 1.5, is left as it
    was. ``gap`` is that of `side_weights`, and ``rounds`` are the most iterations of conjugate gradients.
    """
    if rounds == 0:
        return ellipses
    start = parameters(ellipses)
    rows = scales.of(ellipses.radius_px)
    found = start.copy()
    for i in np.unique(rows):
        chosen = rows == i
        found[chosen] = climb(start[chosen], scales.locating[i], sun_px, gap, rounds)
    radius = ellipses.radius_px
    # A rim that has moved so far has probably locked to another edge.
    far = np.linalg.norm(found[:, :2] - start[:, :2], axis=1) > radius / 3.0
    bent = np.abs(np.log(found[:, 2:4] / start[:, 2:4])).max(axis=1) > 0.4
    return from_parameters(np.where((far | bent)[:, None], start, found))


def parameters(ellipses: Ellipses) -> FloatArray:
    """Arrange ellipses as (n, 5): u0, v0, a, b in pixels and the angle of a in radians."""
    return np.concatenate([ellipses.centre_px, ellipses.semi_axes_px, ellipses.angle_rad[:, None]], axis=1)


def from_parameters(rows: FloatArray) -> Ellipses:
    """Convert (n, 5) parameters to ellipses; the longer axis comes first and angles lie in [0, pi)."""
    swap = rows[:, 3] > rows[:, 2]
    axes = np.where(swap[:, None], rows[:, [3, 2]], rows[:, 2:4])
    return Ellipses(rows[:, :2], axes, (rows[:, 4] + np.where(swap, np.pi / 2, 0.0)) % np.pi)


def side_merits(
    ellipses: Ellipses, field: FloatArray, sun_px: FloatArray, gap: float, count: int = RIM_POINTS
) -> tuple[FloatArray, FloatArray]:
    """Return the means over each side of a rim of the field's component along the signed normal, equation (3).

    On the side towards the Sun the brightness falls inwards, on the other it rises: with the normal signed by the side
    both contribute positively. The merit of a rim is the mean of both, whatever their numbers of points.

    The field (H, W, 2) is interpolated bilinearly between the centres of pixels. Return the merits (n, 2) of the shaded
    and the lit side, and their derivatives (n, 2, 5) by u0, v0, a, b and the angle.
    """
    value, by = np.empty((len(ellipses), 2)), np.empty((len(ellipses), 2, 5))
    rim_merits(value, by, parameters(ellipses), field, sun_px, gap, count)
    return value, by


def confidence(ellipses: Ellipses, scales: GradientScales, sun_px: FloatArray, gap: float) -> FloatArray:
    """Return the mean cosine (n,) between the gradient and the signed normal, equation (4), of the worse side.

    The paper takes one mean over the points of both sides. Here both have to agree, because a terminator or a ridge
    lights up one side as well as any rim.
    """
    values = np.zeros(len(ellipses))
    rows = scales.of(ellipses.radius_px)
    for i in np.unique(rows):
        chosen = rows == i
        values[chosen] = side_merits(ellipses[chosen], scales.pointing[i], sun_px, gap)[0].min(axis=1)
    return values


def suppress_duplicates(
    ellipses: Ellipses, score: FloatArray, least_apart: float, least_ratio: float
) -> NDArray[np.int64]:
    """Keep the best of ellipses on the same crater: their rows, the highest score first.

    Two are different craters if their centres are at least ``least_apart`` smaller mean radii apart, or, one in the
    other, if the ratio of their mean radii is at least ``least_ratio``.
    """
    # The stable sort keeps the order of equal scores the same on every machine.
    order = np.argsort(-score, kind="stable")
    # Contiguous, as numba would compile the kernel again for another layout.
    return best_of_each(order, np.ascontiguousarray(ellipses.centre_px), ellipses.radius_px, least_apart, least_ratio)
