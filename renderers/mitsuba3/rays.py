"""Which pixels can show the body, and the rays through them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from scenarios.geometry import Camera, TriangleMesh, View

FloatArray = NDArray[np.float64]

_BOX_STEPS = 65


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of whole pixels: its first column and row, its width and its height."""

    column: int
    row: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the window in an image array."""
        return slice(self.row, self.row + self.height), slice(self.column, self.column + self.width)

    def strips(self, rows: int) -> Iterator[Window]:
        """Parts of the window of at most ``rows`` rows, from the top."""
        end = self.row + self.height
        for row in range(self.row, end, rows):
            yield Window(self.column, row, self.width, min(rows, end - row))


@dataclass(frozen=True, slots=True, eq=False)
class RayBundle:
    """Rays as linear functions of the pinhole's pixel position (u, v) counted from a window's corner.

    A position of a camera with distortion is first taken to that of its pinhole. The origin of a ray is
    ``origin_m + u origin_u_m + v origin_v_m``, and its direction the same of the other three, to be normalised; all
    (3,), body frame. Rays start just before the body rather than at the camera, so that single precision resolves the
    body however far the camera is; each constant is worked out in double precision.
    """

    origin_m: FloatArray
    origin_u_m: FloatArray
    origin_v_m: FloatArray
    direction: FloatArray
    direction_u: FloatArray
    direction_v: FloatArray
    camera: Camera
    corner_px: tuple[float, float]

    def at(self, uv_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Origins and unit directions, (N, 3) each, at window positions (N, 2)."""
        if self.camera.distortion is not None:
            uv_px = self.camera.undistorted(uv_px + self.corner_px) - self.corner_px
        u, v = uv_px[:, :1], uv_px[:, 1:]
        origins = self.origin_m + u * self.origin_u_m + v * self.origin_v_m
        directions = self.direction + u * self.direction_u + v * self.direction_v
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def outline_points(mesh: TriangleMesh) -> FloatArray:
    """Vertices (N, 3) of the convex hull: they bound the body in every projection."""
    try:
        return mesh.vertices_m[ConvexHull(mesh.vertices_m).vertices]
    except QhullError:  # a flat mesh has no hull
        return mesh.vertices_m


def body_window(view: View, outline_m: FloatArray) -> Window | None:
    """Smallest window that holds the body, given the points that bound it; None where it is out of sight."""
    camera = view.camera
    points_cam_m = view.T_cam_body.transform(outline_m)
    in_front = points_cam_m[:, 2] > 0.0
    if not in_front.any():
        return None
    if not in_front.all():
        return Window(0, 0, camera.width_px, camera.height_px)
    low_px, high_px = _bounds(camera, camera.pinhole.project(points_cam_m))
    size = (camera.width_px, camera.height_px)
    low = np.clip(np.floor(low_px), 0, size).astype(int)
    high = np.clip(np.ceil(high_px), 0, size).astype(int)
    width, height = (int(n) for n in high - low)
    return Window(int(low[0]), int(low[1]), width, height) if width and height else None


def _bounds(camera: Camera, pinhole_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest pixel (2,) of what the pinhole sees within the hull of ``pinhole_px`` (N, 2).

    A lens bends the sides of the bounding box, so points along them are followed. Where one has no pixel the box
    reaches beyond the field.
    """
    low, high = pinhole_px.min(axis=0), pinhole_px.max(axis=0)
    if camera.distortion is None:
        return low, high
    steps = np.linspace(0.0, 1.0, _BOX_STEPS)
    along, level = np.meshgrid(steps, [0.0, 1.0])
    sides = np.concatenate([np.stack([along, level], axis=-1), np.stack([level, along], axis=-1)]).reshape(-1, 2)
    seen = camera.distorted(low + sides * (high - low))
    if not np.isfinite(seen).all():
        return np.zeros(2), np.array([camera.width_px, camera.height_px], dtype=np.float64)
    return seen.min(axis=0) - 1.0, seen.max(axis=0) + 1.0  # between two steps a side bends by far less


def ray_bundle(view: View, radius_m: float, corner_px: tuple[float, float]) -> RayBundle:
    """Rays of a view, with pixels counted from ``corner_px``; the body lies within ``radius_m`` of its origin."""
    camera, pose = view.camera, view.T_cam_body
    start_m = max(0.0, pose.translation_m[2] - 1.01 * radius_m)  # depth of the plane on which the rays start
    slope = np.array([(corner_px[0] - camera.cx_px) / camera.fx_px, (corner_px[1] - camera.cy_px) / camera.fy_px, 1.0])
    to_body = pose.rotation.T
    u_step, v_step = to_body[:, 0] / camera.fx_px, to_body[:, 1] / camera.fy_px
    return RayBundle(
        origin_m=to_body @ (start_m * slope - pose.translation_m),
        origin_u_m=start_m * u_step,
        origin_v_m=start_m * v_step,
        direction=to_body @ slope,
        direction_u=u_step,
        direction_v=v_step,
        camera=camera,
        corner_px=corner_px,
    )


def grid_positions(samples_per_pixel: int) -> FloatArray:
    """Positions (S, 2) of the regular grid of samples within a pixel, S a square number; row by row."""
    n = round(samples_per_pixel**0.5)
    steps = (np.arange(n) + 0.5) / n
    v, u = np.meshgrid(steps, steps, indexing="ij")
    return np.stack([u.ravel(), v.ravel()], axis=1)
