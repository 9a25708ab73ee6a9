"""Rims midway between where the network puts them and where the image's gradient is steepest.

The network sees a rim on as many pixels whatever its size, the gradient on the image's own: errors of the two are of
different kinds, and the mean's are smaller than either's for craters of some size.
"""

from __future__ import annotations

import numpy as np

from estimators.craters.detection.confidence import confidence
from estimators.craters.detection.options import ClassicOptions
from estimators.craters.detection.picture import Picture
from estimators.craters.detection.refinement import SCALES_PX, refine, scales_of
from estimators.craters.learned.placing import ellipses_of, shape_of
from scenarios.geometry import Ellipses

_LEAST_MERIT = 0.6  # of what is climbed to, equation (4) of Cheng et al. (2003)
_FARTHEST = 0.25  # from the network's place, in radii


def blended(seen: Ellipses, picture: Picture, from_px: float, options: ClassicOptions) -> Ellipses:
    """Move rims of a mean radius of ``from_px`` or more halfway to the maximum of the merit next to them, (2) and (3).

    Where the maximum is far off or poor, the rim stays as the network has it.
    """
    rows = np.flatnonzero(seen.radius_px >= from_px)
    if not len(rows):
        return seen
    said, gap = seen[rows], float(np.sin(np.radians(options.transition_deg)))
    scales = scales_of(picture, [s[0] for s in SCALES_PX], [s[1] for s in SCALES_PX], options.softness)
    steepest = Ellipses(said.centre_px, said.semi_axes_px / options.crest_scale, said.angle_rad)
    steepest = refine(steepest, scales, picture.sun_px, gap, options.rounds)
    merit = confidence(steepest, scales, picture.sun_px, gap)
    apart = np.linalg.norm(steepest.centre_px - said.centre_px, axis=1)
    good = (merit > _LEAST_MERIT) & (apart < _FARTHEST * said.radius_px)
    crest = Ellipses(steepest.centre_px, steepest.semi_axes_px * options.crest_scale, steepest.angle_rad)[good]
    said, rows = said[good], rows[good]
    shape = 0.5 * (shape_of(said, picture.sun_px) + shape_of(crest, picture.sun_px))
    middle = ellipses_of(0.5 * (said.centre_px + crest.centre_px), shape, picture.sun_px)
    centre, axes, angle = seen.centre_px.copy(), seen.semi_axes_px.copy(), seen.angle_rad.copy()
    centre[rows], axes[rows], angle[rows] = middle.centre_px, middle.semi_axes_px, middle.angle_rad
    return Ellipses(centre, axes, angle)
