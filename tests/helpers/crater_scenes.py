"""Shaded height fields with craters, seen from above: independent of the renderer and of the world's craters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from boresight.scenarios.geometry import Camera, Ellipses, Pose, pixel_to_opencv
from boresight.scenarios.observation import Frame

SHAPE = (412, 537)
CAMERA = Camera.from_fov(SHAPE[1], SHAPE[0], np.radians(2.93))


@dataclass(frozen=True)
class Bowl:
    """A parabolic bowl with a raised rim; lengths in pixels of a view from above."""

    u: float
    v: float
    radius: float
    depth_ratio: float = 0.15
    rim_ratio: float = 0.03


def heights(bowls, shape=SHAPE, soften_px=0.0):
    """Surface height in pixels; later bowls erase what was there before them."""
    v, u = np.mgrid[: shape[0], : shape[1]] + 0.5
    surface = np.zeros(shape)
    for bowl in bowls:
        r = np.hypot(u - bowl.u, v - bowl.v) / bowl.radius
        rim, depth = 2 * bowl.rim_ratio * bowl.radius, 2 * bowl.depth_ratio * bowl.radius
        inside = rim - depth * (1.0 - r**2)
        outside = rim * np.maximum(r, 1.0) ** -3.0
        surface = np.where(r < 1.0, 0.3 * surface + inside, surface + outside)
    return cv2.GaussianBlur(surface, (0, 0), soften_px) if soften_px else surface


def sun_cam(azimuth_rad, incidence_rad):
    """Towards the Sun in camera axes; the azimuth runs from the columns towards the rows, the ground's normal is -z."""
    level = np.sin(incidence_rad)
    return np.array([level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), -np.cos(incidence_rad)])


def lit(surface, azimuth_rad, incidence_rad):
    """Cosine of incidence, nothing where the Sun does not reach."""
    du, dv = np.gradient(surface, axis=1), np.gradient(surface, axis=0)
    sun = sun_cam(azimuth_rad, incidence_rad)
    cosine = (-du * sun[0] - dv * sun[1] - sun[2]) / np.sqrt(1 + du**2 + dv**2)
    climb = np.cos(incidence_rad) / np.sin(incidence_rad)
    reach = int(np.ptp(surface) / climb) + 2
    v, u = np.mgrid[: surface.shape[0], : surface.shape[1]].astype(np.float32)
    shaded = np.zeros(surface.shape, dtype=bool)
    field = surface.astype(np.float32)
    for step in range(1, reach):
        along = (np.float32(step * np.cos(azimuth_rad)), np.float32(step * np.sin(azimuth_rad)))
        there = cv2.remap(field, u + along[0], v + along[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        shaded |= there > surface + step * climb
    return np.where(shaded, 0.0, np.maximum(cosine, 0.0))


def image_of(
    bowls: Sequence[Bowl], azimuth_rad, incidence_rad, blur_px=0.7, noise=0.01, seed=1, soften_px=1.0
) -> np.ndarray:
    """A picture from above of 1,000 digital numbers at the subsolar slope; each is made once."""
    return _image_of(tuple(bowls), float(azimuth_rad), float(incidence_rad), blur_px, noise, seed, soften_px).copy()


@cache
def _image_of(bowls, azimuth_rad, incidence_rad, blur_px, noise, seed, soften_px):
    picture = lit(heights(bowls, soften_px=soften_px), azimuth_rad, incidence_rad)
    picture = cv2.GaussianBlur(picture, (0, 0), blur_px) if blur_px else picture
    picture = picture + noise * np.random.default_rng(seed).normal(size=picture.shape)
    return (1000.0 * np.maximum(picture, 0.0)).astype(np.float32)


def frame_of(image, azimuth_rad, incidence_rad):
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 2e5]))
    return Frame(image, sun_cam(azimuth_rad, incidence_rad), pose, np.eye(6))


def scattered(rng, count, radius=(7.0, 45.0), apart=1.15):
    """Bowls that do not overlap."""
    bowls: list[Bowl] = []
    while len(bowls) < count:
        r = radius[0] * (radius[1] / radius[0]) ** rng.uniform() ** 1.5
        u, v = rng.uniform(1.3 * r, np.array(SHAPE[::-1]) - 1.3 * r)
        if all(np.hypot(u - b.u, v - b.v) > apart * (r + b.radius) for b in bowls):
            bowls.append(Bowl(u, v, r, rng.uniform(0.1, 0.18), 0.03))
    return bowls


def crests(bowls):
    """Rims of bowls seen from above."""
    centre = np.array([[b.u, b.v] for b in bowls]).reshape(-1, 2)
    radius = np.array([b.radius for b in bowls])
    return Ellipses(centre, np.stack([radius, radius], axis=1), np.zeros(len(bowls)))


def drawn_on(image, ellipses, colour=(0, 255, 0), scale=2, top=None):
    """Draw ellipses on a picture, for the eye."""
    grey = np.clip(image / np.percentile(image, 99.7) * 255, 0, 255).astype(np.uint8)
    canvas = cv2.cvtColor(cv2.resize(grey, None, fx=scale, fy=scale), cv2.COLOR_GRAY2BGR)
    for i in range(len(ellipses) if top is None else min(top, len(ellipses))):
        u, v = pixel_to_opencv(ellipses.centre_px[i]) * scale + (scale - 1) / 2
        axes = ellipses.semi_axes_px[i] * scale
        if np.isfinite(axes).all():
            box = (
                (float(u), float(v)),
                (float(2 * axes[0]), float(2 * axes[1])),
                float(np.degrees(ellipses.angle_rad[i])),
            )
            cv2.ellipse(canvas, box, colour, 1, cv2.LINE_AA)
    return canvas
