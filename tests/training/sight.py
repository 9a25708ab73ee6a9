"""Pictures of training ground: parallel light, parallel lines of sight, shadows, a camera's blur and noise."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from boresight.estimators.craters.detection.ellipse_fit import fit_reweighted
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import Camera, Ellipses, Pose
from boresight.scenarios.observation import Frame
from training.ground import STEP_PX, Ground, make_ground

WIDTH_PX, HEIGHT_PX = 416, 352
CAMERA = Camera.from_fov(WIDTH_PX, HEIGHT_PX, np.radians(2.3))
_STRIDE_PX = 1.2  # along the ground between looks for where a line of sight meets it
MARGIN_PX = 40.0  # of ground beyond the picture: its hills reach into it


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """A picture and what is true of it.

    Parameters
    ----------
    rims
        Of all craters whose crest lies at least halfway in the picture.
    weight
        (n,) 1 where a rim is plain, 0 where nobody could be blamed for finding or missing it.
    """

    frame: Frame
    rims: Ellipses
    weight: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Where camera and Sun stand: rows of ``axes`` are the camera's x, y and z in the ground's x, y and up.

    The picture's middle is the ground's.
    """

    axes: FloatArray
    sun: FloatArray
    middle: FloatArray

    def project(self, points: FloatArray) -> FloatArray:
        """Take points (..., 3) of the ground to pixels (..., 2)."""
        return np.asarray((points - self.middle) @ self.axes[:2].T + [WIDTH_PX / 2, HEIGHT_PX / 2])


def draw_geometry(rng: np.random.Generator) -> tuple[Geometry, FloatArray]:
    """Draw how the camera and the Sun stand over the ground; also return the size of ground that the picture needs."""
    emission, incidence = np.radians(rng.uniform(0.0, 58.0)), np.radians(rng.uniform(18.0, 76.0))
    turn, azimuth = rng.uniform(0.0, 2.0 * np.pi, 2)
    x = np.array([np.cos(emission), 0.0, np.sin(emission)])
    y = np.array([0.0, -1.0, 0.0])
    z = np.array([np.sin(emission), 0.0, -np.cos(emission)])
    c, s = np.cos(turn), np.sin(turn)
    axes = np.stack([c * x - s * y, s * x + c * y, z])
    sun = np.array([np.sin(incidence) * np.cos(azimuth), np.sin(incidence) * np.sin(azimuth), np.cos(incidence)])
    corners = np.array([[i * WIDTH_PX / 2, j * HEIGHT_PX / 2] for i in (-1, 1) for j in (-1, 1)]) @ np.array(
        [[c, s], [-s, c]]
    )
    size = 2.0 * np.abs(corners).max(axis=0) / np.array([np.cos(emission), 1.0]) + 2.0 * MARGIN_PX
    return Geometry(axes, sun, np.array([*(size / 2), 0.0])), size


def shade(ground: Ground, geometry: Geometry, lunar: float) -> FloatArray:
    """Radiance of every point of the ground: between Lambert's law (0) and Lommel and Seeliger's (1), with shadows."""
    h = ground.heights
    slope_y, slope_x = np.gradient(h, STEP_PX)
    length = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    sun, camera = geometry.sun, -geometry.axes[2]
    cos_i = np.maximum((sun[2] - slope_x * sun[0] - slope_y * sun[1]) / length, 0.0)
    cos_e = np.maximum((camera[2] - slope_x * camera[0] - slope_y * camera[1]) / length, 0.02)
    value = cos_i * ((1.0 - lunar) + lunar / (cos_i + cos_e))
    level = np.hypot(sun[0], sun[1])
    rise = STEP_PX * sun[2] / level
    rows, columns = np.indices(h.shape, dtype=np.float32)
    field, limit = h.astype(np.float32), float(h.max())
    dark = np.zeros(h.shape, dtype=bool)
    for k in range(1, int((limit - np.percentile(h, 1)) / rise) + 2):
        u, v = columns + np.float32(k * sun[0] / level), rows + np.float32(k * sun[1] / level)
        dark |= cv2.remap(field, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) > field + np.float32(k * rise)
    return np.where(dark, 0.0, value)


