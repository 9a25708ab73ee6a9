"""Vertices, edges and normals of triangle meshes, as whole-array operations, and Loop subdivision (Loop 1987)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry.mesh import unit

IntArray = NDArray[np.integer]


@dataclass(frozen=True, slots=True, eq=False)
class MeshEdges:
    """The undirected edges of a mesh.

    ``ends`` (E, 2) are vertex indices, the smaller first; ``of_face`` (F, 3) is the edge from corner k to corner k + 1
    of each face.
    """

    ends: IndexArray
    of_face: IndexArray

    def lengths(self, vertices: FloatArray) -> FloatArray:
        """(E,) lengths of the edges between vertices (V, 3), in their unit."""
        lengths: FloatArray = np.linalg.norm(vertices[self.ends[:, 1]] - vertices[self.ends[:, 0]], axis=1)
        return lengths


def directed_edge_keys(faces: IntArray) -> tuple[IndexArray, IndexArray]:
    """Return one integer key for each half-edge (F * 3,), in its own direction and in the opposite one."""
    start = faces.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    # start * stride + end is unique, as end < stride.
    stride = int(start.max()) + 1
    return (start * stride + end).ravel(), (end * stride + start).ravel()


def find_edges(faces: IntArray) -> MeshEdges:
    """Find the undirected edges of a mesh and number them."""
    forward, backward = directed_edge_keys(faces)
    key, of_face = np.unique(np.minimum(forward, backward), return_inverse=True)
    stride = int(faces.max()) + 1
    return MeshEdges(np.stack([key // stride, key % stride], axis=1), of_face.reshape(-1, 3))


def is_closed(faces: IntArray) -> bool:
    """Return whether each edge belongs to exactly two faces that run along it in opposite directions."""
    forward, backward = (np.sort(keys) for keys in directed_edge_keys(faces))
    # Each half-edge has its opposite, and none occurs twice.
    return bool((forward == backward).all() and (forward[1:] != forward[:-1]).all())


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(V, 3) unit normals at the vertices: means of the adjacent faces' normals, weighted by area."""
    corner = vertices[faces[:, 0]]
    # Twice the facet's area as a vector: the sum is weighted by area by itself.
    area = np.cross(vertices[faces[:, 1]] - corner, vertices[faces[:, 2]] - corner)
    corners = np.ascontiguousarray(faces.T).ravel()
    # bincount adds in the order of the faces: the same sums on every machine.
    return unit(np.stack([np.bincount(corners, np.tile(column, 3), len(vertices)) for column in area.T], axis=1))


