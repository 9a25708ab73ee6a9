"""Find and match features with descriptors: OpenCV's SIFT (Lowe 2004) and ORB (Rublee et al. 2011)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.landmark.signal import extract_signal
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import pixel_from_opencv
from boresight.scenarios.spec.base import SpecModel

Kind = Literal["sift", "orb"]
DESCRIPTOR_BYTES = {"sift": 128, "orb": 32}
_BRIGHT_LEVEL = 200.0  # grey value of the 99th percentile, so that brighter pixels are not clipped


class FeatureOptions(SpecModel):
    """Options of feature detection."""

    count: int = Field(400, ge=8, le=100_000, description="At most this many features an image, the strongest first")
    contrast_min: float = Field(0.02, gt=0, le=1, description="SIFT: least contrast of a feature")
    fast_threshold: int = Field(10, ge=1, le=255, description="ORB: least contrast of a corner")


@dataclass(frozen=True, slots=True, eq=False)
class DescribedFeatures:
    """Features of one image: pixels (M, 2), the centre of the first at (0.5, 0.5), and descriptors (M, D) of bytes."""

    uv_px: FloatArray
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.uv_px)


def find_features(image: NDArray[np.float32], kind: Kind, options: FeatureOptions) -> DescribedFeatures:
    """Find and describe features; the image is scaled to a fixed range first, so its unit does not matter."""
    signal = extract_signal(image).image
    grey = np.clip(np.rint(_BRIGHT_LEVEL * signal), 0, 255).astype(np.uint8)
    keypoints, described = _detector(kind, options).detectAndCompute(grey, None)
    if described is None or len(keypoints) == 0:
        return DescribedFeatures(np.empty((0, 2)), np.empty((0, DESCRIPTOR_BYTES[kind]), dtype=np.uint8))
    strongest = np.argsort([-point.response for point in keypoints], kind="stable")[: options.count]
    uv_px = pixel_from_opencv(np.array([point.pt for point in keypoints], dtype=np.float64))
    return DescribedFeatures(uv_px[strongest], np.asarray(described).astype(np.uint8)[strongest])


def _detector(kind: Kind, options: FeatureOptions) -> cv2.Feature2D:
    if kind == "sift":
        # Without the precise upscaling OpenCV's positions are off by a quarter of a pixel.
        return cv2.SIFT.create(contrastThreshold=options.contrast_min, enable_precise_upscale=True)
    return cv2.ORB.create(nfeatures=options.count, fastThreshold=options.fast_threshold)


def match_features(
    observed: NDArray[np.uint8], known: NDArray[np.uint8], kind: Kind, ratio_max: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Match descriptors with their nearest known ones, if these pass the ratio test (Lowe 2004).

    Return the matched rows (M,) of both arrays, and the distances (M,) of the matched descriptors.
    """
    nothing = np.empty(0, dtype=np.int64)
    if len(observed) == 0 or len(known) < 2:
        return nothing, nothing, np.empty(0)
    if kind == "sift":
        matcher = cv2.BFMatcher(cv2.NORM_L2)
        pairs = matcher.knnMatch(observed.astype(np.float32), known.astype(np.float32), k=2)
    else:
        pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(observed, known, k=2)
    # On a self-similar surface the second nearest is often as near: such matches are ambiguous.
    clear = [first for first, second in pairs if first.distance < ratio_max * second.distance]
    rows = np.array([[match.queryIdx, match.trainIdx] for match in clear], dtype=np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1], np.array([match.distance for match in clear], dtype=np.float64)