def look(ground: Ground, radiance: FloatArray, geometry: Geometry) -> FloatArray:
    """Follow the line of sight of every pixel down to the ground and read its radiance there."""
    rows, columns = np.indices((HEIGHT_PX, WIDTH_PX)) + 0.5
    away = np.stack([columns - WIDTH_PX / 2, rows - HEIGHT_PX / 2], axis=-1)
    start = away @ geometry.axes[:2] + geometry.middle  # on the plane through the middle, across the line of sight
    line = geometry.axes[2]
    top, bottom = float(ground.heights.max()), float(ground.heights.min())
    level = float(np.hypot(line[0], line[1]))
    drop = min(abs(line[2]) * _STRIDE_PX / max(level, 1e-3), top - bottom)
    field = ground.heights.astype(np.float32)
    # Places on the ground's grid at height 0, and by how much they move with height.
    base = [((start[..., i] - start[..., 2] / line[2] * line[i]) / STEP_PX).astype(np.float32) for i in (0, 1)]
    move = [np.float32(line[i] / line[2] / STEP_PX) for i in (0, 1)]
    found = np.full((HEIGHT_PX, WIDTH_PX), bottom, dtype=np.float32)
    before = np.full((HEIGHT_PX, WIDTH_PX), drop, dtype=np.float32)
    open_pixels = np.ones((HEIGHT_PX, WIDTH_PX), dtype=bool)
    for k in range(int(np.ceil((top - bottom) / drop)) + 2):
        height = np.float32(top - k * drop)
        u, v = (b + height * m for b, m in zip(base, move, strict=True))
        over = height - cv2.remap(field, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        met = open_pixels & (over <= 0.0)
        share = before[met] / np.maximum(before[met] - over[met], 1e-9)
        found[met] = height + np.float32(drop) * (1.0 - share)
        open_pixels &= ~met
        before = over
        if not open_pixels.any():
            break
    u, v = (b + found * m for b, m in zip(base, move, strict=True))
    seen = cv2.remap(radiance.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.float64)


def expose(rng: np.random.Generator, picture: FloatArray) -> Image:
    """Blur a picture as optics do, give it a limb now and then, and count photons and the noise of reading."""
    if rng.uniform() < 0.25:
        rows, columns = np.indices(picture.shape)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        far = (columns - WIDTH_PX / 2) * np.cos(angle) + (rows - HEIGHT_PX / 2) * np.sin(angle)
        picture = np.where(far > rng.uniform(0.1, 0.45) * WIDTH_PX, 0.0, picture)
    blurred = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.45, 0.95))
    full = max(float(np.percentile(blurred, 99.5)), 1e-9)
    photons = rng.poisson(np.maximum(blurred, 0.0) / full * rng.uniform(5e3, 4e4))
    counts = photons / max(float(photons.max()), 1.0) * 3500.0 + rng.normal(0.0, rng.uniform(1.0, 12.0), picture.shape)
    return np.asarray(np.maximum(np.round(counts), 0.0), dtype=np.float32)


def draw_lesson(rng: np.random.Generator) -> Lesson:
    """Draw ground, look at it and say what is true of it."""
    geometry, size = draw_geometry(rng)
    ground = make_ground(rng, size)
    radiance = shade(ground, geometry, rng.uniform(0.0, 1.0))
    image = expose(rng, look(ground, radiance, geometry))
    rims, weight = _truth(ground, geometry, image)
    frame = Frame(image, geometry.axes @ geometry.sun, Pose(np.eye(3), np.array([0.0, 0.0, 1e5])), np.eye(6))
    return Lesson(frame, rims, weight)


def _truth(ground: Ground, geometry: Geometry, image: Image) -> tuple[Ellipses, FloatArray]:
    """Fit ellipses to the projected crests, and weigh those that lie in light and whole."""
    uv = geometry.project(ground.crests)
    inside = CAMERA.contains(uv).mean(axis=1)
    radius = np.array([bowl.radius for bowl in ground.bowls])
    chosen = np.flatnonzero((inside > 0.5) & (radius > 3.0))
    conics = fit_reweighted(uv[chosen], np.ones(uv[chosen].shape[:2]))
    rims, good = Ellipses.among(conics)
    chosen = chosen[good]
    place = np.clip(np.floor(uv[chosen]), 0, [WIDTH_PX - 1, HEIGHT_PX - 1]).astype(np.int64)
    near_light = cv2.dilate((image > 0.06 * np.percentile(image, 99)).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    lit = near_light[place[..., 1], place[..., 0]].mean(axis=1)
    worn = np.array([ground.bowls[i].depth_ratio for i in chosen]) < 0.085
    plain = (ground.cut[chosen] < 0.4) & (inside[chosen] > 0.85) & (lit > 0.6) & ~worn & (radius[chosen] > 4.0)
    return rims, plain.astype(np.float64)
