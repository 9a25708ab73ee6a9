"""Compiled kernels of the detectors: merits of rims, duplicates, ring templates, and the network."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray
from boresight.scenarios.compiled import compiler

PlaceArray = NDArray[np.uint64]  # unsigned: Numba lets a negative index count from the end, which is slow

Cosines = TypeVar("Cosines", float, FloatArray)

LANES = 64  # pixels of a row, or patches, that are evaluated at once

RIM_POINTS = 72  # of a rim where its merit is evaluated
_HALVINGS = 5  # most reductions of a step that does not increase the merit enough
_ARMIJO = 0.1  # least increase, as a share of that predicted by the gradient
_CONVERGED_PX = 2e-3  # step below which a rim has converged

kernel, inner = compiler(Path(__file__).parent)


@kernel
def divide_softly(out: FloatArray, along_u: Image, along_v: Image, floor: float) -> None:
    """Write vectors (H, W, 2) divided by the root of their square and that of ``floor``."""
    for i in range(len(out)):
        for j in range(out.shape[1]):
            u, v = np.float64(along_u[i, j]), np.float64(along_v[i, j])
            length = max(np.sqrt(u * u + v * v + floor * floor), 1e-12)
            out[i, j, 0], out[i, j, 1] = u / length, v / length


def side_weights(toward_sun: Cosines, gap: float) -> tuple[Cosines, Cosines]:
    """Weight rim points by the cosine between their normal and the Sun: 0 in the transition arcs, +1 and -1 beyond.

    Parameters
    ----------
    toward_sun
        The cosines: one, or an array.
    gap
        Cosine at the end of the transition arcs: sin 30 deg for arcs of 30 deg on each side.

    Returns
    -------
    weights, slopes
        Odd and smooth (a quintic step over the outer half of the arcs), and their derivatives.
    """
    start = 0.5 * gap
    # A quintic step has continuous first and second derivatives: conjugate gradients need a smooth merit when points of
    # a turning rim pass from a transition arc to a side.
    x = np.minimum(np.maximum((np.abs(toward_sun) - start) / (gap - start), 0.0), 1.0)
    step = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    slope = 30.0 * x * x * (1.0 - x) * (1.0 - x) / (gap - start)
    return np.sign(toward_sun) * step, slope


_side_weights = inner(side_weights)  # of one cosine


@kernel
def rim_merits(
    value: FloatArray, by: FloatArray, rims: FloatArray, field: FloatArray, sun: FloatArray, gap: float, count: int
) -> None:
    """Write the merits (n, 2) of both sides of rims and their derivatives (n, 2, 5): see `detection.refinement`.

    Parameters
    ----------
    rims
        (n, 5) u0, v0, a, b in pixels and the angle of a in radians.
    field
        (H, W, 2) at the centres of pixels; it is bilinear between them and constant beyond the outermost.
    sun
        (2,) unit vector towards the Sun.
    count
        Points of a rim.
    """
    for n in range(len(rims)):
        _rim_merit(value[n], by[n], rims[n], field, sun, gap, count)


@inner
def _rim_merit(
    value: FloatArray,
    by: FloatArray,
    rim: FloatArray,
    field: FloatArray,
    sun: FloatArray,
    gap: float,
    count: int | np.int64,
) -> None:
    """Write the merits (2,) of both sides of one rim (5,) and their derivatives (2, 5)."""
    right, bottom = field.shape[1] - 1.0, field.shape[0] - 1.0
    total, total_by = np.zeros(2), np.zeros((2, 5))
    point_by, spin = np.zeros((2, 5)), np.zeros(5)
    point_by[0, 0] = point_by[1, 1] = spin[4] = 1.0
    a, b = rim[2], rim[3]
    c, s = np.cos(rim[4]), np.sin(rim[4])
    for side in range(2):
        value[side] = 0.0
        for d in range(5):
            by[side, d] = 0.0
    for k in range(count):
        t = k * (2.0 * np.pi / count)
        cos, sin = np.cos(t), np.sin(t)
        length = np.hypot(b * cos, a * sin)
        nu, nv = (c * b * cos - s * a * sin) / length, (s * b * cos + c * a * sin) / length
        weight, slope = _side_weights(nu * sun[0] + nv * sun[1], gap)
        if weight == 0.0:
            continue
        # Equation (2), with the origin of OpenCV's pixels in the middle of the first one.
        u = rim[0] + c * a * cos - s * b * sin - 0.5
        v = rim[1] + s * a * cos + c * b * sin - 0.5
        at_u, at_v = min(max(u, 0.0), right), min(max(v, 0.0), bottom)
        # At the last row or column the cell before it is used, so that its four corners exist.
        j, i = int(min(at_u, right - 1.0)), int(min(at_v, bottom - 1.0))
        fu, fv = at_u - j, at_v - i
        along = along_u = along_v = turned = 0.0
        for x in range(2):
            p, q, r, w = field[i, j, x], field[i, j + 1, x], field[i + 1, j, x], field[i + 1, j + 1, x]
            upper, lower = p + fu * (q - p), r + fu * (w - r)
            g = upper + fv * (lower - upper)
            normal, tangent = (nu, -nv) if x == 0 else (nv, nu)
            # The component g . n, its derivatives by the place, and that by a turn of the normal.
            along += normal * g
            along_u += normal * ((q - p) + fv * (w - r - q + p))
            along_v += normal * (lower - upper)
            turned += tangent * g
        # Where the place was clipped, the field does not change with the coordinate.
        along_u, along_v = along_u if u == at_u else 0.0, along_v if v == at_v else 0.0
        point_by[0, 2], point_by[1, 2] = c * cos, s * cos
        point_by[0, 3], point_by[1, 3] = -s * sin, c * sin
        point_by[0, 4], point_by[1, 4] = -s * a * cos - c * b * sin, c * a * cos - s * b * sin
        # The normal (b cos t, a sin t) turns by d(angle) = (b cos t d(a sin t) - a sin t d(b cos t)) / length^2.
        spin[2], spin[3] = b * cos * sin / (length * length), -a * sin * cos / (length * length)
        side, sign = (0, 1.0) if weight > 0.0 else (1, -1.0)
        total[side] += sign * weight
        value[side] += weight * along
        for d in range(5):
            along_by = spin[d] * turned + along_u * point_by[0, d] + along_v * point_by[1, d]
            weight_by = slope * spin[d] * (nu * sun[1] - nv * sun[0])
            total_by[side, d] += sign * weight_by
            by[side, d] += weight * along_by + weight_by * along
    for side in range(2):
        # The weights are negative on the far side, where the gradient points inwards: the ratio is positive for a
        # rim. Quotient rule: the sum of the weights changes with the shape too.
        whole = max(total[side], 1e-9)
        value[side] /= whole
        for d in range(5):
            by[side, d] = (by[side, d] - value[side] * total_by[side, d]) / whole


@kernel
def climb(start: FloatArray, field: FloatArray, sun: FloatArray, gap: float, rounds: int) -> FloatArray:
    """Maximise the merits of rims (n, 5); return them.

    By conjugate gradients (Polak and Ribiere), restarted where the direction leads downhill; all rims stop together.
    """
    n = len(start)
    value, length, radius = np.empty(n), np.empty(n), np.empty(n)
    slope, direction, step, unit = np.empty((n, 5)), np.empty((n, 5)), np.zeros((n, 5)), np.empty((n, 5))
    new_value, new_slope, taken = np.empty(n), np.empty((n, 5)), np.empty((n, 5))
    trial, trial_slope, turned = np.empty(5), np.empty(5), np.empty(5)
    for k in range(n):
        radius[k] = np.sqrt(start[k, 2] * start[k, 3])
        # Scaled so that a unit of each parameter moves the rim by about a pixel: the angle by the difference of the
        # axes.
        for d in range(5):
            unit[k, d] = 1.0 / max(start[k, 2] - start[k, 3], 0.1 * radius[k]) if d == 4 else 1.0
        value[k] = _evaluate(slope[k], step[k], start[k], unit[k], field, sun, gap, radius[k])
        _copy(direction[k], slope[k])
        length[k] = 0.3 / max(np.sqrt(_dot(slope[k], slope[k])), 1e-9)  # the first step is of 0.3 px
    for _ in range(rounds):
        largest = 0.0
        for k in range(n):
            # Restart with the gradient where the conjugate direction has lost the ascent.
            if _dot(direction[k], slope[k]) <= 0.0:
                _copy(direction[k], slope[k])
            gain = _dot(direction[k], slope[k])
            new_value[k] = value[k]
            _copy(new_slope[k], slope[k])
            _copy(taken[k], step[k])
            # Backtracking until Armijo's condition holds; a rim that never reaches it stays.
            for _ in range(_HALVINGS):
                for d in range(5):
                    trial[d] = step[k, d] + length[k] * direction[k, d]
                found = _evaluate(trial_slope, trial, start[k], unit[k], field, sun, gap, radius[k])
                if found >= value[k] + _ARMIJO * length[k] * gain:
                    new_value[k] = found
                    _copy(new_slope[k], trial_slope)
                    _copy(taken[k], trial)
                    break
                length[k] *= 0.4
            for d in range(5):
                largest = max(largest, abs(taken[k, d] - step[k, d]))
        if largest < _CONVERGED_PX:
            break
        for k in range(n):
            for d in range(5):
                turned[d] = new_slope[k, d] - slope[k, d]
            # Polak and Ribiere, floored at 0: a negative value would reverse the old direction; 0 restarts with the
            # gradient.
            beta = _dot(turned, new_slope[k]) / max(_dot(slope[k], slope[k]), 1e-30)
            before = np.sqrt(_dot(direction[k], direction[k]))
            for d in range(5):
                direction[k, d] = new_slope[k, d] + max(beta, 0.0) * direction[k, d]
            size = max(np.sqrt(_dot(direction[k], direction[k])), 1e-30)
            # The first trial is somewhat longer than the last accepted step, and moves the rim by a tenth of its radius
            # at most.
            length[k] = min(1.8 * length[k] * before / size, 0.1 * radius[k] / size)
            value[k] = new_value[k]
            _copy(step[k], taken[k])
            _copy(slope[k], new_slope[k])
    for k in range(n):
        for d in range(5):
            step[k, d] = start[k, d] + step[k, d] * unit[k, d]
    return step


@inner
def _copy(out: FloatArray, values: FloatArray) -> None:
    """Write values (5,); Numba compiles an assignment of arrays ten times as slowly."""
    for d in range(len(values)):
        out[d] = values[d]


@inner
def _dot(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for d in range(len(a)):
        total += a[d] * b[d]
    return total


@inner
def _evaluate(
    slope: FloatArray, step: FloatArray, start: FloatArray, unit: FloatArray, field: FloatArray, sun: FloatArray,
    gap: float, radius: float,
) -> float:  # fmt: skip
    """Write the derivatives (5,) of a rim's merit by the step and return the merit."""
    moved, value, by = np.empty(5), np.empty(2), np.empty((2, 5))
    for d in range(5):
        moved[d] = start[d] + step[d] * unit[d]
    # A collapsed rim is not evaluated; the merit is at least -1, so that -2 is refused by the line search.
    collapsed = min(moved[2], moved[3]) < 0.3 * radius
    if collapsed:
        moved = start
    # An int64, because numba would compile the function once more for a literal.
    _rim_merit(value, by, moved, field, sun, gap, np.int64(RIM_POINTS))
    for d in range(5):
        slope[d] = 0.5 * (by[0, d] + by[1, d]) * unit[d]
    return -2.0 if collapsed else 0.5 * (value[0] + value[1])


