"""Detect Harris corners or SURF blobs, without those that resemble their surroundings (sections 2.2, 3.3).

Blobs are those of the Fast-Hessian detector: H. Bay, A. Ess, T. Tuytelaars, L. Van Gool: Speeded-Up Robust Features
(SURF), Computer Vision and Image Understanding 110 (2008) 346, sections 3.2 and 3.3. OpenCV's free packages do not
contain SURF. Unlike SURF, all octaves are sampled at every pixel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from boresight.estimators.landmark.signal import extract_signal
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import pixel_from_opencv
from boresight.scenarios.spec.base import SpecModel, number

OCTAVES = ((9, 15, 21, 27), (15, 27, 39, 51))
"""Sides of the box filters, pixels: the first two octaves of Bay et al."""

_MIXED_WEIGHT = 0.9
_SCALE_OF_SIDE = 1.2 / 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Blobs of an image, bright and dark.

    ``peaks`` (M, 2) are rows and columns of the maxima, ``offsets_px`` (M, 2) lead from the peaks to the interpolated
    maxima in (u, v), within half a pixel, and ``strength`` (M,) is the determinant of the Hessian at the maximum, of an
    image scaled to 0..1. ``scale_px`` (M,) is the interpolated scale by Bay et al.'s definition: a filter of side 9
    stands for a Gaussian of standard deviation 1.2. The second moments of the filters are larger, so that the scale of
    a Gaussian blob is about three quarters of its standard deviation.
    """

    peaks: NDArray[np.intp]
    offsets_px: FloatArray
    scale_px: FloatArray
    strength: FloatArray


def fast_hessian(image: Image) -> Blobs:
    """Find the maxima of the determinant of the Hessian in position and scale; the image (H, W) is scaled to 0..1."""
    sides = sorted({side for octave in OCTAVES for side in octave})
    layers = {side: determinant(image, side) for side in sides}
    dilated = {side: np.asarray(cv2.dilate(layer, np.ones((3, 3), np.uint8))) for side, layer in layers.items()}
    found = [_maxima(layers, dilated, octave[i - 1 : i + 2]) for octave in OCTAVES for i in range(1, len(octave) - 1)]
    return Blobs(
        np.concatenate([blobs.peaks for blobs in found]),
        np.concatenate([blobs.offsets_px for blobs in found]),
        np.concatenate([blobs.scale_px for blobs in found]),
        np.concatenate([blobs.strength for blobs in found]),
    )


