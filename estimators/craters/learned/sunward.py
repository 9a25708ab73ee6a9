"""The direction of the Sun in an image of craters, where it is not given."""

from __future__ import annotations

import cv2
import numpy as np

from boresight.estimators.craters.learned.heat_map import HeatMapNetwork
from boresight.estimators.craters.learned.search import search
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.errors import BoresightError

_SIDE_PX = 512  # of the part in the middle that is looked at
_TURN_RAD = 0.35  # to either side of the axis
_LEAST_LOGIT = -1.0


def estimate_sun(network: HeatMapNetwork, image: Image, ground: Image) -> FloatArray:
    """Return the unit vector (2,) towards the Sun along columns and rows.

    The brightness varies most along the Sun's direction, which leaves two opposite ones. Of these, and of directions
    20 degrees to either side of the better one, that is returned in which the heat map shows most craters. ``image``
    and ``ground`` (H, W) are those of `search`.

    Raises
    ------
    BoresightError
        If the heat map shows no crater at all.
    """
    row, column = (max(size - _SIDE_PX, 0) // 2 for size in image.shape)
    part = (slice(row, row + _SIDE_PX), slice(column, column + _SIDE_PX))
    image, ground = np.ascontiguousarray(image[part]), np.ascontiguousarray(ground[part])
    axis = _axis(image, ground)

    def count(angle: float) -> float:
        """Return the sum of the probabilities of all maxima, for the Sun in a direction."""
        sun_px = np.array([np.cos(angle), np.sin(angle)])
        logits = search(network, image, ground, sun_px, _LEAST_LOGIT, most=4000)[1]
        return float(np.sum(1.0 / (1.0 + np.exp(-logits))))

    number, angle = max((count(axis + turn), axis + turn) for turn in (0.0, np.pi))
    if number == 0.0:
        raise BoresightError("no crater shows where the Sun stands: give its direction by --sun")
    others = [(count(angle + turn), angle + turn) for turn in (-_TURN_RAD, _TURN_RAD)]
    _, angle = max([(number, angle), *others])
    return np.array([np.cos(angle), np.sin(angle)])


def _axis(image: Image, ground: Image) -> float:
    """Return the angle, rad, of the axis along which the brightness over its local mean varies most."""
    # Normalised convolution, as in `prepare_image`: black sky does not enter the means.
    share = np.maximum(cv2.GaussianBlur(ground, (0, 0), 20.0), 1e-3)
    mean = np.maximum(cv2.GaussianBlur(image * ground, (0, 0), 20.0) / share, 1e-6)
    even = cv2.GaussianBlur(image, (0, 0), 1.5) / mean
    along_u, along_v = (cv2.Sobel(even, cv2.CV_32F, 1 - k, k) * ground for k in (0, 1))
    return float(0.5 * np.arctan2(2.0 * np.sum(along_u * along_v), np.sum(along_u**2 - along_v**2)))