@kernel
def best_of_each(order: IndexArray, centre: FloatArray, radius: FloatArray, apart: float, ratio: float) -> IndexArray:
    """Return the rows, in the given order, of circles that are no duplicates: see `suppress_duplicates`."""
    kept, count = np.empty(len(order), dtype=np.int64), 0
    for i in order:
        for k in range(count):
            j = kept[k]
            du, dv = centre[j, 0] - centre[i, 0], centre[j, 1] - centre[i, 1]
            smaller, larger = min(radius[j], radius[i]), max(radius[j], radius[i])
            if np.sqrt(du * du + dv * dv) < apart * smaller and larger / smaller < ratio:
                break
        else:
            kept[count] = i
            count += 1
    return kept[:count]


@inner
def _add_taps(out: Image, field: Image, place: PlaceArray, weight: Image, base: np.uint64) -> None:
    """Add to ``out`` (LANES,) the sum of weights (T,) times LANES consecutive values of a flat field at each place."""
    k = 0
    # Four at a time, so that the sums stay longer in registers.
    while k + 3 < len(place):
        p, q, r, s = base + place[k], base + place[k + 1], base + place[k + 2], base + place[k + 3]
        a, b, c, d = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        for x in range(np.uint64(LANES)):
            out[x] = out[x] + a * field[p + x] + b * field[q + x] + c * field[r + x] + d * field[s + x]
        k += 4
    while k < len(place):
        p, a = base + place[k], weight[k]
        for x in range(np.uint64(LANES)):
            out[x] += a * field[p + x]
        k += 1


