"""Align the rendered mesh with the image across the line of sight, and compare the two at a pose.

The paper aligns brightness centroids (section 3.2.2). These are wrong where much of the body is dark or the terminator
is misplaced; then the whole images are cross-correlated, as section 6 of the paper proposes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field
from scipy import fft

from boresight.estimators.contract import ImageRenderer, Stopwatch
from boresight.estimators.landmark.signal import KNOWN_SKY, extract_signal
from boresight.scenarios.arrays import FloatArray, Image, IndexArray
from boresight.scenarios.geometry import Camera, Pose, View
from boresight.scenarios.spec.base import SpecModel

_CUT_SHARE = 0.05
"""Share of the border's pixels above which the frame cuts the body."""
_LEAST_OVERLAP = 0.4
_PROBE_PX = 2.0  # shift of a rendering that tells how far its ground is
_NEAR_TIMES = 2.0  # the shifting still converges where the ground moves by up to twice the step

Measure = Callable[[Image, Image, FloatArray], tuple[FloatArray, FloatArray]]
"""(observed signal, rendered signal, projected origin of the body) -> the same point in both images, px."""


class AlignmentOptions(SpecModel):
    """End of the iteration of rendering and shifting."""

    tolerance_px: float = Field(5.0, gt=0, description="Done when the rendered centroid moves less than this")
    max_iterations: int = Field(10, ge=1, le=1000, description="Most iterations of rendering and shifting")


