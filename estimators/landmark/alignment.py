"""The translation across the line of sight, from the whole image instead of its centroid.

The centroid fails where much of the body is dark or its terminator is misplaced; then the rendered image is slid
over the observed one. Section 6 of the paper proposes this refinement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from estimators.contract import ImageRenderer, Stopwatch
from estimators.landmark.signal import KNOWN_SKY, extract_signal
from scenarios.geometry import Camera, Pose, View
from scenarios.spec.base import SpecModel

FloatArray = NDArray[np.float64]
Image = NDArray[np.float32]

Measure = Callable[[Image, Image, FloatArray], tuple[FloatArray, FloatArray]]
"""(observed signal, rendered signal, projected origin of the body) -> the same point in both images, px."""


class AlignmentOptions(SpecModel):
    """When the loop of rendering and shifting ends."""

    tolerance_px: float = Field(5.0, gt=0, description="Done when the rendered centroid moves less than this")
    max_iterations: int = Field(10, ge=1, le=1000)


@dataclass(frozen=True, slots=True, eq=False)
class MeshView:
    """How the mesh of the landmarks is seen: by which camera and renderer, under which Sun."""

    camera: Camera
    renderer: ImageRenderer
    sun_dir_cam: FloatArray

    def at(self, T_cam_body: Pose) -> View:
        """Return the view of a pose; the Sun stays where it is in the camera."""
        return View(self.camera, T_cam_body, T_cam_body.rotation.T @ self.sun_dir_cam)

    def render(self, T_cam_body: Pose) -> Image:
        """Render the mesh."""
        return np.asarray(self.renderer.render(self.at(T_cam_body)), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentStep:
    """One turn of the loop.

    Parameters
    ----------
    T_cam_body
        Pose that the mesh was rendered at.
    rendered
        (H, W) image of the mesh.
    observed_px, rendered_px
        (2,) the point in the observed and in the rendered image that the update brings together.
    """

    T_cam_body: Pose
    rendered: Image
    observed_px: FloatArray
    rendered_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The pose after the loop, and how it came about; ``failure`` says why where it could not run."""

    T_cam_body: Pose
    steps: tuple[AlignmentStep, ...]
    failure: str = ""


def align_translation(
    observed: Image, T_cam_body: Pose, view: MeshView, measure: Measure, options: AlignmentOptions, clock: Stopwatch
) -> Alignment:
    """Render the mesh and shift it onto the observed image, until the rendered point holds still.

    Parameters
    ----------
    observed
        (H, W) signal of the observed image, background 0, not black.
    T_cam_body
        Where to start.
    view
        Camera, renderer and Sun.
    measure
        What is brought together: ``centroid_pair`` or ``alignment.correlation_pair``.
    options
        When to stop.
    clock
        Gets the times ``mesh_rendering`` and ``centroid``.
    """
    steps: list[AlignmentStep] = []
    while len(steps) < options.max_iterations:
        with clock("mesh_rendering"):
            rendered = view.render(T_cam_body)
        with clock("centroid"):
            signal = extract_signal(rendered, KNOWN_SKY)
            if signal.empty:
                return Alignment(T_cam_body, tuple(steps), "the rendered mesh is out of view or in the dark")
            origin_px = view.camera.project(T_cam_body.translation_m)
            observed_px, rendered_px = measure(observed, signal.image, origin_px)
        steps.append(AlignmentStep(T_cam_body, rendered, observed_px, rendered_px))
        T_cam_body = translation_update(T_cam_body, observed_px, rendered_px, view.camera)
        if len(steps) > 1 and np.linalg.norm(rendered_px - steps[-2].rendered_px) < options.tolerance_px:
            break
    return Alignment(T_cam_body, tuple(steps))


