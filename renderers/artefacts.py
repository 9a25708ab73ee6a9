"""Artefacts of a camera, in the order in which light and charge meet them; `Detector` applies them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import UndrawableError
from boresight.scenarios.geometry import View, pixel_to_opencv
from boresight.scenarios.spec.artefacts import CosmicRaysSpec, PixelsSpec, StrayLightSpec

_STEP_PX = 0.5  # that the image moves between two instants of an exposure, at most
MOST_SMEAR_PX = 500.0  # of which an image is made
_SMALL_RAD = 0.02
_PAD_PX = 12  # beyond which an edge no longer acts on the weights of a spline: 0.27^12 is 1e-7
_TRACK_STEP_PX = 0.05
Beyond = Literal["nearest", "constant"]
"""What is beyond the edge of an image, as SciPy names it: its nearest pixel for a scene, zeros for points of light."""


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

    def smeared(self, light: FloatArray, beyond: Beyond = "nearest") -> FloatArray:
        """Return the mean (H, W) of the light (H, W) as it moves during the exposure of each row.

        The whole scene moves as points at the range of the body's origin do: parallax, the spin of the body, and
        changes of light and shadow are left out. Beyond the frame is the light of the nearest pixel, or none with
        ``constant``. Values between pixels are those of a cubic spline, those below zero set to zero, and the sum is
        that of the spline. Raise `UndrawableError` if the image moves too far, or a pixel shows what the camera
        does not see at the middle of the exposure.
        """
        length_px = self.length_px
        if length_px > MOST_SMEAR_PX:
            raise UndrawableError(
                f"detector.motion: the image moves by {length_px:.0f} px in an exposure, above {MOST_SMEAR_PX:g}: give"
                " lower rates, a law with bounds, or a shorter exposure_s"
            )
        padded = np.pad(light, _PAD_PX, mode="edge" if beyond == "nearest" else "constant")
        weights, total = spline_filter(padded, order=3, mode="nearest"), np.zeros(light.shape)
        steps, sources = max(math.ceil(length_px / _STEP_PX), 1), self._path()
        for share in (np.arange(steps) + 0.5) / steps - 0.5:
            columns, rows = np.moveaxis(pixel_to_opencv(sources(share)) + _PAD_PX, -1, 0)
            total += map_coordinates(weights, [rows, columns], order=3, mode="nearest", prefilter=False) / steps
        mean = np.maximum(total, 0.0)
        return np.asarray(mean * (np.sum(total) / max(mean.sum(), np.finfo(float).tiny)), dtype=np.float64)

    @property
    def length_px(self) -> float:
        """Bound of the way of the image in an exposure, in pixels without distortion."""
        camera, rate, velocity = self.view.camera, np.abs(self.rate_rad_s), np.abs(self.velocity_m_s)
        corners = np.array([(u, v) for u in (0, camera.width_px) for v in (0, camera.height_px)])
        away_px = camera.undistorted(corners) - (camera.cx_px, camera.cy_px)
        radius_px, focal_px = float(np.linalg.norm(away_px, axis=1).max()), max(camera.fx_px, camera.fy_px)
        turn = (focal_px + radius_px**2 / focal_px) * np.linalg.norm(rate[:2]) + radius_px * rate[2]
        flight = (focal_px * np.linalg.norm(velocity[:2]) + radius_px * velocity[2]) / self._range_m
        return self.exposure_s * float(turn + flight)

    @property
    def _range_m(self) -> float:
        return float(np.linalg.norm(self.view.T_cam_body.translation_m))

    def _path(self) -> Callable[[float], FloatArray]:
        """Return `_sources`; for a small motion, to 0.01 px, as the parabola through three of its values."""
        turned = np.linalg.norm(self.rate_rad_s) + np.linalg.norm(self.velocity_m_s) / self._range_m
        if self.exposure_s * turned > _SMALL_RAD:
            return self._sources
        before, middle, after = (self._sources(share) for share in (-0.5, 0.0, 0.5))
        slope, bend = after - before, 2.0 * (before - 2.0 * middle + after)
        return lambda share: middle + share * (slope + share * bend)

    def _sources(self, share: float) -> FloatArray:
        """(H, W, 2) where the image at mid-exposure has what each pixel sees at a share of its exposure, -0.5 to 0.5.

        A point at x in camera axes at mid-exposure is at exp(-[w t]) (x - v t) at time t.
        """
        camera = self.view.camera
        height, width = camera.height_px, camera.width_px
        pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
        time_s = share * self.exposure_s + (np.arange(height) - 0.5 * (height - 1)) * self.row_delay_s
        turns = Rotation.from_rotvec(time_s[:, None] * self.rate_rad_s).as_matrix()
        points_m = np.einsum("hij,hwj->hwi", turns, self._range_m * camera.unproject(pixels))
        found = camera.project(points_m + time_s[:, None, None] * self.velocity_m_s)
        if not np.isfinite(found).all():
            raise UndrawableError(
                "detector.motion: a pixel shows what is behind the camera, or outside of its lens, at the middle of the"
                " exposure: give lower rates, or a shorter exposure_s or row_delay_s"
            )
        return found


def background_gradient(stray: StrayLightSpec, view: View) -> FloatArray:
    """(H, W) electrons a second of a linear background across the frame, brightest on the side of the Sun.

    It is ``gradient_e_per_s`` at the edge or corner on that side and 0 at the opposite one, whatever the angle to the
    Sun: of the Sun's direction only the azimuth about the line of sight is used. On the line of sight, where it has
    none, the background is even, at half the level; close to it the azimuth turns fast.
    """
    height, width = view.camera.height_px, view.camera.width_px
    towards = view.T_cam_body.rotate(view.sun_dir_body)[:2]
    towards /= max(float(np.linalg.norm(towards)), 1e-12)
    u, v = np.arange(width) + 0.5 - 0.5 * width, np.arange(height) + 0.5 - 0.5 * height
    along = towards[0] * u + towards[1] * v[:, None]
    reach = 0.5 * (abs(towards[0]) * width + abs(towards[1]) * height)
    share = 0.5 + 0.5 * along / reach if reach > 0.0 else np.full((height, width), 0.5)
    return np.asarray(stray.gradient_e_per_s * share, dtype=np.float64)


@lru_cache(maxsize=1)
def pixel_pattern(spec: PixelsSpec, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return the relative response (H, W) and the further dark current (H, W), e/s, of the pixels of a camera."""
    count = shape[0] * shape[1]
    of_response, of_places, of_levels = (np.random.default_rng((spec.seed, part)) for part in range(3))
    response = np.maximum(1.0 + spec.response_sigma * of_response.standard_normal(shape), 0.0)
    v, u = (np.arange(size) + 0.5 - 0.5 * size for size in shape)
    response *= 1.0 - spec.vignetting * (v[:, None] ** 2 + u**2) / (0.25 * (shape[0] ** 2 + shape[1] ** 2))
    # From both ends of one permutation: a larger share keeps the pixels of a smaller one, and none is both.
    places, hot_e_per_s = of_places.permutation(count), np.zeros(count)
    dead = math.ceil(spec.dead_share * count)
    hot = min(math.ceil(spec.hot_share * count), count - dead)
    response.ravel()[places[:dead]] = 0.0
    hot_e_per_s[places[count - hot :]] = of_levels.exponential(spec.hot_e_per_s, count)[places[count - hot :]]
    for values in (response, hot_e_per_s):
        values.setflags(write=False)
    return response, hot_e_per_s.reshape(shape)


