"""The outline of a shape in an image, its outermost points on rays from a centre, and the light inside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.compiled import compiler
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View
from boresight.scenarios.geometry.mesh import kept_with_mesh

kernel, _ = compiler(Path(__file__).parent)

_TANGENT_PX = 2.0
_CELLS = 128  # on a side of the grid of `nearest_facets`


class ShapeOutline:
    """The outline of a closed mesh, with the edges of its facets found once."""

    def __init__(self, mesh: TriangleMesh) -> None:
        faces = mesh.faces.astype(np.int64)
        ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        key = ends[:, 0] * len(mesh.vertices_m) + ends[:, 1]
        # Both facets of an edge are neighbours in the order of the edges.
        order = np.argsort(key, kind="stable")
        pairs = np.flatnonzero(key[order][:-1] == key[order][1:])
        self._edges = np.column_stack([ends[order[pairs]], order[pairs] // 3, order[pairs + 1] // 3])
        self._vertices_m, self._faces, self._corner = np.array(mesh.vertices_m), faces, faces[:, 0].copy()
        self._area_vectors_m2, self._normals = np.array(mesh.area_vectors_m2), mesh.normals

    def silhouette(self, T_cam_body: Pose) -> IndexArray:
        """Return the vertices (k, 2) of the edges between a facet that is seen from the front and another."""
        camera_m = T_cam_body.camera_position_m
        return silhouette(self._vertices_m, self._corner, self._area_vectors_m2, self._edges, camera_m)

    def at(
        self, T_cam_body: Pose, camera: Camera, centre_px: FloatArray, rays: FloatArray, edges: IndexArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the outermost points on the rays of `ray_directions` from ``centre_px`` in the image.

        Radii (count,), px, and the points (count, 3), m, camera axes; NaN on rays that meet no outline in front of the
        camera. ``edges`` are those of `silhouette` at a pose nearby: small translations do not change them.
        """
        edges = self.silhouette(T_cam_body) if edges is None else edges
        pinhole = np.array([camera.fx_px, camera.fy_px, *(np.array([camera.cx_px, camera.cy_px]) - centre_px)])
        pose = np.column_stack([T_cam_body.rotation, T_cam_body.translation_m])
        return outermost(self._vertices_m, edges, pose, pinhole, rays)

    def light(self, view: View, uv_px: FloatArray) -> FloatArray:
        """Return the light (..., 2) of facets at pixels (..., 2): by Lambert's law, and by Lommel and Seeliger's.

        With the cosines i of incidence and e of emission a facet is i and i / (i + e) bright. It is 0 off the shape and
        with the Sun behind the facet; facets cast no shadow on others.
        """
        camera, pose = view.camera, view.T_cam_body
        points_m = pose.transform(self._vertices_m)
        with np.errstate(divide="ignore"):
            image = np.vstack([camera.project(points_m).T, 1.0 / points_m[:, 2]])
        facet = nearest_facets(image, self._faces, uv_px.reshape(-1, 2)).reshape(uv_px.shape[:-1])
        normals = self._normals[facet]
        incident = np.where(facet < 0, 0.0, np.maximum(normals @ view.sun_dir_body, 0.0))
        emitted = -np.einsum("...i,...i->...", normals, camera.unproject(uv_px) @ pose.rotation)
        return np.stack([incident, incident / np.maximum(incident + emitted, 1e-9)], axis=-1)


outline_of = kept_with_mesh(ShapeOutline)
"""Return the outline of a mesh; of one that was seen before, without finding its edges again."""


@kernel
def silhouette(
    vertices_m: FloatArray, corner: IndexArray, area_vectors_m2: FloatArray, edges: IndexArray, camera_m: FloatArray
) -> IndexArray:
    """Return the edges (k, 2) of `ShapeOutline.silhouette`."""
    facing = np.empty(len(corner), dtype=np.bool_)
    for facet in range(len(corner)):
        v, n = vertices_m[corner[facet]], area_vectors_m2[facet]
        facing[facet] = n[0] * (camera_m[0] - v[0]) + n[1] * (camera_m[1] - v[1]) + n[2] * (camera_m[2] - v[2]) > 0.0
    found, count = np.empty((len(edges), 2), dtype=np.int64), 0
    for edge in range(len(edges)):
        if facing[edges[edge, 2]] != facing[edges[edge, 3]]:
            found[count, 0], found[count, 1] = edges[edge, 0], edges[edge, 1]
            count += 1
    return found[:count]


