"""Rays through pixels and their hits on a mesh, in double precision and independent of the ray tracer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.errors import InsideBodyError
from boresight.scenarios.geometry import Camera, TriangleMesh, View
from boresight.scenarios.geometry.mesh import winding_number

# Points on each side of a bounding box that lens distortion bends.
_BOX_STEPS = 65


@dataclass(frozen=True, slots=True)
class PixelWindow:
    """Rectangle of whole pixels: first column and row, width and height."""

    column: int
    row: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the window in an image array."""
        return slice(self.row, self.row + self.height), slice(self.column, self.column + self.width)

    def strips(self, rows: int) -> Iterator[PixelWindow]:
        """Yield parts of the window of at most ``rows`` rows each, from the top."""
        end = self.row + self.height
        for row in range(self.row, end, rows):
            yield PixelWindow(self.column, row, self.width, min(rows, end - row))


@dataclass(frozen=True, slots=True, eq=False)
class RayBundle:
    """Rays as linear functions of the pinhole's pixel position (u, v) counted from a window's corner.

    Positions of a camera with distortion are first converted to those of its pinhole. The origin of a ray is
    ``origin_m + u origin_u_m + v origin_v_m`` and its direction, to be normalised,
    ``direction + u direction_u + v direction_v``; all (3,), body frame. Rays start just in front of the body, so that
    single precision resolves it at any range; the constants are in double precision.
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
        """Origins, m, and unit directions, (N, 3) each, at positions (N, 2), px, in the window."""
        if self.camera.distortion is not None:
            uv_px = self.camera.undistorted(uv_px + self.corner_px) - self.corner_px
        u, v = uv_px[:, :1], uv_px[:, 1:]
        origins = self.origin_m + u * self.origin_u_m + v * self.origin_v_m
        directions = self.direction + u * self.direction_u + v * self.direction_v
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def outline_points(mesh: TriangleMesh) -> FloatArray:
    """Vertices (N, 3) of the convex hull, which bound the body in every projection."""
    try:
        return mesh.vertices_m[ConvexHull(mesh.vertices_m).vertices]
    except QhullError:  # a flat mesh has no hull
        return mesh.vertices_m


def body_window(view: View, outline_m: FloatArray) -> PixelWindow | None:
    """Smallest window that contains the body, given the points that bound it; None if it is outside the frame."""
    camera = view.camera
    points_cam_m = view.T_cam_body.transform(outline_m)
    in_front = points_cam_m[:, 2] > 0.0
    if not in_front.any():
        return None
    # Points behind the camera have no pixel, and the others alone do not bound the body.
    if not in_front.all():
        return PixelWindow(0, 0, camera.width_px, camera.height_px)
    # Convexity is kept by the pinhole's projection alone; the lens bends the hull afterwards.
    low_px, high_px = _bounds(camera, camera.pinhole.project(points_cam_m))
    size = (camera.width_px, camera.height_px)
    low = np.clip(np.floor(low_px), 0, size).astype(int)
    high = np.clip(np.ceil(high_px), 0, size).astype(int)
    width, height = (int(n) for n in high - low)
    return PixelWindow(int(low[0]), int(low[1]), width, height) if width and height else None


def _bounds(camera: Camera, pinhole_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest pixel (2,) of the hull of the pinhole's positions ``pinhole_px`` (N, 2).

    Distortion bends the sides of the bounding box, so points along them are distorted too. If one of them has no
    pixel, the box extends beyond the field and the whole frame is returned.
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
    return seen.min(axis=0) - 1.0, seen.max(axis=0) + 1.0  # between two steps a side bends by much less


def ray_bundle(view: View, radius_m: float, corner_px: tuple[float, float]) -> RayBundle:
    """Rays of a view, with pixels counted from ``corner_px``, to a body within ``radius_m`` of its origin."""
    camera, pose = view.camera, view.T_cam_body
    # Rays start on the plane of this depth, just in front of the body.
    start_m = max(0.0, pose.translation_m[2] - 1.01 * radius_m)  # depth of the plane on which the rays start
    # K^-1 (u, v, 1) of the window's corner; one pixel on adds 1 / f. Columns of R^T are the camera axes in the body
    # frame.
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
    steps = (np.arange(n) + 0.5) / n  # centres of n equal cells
    v, u = np.meshgrid(steps, steps, indexing="ij")
    return np.stack([u.ravel(), v.ravel()], axis=1)


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Outward unit normals (V, 3): the mean of the adjoining facets' normals, weighted by their areas."""
    total = np.zeros_like(mesh.vertices_m)
    for corner in mesh.faces.T:
        for axis in range(3):
            # bincount adds in the order of the facets, so that the sums are the same on every machine.
            total[:, axis] += np.bincount(corner, mesh.area_vectors_m2[:, axis], len(total))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit: FloatArray = np.divide(total, length, out=np.zeros_like(total), where=length > 0.0)
    return unit


def interpolate(mesh: TriangleMesh, values: FloatArray, facets: IndexArray, weights: FloatArray) -> FloatArray:
    """Values (V, ...) of the vertices, interpolated to (N, ...) points of ``facets`` with corner weights (N, 3)."""
    corners = values[mesh.faces[facets]]
    result: FloatArray = np.einsum("nk,nk...->n...", weights, corners)
    return result


def corner_weights(mesh: TriangleMesh, facets: IndexArray, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
    """Barycentric weights (N, 3) of the points where rays meet given facets, clipped to the facets.

    The ray tracer finds the facet in single precision; the point follows here in double precision (Moeller and
    Trumbore 1997). Clipping keeps a grazing hit on its facet.
    """
    corner_m = mesh.vertices_m[mesh.faces[facets]]
    edge_1, edge_2 = corner_m[:, 1] - corner_m[:, 0], corner_m[:, 2] - corner_m[:, 0]
    p = np.cross(directions, edge_2)
    s = origins_m - corner_m[:, 0]
    q = np.cross(s, edge_1)
    determinant = np.einsum("ni,ni->n", edge_1, p)
    # A ray parallel to its facet: any finite weights will do, as they are clipped.
    determinant = np.where(determinant == 0.0, np.finfo(float).tiny, determinant)
    with np.errstate(over="ignore"):
        # u = (s . p) / det and v = (d . q) / det; the second is bounded by what the first leaves.
        w1 = np.clip(np.einsum("ni,ni->n", s, p) / determinant, 0.0, 1.0)
        w2 = np.clip(np.einsum("ni,ni->n", directions, q) / determinant, 0.0, 1.0 - w1)
    return np.stack([1.0 - w1 - w2, w1, w2], axis=1)


def check_outside(mesh: TriangleMesh, position_body_m: FloatArray) -> None:
    """Raise `InsideBodyError` if the camera, at ``position_body_m`` (3,), is inside the body.

    The winding number is not computed beyond the farthest vertex.
    """
    position = np.asarray(position_body_m, dtype=np.float64)
    distance_m = float(np.linalg.norm(position))
    # Outside the sphere about the body no facet needs to be visited.
    if distance_m > mesh.radius_m:
        return
    # Half way between 1 and 0, which leaves room for rounding; the sign depends on the winding.
    if abs(winding_number(mesh, position)) > 0.5:
        where = ", ".join(f"{x:.6g}" for x in position)
        raise InsideBodyError(
            f"the camera at ({where}) m, {distance_m:.6g} m from the body's origin, is inside the body, whose farthest"
            f" point is at {mesh.radius_m:.6g} m"
        )
