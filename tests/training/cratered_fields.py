"""Height fields of ground near saturation with craters, for the training of the heat map of craters.

Numba alone, so that threads draw fields while a GPU trains. Lengths are in pixels of the image. The fields share
nothing with the worlds that detectors are tested on.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
_kernel = numba.njit(nogil=True, fastmath=True, error_model="numpy")

SIDE = 384  # of a field
TABLE = 1536  # most craters of a field that are told to the training
RADIUS_MIN = 1.7  # of those
RINGS = np.linspace(0.1, 1.25, 8).astype(np.float32)  # in radii: where the profile of a crater is told
COLUMNS = 4 + len(RINGS)  # of the table: x, y, radius, share of the rim that is cut, heights at the rings

_FAMILIES, _WEARS, _STEPS = 16, 24, 128
_FARTHEST = 3.2  # radii that a profile reaches
_WEAR_MIN, _WEAR_MAX = 0.02, 1.6
_CREST_MAX = 1.35  # radii of the fresh crater: what is worn further has no crest that could be seen


def profiles() -> Floats:
    """Return heights (families, wears, steps) of profiles of a fresh depth of 1, from the centre to 3.2 radii.

    A fresh crater has a bowl with a flat or a round floor, filled or with a mound, and a raised rim. Wear is the
    diffusion of its relief: the convolution with a Gaussian of that many radii.
    """
    rng = np.random.default_rng(2003)
    half = 132
    step = 4.6 / half
    across = np.hypot(*np.meshgrid(np.arange(-half, half + 1), np.arange(-half, half + 1))) * step
    table = np.zeros((_FAMILIES, _WEARS, _STEPS), dtype=np.float32)
    wears = np.geomspace(_WEAR_MIN, _WEAR_MAX, _WEARS)
    for family in range(_FAMILIES):
        rim, power, decay = rng.uniform(0.1, 0.28), rng.uniform(1.5, 4.5), rng.uniform(2.5, 4.0)
        bowl = rim - (1.0 + rim) * (1.0 - np.minimum(across, 1.0) ** power)
        if family % 4 == 1:  # filled
            bowl = np.maximum(bowl, -rng.uniform(0.3, 0.7))
        if family % 4 == 2:  # a mound on the floor
            bowl += rng.uniform(0.1, 0.4) * np.exp(-((across / rng.uniform(0.12, 0.25)) ** 2))
        blanket = rim * np.maximum(across, 1.0) ** -decay
        fresh = np.where(across < 1.0, bowl, blanket)
        for k, wear in enumerate(wears):
            worn = cv2.GaussianBlur(fresh, (0, 0), wear / step, borderType=cv2.BORDER_REPLICATE)
            places = np.arange(_STEPS) * (_FARTHEST / (_STEPS - 1))
            fade = np.clip((_FARTHEST - places) / 0.8, 0.0, 1.0)
            table[family, k] = np.interp(places, np.arange(half + 1) * step, worn[half, half:]) * fade
    return table


@_kernel
def _profile(table: Floats, family: int, wear: float, r: float) -> float:
    """Interpolate a profile of a wear in radii at a distance in radii."""
    place = r * ((_STEPS - 1) / _FARTHEST)
    i = int(place)
    if i >= _STEPS - 1:
        return 0.0
    w = np.log(min(max(wear, _WEAR_MIN), _WEAR_MAX) / _WEAR_MIN) * ((_WEARS - 1) / np.log(_WEAR_MAX / _WEAR_MIN))
    k = min(int(w), _WEARS - 2)
    f, g = place - i, w - k
    one = table[family, k, i] * (1.0 - f) + table[family, k, i + 1] * f
    two = table[family, k + 1, i] * (1.0 - f) + table[family, k + 1, i + 1] * f
    return one * (1.0 - g) + two * g


@_kernel
def _crest_of(line: Floats) -> float:
    """Return where a worn profile is highest, in radii of the fresh crater: diffusion moves the crest outwards."""
    scale = (_STEPS - 1) / _FARTHEST
    best = int(0.9 * scale)
    for k in range(best, int(_CREST_MAX * scale)):
        if line[k] > line[best]:
            best = k
    return best / scale


@_kernel
def _lay(height: Floats, albedo: Floats, line: Floats, bowl: Floats, shape: Floats, bright: float) -> None:
    """Lay a crater of a profile ``line`` on the ground, in place: within it replaces the ground, outside it adds.

    ``bowl`` is x, y, radius and depth; ``shape`` the cosine and sine parts of its second and third harmonics.
    """
    x, y, radius, depth = bowl[0], bowl[1], bowl[2], bowl[3]
    mean, slope_x, slope_y = 0.0, 0.0, 0.0
    for k in range(16):
        c, s = np.cos(k * np.pi / 8.0), np.sin(k * np.pi / 8.0)
        column = min(max(int(x + radius * c), 0), SIDE - 1)
        row = min(max(int(y + radius * s), 0), SIDE - 1)
        mean += height[row, column] / 16.0
        slope_x += height[row, column] * c / (8.0 * radius)
        slope_y += height[row, column] * s / (8.0 * radius)
    reach = _FARTHEST * radius * 1.1
    scale = (_STEPS - 1) / _FARTHEST
    for row in range(max(int(y - reach), 0), min(int(y + reach) + 2, SIDE)):
        for column in range(max(int(x - reach), 0), min(int(x + reach) + 2, SIDE)):
            dx, dy = column + 0.5 - x, row + 0.5 - y
            far = np.sqrt(dx * dx + dy * dy)
            c, s = dx / (far + 1e-6), dy / (far + 1e-6)
            c2, s2 = c * c - s * s, 2.0 * c * s
            c3, s3 = c2 * c - s2 * s, s2 * c + c2 * s
            r = far / (radius * (1.0 + shape[0] * c2 + shape[1] * s2 + shape[2] * c3 + shape[3] * s3))
            place = r * scale
            i = int(place)
            if i >= _STEPS - 1:
                continue
            f = place - i
            kept = min(max(2.5 * (r - 0.5), 0.0), 1.0)
            old = height[row, column]
            if kept < 1.0:
                old = kept * old + (1.0 - kept) * (mean + slope_x * dx + slope_y * dy)
            height[row, column] = old + depth * (line[i] * (1.0 - f) + line[i + 1] * f)
            if bright != 0.0:
                albedo[row, column] += bright * min(1.0, max(0.0, 1.6 - 0.5 * r))


@_kernel
def _scatter_rocks(rng: np.random.Generator, height: Floats, count: int, largest: float) -> None:
    """Put round rocks and hills on the ground, in place."""
    for _ in range(count):
        radius = 0.7 * (1.0 - rng.random() * (1.0 - (0.7 / largest) ** 2)) ** -0.5
        x, y = rng.random() * SIDE, rng.random() * SIDE
        tall = radius * (0.15 + 0.5 * rng.random()) / (1.0 + 0.12 * radius)
        for row in range(max(int(y - 2.5 * radius), 0), min(int(y + 2.5 * radius) + 2, SIDE)):
            for column in range(max(int(x - 2.5 * radius), 0), min(int(x + 2.5 * radius) + 2, SIDE)):
                far = ((column + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2) / radius**2
                height[row, column] += tall * np.exp(-far)


@_kernel
def _draw_ridges(rng: np.random.Generator, height: Floats, count: int) -> None:
    """Draw ridges, troughs and steps along lines across the ground, in place."""
    for _ in range(count):
        angle, away = rng.random() * 2.0 * np.pi, (rng.random() - 0.5) * SIDE
        wide = 2.0 * 10.0 ** rng.random()
        tall = wide * (rng.random() - 0.5) * 0.5
        step = rng.random() < 0.3
        bend, turn = rng.random() * 20.0, 2.0 * np.pi * rng.random()
        c, s = np.cos(angle), np.sin(angle)
        for row in range(SIDE):
            for column in range(SIDE):
                x, y = column - SIDE / 2, row - SIDE / 2
                d = (c * x + s * y - away + bend * np.sin((c * y - s * x) * 0.03 + turn)) / wide
                height[row, column] += tall * (np.tanh(d) if step else np.exp(-d * d))


@_kernel
def _is_hidden(bowls: Floats, i: int) -> tuple[bool, float]:
    """Say whether a younger crater took a crater's place, and return the share of its rim that younger ones cut."""
    x, y, radius = bowls[i, 0], bowls[i, 1], bowls[i, 2]
    cut = np.zeros(16, dtype=np.bool_)
    for j in range(i + 1, len(bowls)):
        other = bowls[j, 2]
        if other < 0.3 * radius:
            continue
        apart = np.hypot(bowls[j, 0] - x, bowls[j, 1] - y)
        if apart > radius + other:
            continue
        if apart < 0.35 * other and abs(np.log(other / radius)) < 0.3:
            return True, 1.0
        for k in range(16):
            dx = x + radius * np.cos(k * np.pi / 8.0) - bowls[j, 0]
            dy = y + radius * np.sin(k * np.pi / 8.0) - bowls[j, 1]
            cut[k] |= dx * dx + dy * dy < (0.95 * other) ** 2
    return False, cut.mean()


