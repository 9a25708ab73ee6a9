"""Subdivision of a mesh of tiles into small facets: vertices, size limits and normal cones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray, SingleArray
from boresight.scenarios.bodies.topology import MeshEdges, find_edges, vertex_normals
from boresight.scenarios.craters.kernels import (
    TileLayout,
    cut_tiles,
    kernel,
    number_tile,
    place_edge_vertices,
    place_inner_vertices,
    tile_buffer,
)
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.reading import installed_memory_bytes
from boresight.scenarios.spec.craters import CratersSpec

# Within a tile, next to an edge of fewer pieces, edges of facets are up to half longer than the pieces.
SHORTENED = 0.85

_TILE_M = 100.0  # typical edge of a tile, within
_TILE_PIECES = (10.0, 100.0)  # so many edges of facets: of longer tiles the corners leave the ground of small craters
# Measured peak memory of builds with 82 thousand to 1.3 million tiles and 0.7 to 10 million vertices.
_TILE_BYTES, _VERTEX_BYTES = 800, 70


def normal_cones(tiling: Tiling, vertices_m: SingleArray) -> FloatArray:
    """(T, 4) unit mean of the facets' normals of each tile, and the least cosine of a normal with it."""
    cones = np.empty((len(tiling.mesh.faces), 4))
    _cones(cones, vertices_m, tiling.layout)
    return cones


@kernel
def may_face(cones: FloatArray, directions: FloatArray, slack_rad: FloatArray) -> BoolArray:
    """(T,) whether a facet of a tile may face unit directions (T, 3), which are uncertain by ``slack_rad`` (T,)."""
    found = np.empty(len(cones), dtype=np.bool_)
    for t in range(len(cones)):
        towards = 0.0
        for x in range(3):
            towards += cones[t, x] * directions[t, x]
        # A normal at the angle `beyond` from the mean can face a direction up to 90 deg + beyond from the mean.
        beyond = np.arccos(min(max(cones[t, 3], -1.0), 1.0)) + slack_rad[t]
        found[t] = beyond >= 0.5 * np.pi or towards > -np.sin(beyond)
    return found


@kernel
def overlap(faces: IndexArray, corners_px: FloatArray, size_px: FloatArray, margin_px: float) -> BoolArray:
    """(T,) whether the bounding boxes of tiles with corners (V, 2) overlap a frame, extended by a margin.

    A corner without a pixel is NaN: its tile is outside the lens's field or behind the camera.
    """
    found = np.empty(len(faces), dtype=np.bool_)
    for t in range(len(faces)):
        a, b, c = corners_px[faces[t, 0]], corners_px[faces[t, 1]], corners_px[faces[t, 2]]
        found[t] = True
        for d in range(2):
            # NaN compares as False.
            high = a[d] > -margin_px or b[d] > -margin_px or c[d] > -margin_px
            low = a[d] < size_px[d] + margin_px or b[d] < size_px[d] + margin_px or c[d] < size_px[d] + margin_px
            found[t] &= high and low and not np.isnan(a[d] + b[d] + c[d])
    return found


@kernel
def _cones(cones: FloatArray, vertices: SingleArray, layout: TileLayout) -> None:
    ids = tile_buffer(layout)
    normals = np.empty((ids.size, 3))
    for f in range(len(layout.faces)):
        n = number_tile(ids, f, layout)
        count = 0
        mean = cones[f]
        mean[:] = 0.0
        for i in range(n):
            for j in range(n - i):
                for half in range(1 if i + j == n - 1 else 2):
                    a, b, c = ids[i + half, j], ids[i + 1, j + half], ids[i, j + 1]
                    if _normal(normals[count], vertices, a, b, c):
                        for x in range(3):
                            mean[x] += normals[count, x]
                        count += 1
        size = np.sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2])
        # Normals that add up to nothing have no mean: a cosine of -1 makes the tile face every direction.
        least = 1.0 if size > 0.0 else -1.0
        for x in range(3):
            mean[x] = mean[x] / size if size > 0.0 else 0.0
        for k in range(count):
            least = min(least, mean[0] * normals[k, 0] + mean[1] * normals[k, 1] + mean[2] * normals[k, 2])
        mean[3] = least


@kernel
def _normal(out: FloatArray, vertices: SingleArray, a: int, b: int, c: int) -> bool:
    """Write the unit normal of a facet and return whether its area is above zero."""
    size = 0.0
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        # Differences in double precision, as facets are small against their distance from the origin.
        uy, uz = np.float64(vertices[b, y]) - vertices[a, y], np.float64(vertices[b, z]) - vertices[a, z]
        vy, vz = np.float64(vertices[c, y]) - vertices[a, y], np.float64(vertices[c, z]) - vertices[a, z]
        out[x] = uy * vz - uz * vy
        size += out[x] * out[x]
    if size == 0.0:
        return False
    size = np.sqrt(size)
    for x in range(3):
        out[x] /= size
    return True


@kernel
def facet_normals(found: SingleArray, corners: SingleArray, facets: IndexArray) -> None:
    """Write unit normals (N, 3) of facets (N,) with corners (F, 3, 3); those of zero area are left unchanged."""
    normal = np.empty(3)
    for k in range(len(facets)):
        if _normal(normal, corners[facets[k]], 0, 1, 2):
            for x in range(3):
                found[k, x] = normal[x]


