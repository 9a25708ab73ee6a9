"""Features with descriptors: SURF (Bay et al. 2008), SIFT (Lowe 2004), ORB (Rublee et al. 2011)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from mahotas.features import surf
from numpy.typing import NDArray

from boresight.estimators.landmark.fast_hessian import fast_hessian
from boresight.estimators.landmark.signal import extract_signal
from boresight.scenarios.arrays import FloatArray, Image, IndexArray
from boresight.scenarios.geometry import pixel_from_opencv

_BRIGHT_LEVEL = 200.0  # of 255: headroom for pixels brighter than the 99th percentile of the body
_FULL_SCALE_PERCENTILE = 99.0
_LEAST_STRENGTH = 1e-6  # of a blob, image scaled to 0..1: about ten times the response to the sensor's noise
# Of SIFT and of ORB's corners, below OpenCV's defaults of 0.04 and 20: the strongest of more features are chosen here.
_LEAST_CONTRAST = 0.01
_FAST_THRESHOLD = 5
# Least distance from the body's edge in units of the feature's scale: the limb and the terminator move over the ground.
_CLEAR_SCALES = 5.0
_OPENING_PX = 9


@dataclass(frozen=True, slots=True, eq=False)
class ImageFeatures:
    """Features of one image, the strongest first.

    ``uv_px`` (M, 2) are positions, the centre of the first pixel at (0.5, 0.5). ``descriptors`` (M, D) are float32,
    compared by Euclidean distance, or bytes, by Hamming distance. ``strength`` (M,) is the response of the detector, in
    its own unit.
    """

    uv_px: FloatArray
    descriptors: NDArray[np.float32] | NDArray[np.uint8]
    strength: FloatArray

    def __len__(self) -> int:
        return len(self.uv_px)

    def __getitem__(self, rows: IndexArray | slice) -> ImageFeatures:
        return ImageFeatures(self.uv_px[rows], self.descriptors[rows], self.strength[rows])


def find_features(image: Image, detector: str, count: int) -> ImageFeatures:
    """Find the ``count`` strongest features well within the lit part of the body.

    ``image`` (H, W) is linear radiance in any unit; it is scaled by the 99th percentile of the body. ``detector`` is
    ``surf``, ``sift`` or ``orb``.
    """
    signal = extract_signal(image)
    if signal.empty:
        return _DETECTORS[detector](np.zeros_like(image))[0][:0]
    body = signal.image > 0.0
    rise = image - np.float32(signal.background)
    found, scale_px = _DETECTORS[detector](rise / np.float32(np.percentile(rise[body], _FULL_SCALE_PERCENTILE)))
    clear = _clearance_px(body, found.uv_px) > _CLEAR_SCALES * scale_px
    rows = np.flatnonzero(clear)
    # Stable, so that equal strengths keep the order of detection.
    return found[rows[np.argsort(-found.strength[rows], kind="stable")][:count]]


def _clearance_px(body: NDArray[np.bool_], uv_px: FloatArray) -> FloatArray:
    """(M,) distance to the nearest pixel outside the lit body, after a median filter that removes specks."""
    mask = np.asarray(cv2.medianBlur(body.astype(np.uint8), _OPENING_PX))
    distance = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    height, width = mask.shape
    column, row = np.floor(uv_px).astype(np.int64).T
    clearance: FloatArray = distance[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].astype(np.float64)
    return clearance


def _surf(image: Image) -> tuple[ImageFeatures, FloatArray]:
    """Fast-Hessian blobs, interpolated, with the descriptors of `mahotas`, and their scales, px.

    The detector of `mahotas` does not interpolate: its positions are off by most of a pixel.
    """
    blobs = fast_hessian(image)
    strong = blobs.strength > _LEAST_STRENGTH
    peaks, offsets = blobs.peaks[strong], blobs.offsets_px[strong]
    points = np.column_stack(
        [peaks + offsets[:, ::-1], blobs.scale_px[strong], blobs.strength[strong], np.ones(len(peaks))]
    )
    described = surf.descriptors(image.astype(np.float64), points) if len(points) else np.empty((0, 70))
    uv_px, descriptors = pixel_from_opencv(described[:, 1::-1]), described[:, 6:].astype(np.float32)
    return ImageFeatures(uv_px, descriptors, described[:, 3]), described[:, 2]


def _sift(image: Image) -> tuple[ImageFeatures, FloatArray]:
    # Without the precise upscaling OpenCV's positions are off by a quarter of a pixel.
    detector = cv2.SIFT.create(contrastThreshold=_LEAST_CONTRAST, enable_precise_upscale=True)
    # The size of a feature is twice its scale.
    return _by_opencv(detector, image, 128, 0.5)


def _orb(image: Image) -> tuple[ImageFeatures, FloatArray]:
    height, width = image.shape
    detector = cv2.ORB.create(nfeatures=height * width // 16, fastThreshold=_FAST_THRESHOLD)
    # The size is that of the patch, 31 pixels in its octave; a corner needs a clearance of half of it.
    return _by_opencv(detector, image, 32, 0.5 / _CLEAR_SCALES)


def _by_opencv(
    detector: cv2.Feature2D, image: Image, width: int, scale_of_size: float
) -> tuple[ImageFeatures, FloatArray]:
    grey = np.clip(np.rint(_BRIGHT_LEVEL * image), 0, 255).astype(np.uint8)
    keypoints, described = detector.detectAndCompute(grey, None)
    if described is None or not keypoints:
        described = np.empty((0, width), dtype=np.uint8)
    uv_px = pixel_from_opencv(np.array([point.pt for point in keypoints], dtype=np.float64).reshape(-1, 2))
    strength, size_px = np.array([(point.response, point.size) for point in keypoints]).reshape(-1, 2).T
    return ImageFeatures(uv_px, np.asarray(described), strength), scale_of_size * size_px


_DETECTORS: Mapping[str, Callable[[Image], tuple[ImageFeatures, FloatArray]]] = MappingProxyType(
    {"surf": _surf, "sift": _sift, "orb": _orb}
)
