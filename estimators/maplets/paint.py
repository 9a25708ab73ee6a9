"""Albedo of maplets from real images: that with which their renderings look like the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from boresight.estimators.contract import ImageRenderer, NoProductError
from boresight.estimators.landmark.signal import KNOWN_SKY, background_of, extract_signal
from boresight.estimators.maplets.database import MapletDatabase
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import View

_FACING_MIN = np.cos(np.radians(70.0))
# Share of the greatest brightness: darker places are in shadow or near the terminator, where the ratio is noise.
_LIT_MIN = 0.1
_SKY_STEP_PX, _SKY_PIXELS = 8, 16
_ALBEDO_MIN, _ALBEDO_MAX = 0.05, 4.0


class PosedImage(Protocol):
    """An image (H, W), of any linear unit, with its view."""

    @property
    def pixels(self) -> Image:
        """The brightness, (H, W)."""
        ...

    @property
    def view(self) -> View:
        """The view."""
        ...

    def deproject(self, uv_px: FloatArray) -> FloatArray:
        """Points of the surface (N, 3), body frame, m, at pixel positions (N, 2); NaN off the body."""
        ...


def seen(points_m: FloatArray, normals: FloatArray, image: PosedImage, tolerance_m: float) -> NDArray[np.bool_]:
    """Mask (N,) of surface points (N, 3), body frame, that an image shows at less than 70 deg from their normals.

    A point is hidden if the surface on its line of sight is farther than ``tolerance_m`` from it.
    """
    pose, camera = image.view.T_cam_body, image.view.camera
    sight = pose.camera_position_m - points_m
    facing = np.einsum("ni,ni->n", sight, normals) > _FACING_MIN * np.linalg.norm(sight, axis=1)
    shown: NDArray[np.bool_] = facing & (pose.transform(points_m)[:, 2] > 0.0)
    uv_px = camera.project(pose.transform(points_m[shown]))
    off_m = np.linalg.norm(image.deproject(uv_px) - points_m[shown], axis=1)
    shown[shown] = camera.contains(uv_px) & (off_m <= tolerance_m)
    return shown


def paint(maplets: MapletDatabase, renderer: ImageRenderer, images: Sequence[PosedImage]) -> MapletDatabase:
    """Return maplets with the albedo that the images show, 1 where none shows a node.

    ``renderer`` draws the mesh of ``maplets`` with an albedo of 1. At each node the albedo is the mean over the images
    of observed over rendered brightness, each image scaled so that its median ratio is 1; an image that shows half of
    its nodes black is left out. The sky is measured beside the body; it is 0 where the body fills the frame. Albedo
    takes up the shading of relief that the shape lacks, so that it holds for a Sun like that of the images. Raise
    NoProductError if none of the images shows a lit part of the maplets.
    """
    points_m = maplets.nodes_m.reshape(-1, 3)
    known = np.flatnonzero(np.isfinite(points_m).all(axis=1))
    normals = np.repeat(maplets.axes[:, 2], maplets.side**2, axis=0)
    total, count = np.zeros(len(points_m)), np.zeros(len(points_m))
    for image in images:
        rendered = renderer.render(image.view)
        nodes = known[seen(points_m[known], normals[known], image, maplets.spacing_m)]
        uv_px = image.view.camera.project(image.view.T_cam_body.transform(points_m[nodes]))
        expected = _sampled(rendered, uv_px)
        lit = expected > _LIT_MIN * float(rendered.max())
        if not lit.any():
            continue
        ratio = _sampled(extract_signal(image.pixels, _sky(image)).image, uv_px[lit]) / expected[lit]
        middle = float(np.median(ratio))
        if not middle > 0.0:
            continue
        total[nodes[lit]] += ratio / middle
        count[nodes[lit]] += 1.0
    if not count.any():
        raise NoProductError("no image of the survey shows a lit part of the maplets: name others in images.survey")
    albedo = np.where(count > 0.0, total / np.maximum(count, 1.0), 1.0)
    return replace(maplets, albedo=np.clip(albedo, _ALBEDO_MIN, _ALBEDO_MAX).reshape(maplets.heights_m.shape))


def _sky(image: PosedImage) -> tuple[float, float]:
    """Level and standard deviation of the sky, from a grid of pixels that the body does not cover."""
    height, width = image.pixels.shape
    rows, columns = np.mgrid[:height:_SKY_STEP_PX, :width:_SKY_STEP_PX]
    uv_px = np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5
    sky = ~np.isfinite(image.deproject(uv_px)).all(axis=1)
    if np.count_nonzero(sky) < _SKY_PIXELS:
        return KNOWN_SKY
    return background_of(image.pixels[rows.ravel()[sky], columns.ravel()[sky]])


def _sampled(image: Image, uv_px: FloatArray) -> FloatArray:
    """Values (N,) of an image at pixel positions (N, 2); the centre of the first pixel is at (0.5, 0.5)."""
    return np.asarray(map_coordinates(image.astype(np.float64), uv_px.T[::-1] - 0.5, order=1, mode="nearest"))
