"""Facets in a scene of their own, and the tiles of a fine surface that a view needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenarios.craters import CrateredSurface
from scenarios.craters.tiles import facet_normals, may_face
from scenarios.geometry import View

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.int64]

_RELIEF_PX = 5.0  # by which a facet may lie beside the box about its tile's corners
_SHADOWS_PX = 20.0
_SINGLE = 1e-4  # rounding of single precision and more, radian


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Facets with corners (F, 3, 3), body frame, in a scene of their own."""

    scene: Any
    corners_m: SingleArray

    @classmethod
    def of(cls, mi: Any, corners_m: SingleArray) -> Part:
        """Build the scene under the active variant."""
        properties = mi.Properties()
        properties["face_normals"] = True
        shape = mi.Mesh("part", 3 * len(corners_m), len(corners_m), props=properties)
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = corners_m.ravel()
        parameters["faces"] = np.arange(3 * len(corners_m), dtype=np.uint32)
        parameters.update()
        return cls(mi.load_dict({"type": "scene", "part": shape}), corners_m)

    def first_hits(self, mi: Any, origins_m: FloatArray, directions: FloatArray) -> tuple[SingleArray, IndexArray]:
        """Distances (N,), inf where nothing is met, and facets (N,) of the first hits of rays (N, 3)."""
        hit = self.scene.ray_intersect_preliminary(_rays(mi, origins_m, directions), coherent=True)
        met = hit.is_valid().numpy()
        return np.where(met, hit.t.numpy(), np.inf).astype(np.float32), np.where(met, hit.prim_index.numpy(), 0)

    def blocks(self, mi: Any, origins_m: FloatArray, directions: FloatArray) -> BoolArray:
        """(N,): whether it stands on rays (N, 3)."""
        blocked: BoolArray = self.scene.ray_test(_rays(mi, origins_m, directions), coherent=True).numpy()
        return blocked

    def normals(self, facets: IndexArray) -> SingleArray:
        """Work out unit normals (N, 3) of facets (N,); 0 of one without area."""
        found = np.zeros((len(facets), 3), dtype=np.float32)
        facet_normals(found, self.corners_m, facets)
        return found


def tiles_seen(ground: CrateredSurface, view: View) -> IndexArray:
    """Tiles of which something may be in the frame and face the camera."""
    to_camera = view.T_cam_body.camera_position_m - ground.middles_m
    distance_m = np.linalg.norm(to_camera, axis=1)
    span_rad = 2.0 * ground.tiling.reach_m / distance_m
    facing = may_face(ground.cones, to_camera / distance_m[:, None], span_rad)
    return np.flatnonzero(facing & _near_frame(ground, view, _RELIEF_PX))


def tiles_casting(ground: CrateredSurface, view: View) -> IndexArray:
    """Tiles near the frame of which something may face the Sun: a ray that leaves the body does so through such."""
    facing = may_face(ground.cones, view.sun_dir_body, _SINGLE)
    return np.flatnonzero(facing & _near_frame(ground, view, _SHADOWS_PX))


def _near_frame(ground: CrateredSurface, view: View, margin_px: float) -> BoolArray:
    """(T,): whether the box about a tile's corners in the image reaches into the frame with a margin about it."""
    seen = view.camera.project(view.T_cam_body.transform(ground.corners_m))
    a, b, c = (seen[corners] for corners in ground.tiling.mesh.faces.T)
    size = np.array([view.camera.width_px, view.camera.height_px])
    # Where a corner has no pixel the comparison is false: such a tile is beside the lens's field or behind the camera.
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return np.asarray(((high > -margin_px) & (low < size + margin_px)).all(axis=1))


def _rays(mi: Any, origins_m: FloatArray, directions: FloatArray) -> Any:
    origin = mi.Point3f(np.ascontiguousarray(origins_m.T, dtype=np.float32))
    return mi.Ray3f(origin, mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32)))