@dataclass(frozen=True, slots=True, eq=False)
class MeshView:
    """A rendered shape with its camera, the direction of the Sun in camera axes, and `Alignment.depth_share`."""

    camera: Camera
    renderer: ImageRenderer
    sun_dir_cam: FloatArray
    depth_share: float = 1.0

    def at(self, T_cam_body: Pose) -> View:
        """Return the view from a pose; the Sun is fixed in camera axes."""
        return View(self.camera, T_cam_body, T_cam_body.rotation.T @ self.sun_dir_cam)

    def render(self, T_cam_body: Pose) -> Image:
        """Render the mesh."""
        return np.asarray(self.renderer.render(self.at(T_cam_body)), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentStep:
    """One iteration: the pose at which the mesh was rendered, and its image (H, W).

    ``observed_px`` and ``rendered_px`` (2,) are corresponding points of the observed and the rendered image, which the
    update makes coincide.
    """

    T_cam_body: Pose
    rendered: Image
    observed_px: FloatArray
    rendered_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The aligned pose with its iterations; ``failure`` is the reason where the alignment is impossible.

    ``depth_share`` is the depth of the ground over the range of the body's origin where the frame cuts a body whose
    ground is nearer than half that range; else 1.
    """

    T_cam_body: Pose
    steps: tuple[AlignmentStep, ...]
    failure: str = ""
    depth_share: float = 1.0


def align_translation(
    observed: Image, T_cam_body: Pose, view: MeshView, measure: Measure, options: AlignmentOptions, clock: Stopwatch
) -> Alignment:
    """Render the mesh and shift it onto the observed image, until the rendered point no longer moves.

    The pose after the greatest number of iterations is returned like a converged one. ``observed`` (H, W) is the signal
    of the observed image, background 0, not black. ``measure`` returns the corresponding points: `centroid_pair` or
    `correlation_pair`. ``clock`` records the times ``mesh_rendering`` and ``centroid``.

    The paper shifts a body by the range of its origin. Low above the ground, which is then much nearer, that is too far
    by the ratio of both, and the iteration diverges: shifts are scaled there, see `Alignment`.
    """
    steps: list[AlignmentStep] = []
    depth_share = 1.0
    while len(steps) < options.max_iterations:
        with clock("mesh_rendering"):
            rendered = view.render(T_cam_body)
        with clock("centroid"):
            signal = extract_signal(rendered, KNOWN_SKY)
            if signal.empty:
                return Alignment(T_cam_body, tuple(steps), "the rendered mesh is out of view or in the dark")
            origin_px = view.camera.project(T_cam_body.translation_m)
            observed_px, rendered_px = measure(observed, signal.image, origin_px)
        if not steps and is_cut(observed):
            depth_share = _depth_share(signal.image, T_cam_body, view)
        steps.append(AlignmentStep(T_cam_body, rendered, observed_px, rendered_px))
        target_px = observed_px
        if depth_share < 1.0:
            target_px = rendered_px + depth_share * (observed_px - rendered_px)
        T_cam_body = translation_update(T_cam_body, target_px, rendered_px, view.camera)
        # Section 3.2.2: the centroid of the rendering varies by less than five pixels from one iteration to the next.
        # Near ground moves by more pixels than the origin that is compared.
        if len(steps) > 1 and np.linalg.norm(rendered_px - steps[-2].rendered_px) < options.tolerance_px * depth_share:
            break
    return Alignment(T_cam_body, tuple(steps), depth_share=depth_share)


def _depth_share(rendered: Image, T_cam_body: Pose, view: MeshView) -> float:
    """Return the share of `Alignment`, by how far the ``rendered`` signal (H, W) moves if the body is shifted."""
    step_m = _PROBE_PX * view.camera.pixel_angle_rad * float(np.linalg.norm(T_cam_body.translation_m))
    signal = extract_signal(view.render(T_cam_body.perturbed(np.zeros(3), np.array([step_m, step_m, 0.0]))), KNOWN_SKY)
    # The lesser of both axes: along a smooth limb a shift is found poorly.
    moved_px = 0.0 if signal.empty else float(_shift_of_overlap(signal.image, rendered).min())
    return _PROBE_PX / moved_px if moved_px > _NEAR_TIMES * _PROBE_PX else 1.0


def translation_update(T_cam_body: Pose, observed_px: FloatArray, rendered_px: FloatArray, camera: Camera) -> Pose:
    """Translate the body at its distance so that the rendered point moves to the observed one."""
    r_obs, r_sim = camera.unproject(observed_px), camera.unproject(rendered_px)  # eq. (11)
    distance = float(np.linalg.norm(T_cam_body.translation_m))
    # The paper moves the point r_sim at the distance of the origin to the foot of its perpendicular on r_obs.
    delta = distance * float(r_obs @ r_sim) * r_obs - distance * r_sim  # eq. (13)
    return T_cam_body.perturbed(np.zeros(3), delta)


def centroid_pair(observed: Image, rendered: Image, origin_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the brightness centroids of both images, as in the paper; ``origin_px`` is not used."""
    del origin_px
    return brightness_centroid(observed), brightness_centroid(rendered)


def brightness_centroid(signal: Image) -> FloatArray:
    """Centre of brightness (2,) of an image whose background is 0; the first pixel's centre counts as (0.5, 0.5)."""
    total = signal.sum(dtype=np.float64)
    columns = signal.sum(axis=0, dtype=np.float64) @ (np.arange(signal.shape[1]) + 0.5)
    rows = signal.sum(axis=1, dtype=np.float64) @ (np.arange(signal.shape[0]) + 0.5)
    centroid: FloatArray = np.array([columns, rows]) / total  # eq. (12)
    return centroid


def correlation_pair(observed: Image, rendered: Image, origin_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the projected origin (2,) of the body, px, in the observed and the rendered image, by their best shift."""
    return origin_px + best_shift(observed, rendered), origin_px


def is_cut(observed: Image) -> bool:
    """Say whether the frame cuts the body: a part of the border of the signal (H, W) is lit."""
    border = np.concatenate([observed[0], observed[-1], observed[:, 0], observed[:, -1]])
    return bool(np.count_nonzero(border) > _CUT_SHARE * len(border))


def best_shift(observed: Image, rendered: Image) -> FloatArray:
    """Shift (du, dv) in px that moves the rendered image onto the observed one.

    Both backgrounds are 0, so the sum of squared differences is least where the cross-correlation is greatest; a
    parabola interpolates the peak. The search covers all shifts that keep half of the lit part in the image. Where the
    observed body is cut by the frame, that sum would count the part outside as dark: see `_shift_of_overlap`.
    """
    if is_cut(observed):
        return _shift_of_overlap(observed, rendered)
    rows, columns = np.nonzero(rendered)
    top, left = int(rows.min()), int(columns.min())
    # Cut to its lit part, so that padding by half of it covers all shifts that keep half in the image.
    template = rendered[top : int(rows.max()) + 1, left : int(columns.max()) + 1]
    pad_rows, pad_columns = template.shape[0] // 2, template.shape[1] // 2
    field = np.pad(observed, ((pad_rows, pad_rows), (pad_columns, pad_columns)))
    # The sum of |observed - rendered|^2 over the plane is constant but for -2 times the correlation.
    correlation = cv2.matchTemplate(field, template, cv2.TM_CCORR)
    row, column = (int(i) for i in np.unravel_index(int(correlation.argmax()), correlation.shape))
    # Index in the correlation minus that of no shift: the place of the template in the padded image.
    dv = row + _peak_offset(correlation[:, column], row) - pad_rows - top
    du = column + _peak_offset(correlation[row], column) - pad_columns - left
    return np.array([du, dv], dtype=np.float64)


def _shift_of_overlap(observed: Image, rendered: Image) -> FloatArray:
    """Shift of images that the frame cuts: greatest correlation coefficient over what they have in common.

    Padfield (2012), IEEE Transactions on Image Processing 21, 2706, equations (9) to (12) with the whole frames as
    masks, whose sums over the overlap are those of rectangles. At least 0.4 of the frame are in common. Both images are
    band-passed, from 1/256 to 1/32 of the frame's height, as albedo and reflectance differ most at large scales.
    """
    height, width = observed.shape
    first, second = (_band_passed(image, height / 256.0, height / 32.0) for image in (observed, rendered))
    reach = [int((1.0 - _LEAST_OVERLAP) * side) for side in (height, width)]
    down, right = (np.arange(-most, most + 1) for most in reach)
    shape = [fft.next_fast_len(side + most, real=True) for side, most in zip((height, width), reach, strict=True)]
    spectrum = fft.rfft2(first, shape) * np.conj(fft.rfft2(second, shape))
    # Negative shifts are at the end of the axes, where negative indices are.
    together: FloatArray = fft.irfft2(spectrum, shape)[np.ix_(down, right)]
    count = np.multiply.outer(height - np.abs(down), width - np.abs(right))
    sum_first, sum_second = _sums_in_common(first, down, right), _sums_in_common(second, -down, -right)
    covariance = together - sum_first * sum_second / count
    spread_first = _sums_in_common(first**2, down, right) - sum_first**2 / count
    spread_second = _sums_in_common(second**2, -down, -right) - sum_second**2 / count
    scale = np.sqrt(np.maximum(spread_first, 0.0) * np.maximum(spread_second, 0.0))
    usable = (count >= _LEAST_OVERLAP * height * width) & (scale > 1e-9 * scale.max())
    if not usable.any():  # nothing to compare, as in a saturated image
        return np.zeros(2)
    coefficient = np.where(usable, covariance / np.where(usable, scale, 1.0), -1.0)
    row, column = (int(i) for i in np.unravel_index(int(coefficient.argmax()), coefficient.shape))
    dv = down[row] + _peak_offset(coefficient[:, column], row)
    du = right[column] + _peak_offset(coefficient[row], column)
    return np.array([du, dv], dtype=np.float64)


def _sums_in_common(image: FloatArray, down: IndexArray, right: IndexArray) -> FloatArray:
    """Sum an image (H, W) over what it has in common with a frame shifted by ``down`` (R,), ``right`` (C,): (R, C)."""
    total = cv2.integral(image)
    strips = total[image.shape[0] + np.minimum(down, 0)] - total[np.maximum(down, 0)]
    sums: FloatArray = strips[:, image.shape[1] + np.minimum(right, 0)] - strips[:, np.maximum(right, 0)]
    return sums


def _band_passed(image: Image, fine_px: float, coarse_px: float) -> FloatArray:
    fine, coarse = (cv2.GaussianBlur(image, (0, 0), sigma) for sigma in (fine_px, coarse_px))
    return np.asarray(fine - coarse, dtype=np.float64)


def _peak_offset(profile: Image | FloatArray, peak: int) -> float:
    """Offset in px of the vertex of the parabola through the peak and its neighbours; 0 at an edge."""
    if not 0 < peak < len(profile) - 1:
        return 0.0
    before, top, after = (float(value) for value in profile[peak - 1 : peak + 2])
    curvature = before - 2.0 * top + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0


def centroid_residual_px(observed: Image, T_cam_body: Pose, view: MeshView) -> float | None:
    """Distance, px, between the brightness centroids of the image and of the mesh rendered at a pose.

    ``observed`` (H, W) is the signal of the image, background 0, not black. None where the mesh is out of view or dark
    at that pose.
    """
    signal = extract_signal(view.render(T_cam_body), KNOWN_SKY)
    if signal.empty:
        return None
    return float(np.linalg.norm(brightness_centroid(observed) - brightness_centroid(signal.image)))


def image_correlation(observed: Image, T_cam_body: Pose, view: MeshView) -> float:
    """Correlation coefficient of the image with a shape rendered at a pose, over all pixels; -1 if it is out of view.

    Both are signals with a background of 0, so the outline and the shading contribute. Two poses are compared by it
    without a threshold. It is the correlation with the onboard shape, not with the mesh of landmarks that the alignment
    renders.
    """
    rendered = extract_signal(view.render(T_cam_body), KNOWN_SKY)
    if rendered.empty:
        return -1.0
    one, other = (image.ravel() - image.mean(dtype=np.float64) for image in (observed, rendered.image))
    scale = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) / scale if scale > 0.0 else 0.0


def consistency_failure(residual_px: float | None, limit_px: float | None) -> str:
    """Return why a solution fails the check of its centroid; empty if it passes, or if there is no limit."""
    if limit_px is None or (residual_px is not None and residual_px <= limit_px):
        return ""
    if residual_px is None:
        return "the mesh rendered at the solution is out of view or in the dark"
    return (
        f"the brightness centroid of the mesh at the solution is {residual_px:.3g} px from the image's:"
        f" more than consistency_max_px {limit_px:g}"
    )
