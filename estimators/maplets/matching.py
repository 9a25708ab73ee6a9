"""Find the visible maplets of a rendering and their windows, and match them with the observed image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from boresight.estimators.contract import ImageRenderer
from boresight.estimators.landmark.alignment import MeshView
from boresight.estimators.landmark.pose.posterior import window_overlap
from boresight.estimators.landmark.pose.problem import MIN_LANDMARKS, PoseProblem, minimal_jacobian
from boresight.estimators.landmark.signal import KNOWN_SKY, extract_signal
from boresight.estimators.maplets.database import MapletDatabase
from boresight.estimators.maplets.displacement import Displacement, correlate_window, make_pair, refine_window
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.spec.base import SpecModel, length

IntArray = NDArray[np.int64]

_LEAST_COS_EMISSION = 0.25
_BIN_STEPS = 2.0  # side of a bin of the depth map, in steps of the grid
_HIDDEN_STEPS = 10.0  # an anchor deeper than the nearest surface by this, in steps of the grid, is hidden

_LEAST_PIXELS = 60
_LARGEST_SHIFT_PX = 1.5  # of the least-squares refinement, which is linearised about zero
_PEAK_PX = 1.0  # margin for the fit of the peak at the edge of the search


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
    vertices_cam_m = T_cam_body.transform(vertices_m)
    # Bins of two steps of the grid, so that each bin on the body holds a vertex.
    step_px = _BIN_STEPS * _step_px(database.spacing_m, vertices_cam_m, camera, T_cam_body)
    depth_m = _nearest_depth(vertices_cam_m, anchors_cam_m[seen], camera, max(1.0, step_px))
    # The slack admits slanted ground, whose depth varies within a bin; other parts of the body are much nearer.
    seen = seen[anchors_cam_m[seen, 2] <= depth_m + _HIDDEN_STEPS * database.spacing_m]
    half = np.clip(np.rint(_half_size_px(database, camera, T_cam_body, seen)), *half_px).astype(np.int64)
    middle = np.floor(uv[seen]).astype(np.int64)
    size = np.array([camera.width_px, camera.height_px])
    return Windows(seen, uv[seen], np.maximum(middle - half, 0), np.minimum(middle + half + 1, size))


def _step_px(spacing_m: float, vertices_cam_m: FloatArray, camera: Camera, T_cam_body: Pose) -> float:
    """Return the size of a step of the grid in the image, px, at the range of the body's origin.

    Bins and closing allow for twice that. Where the nearest vertex in view is nearer than half the range, it counts.
    """
    range_m = float(np.linalg.norm(T_cam_body.translation_m))
    seen = camera.contains(camera.project(vertices_cam_m))
    nearest_m = float(vertices_cam_m[seen, 2].min(initial=range_m))
    return spacing_m / (camera.pixel_angle_rad * (nearest_m if nearest_m < 0.5 * range_m else range_m))


def _half_size_px(database: MapletDatabase, camera: Camera, T_cam_body: Pose, seen: IntArray) -> FloatArray:
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
    vertices_cam_m = T_cam_body.transform(vertices_m)
    uv = camera.project(vertices_cam_m)
    pixel = np.floor(uv[camera.contains(uv)]).astype(np.int64)
    pixel = np.minimum(pixel, [camera.width_px - 1, camera.height_px - 1])
    mask = np.zeros((camera.height_px, camera.width_px), dtype=np.uint8)
    mask[pixel[:, 1], pixel[:, 0]] = 1
    step_px = _step_px(spacing_m, vertices_cam_m, camera, T_cam_body)
    # Where vertices are farther apart than pixels, closing fills the holes between them.
    mask = _square(cv2.MORPH_CLOSE, mask, int(np.ceil(step_px)))
    return _square(cv2.MORPH_ERODE, mask, margin_px) > 0


def _square(operation: int, mask: NDArray[np.uint8], half_px: int) -> NDArray[np.uint8]:
    kernel = np.ones((2 * half_px + 1, 2 * half_px + 1), dtype=np.uint8)
    return np.asarray(cv2.morphologyEx(mask, operation, kernel), dtype=np.uint8)


class MatchingOptions(SpecModel):
    """Options of matching maplets."""

    window_px: tuple[int, int] = Field((8, 32), description="Least and largest half width of a window")
    margin_px: int = Field(2, ge=0, le=100, description="Unused margin along the body's outline, pixels")
    search_sigma: float = Field(3.0, gt=0, le=10, description="Radius of the search in standard deviations")
    search_px: int = Field(40, ge=2, le=500, description="Largest radius of the search, pixels")
    correlation_min: float = Field(0.4, ge=0, lt=1, description="Least correlation of a match")
    blur_px: float = Field(0.7, gt=0, le=10, description="Smoothing of both images before the refinement")
    dark: float = Field(0.12, ge=0, lt=1, description="Pixels below this share of the bright level are unused")
    noise_px2: float = Field(9.0, gt=0, description="Area over which differences of the images are correlated")
    height_sigma_m: float = length(0.2, "Standard deviation of the mean onboard height of a maplet", px=0.16, ge=0)
    systematic_px: float = Field(
        0.15, ge=0, description="Standard deviation of systematic errors of a window, each axis"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not 2 <= self.window_px[0] <= self.window_px[1]:
            raise ValueError("window_px must be two ascending numbers of 2 or more")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class MapletScene:
    """A data base with renderers of the mesh over all its maplets, and the mesh's vertices (V, 3).

    ``quick`` renders with one sample per pixel, which suffices for the alignment.
    """

    database: MapletDatabase
    renderer: ImageRenderer
    quick: ImageRenderer
    vertices_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MapletRendering:
    """A rendering of the data base with a camera and a pose, and the windows of the visible maplets.

    ``signal`` (H, W) has the bright level 1; ``on_body`` (H, W) are pixels well within the outline.
    """

    database: MapletDatabase
    camera: Camera
    T_cam_body: Pose
    signal: Image
    on_body: NDArray[np.bool_]
    windows: Windows

    @property
    def anchors_m(self) -> FloatArray:
        """(M, 3) anchors of the visible maplets, body frame."""
        return self.database.anchors_m[self.windows.maplet]

    @property
    def point_jacobian(self) -> FloatArray:
        """(M, 2, 3) derivatives of the anchors' pixels by their positions in the body frame."""
        jacobian = self.camera.jacobian(self.T_cam_body.transform(self.anchors_m))
        return np.asarray(jacobian @ self.T_cam_body.rotation, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class MapletMatches:
    """Maplets (M,) matched with an image, rows of the data base, and correlation coefficients (M,) of their windows.

    ``uv_px`` (M, 2) are where their anchors are in the observed image, with ``covariances_px2`` (M, 2, 2), including
    the uncertainty of the onboard heights. ``shared`` (M, M) is the share of the pixels that each two windows have in
    common, and ``height_sigma_m`` the standard deviation of the mean onboard height of a maplet.
    """

    maplet: NDArray[np.int64]
    uv_px: FloatArray
    covariances_px2: FloatArray
    correlation: FloatArray
    shared: FloatArray
    height_sigma_m: float

    def __len__(self) -> int:
        return len(self.maplet)


def render_maplets(
    scene: MapletScene, camera: Camera, T_cam_body: Pose, sun_dir_cam: FloatArray, options: MatchingOptions
) -> MapletRendering:
    """Render the data base and find its visible maplets."""
    rendered = MeshView(camera, scene.renderer, sun_dir_cam).render(T_cam_body)
    database, vertices_m = scene.database, scene.vertices_m
    return MapletRendering(
        database,
        camera,
        T_cam_body,
        extract_signal(rendered, KNOWN_SKY).image,
        body_mask(vertices_m, camera, T_cam_body, database.spacing_m, options.margin_px),
        visible_windows(database, camera, T_cam_body, vertices_m, options.window_px),
    )


def match_by_correlation(
    observed: Image, seen: MapletRendering, uncertainty: FloatArray, options: MatchingOptions
) -> MapletMatches:
    """Match maplets within the uncertainty (6, 6) of the pose by correlation, to some tenths of a pixel."""
    reach = _reach_px(seen, uncertainty, options)
    # cv2.matchTemplate takes a mask of the type of the images.
    usable = seen.on_body.astype(np.float32)

    def search(index: int, window: tuple[slice, slice]) -> Displacement | None:
        corner = (window[1].start, window[0].start)
        across, down = (int(r) for r in reach[index])
        template, mask = (np.ascontiguousarray(image[window]) for image in (seen.signal, usable))
        return correlate_window(observed, template, mask, corner, (across, down), options.noise_px2)

    return _collect(seen, seen.on_body, search, options)


def match_by_least_squares(observed: Image, seen: MapletRendering, options: MatchingOptions) -> MapletMatches:
    """Match maplets that are within a pixel of their predicted position by least squares, to hundredths of a pixel."""
    pair = make_pair(observed, seen.signal, seen.on_body, options.blur_px, options.dark)

    def solve(index: int, window: tuple[slice, slice]) -> Displacement | None:
        del index
        found = refine_window(pair, window, options.noise_px2)
        return found if found is not None and np.abs(found.shift_px).max() <= _LARGEST_SHIFT_PX else None

    return _collect(seen, pair.usable, solve, options)


def _reach_px(seen: MapletRendering, uncertainty: FloatArray, options: MatchingOptions) -> NDArray[np.int64]:
    """Radius (M, 2) of the search for each window, from the uncertainty of the pose."""
    n = len(seen.windows)
    if n < MIN_LANDMARKS:
        return np.ones((n, 2), dtype=np.int64)
    flat = np.tile(np.eye(2), (n, 1, 1))
    jacobian = minimal_jacobian(PoseProblem(seen.anchors_m, seen.windows.uv_px, flat, seen.camera), seen.T_cam_body)
    # Only the diagonal of J P J^T: the search region is a rectangle along columns and rows.
    variance = np.einsum("nip,pq,niq->ni", jacobian, uncertainty, jacobian)
    reach = np.ceil(options.search_sigma * np.sqrt(variance)) + _PEAK_PX
    return np.asarray(np.minimum(reach, options.search_px), dtype=np.int64)


def _collect(
    seen: MapletRendering,
    usable: NDArray[np.bool_],
    locate: Callable[[int, tuple[slice, slice]], Displacement | None],
    options: MatchingOptions,
) -> MapletMatches:
    """Locate the windows with enough usable pixels; keep those with sufficient correlation."""
    kept: list[tuple[int, Displacement]] = []
    for index in range(len(seen.windows)):
        window = seen.windows.slices(index)
        if np.count_nonzero(usable[window]) < _LEAST_PIXELS:
            continue
        found = locate(index, window)
        if found is not None and found.correlation >= options.correlation_min:
            kept.append((index, found))
    rows = np.array([index for index, _ in kept], dtype=np.int64)
    # A maplet that lies too high by h along its normal is displaced in the image by J n h.
    by_height = options.height_sigma_m * np.einsum(
        "nij,nj->ni", seen.point_jacobian[rows], seen.database.axes[seen.windows.maplet[rows], 2]
    )
    matched = np.array([found.covariance_px2 for _, found in kept]).reshape(-1, 2, 2)
    return MapletMatches(
        seen.windows.maplet[rows],
        seen.windows.uv_px[rows] + np.array([found.shift_px for _, found in kept]).reshape(-1, 2),
        # Errors of measurement, of onboard heights and systematic ones, independent of each other.
        matched + by_height[:, :, None] * by_height[:, None, :] + options.systematic_px**2 * np.eye(2),
        np.array([found.correlation for _, found in kept]),
        window_overlap(seen.windows.first[rows].astype(np.float64), seen.windows.last[rows].astype(np.float64)),
        options.height_sigma_m,
    )