class RingTaps(NamedTuple):
    """Non-zero weights (T,) of templates and their places in a flat field, and the first of each side of a template."""

    place: PlaceArray
    weight: Image
    start: IndexArray


@kernel
def ring_scores(
    best: Image, which: IndexArray, field: Image, taps: RingTaps, near: BoolArray, least: np.float32
) -> None:
    """Write the best merit (H, W) of all templates, and the template's row, where it reaches ``least``.

    A merit is the smaller of the template's two sides, so that the second need not be evaluated where the first is low.

    Parameters
    ----------
    field
        (2, H', W') the gradient, padded so that the templates at all pixels, and LANES more columns, are in it.
    near
        (H, W) whether any gradient within reach of a template is not zero.
    """
    height, width = best.shape
    one, other, flat = np.empty(LANES, dtype=np.float32), np.empty(LANES, dtype=np.float32), field.ravel()
    for row in range(height):
        for left in range(0, width, LANES):
            n = min(LANES, width - left)
            if not near[row, left : left + n].any():
                continue
            base = np.uint64(row * field.shape[2] + left)
            for m in range(len(taps.start) // 2):
                first, middle, end = taps.start[2 * m], taps.start[2 * m + 1], taps.start[2 * m + 2]
                one[:] = 0.0
                _add_taps(one, flat, taps.place[first:middle], taps.weight[first:middle], base)
                higher = False
                for x in range(n):
                    higher |= one[x] >= least and one[x] > best[row, left + x]
                if not higher:
                    continue
                other[:] = 0.0
                _add_taps(other, flat, taps.place[middle:end], taps.weight[middle:end], base)
                for x in range(n):
                    merit = min(one[x], other[x])
                    if merit > best[row, left + x]:
                        best[row, left + x], which[row, left + x] = merit, m


class NetworkWeights(NamedTuple):
    """Weights of three convolutions and two dense layers (outputs, inputs), and their biases."""

    conv1: Image
    bias1: Image
    conv2: Image
    bias2: Image
    conv3: Image
    bias3: Image
    dense1: Image
    bias4: Image
    dense2: Image
    bias5: Image


@kernel
def apply_network(out: Image, pixels: Image, scalars: Image, w: NetworkWeights) -> None:
    """Write the outputs (n, OUTPUTS) for patches (n, S, S) and their further inputs (n, K).

    LANES patches are evaluated at once: they are the last axis of all layers, which have a border of zeros.
    """
    side, pad, zero = pixels.shape[1], round(np.sqrt(w.conv1.shape[1])) // 2, np.float32(0.0)
    # No literals, for which numba would compile twice.
    none, border = np.int64(0), np.int64(1)
    first = np.zeros((side + 2 * pad, side + 2 * pad, 1, LANES), dtype=np.float32)
    second = np.zeros((side // 2 + 2, side // 2 + 2, len(w.conv1), LANES), dtype=np.float32)
    third = np.zeros((side // 4 + 2, side // 4 + 2, len(w.conv2), LANES), dtype=np.float32)
    inputs = np.zeros((1, 1, w.dense1.shape[1], LANES), dtype=np.float32)
    n_seen = w.dense1.shape[1] - scalars.shape[1]
    last = inputs[0, 0, :n_seen].reshape((side // 8, side // 8, len(w.conv3), LANES))
    hidden = np.zeros((1, 1, len(w.dense1), LANES), dtype=np.float32)
    result = np.zeros((1, 1, len(w.dense2), LANES), dtype=np.float32)
    for start in range(0, len(pixels), LANES):
        n = min(LANES, len(pixels) - start)
        for p in range(n):
            for i in range(side):
                for j in range(side):
                    first[pad + i, pad + j, 0, p] = pixels[start + p, i, j]
            for k in range(scalars.shape[1]):
                inputs[0, 0, n_seen + k, p] = scalars[start + p, k]
        _convolve(second, border, first, w.conv1, w.bias1, zero)
        _convolve(third, border, second, w.conv2, w.bias2, zero)
        _convolve(last, none, third, w.conv3, w.bias3, zero)
        _convolve(hidden, none, inputs, w.dense1, w.bias4, zero)
        _convolve(result, none, hidden, w.dense2, w.bias5, -np.float32(np.inf))
        for p in range(n):
            for k in range(out.shape[1]):
                out[start + p, k] = result[0, 0, k, p]


@inner
def _convolve(out: Image, border: np.int64, x: Image, weights: Image, bias: Image, floor: np.float32) -> None:
    """Write a convolution (H / 2, W / 2, C', LANES) of stride 2, at least ``floor``, of a padded (H, W, C, LANES).

    A ``border`` of ``out`` is left as it is. A dense layer has one window, the whole layer before it.
    """
    width, depth = x.shape[1], x.shape[2]
    size = round(np.sqrt(weights.shape[1] / depth))
    place = np.empty((size, size, depth), dtype=np.uint64)
    for i in range(size):
        for j in range(size):
            for c in range(depth):
                place[i, j, c] = np.uint64(((i * width + j) * depth + c) * LANES)
    total, flat, places = np.empty(LANES, dtype=np.float32), x.ravel(), place.ravel()
    for i in range(out.shape[0] - 2 * border):
        for j in range(out.shape[1] - 2 * border):
            base = np.uint64((2 * i * width + 2 * j) * depth * LANES)
            for c in range(out.shape[2]):
                total[:] = bias[c]
                _add_taps(total, flat, places, weights[c], base)
                row = out[border + i, border + j, c]
                for p in range(LANES):
                    row[p] = max(total[p], floor)