def translation_update(T_cam_body: Pose, observed_px: FloatArray, rendered_px: FloatArray, camera: Camera) -> Pose:
    """Shift the body in the camera so that the rendered point comes to lie on the observed one."""
    r_obs, r_sim = camera.unproject(observed_px), camera.unproject(rendered_px)  # eq. (11)
    distance = float(np.linalg.norm(T_cam_body.translation_m))
    delta = distance * float(r_obs @ r_sim) * r_obs - distance * r_sim  # eq. (13)
    return T_cam_body.perturbed(np.zeros(3), delta)


def centroid_pair(observed: Image, rendered: Image, origin_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Take the centroids of both images: the paper's measure. ``origin_px`` is not needed for it."""
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
    """Follow the projected origin of the body from the rendered to the observed image by their best shift.

    Returns
    -------
    (2,) position in the observed image and (2,) position in the rendered image, px.
    """
    return origin_px + best_shift(observed, rendered), origin_px


def best_shift(observed: Image, rendered: Image) -> FloatArray:
    """Shift (du, dv) in px that moves the rendered image onto the observed one.

    Both backgrounds are 0, so the least squares of the difference is where the cross-correlation is greatest; a
    parabola refines the peak. Shifts that leave half of the lit part in the image are tried.
    """
    rows, columns = np.nonzero(rendered)
    top, left = int(rows.min()), int(columns.min())
    template = rendered[top : int(rows.max()) + 1, left : int(columns.max()) + 1]
    pad_rows, pad_columns = template.shape[0] // 2, template.shape[1] // 2
    field = np.pad(observed, ((pad_rows, pad_rows), (pad_columns, pad_columns)))
    correlation = cv2.matchTemplate(field, template, cv2.TM_CCORR)
    row, column = (int(i) for i in np.unravel_index(int(correlation.argmax()), correlation.shape))
    dv = row + _peak_offset(correlation[:, column], row) - pad_rows - top
    du = column + _peak_offset(correlation[row], column) - pad_columns - left
    return np.array([du, dv], dtype=np.float64)


def _peak_offset(profile: NDArray[np.float32], peak: int) -> float:
    if not 0 < peak < len(profile) - 1:
        return 0.0
    before, top, after = (float(value) for value in profile[peak - 1 : peak + 2])
    curvature = before - 2.0 * top + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0


def centroid_residual_px(observed: Image, T_cam_body: Pose, view: MeshView) -> float | None:
    """Distance between the brightness centroids of the image and of the mesh rendered at a pose.

    Parameters
    ----------
    observed
        (H, W) signal of the image, background 0, not black.
    T_cam_body
        The pose to judge.
    view
        Camera, renderer and Sun.

    Returns
    -------
    None where the mesh is out of view or in the dark at that pose.
    """
    signal = extract_signal(view.render(T_cam_body), KNOWN_SKY)
    if signal.empty:
        return None
    return float(np.linalg.norm(brightness_centroid(observed) - brightness_centroid(signal.image)))


def image_correlation(observed: Image, T_cam_body: Pose, view: MeshView) -> float:
    """Correlation of the image with a shape rendered at a pose, over all pixels; -1 where nothing is to be seen of it.

    Both are signals with a background of 0, so that it tells of the outline and of light and shade at once. It needs
    no threshold where two poses are compared: neither was chosen by it.
    """
    rendered = extract_signal(view.render(T_cam_body), KNOWN_SKY)
    if rendered.empty:
        return -1.0
    one, other = (image.ravel() - image.mean(dtype=np.float64) for image in (observed, rendered.image))
    scale = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) / scale if scale > 0.0 else 0.0


def consistency_failure(residual_px: float | None, limit_px: float | None) -> str:
    """Say why a solution is not to be believed; empty where it is, or where no limit is set."""
    if limit_px is None or (residual_px is not None and residual_px <= limit_px):
        return ""
    if residual_px is None:
        return "the mesh rendered at the solution is out of view or in the dark"
    return (
        f"the brightness centroid of the mesh at the solution is {residual_px:.3g} px from the image's:"
        f" more than consistency_max_px {limit_px:g}"
    )
