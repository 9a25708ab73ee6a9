"""Pieces of a fine surface, each with a tree of its own for the ray tracer."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenarios.bodies.detail.placement import tangent_axes
from scenarios.craters import CrateredSurface
from scenarios.geometry import View

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.int64]

_PIECE_FACETS = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """An axis-aligned box: its least and greatest corners, (3,)."""

    low_m: FloatArray
    high_m: FloatArray

    @property
    def corners_m(self) -> FloatArray:
        """(8, 3) its corners."""
        return np.array(list(itertools.product(*zip(self.low_m, self.high_m, strict=True))))

    def rows_within(self, view: View, uv_px: FloatArray) -> IndexArray:
        """Rows of the pixel positions (N, 2) at which a view may show it."""
        seen = view.camera.project(view.T_cam_body.transform(self.corners_m))
        if not np.isfinite(seen).all():
            return np.arange(len(uv_px))
        low, high = seen.min(axis=0) - 1.0, seen.max(axis=0) + 1.0
        within = (uv_px[:, 0] >= low[0]) & (uv_px[:, 0] <= high[0]) & (uv_px[:, 1] >= low[1]) & (uv_px[:, 1] <= high[1])
        return np.flatnonzero(within)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A mesh in a scene of its own, with (F, 3) unit normals of its facets."""

    scene: Any
    normals: SingleArray
    box: Box

    @classmethod
    def of(cls, mi: Any, vertices_m: SingleArray, faces: NDArray[np.integer]) -> Part:
        """Build the scene under the active variant."""
        properties = mi.Properties()
        properties["face_normals"] = True
        shape = mi.Mesh("part", len(vertices_m), len(faces), props=properties)
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = vertices_m.ravel()
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
        box = Box(low.astype(np.float64), high.astype(np.float64))
        return cls(mi.load_dict({"type": "scene", "part": shape}), _normals(vertices_m, faces), box)

    @property
    def n_facets(self) -> int:
        """Number of facets."""
        return len(self.normals)

    def first_hits(self, mi: Any, origins_m: FloatArray, directions: FloatArray) -> tuple[SingleArray, IndexArray]:
        """Distances (N,), inf where nothing is met, and facets (N,) of the first hits of rays (N, 3)."""
        hit = self.scene.ray_intersect_preliminary(_rays(mi, origins_m, directions), coherent=True)
        met = hit.is_valid().numpy()
        return np.where(met, hit.t.numpy(), np.inf).astype(np.float32), np.where(met, hit.prim_index.numpy(), 0)

    def blocks(self, mi: Any, origins_m: FloatArray, directions: FloatArray) -> BoolArray:
        """(N,): whether it stands on rays (N, 3)."""
        blocked: BoolArray = self.scene.ray_test(_rays(mi, origins_m, directions), coherent=True).numpy()
        return blocked


def clear_of(mi: Any, parts: Sequence[Part], points_m: FloatArray, direction: FloatArray) -> BoolArray:
    """(N,): whether no part stands on the rays from points (N, 3) along one unit direction (3,)."""
    axes = np.stack([*tangent_axes(direction[None], np.zeros(1)), direction[None]])[:, 0]
    places = points_m @ axes.T
    clear = np.ones(len(points_m), dtype=bool)
    for part in parts:
        corners = part.box.corners_m @ axes.T
        low, high = corners.min(axis=0), corners.max(axis=0)
        rows = np.flatnonzero(clear & (places[:, 2] <= high[2]) & (places[:, 0] >= low[0]) & (places[:, 0] <= high[0]))
        rows = rows[(places[rows, 1] >= low[1]) & (places[rows, 1] <= high[1])]
        if len(rows):
            clear[rows] = ~part.blocks(mi, points_m[rows], np.broadcast_to(direction, (len(rows), 3)))
    return clear


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """The fine surface in pieces of about equally many facets, compact in space.

    Parameters
    ----------
    ground
        The surface.
    tiles
        The tiles of each piece.
    corners
        The corners of tiles in each piece.
    """

    ground: CrateredSurface
    tiles: tuple[IndexArray, ...]
    corners: tuple[IndexArray, ...]

    @classmethod
    def of(cls, ground: CrateredSurface) -> Pieces:
        """Halve the tiles at the median along the longest side until pieces are small enough."""
        tiling = ground.tiling
        middles = tiling.mesh.vertices_m[tiling.mesh.faces].mean(axis=1)
        groups = [np.arange(len(middles))]
        while tiling.n_facets / len(groups) > _PIECE_FACETS:
            halves = []
            for group in groups:
                axis = int(np.ptp(middles[group], axis=0).argmax())
                order = group[np.argsort(middles[group, axis], kind="stable")]
                halves += [order[: len(order) // 2], order[len(order) // 2 :]]
            groups = halves
        tiles = tuple(np.sort(group) for group in groups)
        return cls(ground, tiles, tuple(np.unique(tiling.mesh.faces[group]).astype(np.int64) for group in tiles))

    def mesh(self, number: int) -> tuple[SingleArray, IndexArray]:
        """Vertices (V, 3) and faces (F, 3) of a piece."""
        used, faces = np.unique(self.ground.tiling.facets(self.tiles[number]), return_inverse=True)
        return np.asarray(self.ground.vertices_m[used]), faces.reshape(-1, 3).astype(np.int64)

    def needed(self, view: View, margin_px: float, least_cosine: float) -> list[int]:
        """List the pieces of which something is in the frame, or within a margin, and neither turned away nor dark.

        Parameters
        ----------
        margin_px
            About the frame.
        least_cosine
            Of the angles of incidence and emission on the smooth surface.
        """
        points, up = self.ground.corners_m, self.ground.tiling.up
        to_camera = view.T_cam_body.camera_position_m - points
        seen = np.einsum("ni,ni->n", up, to_camera) > least_cosine * np.linalg.norm(to_camera, axis=1)
        seen &= up @ view.sun_dir_body > least_cosine
        seen &= view.camera.contains(view.camera.project(view.T_cam_body.transform(points)), -margin_px)
        return [number for number, corners in enumerate(self.corners) if seen[corners].any()]


def _rays(mi: Any, origins_m: FloatArray, directions: FloatArray) -> Any:
    origin = mi.Point3f(np.ascontiguousarray(origins_m.T, dtype=np.float32))
    return mi.Ray3f(origin, mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32)))


def _normals(vertices_m: SingleArray, faces: NDArray[np.integer]) -> SingleArray:
    a, b, c = (vertices_m[column].astype(np.float64) for column in faces.T)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    return np.asarray(normal, dtype=np.float32)
