"""How a mesh of tiles is cut into small facets: which vertices there are, and where they lie."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenarios.bodies.topology import Edges, find_edges, vertex_normals
from scenarios.craters.kernels import Layout, cut_tiles, place_edges, place_interiors
from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Within a tile, beside an edge of fewer pieces, facets have edges longer than the pieces by up to half of them.
SHORTENED = 0.85


@dataclass(frozen=True, eq=False)
class Tiling:
    """Tiles with their cuts: an edge into pieces of at most a given length, a tile into as many as its longest edge.

    Where two tiles meet both have the vertices of their common edge and no others, so that there is no crack. Vertices
    are numbered: corners of tiles, then the inner ones of each edge, then those of each tile.

    Parameters
    ----------
    mesh
        The tiles; a closed mesh near a smooth surface.
    up
        (V, 3) unit directions at their corners that relief is put on along.
    edges
        Of the tiles.
    edge_pieces
        (E,) pieces of each edge.
    """

    mesh: TriangleMesh
    up: FloatArray
    edges: Edges
    edge_pieces: IndexArray

    @classmethod
    def of(cls, mesh: TriangleMesh, up: FloatArray, edge_m: float) -> Tiling:
        """Cut edges so that facets have none longer than ``edge_m``, but for one in a hundred."""
        edges = find_edges(mesh.faces)
        length = np.linalg.norm(mesh.vertices_m[edges.ends[:, 1]] - mesh.vertices_m[edges.ends[:, 0]], axis=1)
        return cls(mesh, up, edges, np.maximum(np.ceil(length / (SHORTENED * edge_m)), 1.0).astype(np.int64))

    @cached_property
    def tile_pieces(self) -> IndexArray:
        """(T,) rows of facets of each tile."""
        return np.asarray(self.edge_pieces[self.edges.of_face].max(axis=1), dtype=np.int64)

    @cached_property
    def edge_start(self) -> IndexArray:
        """(E + 1,) first vertex within each edge, and the one after the last."""
        return self._starts(len(self.mesh.vertices_m), self.edge_pieces - 1)

    @cached_property
    def tile_start(self) -> IndexArray:
        """(T + 1,) first vertex within each tile, and the one after the last."""
        return self._starts(int(self.edge_start[-1]), (self.tile_pieces - 1) * (self.tile_pieces - 2) // 2)

    @staticmethod
    def _starts(first: int, counts: IndexArray) -> IndexArray:
        return np.concatenate([[0], np.cumsum(counts)]) + first

    @property
    def n_vertices(self) -> int:
        """Number of vertices in all."""
        return int(self.tile_start[-1])

    @cached_property
    def n_facets(self) -> int:
        """Number of facets at most; where an edge has fewer pieces than its tile some fall together."""
        return int((self.tile_pieces**2).sum())

    def places(self) -> tuple[FloatArray, FloatArray]:
        """Positions (N, 3) of all vertices on curved tiles, and (N, 3) directions `up` there.

        Tiles are the triangles of Vlachos et al. (2001, "Curved PN triangles"): cubic patches through the corners and
        at right angles to the normals of the mesh there.
        """
        points, up = np.empty((self.n_vertices, 3)), np.empty((self.n_vertices, 3))
        corners = len(self.mesh.vertices_m)
        points[:corners], up[:corners] = self.mesh.vertices_m, self.up
        normals = vertex_normals(self.mesh.vertices_m, self._faces)
        place_edges(points, up, normals, self.edges.ends, self.edge_pieces, self.edge_start)
        place_interiors(points, up, normals, self._faces, self.tile_pieces, self.tile_start)
        return points, up

    def facets(self, tiles: IndexArray) -> IndexArray:
        """(F, 3) vertices of the facets of some tiles, counter-clockwise as the tiles are."""
        found = np.empty((int((self.tile_pieces[tiles] ** 2).sum()), 3), dtype=np.int64)
        count = cut_tiles(found, tiles, self.layout)
        return found[:count]

    @cached_property
    def layout(self) -> Layout:
        """What kernels number the vertices of a tile by."""
        ends, of_face = self.edges.ends, np.ascontiguousarray(self.edges.of_face)
        return Layout(self._faces, of_face, ends, self.edge_pieces, self.edge_start, self.tile_pieces, self.tile_start)

    @cached_property
    def _faces(self) -> IndexArray:
        return np.ascontiguousarray(self.mesh.faces, dtype=np.int64)

    @cached_property
    def runs(self) -> tuple[FloatArray, IndexArray]:
        """Middles (R, 3) of the corners, edges and tiles, and (R, 2) the vertices from the first to before the last."""
        corners = self.mesh.vertices_m
        middles = [corners, corners[self.edges.ends].mean(axis=1), corners[self._faces].mean(axis=1)]
        each = np.arange(len(corners))
        ranges = [
            np.stack([each, each + 1], axis=1),
            np.stack([self.edge_start[:-1], self.edge_start[1:]], axis=1),
            np.stack([self.tile_start[:-1], self.tile_start[1:]], axis=1),
        ]
        return np.concatenate(middles), np.concatenate(ranges)

    @cached_property
    def reach_m(self) -> float:
        """Farthest that a vertex lies from the middle of its run."""
        corners = self.mesh.corners_m
        return 1.1 * float(np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max())

    @cached_property
    def bulge_m(self) -> float:
        """More than a ball can rise into a tile between its corners: half the longest edge."""
        ends = self.mesh.vertices_m[self.edges.ends]
        return 0.5 * float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max())
