"""Cratered ground for training: a height field drawn from a seed, seen from afar aslant, with shadows.

It shares nothing with the worlds that detectors are tested on: neither the body, nor the population, nor the profile
of a crater, nor the renderer. Lengths are in pixels of the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from boresight.scenarios.arrays import FloatArray

STEP_PX = 0.6  # between the heights of a ground


@dataclass(frozen=True, slots=True)
class Bowl:
    """One crater: place of its centre and radius of its crest on the ground; ratios are to the diameter.

    Parameters
    ----------
    power
        Of the bowl's profile: 2 is a paraboloid, more has a flat floor.
    decay
        Of the blanket outside: its height falls as distance to this power.
    rounding
        Half width of the crest, in radii.
    """

    x: float
    y: float
    radius: float
    depth_ratio: float
    rim_ratio: float
    power: float
    decay: float
    rounding: float

    def heights(self, r: FloatArray) -> FloatArray:
        """Height over the old ground at distances in radii; it is greatest at 1."""
        off = np.abs(r - 1.0)
        away = np.sqrt(off**2 + self.rounding**2) - self.rounding
        within = 1.0 - np.maximum(1.0 - away, 0.0) ** self.power
        rim, depth = 2.0 * self.radius * self.rim_ratio, 2.0 * self.radius * self.depth_ratio
        fade = np.clip(3.0 - r, 0.0, 1.0)
        return np.asarray(np.where(r < 1.0, rim - depth * within, rim * (1.0 + away) ** -self.decay * fade))


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """A height field and the crests of its craters.

    Parameters
    ----------
    heights
        (rows, columns) at x = STEP_PX * column, y = STEP_PX * row.
    bowls
        From the oldest to the youngest.
    crests
        (n, 48, 3) points of the crests when they were made.
    cut
        (n,) share of each crest that younger craters have taken away.
    """

    heights: FloatArray
    bowls: tuple[Bowl, ...]
    crests: FloatArray
    cut: FloatArray


def draw_bowls(rng: np.random.Generator, size: FloatArray) -> tuple[Bowl, ...]:
    """Draw a population over a rectangle: a power law of sizes, and age, which wears rims down."""
    least, most = 2.2, 90.0
    slope = rng.uniform(1.7, 2.4)
    count = int(rng.uniform(1.5, 5.0) * 1e-3 * size.prod())
    radius = rng.uniform(most**-slope, least**-slope, count) ** (-1.0 / slope)
    bowls = []
    for r, age in zip(radius, np.sort(rng.uniform(0.0, 1.0, count))[::-1], strict=True):
        depth = 0.07 + 0.13 * (0.75 * (1.0 - age) + 0.25 * rng.uniform())
        rim = depth * rng.uniform(0.12, 0.24) * (1.0 - 0.5 * age)
        rounding = rng.uniform(0.03, 0.07) + 0.1 * age
        x, y = rng.uniform(0.0, 1.0, 2) * size
        bowls.append(Bowl(x, y, r, depth, rim, rng.uniform(1.7, 2.6), rng.uniform(2.5, 3.5), rounding))
    return tuple(bowls)


def draw_relief(rng: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    """Draw ground without craters: broad hills that turn it to and from the Sun, and fine roughness."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None]) / STEP_PX
    total = np.zeros(shape)
    for shortest, longest, power, slope in (
        (120.0, 900.0, 2.0, rng.uniform(0.02, 0.25)),
        (2.0, 60.0, 1.9, rng.uniform(0.01, 0.08)),
    ):
        band = np.where((frequency > 1.0 / longest) & (frequency < 1.0 / shortest), np.maximum(frequency, 1e-9), np.inf)
        field = np.fft.irfft2(np.fft.rfft2(rng.normal(size=shape)) * band**-power, shape)
        tilt = np.hypot(*np.gradient(field, STEP_PX))
        total += field * (slope / np.sqrt(np.mean(tilt**2)))
    return total


def make_ground(rng: np.random.Generator, size: FloatArray) -> Ground:
    """Lay craters on hills one after the other: each replaces the ground within and adds to that outside."""
    shape = (int(size[1] / STEP_PX), int(size[0] / STEP_PX))
    heights = draw_relief(rng, shape)
    bowls = draw_bowls(rng, size)
    crests = np.array([_lay(heights, bowl) for bowl in bowls]).reshape(-1, 48, 3)
    places = np.array([[bowl.x, bowl.y, bowl.radius] for bowl in bowls]).reshape(-1, 3)
    cut = np.zeros(len(bowls))
    for i in range(len(bowls)):
        younger = places[i + 1 :]
        near = younger[np.hypot(*(younger[:, :2] - places[i, :2]).T) < younger[:, 2] + places[i, 2]]
        far = np.linalg.norm(crests[i][:, None, :2] - near[None, :, :2], axis=2)
        cut[i] = np.mean(np.any(far < near[:, 2], axis=1))
    return Ground(heights, bowls, crests, cut)


def _lay(heights: FloatArray, bowl: Bowl) -> FloatArray:
    """Lay one crater on the ground, in place, and return its crest (48, 3)."""
    reach = 3.0 * bowl.radius
    rows = slice(max(int((bowl.y - reach) / STEP_PX), 0), int((bowl.y + reach) / STEP_PX) + 2)
    columns = slice(max(int((bowl.x - reach) / STEP_PX), 0), int((bowl.x + reach) / STEP_PX) + 2)
    part = heights[rows, columns]
    y, x = np.indices(part.shape) * STEP_PX + np.array([rows.start, columns.start])[:, None, None] * STEP_PX
    dx, dy = x - bowl.x, y - bowl.y
    r = np.hypot(dx, dy) / bowl.radius
    ring = (np.abs(r - 1.0) < 0.25) | ((bowl.radius < 4.0) & (r < 1.3))
    basis = np.stack([np.ones(int(ring.sum())), dx[ring], dy[ring]], axis=1)
    plane = np.linalg.lstsq(basis, part[ring], rcond=None)[0] if len(basis) > 3 else np.zeros(3)
    kept = np.clip(2.0 * (r - 0.5), 0.0, 1.0)
    old = kept * part + (1.0 - kept) * (plane[0] + plane[1] * dx + plane[2] * dy)
    part[:] = np.where(r < 3.0, old + bowl.heights(r), part)
    t = np.arange(48) * (2.0 * np.pi / 48)
    crest = np.stack([bowl.x + bowl.radius * np.cos(t), bowl.y + bowl.radius * np.sin(t)], axis=1)
    start = np.array([columns.start, rows.start]) * STEP_PX
    return np.concatenate([crest, sample(part, *(crest - start).T)[:, None]], axis=1)


def sample(field: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Interpolate a field of the ground at places; beyond its edge it stays what it is there."""
    u, v = (np.asarray(w / STEP_PX, dtype=np.float32) for w in (x, y))
    flat = u.ndim == 1
    if flat:
        u, v = u[None], v[None]
    found = cv2.remap(field.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found[0] if flat else found, dtype=np.float64)
