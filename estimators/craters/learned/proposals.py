"""Ring templates: proposals of rims from the gradients that sunlight causes on both their sides."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.detection.preparation import PreparedImage, gradient_of
from boresight.estimators.craters.kernels import LANES, RingTaps, ring_scores, side_weights
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import Ellipses, pixel_to_opencv

SHAPES = ((1.0, 1), (0.75, 4), (0.52, 6))  # ratio of the axes, and how many angles of it there are
RADII_PX = (4.2, 5.3, 6.7)  # mean radii at each level of the pyramid; the next level doubles them
_POINTS = 40
_GAP = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class RingTemplates:
    """m templates at one level.

    ``shape`` (m, 3) are semi-axes and angle, in pixels of the level. The axes of ``kernels`` (m, 2, K, K, 2) are side
    (towards and away from the Sun), rows, columns, component of the gradient.
    """

    shape: FloatArray
    kernels: Image


def ring_templates(sun_px: FloatArray) -> RingTemplates:
    """Draw templates for a direction of the Sun: the signed normals of each side, distributed over pixels."""
    shape = []
    for radius in RADII_PX:
        for ratio, angles in SHAPES:
            # Semi-axes of the given ratio whose geometric mean is the radius.
            axes = radius / np.sqrt(ratio), radius * np.sqrt(ratio)
            shape += [(*axes, np.pi * k / angles) for k in range(angles)]
    rows = np.array(shape)
    half = int(np.ceil(rows[:, 0].max())) + 1
    ellipses = Ellipses(np.full((len(rows), 2), half + 0.5), rows[:, :2], rows[:, 2])
    points, normals = ellipses.points(_POINTS)
    weight, _ = side_weights(normals @ sun_px, _GAP)
    # Points are denser where the curvature is high: each is weighted by its length of the rim.
    weight = weight * np.linalg.norm(np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1), axis=2)
    kernels = np.zeros((len(rows), 2, 2 * half + 1, 2 * half + 1, 2))
    for side, sign in enumerate((1.0, -1.0)):
        part = np.where(sign * weight > 0.0, weight, 0.0)
        # Each side is a mean of its own, so that the merit can be the smaller one.
        part = part / np.abs(part).sum(axis=1, keepdims=True)
        _splat(kernels[:, side], pixel_to_opencv(points), part[..., None] * normals)
    return RingTemplates(rows, kernels.astype(np.float32))


def _splat(kernels: FloatArray, place: FloatArray, values: FloatArray) -> None:
    """Add values at places between pixels to each kernel, bilinearly, in place."""
    low = np.floor(place).astype(np.int64)
    f = place - low
    m = np.broadcast_to(np.arange(len(kernels))[:, None], low.shape[:2])
    for du in (0, 1):
        for dv in (0, 1):
            share = np.abs(1 - du - f[..., 0]) * np.abs(1 - dv - f[..., 1])
            np.add.at(kernels, (m, low[..., 1] + dv, low[..., 0] + du), share[..., None] * values)


def halved(image: Image) -> Image:
    """Halve an image by means of 2 x 2: continuous pixels (u, v) become (u / 2, v / 2) exactly.

    (``cv2.pyrDown`` samples at the even pixels' centres, which shifts by half a pixel.)
    """
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    even = image[:height, :width]
    return np.asarray(0.25 * (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]), dtype=np.float32)


def pyramid(image: Image, levels: int) -> list[Image]:
    """Return an image and its successive halves."""
    found = [image]
    for _ in range(levels - 1):
        found.append(halved(found[-1]))
    return found


def soft_directions(image: Image, noise: float, softness: float) -> Image:
    """Return gradients g (H, W, 2) divided by sqrt(g^2 + f^2): near 0 for weak ones, unit vectors for strong ones.

    The softening length f is ``softness`` times the median length of the gradients that are not 0, and at least four
    times ``noise``, the standard deviation of the noise in a component.
    """
    gradient = gradient_of(image, 3)
    strength = gradient.strength
    floor = max(softness * float(np.median(strength[strength > 0.0])) if np.any(strength > 0.0) else 1.0, 4.0 * noise)
    soft = np.sqrt(strength**2 + np.float32(floor) ** 2)
    return np.stack([gradient.along_u / soft, gradient.along_v / soft], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """Proposed rims, the best first, and their merits (n,)."""

    ellipses: Ellipses
    merit: FloatArray


def propose(picture: PreparedImage, levels: int, least_merit: float, count: int, softness: float = 1.0) -> Proposals:
    """Find the best template at each local maximum of the templates' merit, at all levels.

    A template's merit is the smaller of its two sides' means: a terminator or a ridge has only one good side.
    """
    templates = ring_templates(picture.sun_px)
    found, merits = [], []
    for level, image in enumerate(pyramid(picture.even, levels)):
        if min(image.shape) < 2 * templates.kernels.shape[2]:
            break
        # 0.43 is `noise_gain(3)`, and the mean of 2 x 2 pixels halves the noise at each level.
        noise = float(np.median(picture.noise[picture.ground])) * 0.43 / 2.0**level
        score, best = template_scores(soft_directions(image, noise, softness), templates, least_merit)
        rows, columns = _maxima(score, least_merit)
        shape = templates.shape[best[rows, columns]]
        centre = np.stack([columns + 0.5, rows + 0.5], axis=1) * 2.0**level
        found.append(np.concatenate([centre, shape[:, :2] * 2.0**level, shape[:, 2:]], axis=1))
        merits.append(score[rows, columns])
    rows_of = np.concatenate(found)
    merit = np.concatenate(merits)
    order = np.argsort(-merit, kind="stable")[:count]
    chosen = rows_of[order]
    return Proposals(Ellipses(chosen[:, :2], chosen[:, 2:4], chosen[:, 4]), merit[order].astype(np.float64))


def template_scores(field: Image, templates: RingTemplates, least: float) -> tuple[Image, NDArray[np.int64]]:
    """Return the best merit (H, W) of all templates at each pixel, and the template's row, where it reaches ``least``.

    Where it does not, the merit is any number below that.
    """
    height, width = field.shape[:2]
    reach = templates.kernels.shape[2]
    half = reach // 2
    # Beyond the image there are no gradients.
    padded = np.zeros((2, height + 2 * half, width + 2 * half + LANES), dtype=np.float32)
    padded[:, half : half + height, half : half + width] = np.moveaxis(field, 2, 0)
    # Few pixels of a template are not zero: those of the ring.
    m, side, row, column, axis = np.nonzero(templates.kernels)
    place = (axis * padded.shape[1] + row) * padded.shape[2] + column
    start = np.searchsorted(2 * m + side, np.arange(2 * len(templates.kernels) + 1))
    taps = RingTaps(place.astype(np.uint64), templates.kernels[m, side, row, column, axis], start)
    near = cv2.dilate(field.any(axis=2).view(np.uint8), np.ones((reach, reach), np.uint8)).view(np.bool_)
    best = np.full((height, width), -2.0, dtype=np.float32)
    which = np.zeros((height, width), dtype=np.int64)
    ring_scores(best, which, padded, taps, near, np.float32(least))
    return best, which


def _maxima(score: Image, least: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of the local maxima within 3 x 3 that reach ``least``."""
    # A pixel is a local maximum where the dilation, the maximum of its neighbours and itself, leaves it unchanged.
    top = cv2.dilate(score, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero((score >= top) & (score >= least))
    return rows, columns
