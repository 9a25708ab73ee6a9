"""The search for craters by the heat map: the image turned towards the Sun, at several resolutions, and its maxima."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from boresight.estimators.craters.learned.heat_map import (
    BANDS_PX,
    DEEPEST,
    STRIDE,
    HeatMapNetwork,
    contrast_channels,
)
from boresight.estimators.craters.learned.proposals import halved
from boresight.scenarios.arrays import FloatArray, Image, IndexArray
from boresight.scenarios.geometry import Ellipses

LEVEL_STEP = 2  # halvings between resolutions: a factor of 4 in radius, within the range of 2.1 to 36 px of the network
_LEAST_SIDE_PX = 48
_LONGEST_ELONGATION = 0.45


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Similarity from an image to the turned one: x' = R x + t, both in continuous pixels.

    ``rotation`` (2, 2) takes the direction to the Sun to the first axis; ``size`` is the turned image's (W, H).
    """

    rotation: FloatArray
    shift_px: FloatArray
    size: tuple[int, int]

    @classmethod
    def of(cls, width: int, height: int, sun_px: FloatArray) -> Turn:
        """Turn all of an image, with room to multiples of ``DEEPEST`` pixels."""
        rotation = np.array([[sun_px[0], sun_px[1]], [-sun_px[1], sun_px[0]]])
        corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64) @ rotation.T
        low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
        size = (np.ceil(extent / DEEPEST - 1e-9) * DEEPEST).astype(int)
        return cls(rotation, 0.5 * (size - extent) - low, (int(size[0]), int(size[1])))

    def apply(self, image: Image) -> Image:
        """Resample an image (H, W) by bilinear interpolation; 0 outside of it."""
        # OpenCV counts from the centre of the first pixel: x + 0.5 is the continuous pixel.
        shift = self.shift_px + self.rotation @ np.array([0.5, 0.5]) - 0.5
        matrix = np.concatenate([self.rotation, shift[:, None]], axis=1)
        return np.asarray(cv2.warpAffine(image, matrix, self.size, flags=cv2.INTER_LINEAR), dtype=np.float32)

    def back(self, points_px: FloatArray) -> FloatArray:
        """Take points (n, 2) of the turned image to the image."""
        return np.asarray((points_px - self.shift_px) @ self.rotation)


def search(
    network: HeatMapNetwork, image: Image, ground: Image, sun_px: FloatArray, least_logit: float, most: int
) -> tuple[Ellipses, FloatArray]:
    """Return rims, and the logits (n,) that they are craters, of the maxima of the heat map at all resolutions.

    ``image`` and ``ground`` (H, W) are float32, the latter 1 on the ground and 0 elsewhere; ``sun_px`` (2,) is the unit
    vector towards the Sun. At each resolution at most ``most`` maxima above ``least_logit`` are returned.
    """
    found, logits = [np.zeros((0, 5))], [np.zeros(0)]
    scale = 1
    while min(image.shape) >= _LEAST_SIDE_PX:
        rims, logit = _search_level(network, image, ground, sun_px, least_logit, most)
        rims[:, :4] *= scale
        found.append(rims)
        logits.append(logit)
        for _ in range(LEVEL_STEP):
            image, ground = halved(image), halved(ground)
        scale *= 2**LEVEL_STEP
    rows = np.concatenate(found)
    return Ellipses(rows[:, :2], rows[:, 2:4], rows[:, 4]), np.concatenate(logits)


def _search_level(
    network: HeatMapNetwork, image: Image, ground: Image, sun_px: FloatArray, least_logit: float, most: int
) -> tuple[FloatArray, FloatArray]:
    """Return rims (n, 5) u, v, a, b, angle and logits (n,) at one resolution."""
    turn = Turn.of(image.shape[1], image.shape[0], sun_px)
    inside = (turn.apply(ground) > 0.99).astype(np.float32)
    outputs = network.forward(contrast_channels(turn.apply(image), inside)).astype(np.float64)
    band, row, column = _maxima(outputs[:, 0], least_logit)
    logit = outputs[band, 0, row, column]
    order = np.argsort(-logit, kind="stable")[:most]
    band, row, column, logit = band[order], row[order], column[order], logit[order]
    moved_x, moved_y, log_radius, along, across = outputs[band, 1:, row, column].T
    middle = np.array(BANDS_PX)[band]
    place = (np.stack([column, row], axis=1) + 0.5) * STRIDE + middle[:, None] * np.stack([moved_x, moved_y], axis=1)
    # The elongation (a - b) / (a + b), as a vector by twice the angle of the longer axis.
    size = np.minimum(np.hypot(along, across), _LONGEST_ELONGATION)
    ratio = np.sqrt((1.0 + size) / (1.0 - size))
    radius = middle * np.exp(log_radius)
    angle = 0.5 * np.arctan2(across, along) + np.arctan2(sun_px[1], sun_px[0])
    rims = np.stack([radius * ratio, radius / ratio, angle % np.pi], axis=1)
    return np.concatenate([turn.back(place), rims], axis=1), logit


def _maxima(logit: FloatArray, least: float) -> tuple[IndexArray, ...]:
    """Return bands, rows and columns of maxima within 3 x 3 cells of each band (bands, H, W) that exceed ``least``."""
    top = np.stack([cv2.dilate(one, np.ones((3, 3), np.uint8)) for one in logit])
    return np.nonzero((logit >= top) & (logit > least))
