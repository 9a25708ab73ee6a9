"""Artefacts of a camera, in the order in which light and charge meet them; `Detector` applies them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import View
from boresight.scenarios.spec.artefacts import CosmicRaysSpec, PixelsSpec, StrayLightSpec

_STEP_PX = 0.5  # that the image moves between two instants of an exposure, at most
_MOST_STEPS = 400
_TRACK_STEP_PX = 0.05


def veiled(light: FloatArray, share: float) -> FloatArray:
    """Spread a share of the light (H, W) evenly over the frame; the sum stays."""
    return light if share == 0.0 else (1.0 - share) * light + share * light.mean()


def glow(stray: StrayLightSpec, view: View) -> FloatArray:
    """(H, W) electrons a second of the Sun's stray light, which fall linearly across the frame from the Sun's side.

    The level is that at the corner or edge nearest to the Sun, and 0 at the opposite one. With the Sun on the line of
    sight it is even, at half the level.
    """
    height, width = view.camera.height_px, view.camera.width_px
    towards = view.T_cam_body.rotate(view.sun_dir_body)[:2]
    towards /= max(float(np.linalg.norm(towards)), 1e-12)
    u, v = np.arange(width) + 0.5 - 0.5 * width, np.arange(height) + 0.5 - 0.5 * height
    along = towards[0] * u + towards[1] * v[:, None]
    reach = 0.5 * (abs(towards[0]) * width + abs(towards[1]) * height)
    share = 0.5 + 0.5 * along / reach if reach > 0.0 else np.full((height, width), 0.5)
    return np.asarray(stray.glow_e_per_s * share, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of a camera at constant rates during an exposure.

    ``rate_rad_s`` (3,) is the camera's angular velocity, ``velocity_m_s`` (3,) its velocity about the body, both in
    camera axes at the middle of the exposure of the middle row. Row v is exposed ``row_delay_s`` before row v + 1.
    """

    view: View
    exposure_s: float
    rate_rad_s: FloatArray
    velocity_m_s: FloatArray
    row_delay_s: float = 0.0

    def smeared(self, light: FloatArray) -> FloatArray:
        """Return the mean (H, W) of the light (H, W) as it moves during the exposure of each row.

        The whole scene moves as points at the range of the body's origin do: parallax, the spin of the body, and
        changes of light and shadow are left out. Light that enters the frame is that of its nearest edge pixel.
        Values between pixels are those of a cubic spline, none below zero.
        """
        first, last = (self._sources(share) for share in (-0.5, 0.5))
        longest = float(np.linalg.norm(last - first, axis=-1).max())
        steps = int(np.clip(np.ceil(longest / _STEP_PX), 1, _MOST_STEPS))
        weights, total = spline_filter(light, order=3, mode="nearest"), np.zeros(light.shape)
        for share in (np.arange(steps) + 0.5) / steps - 0.5:
            columns, rows = np.moveaxis(self._sources(share) - 0.5, -1, 0)
            total += map_coordinates(weights, [rows, columns], order=3, mode="nearest", prefilter=False)
        return np.maximum(total / steps, 0.0)

    def _sources(self, share: float) -> FloatArray:
        """(H, W, 2) where the image at mid-exposure has what each pixel sees at a share of its exposure, -0.5 to 0.5.

        A point at x in camera axes at mid-exposure is at exp(-[w t]) (x - v t) at time t.
        """
        camera = self.view.camera
        height, width = camera.height_px, camera.width_px
        pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
        time_s = share * self.exposure_s + (np.arange(height) - 0.5 * (height - 1)) * self.row_delay_s
        range_m = float(np.linalg.norm(self.view.T_cam_body.translation_m))
        turns = Rotation.from_rotvec(time_s[:, None] * self.rate_rad_s).as_matrix()
        points_m = np.einsum("hij,hwj->hwi", turns, range_m * camera.unproject(pixels))
        found = camera.project(points_m + time_s[:, None, None] * self.velocity_m_s)
        return np.where(np.isfinite(found), found, pixels)


@lru_cache(maxsize=4)
def pixel_pattern(spec: PixelsSpec, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return the relative response (H, W) and the further dark current (H, W), e/s, of the pixels of a camera."""
    count = shape[0] * shape[1]
    of_response, of_places, of_levels = (np.random.default_rng((spec.seed, part)) for part in range(3))
    response = np.maximum(1.0 + spec.response_sigma * of_response.standard_normal(shape), 0.0)
    v, u = ((np.arange(size) + 0.5) / size - 0.5 for size in shape)
    corner = (0.5 * shape[0]) ** 2 + (0.5 * shape[1]) ** 2
    response *= 1.0 - spec.vignetting * ((shape[0] * v[:, None]) ** 2 + (shape[1] * u) ** 2) / corner
    # From both ends of one permutation: a larger share keeps the pixels of a smaller one, and none is both.
    places, hot_e_per_s = of_places.permutation(count), np.zeros(count)
    dead, hot = (int(np.ceil(share * count)) for share in (spec.dead_share, spec.hot_share))
    response.ravel()[places[:dead]] = 0.0
    hot_e_per_s[places[count - hot :]] = of_levels.exponential(spec.hot_e_per_s, count)[places[count - hot :]]
    for values in (response, hot_e_per_s):
        values.setflags(write=False)
    return response, hot_e_per_s.reshape(shape)


def cosmic_rays(
    spec: CosmicRaysSpec, shape: tuple[int, int], exposure_s: float, rng: np.random.Generator
) -> FloatArray:
    """Draw the electrons (H, W) of the tracks in an exposure; what leaves the frame is lost."""
    electrons = np.zeros(shape)
    for _ in range(rng.poisson(spec.hits_per_s * exposure_s)):
        u, v, angle = rng.uniform((0.0, 0.0, 0.0), (shape[1], shape[0], 2.0 * np.pi))
        length_px = rng.exponential(spec.length_px)
        count = int(np.ceil(length_px / _TRACK_STEP_PX))
        along = (np.arange(count) + 0.5) / max(count, 1) * length_px
        columns = np.floor(u + along * np.cos(angle)).astype(np.int64)
        rows = np.floor(v + along * np.sin(angle)).astype(np.int64)
        inside = (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
        np.add.at(electrons, (rows[inside], columns[inside]), spec.e_per_px * length_px / count)
    return electrons


def jpeg_compressed(numbers: NDArray[np.float32], quality: int) -> NDArray[np.float32]:
    """Compress whole numbers (H, W) from 0 to 255 as a grey JPEG image and decode it."""
    _, content = cv2.imencode(".jpg", numbers.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), dtype=np.float32)