def determinant(image: Image, side: int) -> Image:
    """Dxx Dyy - (0.9 Dxy)^2 of box filters of a side, normalised by their area, (H, W)."""
    lobe = side // 3
    long = 2 * lobe - 1
    # Lobes of weight 1, -2, 1: the whole box once, minus three times its middle third.
    xx = _box(image, (side, long)) - 3.0 * _box(image, (lobe, long))
    yy = _box(image, (long, side)) - 3.0 * _box(image, (long, lobe))
    xy = _mixed(_box(image, (lobe, lobe)), (lobe + 1) // 2)
    # Each derivative is divided by the area of the filter, side^2, so that responses of all sides compare; 0.9 balances
    # the box filters against Gaussian derivatives (Bay et al., section 3.2).
    normalised: Image = (xx * yy - (_MIXED_WEIGHT * xy) ** 2) / np.float32(side**4)
    return normalised


def _box(image: Image, size: tuple[int, int]) -> Image:
    """Sum over a window (width, height) about each pixel, by running sums whose cost does not depend on the size."""
    return np.asarray(cv2.boxFilter(image, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_REPLICATE))


def _mixed(lobe: Image, reach: int) -> Image:
    """Mixed derivative Dxy: four lobes about each pixel with alternating signs."""
    wide = cv2.copyMakeBorder(lobe, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    first, last = slice(None, -2 * reach), slice(2 * reach, None)
    mixed: Image = wide[first, first] + wide[last, last] - wide[first, last] - wide[last, first]
    return mixed


def _maxima(layers: Mapping[int, Image], dilated: Mapping[int, Image], sides: tuple[int, ...]) -> Blobs:
    """Maxima of the middle one of three layers (H, W) among their 26 neighbours."""
    below, middle, above = sides
    around = np.maximum(np.maximum(dilated[below], dilated[above]), dilated[middle])
    highest = (layers[middle] == around) & (layers[middle] > 0.0)
    # Filters that reach beyond the image see replicated pixels.
    reach = above // 2 + 1
    highest[:reach] = highest[-reach:] = False
    highest[:, :reach] = highest[:, -reach:] = False
    peaks = np.argwhere(highest)
    offsets = _interpolated([layers[side] for side in sides], peaks)
    scale_px = _SCALE_OF_SIDE * (middle + offsets[:, 2] * (middle - below))
    return Blobs(peaks, offsets[:, :2], scale_px, layers[middle][highest].astype(np.float64))


def _interpolated(layers: Sequence[Image], peaks: NDArray[np.intp]) -> FloatArray:
    """Offsets (M, 3) in (u, v, layer), within a half, to the maximum of a quadratic through the neighbours.

    After M. Brown, D. Lowe: Invariant features from interest point groups, BMVC 2002; 0 where the quadratic has no
    maximum.
    """
    rows, columns = peaks[:, 0], peaks[:, 1]

    def at(step: NDArray[np.intp]) -> FloatArray:
        return np.asarray(layers[1 + step[2]][rows + step[1], columns + step[0]], dtype=np.float64)

    axes = np.eye(3, dtype=np.intp)
    slope = np.stack([0.5 * (at(axis) - at(-axis)) for axis in axes], axis=-1)
    curvature = np.empty((len(peaks), 3, 3))
    for i, one in enumerate(axes):
        for j, other in enumerate(axes):
            if i == j:
                curvature[:, i, i] = at(one) - 2.0 * at(0 * one) + at(-one)
            else:
                curvature[:, i, j] = 0.25 * (at(one + other) + at(-one - other) - at(one - other) - at(other - one))
    # Only a negative definite curvature has a maximum; elsewhere the Newton step leads to a saddle.
    peaked = np.linalg.eigvalsh(curvature)[:, -1] < 0.0
    offsets = np.zeros((len(peaks), 3))
    offsets[peaked] = -np.linalg.solve(curvature[peaked], slope[peaked, :, None])[..., 0]
    return np.clip(offsets, -0.5, 0.5)


class CornerOptions(SpecModel):
    """Options of corner detection."""

    detector: Literal["harris", "surf"] = Field(
        "harris",
        description="Corners by first derivatives, or blobs by SURF's detector, to which k and windows are nothing",
    )
    count: int = number(
        100, "At most this many corners an image, the strongest first", each_px2=65_000, ge=4, le=100_000
    )
    block_px: int = Field(3, ge=2, le=31, description="Side of the window over which gradients are summed")
    aperture_px: Literal[1, 3, 5, 7] = Field(3, description="Aperture of the Sobel derivative")
    k: float = Field(0.04, gt=0, lt=0.25, description="Harris' free parameter")
    blur_px: float = Field(0.0, ge=0, le=20, description="Gaussian smoothing before the derivatives, against noise")
    separation_px: int = Field(2, ge=1, le=100, description="No two corners closer than this along both axes")
    min_relative_strength: float = Field(1e-4, ge=0, lt=1, description="Weakest corner over the strongest in the image")
    subpixel: bool = Field(True, description="Refine by a parabola through the response at the peak's neighbours")
    patch_px: int = Field(11, ge=3, le=63, description="Odd side of the patch that is correlated")
    surroundings_px: int = Field(31, ge=5, le=127, description="Odd side of the window that it is correlated with")
    self_similarity_max: float = Field(
        0.8, gt=0, le=1, description="A second correlation peak above this purges the corner; 1 keeps all"
    )

    @model_validator(mode="after")
    def _windows(self) -> Self:
        if self.patch_px % 2 == 0 or self.surroundings_px % 2 == 0:
            raise ValueError("patch_px and surroundings_px must be odd")
        if self.patch_px + 4 > self.surroundings_px:
            raise ValueError("surroundings_px must exceed patch_px by at least 4")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Corners of one image, the strongest first.

    ``uv_px`` (M, 2) are positions, the centre of the first pixel at (0.5, 0.5), and ``strength`` (M,) is the response
    of the detector on an image scaled to 0..1.
    """

    uv_px: FloatArray
    strength: FloatArray

    def __len__(self) -> int:
        return len(self.uv_px)


def detect_corners(image: NDArray[np.float32], options: CornerOptions) -> Corners:
    """Find the strongest corners that are distinct from their surroundings; a black image has none.

    The image is scaled to a fixed range first, so its unit does not matter. Raise BoresightError if the image has a
    wrong shape or is not finite.
    """
    signal = extract_signal(image)
    if signal.empty:
        return Corners(np.empty((0, 2)), np.empty(0))
    smooth = cv2.GaussianBlur(signal.image, (0, 0), options.blur_px) if options.blur_px > 0.0 else signal.image
    found = _blobs(smooth, options) if options.detector == "surf" else _corners(smooth, options)
    # Before the refinement to subpixels: patches are cut at whole pixels.
    kept = distinct_peaks(smooth, found.peaks, options)
    positions = found.peaks[kept, ::-1].astype(np.float64)
    if options.subpixel:
        positions += found.offsets_px[kept]
    return Corners(pixel_from_opencv(positions), found.strength[kept])


@dataclass(frozen=True, slots=True, eq=False)
class _DetectedPeaks:
    """Rows and columns (M, 2) of peaks, the strongest first, their offsets (M, 2) in (u, v) and strengths (M,)."""

    peaks: NDArray[np.intp]
    offsets_px: FloatArray
    strength: FloatArray


def _corners(image: NDArray[np.float32], options: CornerOptions) -> _DetectedPeaks:
    response = harris_response(image, options)
    peaks = response_peaks(response, options)
    strength = response[peaks[:, 0], peaks[:, 1]].astype(np.float64)
    return _DetectedPeaks(peaks, _parabola_offset(response, peaks), strength)


def _blobs(image: NDArray[np.float32], options: CornerOptions) -> _DetectedPeaks:
    """Find blobs of all scales; where several coincide, keep the strongest."""
    blobs = fast_hessian(image)
    # Ascending, so that of several blobs at a pixel the strongest is written last and stays.
    order = np.argsort(blobs.strength, kind="stable")
    rows, columns = blobs.peaks[order, 0], blobs.peaks[order, 1]
    strongest = np.zeros(image.shape, dtype=np.float32)
    number = np.zeros(image.shape, dtype=np.intp)
    strongest[rows, columns], number[rows, columns] = blobs.strength[order], order
    peaks = response_peaks(strongest, options)
    chosen = number[peaks[:, 0], peaks[:, 1]]
    return _DetectedPeaks(peaks, blobs.offsets_px[chosen], blobs.strength[chosen])


def harris_response(image: NDArray[np.float32], options: CornerOptions) -> NDArray[np.float32]:
    """Harris response det(M) - k trace(M)**2 of the gradient's structure tensor M, (H, W)."""
    return np.asarray(cv2.cornerHarris(image, options.block_px, options.aperture_px, options.k), dtype=np.float32)


def response_peaks(response: NDArray[np.float32], options: CornerOptions) -> NDArray[np.intp]:
    """(M, 2) rows and columns of the local maxima of the response, the strongest first.

    Peaks whose surroundings extend beyond the image are left out.
    """
    # A local maximum is its own neighbourhood's maximum, which the dilation computes.
    side = 2 * options.separation_px + 1
    neighbourhood = cv2.dilate(response, np.ones((side, side), dtype=np.uint8))
    # Harris responses of edges are negative: the floor is not below 0.
    floor = max(options.min_relative_strength * float(response.max()), 0.0)
    peak = (response == neighbourhood) & (response > floor)
    # The surroundings of a corner have to be in the image for its self-similarity.
    margin = options.surroundings_px // 2
    peak[:margin] = peak[-margin:] = False
    peak[:, :margin] = peak[:, -margin:] = False
    rows, columns = np.nonzero(peak)
    order = np.argsort(-response[rows, columns], kind="stable")
    return np.stack([rows, columns], axis=1)[order]


def distinct_peaks(image: NDArray[np.float32], peaks: NDArray[np.intp], options: CornerOptions) -> list[int]:
    """Return the indices of the first ``count`` peaks that are distinct from their surroundings.

    Corners on the limb resemble each other along the limb; they belong to the horizon and to no place on the body.
    """
    kept: list[int] = []
    for index, (row, column) in enumerate(peaks):
        if len(kept) == options.count:
            break
        if self_similarity(image, int(row), int(column), options) <= options.self_similarity_max:
            kept.append(index)
    return kept


def self_similarity(image: NDArray[np.float32], row: int, column: int, options: CornerOptions) -> float:
    """Return the highest normalised cross-correlation of a corner's patch with its surroundings, apart from itself.

    Shifts below half a patch, which make up the main peak, are left out. A patch without contrast gives 1.
    """
    half, reach = options.patch_px // 2, options.surroundings_px // 2
    patch = image[row - half : row + half + 1, column - half : column + half + 1]
    window = image[row - reach : row + reach + 1, column - reach : column + reach + 1]
    if np.ptp(patch) == 0.0:
        return 1.0
    # Zero-mean normalised: independent of brightness and contrast, which vary along a limb.
    correlation = cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED)
    return float(correlation[_away_from_centre(options.patch_px, options.surroundings_px)].max())


def _away_from_centre(patch_px: int, surroundings_px: int) -> NDArray[np.bool_]:
    shift = np.arange(surroundings_px - patch_px + 1) - (surroundings_px - patch_px) // 2
    # At least the outermost shifts are kept where the surroundings are hardly larger than the patch.
    mask: NDArray[np.bool_] = np.hypot(shift[:, None], shift[None, :]) > min(patch_px // 2, shift.max() - 1)
    return mask


def _parabola_offset(response: NDArray[np.float32], peaks: NDArray[np.intp]) -> FloatArray:
    """Offsets (M, 2) in (u, v), within half a pixel, to the vertex of a parabola through three responses per axis."""
    rows, columns = peaks[:, 0], peaks[:, 1]
    centre = response[rows, columns].astype(np.float64)
    offsets = []
    for step_row, step_column in ((0, 1), (1, 0)):
        before = response[rows - step_row, columns - step_column].astype(np.float64)
        after = response[rows + step_row, columns + step_column].astype(np.float64)
        curvature = before - 2.0 * centre + after
        slope = 0.5 * (before - after)
        offsets.append(np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature < 0.0))
    clipped: FloatArray = np.clip(np.stack(offsets, axis=1), -0.5, 0.5)
    return clipped
