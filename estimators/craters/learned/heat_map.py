"""The heat map of craters: a small U-Net that returns centres, radii and elongations of rims in a Sun-aligned image.

The network is described in ``tests/training/heat_map_network.py``; here it is applied by NumPy alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from boresight.scenarios.arrays import Image

STRIDE = 2  # pixels of the image for one of the heat map
BANDS_PX = (2.5, 4.5, 8.1, 14.6, 26.2)  # radii in the middle of each band
OUTPUTS = 6  # of each band: logit, place along x and y, log radius, elongation along and across
DEEPEST = 16  # pixels of the image for one of the coarsest layer: sides are multiples of it
WINDOW_PX = 20.0  # standard deviation of the window that evens brightness and contrast out
_AT_ONCE = 4096  # places of a layer that are multiplied at once: their inputs fit the cache

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


@dataclass(frozen=True, slots=True, eq=False)
class HeatMapNetwork:
    """Weights by name, of the shapes in ``SHAPES``."""

    weights: Mapping[str, Image]

    def forward(self, channels: Image) -> Image:
        """Return (bands, OUTPUTS, H / 2, W / 2) for the two channels (2, H, W) of an image.

        H and W are multiples of ``DEEPEST``.
        """
        _, height, width = channels.shape
        folded = channels.reshape(2, height // 2, 2, width // 2, 2).transpose(0, 2, 4, 1, 3)
        two = self._convolve("second", self._convolve("stem", folded.reshape(8, height // 2, width // 2)))
        four = self._convolve("quarter", self._convolve("down4", two, 2))
        eight = self._convolve("eighth", self._convolve("down8", four, 2))
        x = self._convolve("deep2", self._convolve("deep1", self._convolve("down16", eight, 2)))
        for skip, side, up in ((eight, "side8", "up8"), (four, "side4", "up4"), (two, "side2", "up2")):
            x = self._convolve(up, skip + self._mix(side, x).repeat(2, axis=1).repeat(2, axis=2))
        return self._mix("head", x).reshape(len(BANDS_PX), OUTPUTS, height // 2, width // 2)

    def _mix(self, name: str, x: Image) -> Image:
        """Convolve (C, H, W) by a kernel of 1 x 1."""
        kernel, bias = self.weights[f"{name}_kernel"], self.weights[f"{name}_bias"]
        found = kernel[:, :, 0, 0] @ x.reshape(len(x), -1) + bias[:, None]
        return np.asarray(found.reshape(-1, *x.shape[1:]), dtype=np.float32)

    def _convolve(self, name: str, x: Image, stride: int = 1) -> Image:
        """Convolve (C, H, W) by a kernel of 3 x 3, with zeros beyond the border, and set what is negative to 0."""
        kernel, bias = self.weights[f"{name}_kernel"], self.weights[f"{name}_bias"]
        inputs, height, width = x.shape[0], x.shape[1] // stride, x.shape[2] // stride
        padded = np.pad(x, ((0, 0), (1, 1), (1, 1)))
        flat = np.ascontiguousarray(kernel.transpose(0, 2, 3, 1).reshape(len(kernel), -1))
        found = np.empty((len(kernel), height, width), dtype=np.float32)
        rows = max(_AT_ONCE // width, 1)
        taps = np.empty((9, inputs, rows, width), dtype=np.float32)
        for first in range(0, height, rows):
            n = min(rows, height - first)
            strip = taps if n == rows else np.empty((9, inputs, n, width), dtype=np.float32)
            for k in range(9):
                row, column = first * stride + k // 3, k % 3
                strip[k] = padded[:, row : row + n * stride : stride, column : column + width * stride : stride]
            value = flat @ strip.reshape(9 * inputs, -1)
            value += bias[:, None]
            np.maximum(value, 0.0, out=value)
            found[:, first : first + n] = value.reshape(-1, n, width)
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