def smoothstep(share: FloatArray) -> FloatArray:
    """Blend from 0 to 1 where a share rises from 0 to 1, with no crease at the ends."""
    share = np.clip(share, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def tangent_axes(up: FloatArray, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (N, 3) perpendicular to ``up`` (N, 3) and to each other, rotated by angles (N,) about it."""
    # The axis along which `up` is smallest is farthest from parallel.
    helper = np.zeros_like(up)
    np.put_along_axis(helper, np.abs(up).argmin(axis=1)[:, None], 1.0, axis=1)
    first = unit(np.cross(up, helper))
    second = np.cross(up, first)
    cosine, sine = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    return cosine * first + sine * second, cosine * second - sine * first


_FIT_ROUNDS = 8  # of progressive interpolation


def rounds_for(n_faces: int, wanted: int) -> int:
    """Return the number of 1-to-4 subdivisions that give at least ``wanted`` faces."""
    rounds = 0
    while n_faces * 4**rounds < wanted:
        rounds += 1
    return rounds


def refine(vertices: FloatArray, faces: IntArray, rounds: int) -> tuple[FloatArray, IntArray]:
    """Subdivide a closed mesh ``rounds`` times; each face becomes four.

    ``vertices`` (V, k) may hold further quantities after the position; all are refined alike. The original
    vertices come first in the result.
    """
    for _ in range(rounds):
        edges = find_edges(faces)
        vertices = np.concatenate([_moved(vertices, edges), _edge_points(vertices, faces, edges)])
        faces = _split(faces, edges, len(vertices) - len(edges.ends))
    return vertices, faces


def interpolating_control(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Control points (V, 3) whose Loop surface passes through the given vertices.

    Loop's surface lies inside its control points, so that a body would lose volume. Adding the difference between the
    vertices and the limit surface converges to interpolation (Chen et al. 2008, "Progressive interpolation using
    Loop subdivision surfaces").
    """
    edges = find_edges(faces)
    control = vertices
    for _ in range(_FIT_ROUNDS):
        control = control + (vertices - limit(control, edges))
    return control


def smoothed(values: FloatArray, edges: MeshEdges, rounds: int) -> FloatArray:
    """Replace each vertex's values (V, k) by the mean over itself and its neighbours, ``rounds`` times."""
    valence = _valence(edges, len(values))[:, None]
    for _ in range(rounds):
        values = (values + _neighbour_sum(values, edges)) / (1.0 + valence)
    return values


def _valence(edges: MeshEdges, n_vertices: int) -> FloatArray:
    return np.bincount(edges.ends.ravel(), minlength=n_vertices).astype(np.float64)


def _neighbour_sum(values: FloatArray, edges: MeshEdges) -> FloatArray:
    here, there = edges.ends.T
    # Each edge counts in both directions.
    here, there = np.concatenate([here, there]), np.concatenate([there, here])
    return np.stack([np.bincount(here, column[there], len(values)) for column in values.T], axis=1)


def _beta(valence: FloatArray) -> FloatArray:
    """Weight of each neighbour in a vertex's new position."""
    return (0.625 - (0.375 + 0.25 * np.cos(2.0 * np.pi / valence)) ** 2) / valence  # Loop 1987


def _moved(values: FloatArray, edges: MeshEdges) -> FloatArray:
    valence = _valence(edges, len(values))[:, None]
    beta = _beta(valence)
    return (1.0 - valence * beta) * values + beta * _neighbour_sum(values, edges)


def limit(values: FloatArray, edges: MeshEdges) -> FloatArray:
    """Return the limits of vertex values (V, k) after infinitely many subdivisions."""
    valence = _valence(edges, len(values))[:, None]
    # Limit of Loop's matrix powers: 1 / (3 / (8 beta) + n) for each of n neighbours.
    weight = 1.0 / (0.375 / _beta(valence) + valence)
    return (1.0 - valence * weight) * values + weight * _neighbour_sum(values, edges)


def _edge_points(values: FloatArray, faces: IntArray, edges: MeshEdges) -> FloatArray:
    """Return the new vertices: 3/8 of the two ends of each edge and 1/8 of the two corners opposite to it."""
    # Corner k - 1 is opposite to the edge from corner k to corner k + 1.
    opposite = np.roll(faces, 1, axis=1).ravel()
    edge = edges.of_face.ravel()
    wings = np.stack([np.bincount(edge, column[opposite], len(edges.ends)) for column in values.T], axis=1)
    return 0.375 * (values[edges.ends[:, 0]] + values[edges.ends[:, 1]]) + 0.125 * wings


def _split(faces: IntArray, edges: MeshEdges, n_old: int) -> IntArray:
    a, b, c = faces.astype(np.int64).T
    ab, bc, ca = edges.of_face.T + n_old
    # Three triangles at the corners and one in the middle, each with the winding of its parent.
    children = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1)
    return children.reshape(-1, 3)


def refine_where(
    values: FloatArray, faces: IntArray, edge_m: float, is_near: Callable[[FloatArray, FloatArray], BoolArray]
) -> tuple[FloatArray, IntArray]:
    """Bisect the facets of a region until their edges are at most ``edge_m`` long; the mesh stays closed.

    ``values`` (V, k) hold the position in the first three columns; at the middle of an edge all are averaged, so that
    the surface stays as it is. ``is_near`` tells from the corners (n, 3, 3) and the longest edges (n,) of facets
    whether they belong to the region. A facet that is divided is divided at its longest edge at least, which bounds the
    angles (Rivara 1984) and divides some facets beside the region too. The original vertices come first in the result,
    facets that are left as they are first among the facets.
    """
    while True:
        edges = find_edges(faces)
        lengths = edges.lengths(values[:, :3])[edges.of_face]
        longest = lengths.argmax(axis=1)
        coarse = np.flatnonzero(lengths.max(axis=1) > edge_m)
        coarse = coarse[is_near(values[faces[coarse], :3], lengths.max(axis=1)[coarse])]
        if not len(coarse):
            return values, faces
        marked = np.zeros(len(edges.ends), dtype=bool)
        marked[edges.of_face[coarse][lengths[coarse] > edge_m]] = True
        bases = np.take_along_axis(edges.of_face, longest[:, None], axis=1)[:, 0]
        while len(unmarked := np.flatnonzero(marked[edges.of_face].any(axis=1) & ~marked[bases])):
            marked[bases[unmarked]] = True
        middle = len(values) + np.cumsum(marked) - 1
        values = np.concatenate([values, values[edges.ends[marked]].mean(axis=1)])
        faces = _bisected(faces, edges.of_face, longest, marked, middle)


def _bisected(
    faces: IntArray, of_face: IndexArray, longest: IndexArray, marked: BoolArray, middle: IndexArray
) -> IntArray:
    """Divide the facets with marked edges at the new vertices ``middle`` (E,), first at the longest edge (F,)."""
    divided = marked[of_face].any(axis=1)
    order = (longest[divided, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces[divided].astype(np.int64), order, axis=1).T
    edge = np.take_along_axis(of_face[divided], order, axis=1)
    ab, bc, ca = middle[edge].T
    _, right, left = marked[edge].T
    children = [faces[~divided]]
    # The halves a, ab, c and ab, b, c: whole, or divided again at their other marked edge.
    for chosen, corners in (
        (~left, (a, ab, c)), (left, (a, ab, ca)), (left, (ab, c, ca)),
        (~right, (ab, b, c)), (right, (ab, b, bc)), (right, (ab, bc, c)),
    ):  # fmt: skip
        children.append(np.stack(corners, axis=1)[chosen])
    return np.concatenate(children)
