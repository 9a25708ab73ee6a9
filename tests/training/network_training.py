"""Training of the network: back-propagation and Adam in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.learned.network import OUTPUTS, SCALARS, SHAPES, SIDE, STRIDE, Network
from boresight.scenarios.arrays import Image

AnyFloats = NDArray[np.floating[Any]]
_CHANNELS = (1, 12, 24, 32)
_SIZES = (5, 3, 3)
_TOP = (SIDE // STRIDE**3, SIDE // STRIDE**3, _CHANNELS[3])
_HIDDEN = 64


@dataclass(frozen=True, slots=True, eq=False)
class Lessons:
    """What is learned from: patches, numbers, and what the network should say.

    Parameters
    ----------
    pixels, scalars
        (n, SIDE, SIDE, 1) and (n, SCALARS).
    crater
        (n,) 1 where it is one, 0 where not.
    weight
        (n,) of the verdict.
    target
        (n, 5) displacement over the radius, log scale, elongation; of no weight where ``crater`` is 0.
    placed
        (n,) weight of the target.
    """

    pixels: Image
    scalars: Image
    crater: Image
    weight: Image
    target: Image
    placed: Image

    def __getitem__(self, rows: NDArray[np.int64]) -> Lessons:
        return Lessons(
            self.pixels[rows],
            self.scalars[rows],
            self.crater[rows],
            self.weight[rows],
            self.target[rows],
            self.placed[rows],
        )

    def mirrored(self, flip: NDArray[np.bool_]) -> Lessons:
        """Mirror rows across the Sun's direction: ground so lit might exist as well."""
        pixels, target = self.pixels.copy(), self.target.copy()
        pixels[flip] = pixels[flip][:, ::-1]
        target[flip] *= np.array([1, -1, 1, 1, -1], dtype=np.float32)
        return Lessons(pixels, self.scalars, self.crater, self.weight, target, self.placed)


def windows(x: AnyFloats, size: int) -> AnyFloats:
    """Arrange the windows of a strided convolution as (n, H', W', size * size * C); the border is padded by zeros."""
    pad = size // 2
    padded = np.pad(x, ((0, 0), (pad, pad), (pad, pad), (0, 0)))
    view = np.lib.stride_tricks.sliding_window_view(padded, (size, size), axis=(1, 2))[:, ::STRIDE, ::STRIDE]
    # The channel becomes the last axis of a window, the order in which the weights of the kernels are stored.
    rows = np.ascontiguousarray(np.moveaxis(view, 3, 5))
    return rows.reshape(*rows.shape[:3], -1)