def cosmic_rays(
    spec: CosmicRaysSpec, shape: tuple[int, int], exposure_s: float, rng: np.random.Generator
) -> FloatArray:
    """Draw the electrons (H, W) of the tracks in an exposure; what leaves the frame is lost."""
    electrons, (height, width), mean_px = np.zeros(shape), shape, spec.length_px
    # A track of length L reaches into the frame from a middle up to L / 2 beyond it. There are (W + L) (H + L) / (W H)
    # times as many of its length as with their middle in the frame; an exponential law times that is a sum of gammas.
    areas = np.array([width * height, (width + height) * mean_px, 2.0 * mean_px**2])
    hits = rng.poisson(spec.hits_per_s * exposure_s * areas.sum() / areas[0])
    for power in rng.choice(3, hits, p=areas / areas.sum()):
        length_px = rng.gamma(1.0 + power, mean_px)
        beyond = 0.5 * length_px
        u, v, angle = rng.uniform((-beyond, -beyond, 0.0), (width + beyond, height + beyond, 2.0 * np.pi))
        count = max(math.ceil(length_px / _TRACK_STEP_PX), 1)
        along = ((np.arange(count) + 0.5) / count - 0.5) * length_px
        columns = np.floor(u + along * np.cos(angle)).astype(np.int64)
        rows = np.floor(v + along * np.sin(angle)).astype(np.int64)
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        np.add.at(electrons, (rows[inside], columns[inside]), spec.e_per_px * length_px / count)
    return electrons


def jpeg_compressed(numbers: NDArray[np.float32], quality: int) -> NDArray[np.float32]:
    """Compress whole numbers (H, W) from 0 to 255 as a grey JPEG image and decode it."""
    _, content = cv2.imencode(".jpg", numbers.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), dtype=np.float32)
