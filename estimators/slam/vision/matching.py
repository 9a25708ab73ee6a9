"""Detect features and match them between images: by descriptors, by epipolar RANSAC, and guided by a prediction.

Features are SURF (Bay et al. 2008), SIFT (Lowe 2004) and ORB (Rublee et al. 2011).

Guided matching searches each landmark's feature in its predicted error ellipse. The main error, that of the camera's
position, is shared by all landmarks, so that one correct match determines where the others are. Each landmark's best
match is a hypothesis; the one with which most others agree is chosen, as in the 1-point RANSAC of Civera et al. (2010).
Conditioned on all that agree, the ellipses are small, and the best descriptor in each is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from mahotas.features import surf
from numpy.typing import NDArray

from boresight.estimators.landmark.corners import fast_hessian
from boresight.estimators.landmark.signal import extract_signal
from boresight.estimators.slam.association.gating import diagonal_blocks, snooped
from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray
from boresight.scenarios.geometry import pixel_from_opencv
from boresight.scenarios.observation import Prediction

_BRIGHT_LEVEL = 200.0  # of 255: headroom for pixels brighter than the 99th percentile of the body
_FULL_SCALE_PERCENTILE = 99.0
_LEAST_STRENGTH = 1e-6  # of a blob, image scaled to 0..1: about ten times the response to the sensor's noise
# Of SIFT and of ORB's corners, below OpenCV's defaults of 0.04 and 20: the strongest of more features are chosen here.
_LEAST_CONTRAST = 0.01
_FAST_THRESHOLD = 5
# Least distance from the body's edge in units of the feature's scale: the limb and the terminator move over the ground.
_CLEAR_SCALES = 5.0
_OPENING_PX = 9

Descriptors = NDArray[np.float32] | NDArray[np.uint8]

# Mahalanobis distance in 2 dimensions: exp(-9 / 2), about 1 %, of the correct matches lie outside.
_GATE = 3.0
_LEAST_AGREEMENT = 3
_SLACK = 2.0  # factor on the noise in the last search, for nonlinearity
_MOST_DISTANCE = 3.0  # largest descriptor distance, in medians of those that agree

# Matches: a fundamental matrix has 7 degrees of freedom, so that 7 matches always fit.
_FUNDAMENTAL_LEAST = 8
_CONFIDENCE = 0.999
_MOST_ITERATIONS = 10_000
_SAMPLES = 300
_REFITS = 3


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


def match_descriptors(before: ImageFeatures, after: ImageFeatures, ratio_max: float) -> IndexArray:
    """Match features that are each other's nearest and clearly nearer than the second nearest (Lowe 2004).

    Return (K, 2) rows of ``before``, ascending, and of ``after``.
    """
    if len(before) == 0 or len(after) < 2:
        return np.empty((0, 2), dtype=np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if before.descriptors.dtype == np.uint8 else cv2.NORM_L2)
    # OpenCV's queryIdx is the row of the first argument, trainIdx that of the second.
    nearest = {back.queryIdx: back.trainIdx for back in matcher.match(after.descriptors, before.descriptors)}
    pairs = matcher.knnMatch(before.descriptors, after.descriptors, k=2)
    clear = [
        (first.queryIdx, first.trainIdx)
        for first, second in pairs
        if first.distance < ratio_max * second.distance and nearest[first.trainIdx] == first.queryIdx
    ]
    return np.array(clear, dtype=np.int64).reshape(-1, 2)


def fundamental_inliers(before_px: FloatArray, after_px: FloatArray, limit_px: float) -> BoolArray:
    """(K,) which matches (K, 2) and (K, 2) are inliers of the best fundamental matrix: RANSAC by OpenCV (MAGSAC).

    OpenCV's plain RANSAC, where an assertion within its MAGSAC fails.
    """
    if len(before_px) < _FUNDAMENTAL_LEAST:
        return np.zeros(len(before_px), dtype=np.bool_)
    asked = (limit_px, _CONFIDENCE, _MOST_ITERATIONS)
    try:
        matrix, mask = cv2.findFundamentalMat(before_px, after_px, cv2.USAC_MAGSAC, *asked)
    except cv2.error:  # some ordinary matches lead it to an empty model
        matrix, mask = cv2.findFundamentalMat(before_px, after_px, cv2.FM_RANSAC, *asked)
    if matrix is None or mask is None:
        return np.zeros(len(before_px), dtype=np.bool_)
    return np.asarray(mask).ravel().astype(np.bool_)


def direction_inliers(before: FloatArray, after: FloatArray, limit_rad: float, rng: np.random.Generator) -> BoolArray:
    """(K,) which matches are inliers of the best direction of motion, with known attitude: RANSAC.

    Epipolar constraint: two rays to one point and the baseline are coplanar, ``t . (r1 x r2) = 0``. Two matches
    determine t, so that a few hundred samples are enough for any useful share of correct matches. ``before`` and
    ``after`` (K, 3) are unit directions from the camera in common axes, and ``limit_rad`` is the largest angle of the
    second ray from its epipolar plane. ``rng`` draws the samples.
    """
    if len(before) < 3:
        return np.zeros(len(before), dtype=np.bool_)
    # With a fifth of correct matches, 300 pairs miss a correct one with a probability of 0.96^300, 5e-6.
    pairs = np.array([rng.choice(len(before), 2, replace=False) for _ in range(_SAMPLES)])
    planes = np.cross(before, after)
    # t is normal to both r1 x r2, and so along the product of two of them.
    directions = np.cross(planes[pairs[:, 0]], planes[pairs[:, 1]])
    lengths = np.linalg.norm(directions, axis=1)
    # Pairs in one epipolar plane determine no direction.
    directions = directions[lengths > 0.0] / lengths[lengths > 0.0, None]
    if len(directions) == 0:
        return np.zeros(len(before), dtype=np.bool_)
    counts = [int(np.sum(np.abs(off_plane(before, after, d)) < limit_rad)) for d in directions]
    inlier = np.abs(off_plane(before, after, directions[int(np.argmax(counts))])) < limit_rad
    for _ in range(_REFITS):
        # Fit to all inliers and select again: two noisy matches alone give a rough direction.
        if inlier.sum() < 2:
            break
        inlier = np.abs(off_plane(before, after, fitted_direction(before[inlier], after[inlier]))) < limit_rad
    return inlier


def fitted_direction(before: FloatArray, after: FloatArray) -> FloatArray:
    """(3,) direction of motion, up to its sign, with the least squared angles from the epipolar planes."""
    planes = np.cross(before, after)
    # Least sum of squares of t . (r1 x r2) over unit t: the eigenvector of the smallest eigenvalue (eigh sorts
    # ascending).
    direction = np.linalg.eigh(planes.T @ planes)[1][:, 0]
    for _ in range(_REFITS):  # weights turn the triple product into the angle from the plane
        weights = 1.0 / np.maximum(np.linalg.norm(np.cross(before, direction), axis=1), 1e-9)
        weighted = planes * weights[:, None]
        direction = np.linalg.eigh(weighted.T @ weighted)[1][:, 0]
    return np.asarray(direction, dtype=np.float64)


def off_plane(before: FloatArray, after: FloatArray, direction: FloatArray) -> FloatArray:
    """(K,) signed angle, rad, of the second rays from their epipolar planes."""
    normals = np.cross(direction, before)
    # A ray along the motion has no epipolar plane: the floor gives it an angle of about 0.
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.arcsin(np.clip(np.einsum("ki,ki->k", normals, after), -1.0, 1.0)), dtype=np.float64)


def guided_rows(
    prediction: Prediction, descriptors: Descriptors, features: ImageFeatures, sigma_px: float
) -> IndexArray:
    """(n,) row of the feature that each predicted landmark is matched with; -1 for none.

    ``descriptors`` (n, D) are those of the landmarks, from their last image, and ``features`` those of the new image,
    with the noise ``sigma_px`` of a coordinate.
    """
    none = np.full(len(prediction.tracks), -1, dtype=np.int64)
    if len(features) == 0 or len(none) < _LEAST_AGREEMENT:
        return none
    apart = _descriptor_distances(descriptors, features.descriptors)
    # Innovation covariance S = H P H' + R.
    covariance = prediction.covariance_px2 + sigma_px**2 * np.eye(2 * len(none))
    best = _best(prediction.uv_px, covariance, apart, features.uv_px)
    agree = _consensus(prediction.uv_px, covariance, best, features.uv_px)
    innovation = np.where((best >= 0)[:, None], features.uv_px[best] - prediction.uv_px, 0.0)
    agree = snooped(innovation, covariance, agree, _GATE**2)
    if agree.sum() < _LEAST_AGREEMENT:
        return none
    where, spread = _conditioned(prediction.uv_px, covariance, agree, features.uv_px[best[agree]], sigma_px)
    # The scale of descriptor distances depends on the detector and the images: take it from matches that are known to
    # agree.
    limit = _MOST_DISTANCE * np.median(apart[np.flatnonzero(agree), best[agree]])
    # A second search for all landmarks, in ellipses that are now little larger than the noise.
    rows = _best(where, spread + (_SLACK * sigma_px) ** 2 * np.eye(len(spread)), apart, features.uv_px)
    rows[(rows >= 0) & (apart[np.arange(len(rows)), rows] > limit)] = -1
    return _each_once(rows, apart)


def _descriptor_distances(ours: Descriptors, theirs: Descriptors) -> FloatArray:
    """(n, M) Euclidean distances, or Hamming distances of packed bits."""
    if ours.dtype == np.uint8 and ours.shape[1] <= 64:
        bits = np.unpackbits(np.bitwise_xor(ours[:, None], theirs), axis=2)
        return np.asarray(bits.sum(axis=2), dtype=np.float64)
    a, b = ours.astype(np.float64), theirs.astype(np.float64)
    # |a - b|^2 by one matrix product; rounding may make it slightly negative.
    squares = np.sum(a**2, axis=1)[:, None] - 2.0 * a @ b.T + np.sum(b**2, axis=1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)), dtype=np.float64)


def _best(where: FloatArray, covariance: FloatArray, apart: FloatArray, uv_px: FloatArray) -> IndexArray:
    """(n,) feature with the nearest descriptor in the ellipse of each landmark; -1 if the ellipse has none."""
    offset = uv_px - where[:, None]
    inverse = np.linalg.inv(diagonal_blocks(covariance))
    inside = np.einsum("nmi,nij,nmj->nm", offset, inverse, offset) <= _GATE**2
    rows = np.where(inside, apart, np.inf).argmin(axis=1).astype(np.int64)
    return np.where(inside.any(axis=1), rows, -1)


def _consensus(where: FloatArray, covariance: FloatArray, best: IndexArray, uv_px: FloatArray) -> BoolArray:
    """(n,) landmarks whose best matches agree with the hypothesis that has the most agreement."""
    n = len(best)
    found = best >= 0
    innovation = np.where(found[:, None], uv_px[best] - where, 0.0)
    wide = covariance.reshape(n, 2, n, 2)
    own = diagonal_blocks(covariance)
    agreement = np.zeros((n, n), dtype=np.bool_)
    for one in np.flatnonzero(found).tolist():
        # Kalman gain S_j1 S_11^-1 of this landmark's innovation alone, for the predictions of all others.
        gain = np.einsum("nik,kj->nij", wide[:, :, one], np.linalg.inv(own[one]))
        left = innovation - gain @ innovation[one]
        spread = own - np.einsum("nij,njk->nik", gain, np.swapaxes(wide[:, :, one], 1, 2))
        # Its own conditional covariance is zero and has no inverse; its residual is zero too, so it agrees.
        spread[one] = own[one]
        squared = np.einsum("ni,ni->n", left, np.linalg.solve(spread, left[..., None])[..., 0])
        agreement[one] = found & (squared <= _GATE**2)
    return np.asarray(agreement[int(agreement.sum(axis=1).argmax())], dtype=np.bool_)


def _conditioned(
    where: FloatArray, covariance: FloatArray, agree: BoolArray, seen_px: FloatArray, sigma_px: float
) -> tuple[FloatArray, FloatArray]:
    """Predicted pixels (n, 2) of all landmarks and their covariance (2 n, 2 n), conditioned on the matched ones."""
    rows = (2 * np.flatnonzero(agree)[:, None] + np.arange(2)).ravel()
    cross = covariance[:, rows].copy()
    # Predicted is the pixel of the landmark, without the noise of its feature: that noise is not in the covariance of
    # the prediction with the measurements.
    cross[rows, np.arange(len(rows))] -= sigma_px**2
    gain = np.linalg.solve(covariance[np.ix_(rows, rows)], cross.T).T
    expected = where + (gain @ (seen_px - where[agree]).ravel()).reshape(-1, 2)
    without = covariance - sigma_px**2 * np.eye(len(covariance))
    return expected, np.asarray(without - gain @ cross.T, dtype=np.float64)


def _each_once(rows: IndexArray, apart: FloatArray) -> IndexArray:
    """Assign a feature that several landmarks claim to the one with the nearest descriptor."""
    kept = rows.copy()
    for row in np.unique(rows[rows >= 0]).tolist():
        claims = np.flatnonzero(rows == row)
        kept[claims[apart[claims, row] > apart[claims, row].min()]] = -1
    return kept