def fresh_network(rng: np.random.Generator) -> Network:
    """Draw first weights (He et al. 2015)."""
    weights: dict[str, Image] = {}
    for i, size in enumerate(_SIZES):
        fan = size * size * _CHANNELS[i]
        weights[f"conv{i + 1}"] = rng.normal(0, np.sqrt(2 / fan), (fan, _CHANNELS[i + 1])).astype(np.float32)
        weights[f"bias{i + 1}"] = np.zeros(_CHANNELS[i + 1], dtype=np.float32)
    fan = (SIDE // STRIDE**3) ** 2 * _CHANNELS[3] + SCALARS
    weights["dense1"] = rng.normal(0, np.sqrt(2 / fan), (fan, _HIDDEN)).astype(np.float32)
    weights["bias4"] = np.zeros(_HIDDEN, dtype=np.float32)
    weights["dense2"] = rng.normal(0, np.sqrt(0.1 / _HIDDEN), (_HIDDEN, OUTPUTS)).astype(np.float32)
    weights["bias5"] = np.zeros(OUTPUTS, dtype=np.float32)
    return Network(weights)


def loss(network: Network, lessons: Lessons, emphasis: float) -> tuple[float, dict[str, Image]]:
    """Return the loss and its derivatives by the weights.

    The loss is the mean cross-entropy of the verdicts and ``emphasis`` times the mean of Huber's function (with a bend
    at a tenth) of the errors of place and shape.
    """
    w = network.weights
    columns, masks, shapes = [], [], []
    x = lessons.pixels
    for i, size in enumerate(_SIZES):
        column = windows(x, size)
        shapes.append(x.shape)
        before: Image = column @ w[f"conv{i + 1}"] + w[f"bias{i + 1}"]
        columns.append(column)
        masks.append(before > 0.0)
        x = np.where(masks[-1], before, np.zeros_like(before))
    flat = np.concatenate([x.reshape(len(x), -1), lessons.scalars], axis=1)
    raw = flat @ w["dense1"] + w["bias4"]
    hidden = np.maximum(raw, 0.0)
    out = hidden @ w["dense2"] + w["bias5"]
    value, by_out = _criterion(out, lessons, emphasis)
    by: dict[str, Any] = {"dense2": hidden.T @ by_out, "bias5": by_out.sum(axis=0)}
    by_raw = (by_out @ w["dense2"].T) * (raw > 0.0)
    by["dense1"], by["bias4"] = flat.T @ by_raw, by_raw.sum(axis=0)
    by_x: AnyFloats = (by_raw @ w["dense1"].T)[:, :-SCALARS].reshape(-1, *_TOP)
    for i in (2, 1, 0):
        rows: AnyFloats = (by_x * masks[i]).reshape(-1, by_x.shape[-1])
        by[f"conv{i + 1}"] = columns[i].reshape(len(rows), -1).T @ rows
        by[f"bias{i + 1}"] = rows.sum(axis=0)
        if i:
            by_x = _folded((rows @ w[f"conv{i + 1}"].T).reshape(columns[i].shape), shapes[i], _SIZES[i])
    return value, by


def _criterion(out: Image, lessons: Lessons, emphasis: float) -> tuple[float, Image]:
    """Return the loss and its derivative by the outputs."""
    n = len(out)
    odds = out[:, 0]
    sure = 1.0 / (1.0 + np.exp(-np.clip(odds, -30, 30)))
    entropy = np.maximum(odds, 0.0) - odds * lessons.crater + np.log1p(np.exp(-np.abs(odds)))
    miss = out[:, 1:] - lessons.target
    bend = 0.1
    size = np.abs(miss)
    huber = np.where(size < bend, 0.5 * miss**2, bend * (size - 0.5 * bend))
    value = float((entropy * lessons.weight).sum() + emphasis * (huber * lessons.placed[:, None]).sum()) / n
    by = np.empty_like(out)
    by[:, 0] = (sure - lessons.crater) * lessons.weight / n
    by[:, 1:] = emphasis * np.clip(miss, -bend, bend) * lessons.placed[:, None] / n
    return value, by


def _folded(columns: AnyFloats, shape: tuple[int, ...], size: int) -> AnyFloats:
    """Sum what the windows of a convolution hold back to their pixels: the transpose of ``windows``."""
    n, height, width, channels = shape
    pad = size // 2
    padded = np.zeros((n, height + 2 * pad, width + 2 * pad, channels), dtype=columns.dtype)
    parts = columns.reshape(n, columns.shape[1], columns.shape[2], size, size, channels)
    for i in range(size):
        for j in range(size):
            rows = slice(i, i + STRIDE * columns.shape[1], STRIDE)
            cols = slice(j, j + STRIDE * columns.shape[2], STRIDE)
            padded[:, rows, cols] += parts[:, :, :, i, j]
    return padded[:, pad : pad + height, pad : pad + width]


@dataclass(frozen=True, slots=True)
class Schedule:
    """How long to train: epochs, lessons a step, the first rate of Adam (it falls by a cosine), weight of places."""

    epochs: int = 14
    batch: int = 128
    rate: float = 2e-3
    emphasis: float = 30.0
    decay: float = 1e-4


def train(
    network: Network,
    lessons: Lessons,
    schedule: Schedule,
    rng: np.random.Generator,
    told: Callable[[int, float, Network], None],
) -> Network:
    """Minimise the loss by Adam (Kingma and Ba 2015); ``told`` hears of each epoch's mean loss."""
    w = {name: network.weights[name].copy() for name in SHAPES}
    first = {name: np.zeros_like(w[name]) for name in SHAPES}
    second = {name: np.zeros_like(w[name]) for name in SHAPES}
    n = len(lessons.crater)
    steps, k = schedule.epochs * (n // schedule.batch), 0
    for epoch in range(schedule.epochs):
        order, total = rng.permutation(n), 0.0
        for start in range(0, n - schedule.batch + 1, schedule.batch):
            rows = np.sort(order[start : start + schedule.batch])
            batch = lessons[rows].mirrored(rng.random(schedule.batch) < 0.5)
            value, by = loss(Network(w), batch, schedule.emphasis)
            total += value
            k += 1
            rate = schedule.rate * 0.5 * (1.0 + np.cos(np.pi * k / steps)) * min(1.0, k / 100.0)
            for name in SHAPES:
                first[name] += np.float32(0.1) * (by[name] - first[name])
                second[name] += np.float32(0.001) * (by[name] ** 2 - second[name])
                step = first[name] / (1 - 0.9**k) / (np.sqrt(second[name] / (1 - 0.999**k)) + 1e-8)
                w[name] -= (rate * (step + schedule.decay * w[name] * (w[name].ndim > 1))).astype(np.float32)
        told(epoch, total / max(n // schedule.batch, 1), Network(dict(w)))
    return Network(w)