def tile_rounds(typical_m: float, edge_m: float) -> int:
    """Return the number of 1-to-4 subdivisions that take facets with a typical edge to tiles for facets of an edge."""
    least, most = _TILE_PIECES
    return max(0, math.ceil(math.log2(typical_m / min(max(_TILE_M, least * edge_m), most * edge_m))))


def expected_size(mesh: TriangleMesh, spec: CratersSpec) -> tuple[int, int]:
    """Estimate the numbers of tiles and facets of a cratered surface on a mesh."""
    typical_m = float(np.median(find_edges(mesh.faces).lengths(mesh.vertices_m)))
    rounds = tile_rounds(typical_m, spec.edge_m)
    tiles = len(mesh.faces) * 4**rounds
    # A tile of n pieces along an edge has n^2 facets.
    return tiles, tiles * max(1, math.ceil(typical_m / 2**rounds / (SHORTENED * spec.edge_m))) ** 2


def expected_bytes(mesh: TriangleMesh, spec: CratersSpec) -> tuple[int, int]:
    """Estimate the memory that the tiles and the vertices of a cratered surface take while it is built."""
    tiles, facets = expected_size(mesh, spec)
    # A closed mesh has half as many vertices as facets.
    return tiles * _TILE_BYTES, facets // 2 * _VERTEX_BYTES


def check_size(mesh: TriangleMesh, spec: CratersSpec) -> None:
    """Check that this machine has enough memory for a cratered surface.

    Raise BoresightError if it has not; the message states the required memory and what to change.
    """
    parts, room = expected_bytes(mesh, spec), installed_memory_bytes()
    if sum(parts) <= room:
        return
    facets = expected_size(mesh, spec)[1]
    raise BoresightError(
        f"craters: a surface of {facets:.3g} facets on a body {2e-3 * mesh.radius_m:.3g} km across"
        f" takes about {sum(parts) / 1e9:.3g} GB of memory, and this machine has {room / 1e9:.3g} GB: raise"
        f" craters.edge_m ({spec.edge_m:g}), with min_diameter_m four times as much, or take a smaller body"
    )


@dataclass(frozen=True, eq=False)
class Tiling:
    """Subdivision of tiles: each edge into pieces of a maximum length, each tile into as many rows as its longest edge.

    Adjacent tiles share the vertices of their common edge, so that there are no cracks. Numbering of the vertices:
    corners of tiles, then the inner ones of each edge, then those of each tile. ``mesh`` has the tiles, closed and near
    a smooth surface, ``up`` (V, 3) unit vectors at their corners along which the relief is applied, ``edge_pieces``
    (E,) the pieces of each of the ``edges``.
    """

    mesh: TriangleMesh
    up: FloatArray
    edges: MeshEdges
    edge_pieces: IndexArray

    @classmethod
    def of(cls, mesh: TriangleMesh, up: FloatArray, edge_m: float) -> Tiling:
        """Choose the pieces so that about 99 % of the facets' edges are at most ``edge_m`` long."""
        edges = find_edges(mesh.faces)
        length = edges.lengths(mesh.vertices_m)
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
        # Inner vertices of a tile of n rows: (n - 1)(n - 2) / 2.
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
        """Upper bound of the number of facets; some degenerate at edges with fewer pieces than their tile."""
        return int((self.tile_pieces**2).sum())

    def places(self) -> tuple[FloatArray, FloatArray]:
        """Positions (N, 3) of all vertices on curved tiles, and (N, 3) directions `up` there.

        Tiles are the triangles of Vlachos et al. (2001, "Curved PN triangles"): cubic patches through the corners,
        perpendicular to the mesh's normals there.
        """
        points, up = np.empty((self.n_vertices, 3)), np.empty((self.n_vertices, 3))
        corners = len(self.mesh.vertices_m)
        points[:corners], up[:corners] = self.mesh.vertices_m, self.up
        normals = vertex_normals(self.mesh.vertices_m, self._faces)
        place_edge_vertices(points, up, normals, self.edges.ends, self.edge_pieces, self.edge_start)
        place_inner_vertices(points, up, normals, self._faces, self.tile_pieces, self.tile_start)
        return points, up

    def facets(self, tiles: IndexArray) -> IndexArray:
        """(F, 3) vertices of the facets of the given tiles, with the orientation of the tiles."""
        found = np.empty((int((self.tile_pieces[tiles] ** 2).sum()), 3), dtype=np.int64)
        count = cut_tiles(found, tiles, self.layout)
        return found[:count]

    @cached_property
    def layout(self) -> TileLayout:
        """The arrays from which kernels number the vertices of a tile."""
        ends, of_face = self.edges.ends, np.ascontiguousarray(self.edges.of_face)
        return TileLayout(
            self._faces, of_face, ends, self.edge_pieces, self.edge_start, self.tile_pieces, self.tile_start
        )

    @cached_property
    def _faces(self) -> IndexArray:
        return np.ascontiguousarray(self.mesh.faces, dtype=np.int64)

    @cached_property
    def runs(self) -> tuple[FloatArray, IndexArray]:
        """Centres (R, 3) of corners, edges and tiles, and their vertex ranges (R, 2), end exclusive."""
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
        """Bound of the distance of a vertex from the centre of its run."""
        corners = self.mesh.corners_m
        # 10 % for tiles that are curved.
        return 1.1 * float(np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max())

    @cached_property
    def bulge_m(self) -> float:
        """Bound of the depth to which a sphere can enter a tile between its corners: half the longest edge."""
        return 0.5 * float(self.edges.lengths(self.mesh.vertices_m).max())