@kernel
def nearest_facets(image: FloatArray, faces: IndexArray, uv_px: FloatArray) -> IndexArray:
    """Return the facet (n,) that is nearest to the camera at each pixel (n, 2); -1 where there is none.

    ``image`` (3, V) are the columns and rows of the vertices of ``faces`` (F, 3), px, and their inverse depths, which
    are linear in the image. Facets with a vertex behind the camera, or that are seen from behind, are left out.
    """
    found, nearest = np.full(len(uv_px), -1), np.zeros(len(uv_px))
    # Of the points in each cell of a grid the first, and the next after each.
    first, after = np.full((_CELLS, _CELLS), -1), np.empty(len(uv_px), dtype=np.int64)
    left, top = uv_px[:, 0].min(), uv_px[:, 1].min()
    per_px = (_CELLS - 1) / max(uv_px[:, 0].max() - left, uv_px[:, 1].max() - top, 1e-9)
    for point in range(len(uv_px)):
        i, j = int((uv_px[point, 0] - left) * per_px), int((uv_px[point, 1] - top) * per_px)
        after[point], first[i, j] = first[i, j], point
    for facet in range(len(faces)):
        a, b, c = faces[facet]
        ua, va, wa = image[0, a], image[1, a], image[2, a]
        ub, vb, wb = image[0, b] - ua, image[1, b] - va, image[2, b]
        uc, vc, wc = image[0, c] - ua, image[1, c] - va, image[2, c]
        area = ub * vc - vb * uc
        # Rows count downwards, so that facets are clockwise from the front.
        if not (area < 0.0 and min(wa, wb, wc) > 0.0):
            continue
        x, y = (ua - left) * per_px, (va - top) * per_px
        columns = range(max(int(x + min(0.0, ub, uc) * per_px), 0), min(int(x + max(0.0, ub, uc) * per_px) + 1, _CELLS))
        rows = range(max(int(y + min(0.0, vb, vc) * per_px), 0), min(int(y + max(0.0, vb, vc) * per_px) + 1, _CELLS))
        for i in columns:
            for j in rows:
                point = first[i, j]
                while point >= 0:
                    u, v = uv_px[point, 0] - ua, uv_px[point, 1] - va
                    of_b, of_c = (u * vc - v * uc) / area, (ub * v - vb * u) / area
                    inverse = wa + of_b * (wb - wa) + of_c * (wc - wa)
                    if of_b >= 0.0 and of_c >= 0.0 and of_b + of_c <= 1.0 and inverse > nearest[point]:
                        found[point], nearest[point] = facet, inverse
                    point = after[point]
    return found


@kernel
def outermost(
    vertices_m: FloatArray, edges: IndexArray, pose: FloatArray, pinhole: FloatArray, rays: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the outermost crossings of projected edges (E, 2) with rays (count, 2), see `ShapeOutline.at`.

    ``pose`` (3, 4) takes vertices to the camera, and ``pinhole`` has the focal lengths and the principal point, px,
    from the centre of the rays.
    """
    count = len(rays)
    radius, point = np.full(count, np.nan), np.full((count, 3), np.nan)
    ends, uv = np.empty((2, 3)), np.empty((2, 2))
    for edge in range(len(edges)):
        for end in range(2):
            vertex = vertices_m[edges[edge, end]]
            for axis in range(3):
                row = pose[axis]
                ends[end, axis] = row[0] * vertex[0] + row[1] * vertex[1] + row[2] * vertex[2] + row[3]
            for axis in range(2):
                uv[end, axis] = pinhole[axis] * ends[end, axis] / ends[end, 2] + pinhole[2 + axis]
        z0, z1 = ends[0, 2], ends[1, 2]
        if not (z0 > 0.0 and z1 > 0.0):
            continue
        start = np.arctan2(uv[0, 1], uv[0, 0]) * count / (2.0 * np.pi)
        span = np.arctan2(uv[1, 1], uv[1, 0]) * count / (2.0 * np.pi) - start
        # A segment is seen under less than half a turn.
        span -= count * np.round(span / count)
        for k in range(int(np.ceil(min(start, start + span))), int(np.floor(max(start, start + span))) + 1):
            c, s = rays[k % count, 0], rays[k % count, 1]
            first, second = c * uv[0, 1] - s * uv[0, 0], c * uv[1, 1] - s * uv[1, 0]
            share = 0.5 if first == second else first / (first - second)
            r = c * (uv[0, 0] + share * (uv[1, 0] - uv[0, 0])) + s * (uv[0, 1] + share * (uv[1, 1] - uv[0, 1]))
            if r > 0.0 and not r <= radius[k % count]:
                radius[k % count] = r
                # The inverse of the depth is linear along the segment in the image.
                place = share * z0 / ((1.0 - share) * z1 + share * z0)
                point[k % count] = ends[0] + place * (ends[1] - ends[0])
    return radius, point


def ray_directions(count: int) -> FloatArray:
    """Return unit directions (count, 2) in the image at the angles 2 pi k / count, from columns towards rows."""
    angle = np.arange(count) * (2.0 * np.pi / count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def outline_normals(radius_px: FloatArray, rays: FloatArray) -> FloatArray:
    """Outward unit normals (n, 2) of an outline by radii (n,) on rays (n, 2); NaN where a radius near it is missing.

    The tangent spans a few pixels, as the blur of an image does: single facets are smaller.
    """
    place, n = radius_px[:, None] * rays, len(rays)
    step = max(1, round(_TANGENT_PX * n / (2.0 * np.pi * max(float(np.nanmean(radius_px)), 1.0))))
    along = np.roll(place, -step, axis=0) - np.roll(place, step, axis=0)
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
