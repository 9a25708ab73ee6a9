"""The heat map of craters: its network, the search for its maxima, and the direction of the Sun by them.

A small U-Net returns centres, radii and elongations of rims in a Sun-aligned image. It is described in
``tests/training/heat_map_network.py``; here it is applied by NumPy alone. The search turns the image towards the Sun,
at several resolutions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.learned.proposals import halved
from boresight.scenarios.arrays import FloatArray, Image, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses

STRIDE = 2  # pixels of the image for one of the heat map
BANDS_PX = (2.5, 4.5, 8.1, 14.6, 26.2)  # radii in the middle of each band
OUTPUTS = 6  # of each band: logit, place along x and y, log radius, elongation along and across
DEEPEST = 16  # pixels of the image for one of the coarsest layer: sides are multiples of it
WINDOW_PX = 20.0  # standard deviation of the window that evens brightness and contrast out
_AT_ONCE = 32  # blocks of ``DEEPEST`` pixels that are multiplied at once: their inputs fit the cache

_CONVOLUTIONS = {
    "stem": (8, 24, 3), "second": (24, 24, 3), "down4": (24, 48, 3), "quarter": (48, 48, 3), "down8": (48, 64, 3),
    "eighth": (64, 64, 3), "down16": (64, 96, 3), "deep1": (96, 96, 3), "deep2": (96, 96, 3),
    "side8": (96, 64, 1), "side4": (64, 48, 1), "side2": (48, 24, 1),
    "up8": (64, 64, 3), "up4": (48, 48, 3), "up2": (24, 48, 3), "head": (48, len(BANDS_PX) * OUTPUTS, 1),
}  # fmt: skip
SHAPES: dict[str, tuple[int, ...]] = {
    f"{name}_kernel": (outputs, inputs, size, size) for name, (inputs, outputs, size) in _CONVOLUTIONS.items()
}
SHAPES |= {f"{name}_bias": (outputs,) for name, (_, outputs, _) in _CONVOLUTIONS.items()}


class _Pieces(NamedTuple):
    """Row, first column and end of runs of blocks of ``DEEPEST`` pixels, and how many rows the image has."""

    runs: list[tuple[int, int, int]]
    rows: int


def _pieces(blocks: NDArray[np.uint8]) -> _Pieces:
    """Return runs from the first to the last block of each row that is not 0, cut to ``_AT_ONCE`` blocks."""
    runs = []
    for row, columns in enumerate(np.flatnonzero(one) for one in blocks):
        if len(columns):
            end = int(columns[-1]) + 1
            runs += [(row, first, min(first + _AT_ONCE, end)) for first in range(int(columns[0]), end, _AT_ONCE)]
    return _Pieces(runs, len(blocks))


@dataclass(frozen=True, slots=True, eq=False)
class HeatMapNetwork:
    """Weights by name, of the shapes in ``SHAPES``."""

    weights: Mapping[str, Image]

    def forward(self, channels: Image, ground: Image) -> Image:
        """Return (bands, OUTPUTS, H / 2, W / 2) for the two channels (2, H, W) of an image.

        H and W are multiples of ``DEEPEST``. Outputs are computed where ``ground`` (H, W) is not 0 and 2 pixels beyond;
        those farther away are arbitrary, their logits at last minus infinity.
        """
        _, height, width = channels.shape
        blocks = ground.reshape(height // DEEPEST, DEEPEST, width // DEEPEST, DEEPEST).any(axis=(1, 3)).view(np.uint8)
        # Outputs depend on the layers down to the deepest within 5 blocks, and on those back up within one.
        far, close = (cv2.dilate(blocks, np.ones((2 * reach + 1,) * 2, np.uint8)) for reach in (5, 1))
        down, up = _pieces(far), _pieces(close)
        x = np.zeros((8, height // 2 + 2, width // 2 + 2), dtype=np.float32)
        folded = channels.reshape(2, height // 2, 2, width // 2, 2).transpose(0, 2, 4, 1, 3)
        x[:, 1:-1, 1:-1] = folded.reshape(8, height // 2, width // 2)
        two = self._convolve("second", self._convolve("stem", x, down), down)
        four = self._convolve("quarter", self._convolve("down4", two, down, 2), down)
        eight = self._convolve("eighth", self._convolve("down8", four, down, 2), down)
        x = self._convolve("deep1", self._convolve("down16", eight, down, 2), down)
        x = self._convolve("deep2", x, down, then="side8")
        for skip, name, then in ((eight, "up8", "side4"), (four, "up4", "side2"), (two, "up2", "head")):
            skip[:, 1:-1, 1:-1] += x[:, 1:-1, 1:-1].repeat(2, axis=1).repeat(2, axis=2)
            x = self._convolve(name, skip, up, then=then)
        found = x[:, 1:-1, 1:-1].reshape(len(BANDS_PX), OUTPUTS, height // 2, width // 2)
        cells = DEEPEST // STRIDE
        found[:, 0][:, close.repeat(cells, axis=0).repeat(cells, axis=1) == 0] = -np.inf
        return found

    def _convolve(self, name: str, x: Image, pieces: _Pieces, stride: int = 1, then: str = "") -> Image:
        """Convolve (C, H + 2, W + 2) by a kernel of 3 x 3, set what is negative to 0, and ``then`` mix the channels.

        The result (C', H / stride + 2, W / stride + 2) is 0 along its border and beyond the pieces.
        """
        kernel, bias = self.weights[f"{name}_kernel"], self.weights[f"{name}_bias"]
        inputs, height, width = x.shape[0], (x.shape[1] - 2) // stride, (x.shape[2] - 2) // stride
        flat = np.ascontiguousarray(kernel.transpose(0, 2, 3, 1).reshape(len(kernel), -1))
        outputs = len(self.weights[f"{then or name}_bias"])
        found = np.zeros((outputs, height + 2, width + 2), dtype=np.float32)
        side = height // pieces.rows  # places of the layer along a block
        room = np.empty(flat.shape[1] * side * side * _AT_ONCE, dtype=np.float32)
        for row, first, end in pieces.runs:
            top, left, columns = row * side, first * side, (end - first) * side
            taps = room[: flat.shape[1] * side * columns].reshape(9, inputs, side, columns)
            for k in range(9):
                v, u = top * stride + k // 3, left * stride + k % 3
                taps[k] = x[:, v : v + side * stride : stride, u : u + columns * stride : stride]
            value = flat @ taps.reshape(flat.shape[1], -1)
            value += bias[:, None]
            np.maximum(value, 0.0, out=value)
            if then:
                value = self.weights[f"{then}_kernel"][:, :, 0, 0] @ value
                value += self.weights[f"{then}_bias"][:, None]
            found[:, 1 + top : 1 + top + side, 1 + left : 1 + left + columns] = value.reshape(-1, side, columns)
        return found


def contrast_channels(image: Image, ground: Image) -> Image:
    """Return what the network is given (2, H, W): contrast in local units, and relative brightness.

    Both are the brightness minus its local mean over the ground; the first is divided by the local standard deviation,
    the second by that mean. ``ground`` (H, W) is 1 on the ground and 0 elsewhere, where both are 0.
    """

    def local_mean(values: Image) -> Image:
        reach = 2 * int(3.0 * WINDOW_PX) + 1
        blurred = cv2.GaussianBlur(values, (reach, reach), WINDOW_PX, borderType=cv2.BORDER_REFLECT_101)
        return np.asarray(blurred, dtype=np.float32)

    share = np.maximum(local_mean(ground), 1e-3)
    mean = local_mean(image * ground) / share
    square = local_mean(np.square(image - mean) * ground) / share
    spread = np.maximum(np.sqrt(square + (0.02 * mean) ** 2), 1e-6)
    even = np.clip((image - mean) / spread, -4.0, 4.0)
    relief = np.clip((image - mean) / np.maximum(mean, 1e-6), -1.0, 2.0)
    return np.stack([even * ground, relief * ground]).astype(np.float32)


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
    outputs = network.forward(contrast_channels(turn.apply(image), inside), inside)
    band, row, column = _maxima(outputs[:, 0], least_logit)
    logit = outputs[band, 0, row, column].astype(np.float64)
    order = np.argsort(-logit, kind="stable")[:most]
    band, row, column, logit = band[order], row[order], column[order], logit[order]
    moved_x, moved_y, log_radius, along, across = outputs[band, 1:, row, column].astype(np.float64).T
    middle = np.array(BANDS_PX)[band]
    place = (np.stack([column, row], axis=1) + 0.5) * STRIDE + middle[:, None] * np.stack([moved_x, moved_y], axis=1)
    # The elongation (a - b) / (a + b), as a vector by twice the angle of the longer axis.
    size = np.minimum(np.hypot(along, across), _LONGEST_ELONGATION)
    ratio = np.sqrt((1.0 + size) / (1.0 - size))
    radius = middle * np.exp(log_radius)
    angle = 0.5 * np.arctan2(across, along) + np.arctan2(sun_px[1], sun_px[0])
    rims = np.stack([radius * ratio, radius / ratio, angle % np.pi], axis=1)
    return np.concatenate([turn.back(place), rims], axis=1), logit


def _maxima(logit: Image, least: float) -> tuple[IndexArray, ...]:
    """Return bands, rows and columns of maxima within 3 x 3 cells of each band (bands, H, W) that exceed ``least``."""
    top = np.stack([cv2.dilate(one, np.ones((3, 3), np.uint8)) for one in logit])
    return np.nonzero((logit >= top) & (logit > least))


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