@_kernel
def draw_field(rng: np.random.Generator, table: Floats, height: Floats, albedo: Floats, told: Floats) -> int:
    """Draw a field into ``height`` and ``albedo`` (SIDE, SIDE), and its craters into ``told`` (TABLE, COLUMNS).

    Return the number of craters told, the youngest first. ``table`` is that of `profiles`.
    """
    height[:], albedo[:], told[:] = 0.0, 0.0, 0.0
    # Cumulative numbers of a power law; a share of 1 is geometric saturation of radii from the least one on.
    least, most, slope = 1.6 + 0.8 * rng.random(), 110.0, 1.5 + 1.3 * rng.random()
    density = 0.006 * 40.0 ** rng.random()
    count = int(min(density * 0.385 * (SIDE + 40.0) ** 2 / 3.0**2 * (least / 3.0) ** -slope, 3000))
    diffusion = 0.2 * 60.0 ** rng.random()  # px, over the age of the ground
    deepest = 0.10 + 0.12 * rng.random()
    rays = rng.random() < 0.35
    if rng.random() < 0.3:
        _draw_ridges(rng, height, 1 + int(3 * rng.random()))
    if rng.random() < 0.15:
        _scatter_rocks(rng, height, 40, 30.0)
    bowls = np.zeros((count, 4), dtype=np.float32)
    rings = np.zeros((count, len(RINGS)), dtype=np.float32)
    shape = np.zeros(4, dtype=np.float32)
    line = np.zeros(_STEPS, dtype=np.float32)
    crest = np.zeros(count, dtype=np.float32)
    for i in range(count):
        u = rng.random()
        radius = (least**-slope + u * (most**-slope - least**-slope)) ** (-1.0 / slope)
        bowl = bowls[i]
        bowl[0], bowl[1] = rng.random() * (SIDE + 40.0) - 20.0, rng.random() * (SIDE + 40.0) - 20.0
        bowl[2], bowl[3] = radius, 2.0 * radius * deepest * (0.6 + 0.4 * rng.random())
        age = 1.0 - i / count
        wear = 0.04 + 0.12 * rng.random() + diffusion * np.sqrt(age) / radius
        if rng.random() < 0.35:
            wear += 0.8 * rng.random() ** 2
        family = int(rng.random() * _FAMILIES)
        uneven = 0.015 + 0.035 * rng.random()
        for k in range(4):
            shape[k] = rng.normal() * uneven / (1.0 + (k > 1))
        for k in range(_STEPS):
            line[k] = _profile(table, family, wear, k * (_FARTHEST / (_STEPS - 1)))
        crest[i] = _crest_of(line)
        for k in range(len(RINGS)):
            rings[i, k] = bowl[3] * _profile(table, family, wear, RINGS[k] * crest[i])
        bright = 0.0
        if rays and wear < 0.25 and rng.random() < 0.4:
            bright = rng.random() * 0.5 - 0.12
        _lay(height, albedo, line, bowl, shape, bright)
    if rng.random() < 0.4:
        _scatter_rocks(rng, height, int(10.0 * 40.0 ** rng.random()), 4.0)
    n = 0
    for i in range(count - 1, -1, -1):
        if n == TABLE:
            break
        if bowls[i, 2] < RADIUS_MIN:
            continue
        hidden, cut = _is_hidden(bowls, i)
        if hidden or cut > 0.8:
            continue
        told[n, :2], told[n, 2], told[n, 3], told[n, 4:] = bowls[i, :2], bowls[i, 2] * crest[i], cut, rings[i]
        n += 1
    return n
