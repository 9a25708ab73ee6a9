"""Find the visible maplets, their windows in the image, and the pixels on the body."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.estimators.maplets.database import MapletDatabase
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose

IntArray = NDArray[np.int64]

_LEAST_COS_EMISSION = 0.25
_BIN_STEPS = 2.0  # side of a bin of the depth map, in steps of the grid
_HIDDEN_STEPS = 10.0  # an anchor deeper than the nearest surface by this, in steps of the grid, is hidden


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Windows of M maplets in an image: rows (M,) of the data base, and projected anchors (M, 2), px.

    ``first`` and ``last`` (M, 2) are column and row of the first pixel of the window, and of the first one after it.
    """

    maplet: IntArray
    uv_px: FloatArray
    first: IntArray
    last: IntArray

    def __len__(self) -> int:
        return len(self.maplet)

    def slices(self, index: int) -> tuple[slice, slice]:
        """Rows and columns of one window."""
        (left, top), (right, bottom) = self.first[index], self.last[index]
        return slice(int(top), int(bottom)), slice(int(left), int(right))


def visible_windows(
    database: MapletDatabase, camera: Camera, T_cam_body: Pose, vertices_m: FloatArray, half_px: tuple[int, int]
) -> Windows:
    """Return the windows of maplets that face the camera and whose anchors are in the image and not hidden.

    A window covers the footprint of its maplet about the projected anchor, between a least and a largest size.
    ``vertices_m`` (V, 3) are those of the mesh over all maplets, no farther apart than the spacing, and ``half_px`` the
    least and the largest distance from the anchor to the edge of a window.
    """
    anchors_cam_m = T_cam_body.transform(database.anchors_m)
    uv = camera.project(anchors_cam_m)
    to_camera = -anchors_cam_m / np.linalg.norm(anchors_cam_m, axis=1, keepdims=True)
    facing = np.einsum("ni,ni->n", T_cam_body.rotate(database.axes[:, 2]), to_camera) > _LEAST_COS_EMISSION
    seen = np.flatnonzero(facing & camera.contains(uv))
    # Bins of two steps of the grid, so that each bin on the body holds a vertex.
    step_px = _BIN_STEPS * database.spacing_m / (camera.pixel_angle_rad * np.linalg.norm(T_cam_body.translation_m))
    depth_m = _nearest_depth(T_cam_body.transform(vertices_m), anchors_cam_m[seen], camera, max(1.0, float(step_px)))
    # The slack admits slanted ground, whose depth varies within a bin; other parts of the body are much nearer.
    seen = seen[anchors_cam_m[seen, 2] <= depth_m + _HIDDEN_STEPS * database.spacing_m]
    half = np.clip(np.rint(_reach_px(database, camera, T_cam_body, seen)), *half_px).astype(np.int64)
    middle = np.floor(uv[seen]).astype(np.int64)
    size = np.array([camera.width_px, camera.height_px])
    return Windows(seen, uv[seen], np.maximum(middle - half, 0), np.minimum(middle + half + 1, size))


def _reach_px(database: MapletDatabase, camera: Camera, T_cam_body: Pose, seen: IntArray) -> FloatArray:
    """Half size (M, 2) in px of the projected reference planes, along columns and rows."""
    corner = database.half_m * np.array([[1.0, 1.0], [1.0, -1.0]])
    planes = T_cam_body.rotate(database.axes[seen, :2].reshape(-1, 3)).reshape(-1, 2, 3)
    # Two corners of the square are enough: the other two lie opposite to them about the centre.
    reach_m = np.abs(np.einsum("ck,nkj->ncj", corner, planes)[..., :2]).max(axis=1)
    depth_m = T_cam_body.transform(database.centres_m[seen])[:, 2:]
    reach: FloatArray = reach_m * np.array([camera.fx_px, camera.fy_px]) / depth_m
    return reach


def _nearest_depth(points_cam_m: FloatArray, anchors_cam_m: FloatArray, camera: Camera, step_px: float) -> FloatArray:
    """Depth (M,) of the nearest point in the bin of each anchor; bins are large enough to leave no holes."""
    shape = (int(np.ceil(camera.height_px / step_px)) + 2, int(np.ceil(camera.width_px / step_px)) + 2)
    # A depth map of vertices instead of facets: coarse, but without a search for intersections.
    depth = np.full(shape, np.inf)
    np.minimum.at(depth, _bins(camera.project(points_cam_m), step_px, shape), points_cam_m[:, 2])
    nearest: FloatArray = depth[_bins(camera.project(anchors_cam_m), step_px, shape)]
    return nearest


def _bins(uv_px: FloatArray, step_px: float, shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Row and column of each point's bin; points outside the image fall in the bins of the margin."""
    index = np.nan_to_num(np.floor(uv_px / step_px), nan=-1.0)
    column, row = (np.clip(index[:, axis], -1, shape[1 - axis] - 2).astype(np.int64) + 1 for axis in (0, 1))
    return row, column


def body_mask(
    vertices_m: FloatArray, camera: Camera, T_cam_body: Pose, spacing_m: float, margin_px: int
) -> NDArray[np.bool_]:
    """(H, W) pixels on the body and at least ``margin_px`` within its outline.

    The outline itself is not used: there the true, rougher surface rises above the smoother onboard shape, so that the
    body appears too large.
    """
    # Vertices without a test for hidden ones: those of the far side lie within the same outline.
    uv = camera.project(T_cam_body.transform(vertices_m))
    pixel = np.floor(uv[camera.contains(uv)]).astype(np.int64)
    pixel = np.minimum(pixel, [camera.width_px - 1, camera.height_px - 1])
    mask = np.zeros((camera.height_px, camera.width_px), dtype=np.uint8)
    mask[pixel[:, 1], pixel[:, 0]] = 1
    step_px = spacing_m / (camera.pixel_angle_rad * float(np.linalg.norm(T_cam_body.translation_m)))
    # Where vertices are farther apart than pixels, closing fills the holes between them.
    mask = _square(cv2.MORPH_CLOSE, mask, int(np.ceil(step_px)))
    return _square(cv2.MORPH_ERODE, mask, margin_px) > 0


def _square(operation: int, mask: NDArray[np.uint8], half_px: int) -> NDArray[np.uint8]:
    kernel = np.ones((2 * half_px + 1, 2 * half_px + 1), dtype=np.uint8)
    return np.asarray(cv2.morphologyEx(mask, operation, kernel), dtype=np.uint8)
