"""A small convolutional network in NumPy: three convolutions and two dense layers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]

STRIDE = 2  # of every convolution
NAMES = ("conv1", "bias1", "conv2", "bias2", "conv3", "bias3", "dense1", "bias4", "dense2", "bias5")
OUTPUTS = 6  # log odds of a crater; displacement (2), log scale, elongation along and across the Sun (2)


def windows(x: FloatImage, size: int) -> FloatImage:
    """Lay the windows of a strided convolution out as (n, H', W', size * size * C); the border is padded by zeros."""
    pad = size // 2
    padded = np.pad(x, ((0, 0), (pad, pad), (pad, pad), (0, 0)))
    view = np.lib.stride_tricks.sliding_window_view(padded, (size, size), axis=(1, 2))[:, ::STRIDE, ::STRIDE]
    rows = np.ascontiguousarray(np.moveaxis(view, 3, 5))
    return rows.reshape(*rows.shape[:3], -1)


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Weights by name: conv (size * size * C, C'), bias (C'), dense (inputs, outputs)."""

    weights: Mapping[str, FloatImage]

    def forward(self, pixels: FloatImage, scalars: FloatImage) -> FloatImage:
        """Return (n, OUTPUTS) for patches (n, SIDE, SIDE, 1) and their numbers (n, SCALARS)."""
        x = pixels
        for i in (1, 2, 3):
            kernel = self.weights[f"conv{i}"]
            size = round(np.sqrt(len(kernel) / x.shape[-1]))
            x = np.maximum(windows(x, size) @ kernel + self.weights[f"bias{i}"], 0.0)
        flat = np.concatenate([x.reshape(len(x), -1), scalars], axis=1)
        hidden = np.maximum(flat @ self.weights["dense1"] + self.weights["bias4"], 0.0)
        return np.asarray(hidden @ self.weights["dense2"] + self.weights["bias5"], dtype=np.float32)
