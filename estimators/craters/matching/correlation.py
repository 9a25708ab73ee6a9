"""Matching by correlation of rectified templates, after Cheng et al. (2003)."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.craters.contract import CraterImage, CraterMatches, GroundModel, too_few_craters
from boresight.estimators.craters.matching.context import mutual_best
from boresight.estimators.craters.matching.transfer import (
    CraterTransfer,
    joint_covariance,
    locate_craters,
    transfer_craters,
)
from boresight.estimators.options import Configured
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import Ellipses, angle_between
from boresight.scenarios.spec.base import SpecModel

_HALF_PIXEL = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # OpenCV's pixels to this project's


class CorrelationOptions(SpecModel):
    """Options of matching by correlation; the paper prints 10 degrees and 0.9."""

    sun_deg: float = Field(10.0, gt=0.0, description="Largest angle between the directions of the Sun")
    accepted: float = Field(0.9, gt=0.0, lt=1.0, description="Least correlation")
    template_radii: float = Field(1.5, gt=0.0, description="Half a template's side, in radii of the crater")
    least_half_px: int = Field(7, ge=2, description="Least half side of a template")
    most_half_px: int = Field(24, ge=2, description="Largest half side of a template")
    search_px: int = Field(5, ge=1, description="Search range around the crater in the second image")
    place_px: float = Field(3.0, gt=0.0, description="Largest distance of the best place from the centre")
    size_ratio: float = Field(1.4, gt=1.0, description="Largest ratio of predicted and seen radius, or inverse")
    gate_sigma: float = Field(3.5, gt=0.0, description="Largest distance from the predicted place, in sigmas")


class CorrelationMatcher(Configured[CorrelationOptions]):
    """Confirms a crater if its image, rectified by the local plane, correlates with the second image.

    Use it when
    -----------
    The Sun's directions in both images differ by less than 10 deg, and both images have pixels: it needs few craters.

    It fails when
    -------------
    The directions of the Sun differ by more than ``sun_deg``, or no crater of the first image is in sight of the second
    by the prior poses.

    Cost
    ----
    Part of that of ``hybrid`` where images have pixels; not measured by itself.

    Source
    ------
    Cheng et al. (2003), equations (5) and (6).
    """

    name: ClassVar[str] = "correlation"
    version: ClassVar[int] = 1
    options_model = CorrelationOptions

    def match(self, first: CraterImage, second: CraterImage, ground: GroundModel) -> CraterMatches:
        """Match by pixels, if the illumination is similar."""
        if reason := too_few_craters(first, second):
            return CraterMatches.none(reason)
        # Between the directions of the Sun in body axes, from the prior attitudes: there the shadows are cast, however
        # the camera is rolled.
        here, there = (each.frame.prior_T_cam_body.rotation.T @ each.frame.sun_dir_cam for each in (first, second))
        angle_deg = np.degrees(angle_between(here, there))
        if angle_deg > self.options.sun_deg:
            return CraterMatches.none(f"the directions of the Sun differ by {angle_deg:.3g} deg: too much to correlate")
        expected = transfer_craters(first, second, locate_craters(first, ground), ground)
        if len(expected.rows) == 0:
            return CraterMatches.none("no crater of the first image is in sight of the second by the prior poses")
        near, options = near_expected(expected, first, second, self.options), self.options
        # The best of each crater.
        best = np.full(near.shape, -np.inf)
        image, other = (np.ascontiguousarray(each.frame.image, dtype=np.float32) for each in (first, second))
        for p in np.flatnonzero(near.any(axis=1)):
            template = rectify_template(image, expected.homographies[p], expected.ellipses[p : p + 1], options)
            for k in np.flatnonzero(near[p]):
                best[p, k] = _best_correlation(template, other, second.detections.ellipses.centre_px[k], options)
        pairs = mutual_best(np.where(best > options.accepted, -best, np.inf))
        if len(pairs) == 0:
            return CraterMatches.none(f"none of {int(near.sum())} couples near their predicted place correlates")
        rows = np.column_stack([expected.rows[pairs[:, 0]], pairs[:, 1]])
        return CraterMatches(rows, best[pairs[:, 0], pairs[:, 1]])


def near_expected(
    expected: CraterTransfer, first: CraterImage, second: CraterImage, options: CorrelationOptions
) -> NDArray[np.bool_]:
    """Return (p, m) which craters of the second image are near an expected one in place and size."""
    seen, H = second.detections.ellipses, expected.by_error
    # Besides the errors of the poses an offset has those of both detections and of the shape, summed up as place_px.
    covariance = H @ joint_covariance(first, second) @ np.swapaxes(H, 1, 2) + options.place_px**2 * np.eye(2)
    offsets = seen.centre_px[None] - expected.ellipses.centre_px[:, None]
    far = np.einsum("pmi,pij,pmj->pm", offsets, np.linalg.inv(covariance), offsets)
    ratio = np.log(seen.radius_px[None] / expected.ellipses.radius_px[:, None])
    return np.asarray((far < options.gate_sigma**2) & (np.abs(ratio) < np.log(options.size_ratio)))


def rectify_template(image: Image, homography: FloatArray, ellipse: Ellipses, options: CorrelationOptions) -> Image:
    """Resample a crater of the first image as it should appear in the second, (2 h + 1, 2 h + 1); NaN off the image.

    The predicted centre of the crater is at the centre of the central pixel.
    """
    half = int(
        np.clip(np.ceil(options.template_radii * ellipse.radius_px[0]), options.least_half_px, options.most_half_px)
    )
    shift = np.eye(3)
    # Pixel ``half`` is the central one, and its centre is at half + 0.5 in this project's pixels.
    shift[:2, 2] = half + 0.5 - ellipse.centre_px[0]
    # OpenCV's pixels of the image, to ours, to the second image, to the template, to OpenCV's.
    matrix = np.linalg.inv(_HALF_PIXEL) @ shift @ homography @ _HALF_PIXEL
    side = 2 * half + 1
    return np.asarray(
        cv2.warpPerspective(
            image,
            matrix,
            (side, side),
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        ),
        dtype=np.float32,
    )


def pseudo_normalised(template: FloatArray, windows: FloatArray) -> FloatArray:
    """Return (...) the correlation (6) of a template (h, w) with windows (..., h, w)."""
    # 2 cov / (var + var) instead of cov / (sigma sigma): 1 only for equal contrast too, not for any linear relation.
    here = template - template.mean()
    there = windows - windows.mean(axis=(-2, -1), keepdims=True)
    covariance = (here * there).mean(axis=(-2, -1))
    total = (here**2).mean() + (there**2).mean(axis=(-2, -1))
    return np.asarray(2.0 * covariance / np.maximum(total, 1e-300))  # eq. (6)


def _best_correlation(template: Image, image: Image, centre_px: FloatArray, options: CorrelationOptions) -> float:
    """Return the highest correlation around a crater's centre (2,) px.

    Minus infinity if its place is too far from the centre, if the search window leaves the image, or if the template
    is incomplete.
    """
    half, reach = template.shape[0] // 2, options.search_px
    column, row = np.floor(centre_px).astype(int)
    top, left = row - half - reach, column - half - reach
    side = template.shape[0] + 2 * reach
    if top < 0 or left < 0 or top + side > image.shape[0] or left + side > image.shape[1]:
        return -np.inf
    # A template that is cut off by the frame is not compared: equation (6) has no weights.
    if not np.isfinite(template).all():
        return -np.inf
    window = image[top : top + side, left : left + side].astype(np.float64)
    windows = np.lib.stride_tricks.sliding_window_view(window, template.shape)
    scores = pseudo_normalised(template.astype(np.float64), windows)
    at = np.array(np.unravel_index(int(np.argmax(scores)), scores.shape))[::-1]
    # The best place has to be at the detected centre, or another structure has correlated.
    place = np.array([column, row]) + at - reach + 0.5
    return float(scores.max()) if np.linalg.norm(place - centre_px) <= options.place_px else -np.inf
