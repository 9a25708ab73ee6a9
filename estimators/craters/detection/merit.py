"""The merit of a rim in the image, equations (3) and (4) of Cheng et al. (2003), and its derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.kernels import RIM_POINTS, divide_softly, rim_merits
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Ellipses


@dataclass(frozen=True, slots=True, eq=False)
class GradientField:
    """A field of vectors over the pixels, (H, W, 2), interpolated bilinearly between their centres."""

    values: FloatArray

    @classmethod
    def of_gradient(cls, along_u: NDArray[np.float32], along_v: NDArray[np.float32], floor: float) -> GradientField:
        """Divide gradients g by sqrt(g^2 + floor^2): unit vectors where ``floor`` is 0."""
        values = np.empty((*along_u.shape, 2))
        divide_softly(values, along_u, along_v, floor)
        return cls(values)


def side_merits(
    ellipses: Ellipses, field: GradientField, sun_px: FloatArray, gap: float, count: int = RIM_POINTS
) -> tuple[FloatArray, FloatArray]:
    """Return the means over each side of a rim of the field's component along the signed normal, equation (3).

    On the side towards the Sun the brightness falls inwards, on the other it rises: with the normal signed by the side
    both contribute positively. The merit of a rim is the mean of both, whatever their numbers of points.

    Returns
    -------
    merits, derivatives
        (n, 2) of the shaded and the lit side, and (n, 2, 5) by u0, v0, a, b and the angle.
    """
    rims = np.column_stack([ellipses.centre_px, ellipses.semi_axes_px, ellipses.angle_rad])
    value, by = np.empty((len(rims), 2)), np.empty((len(rims), 2, 5))
    rim_merits(value, by, rims, field.values, sun_px, gap, count)
    return value, by
