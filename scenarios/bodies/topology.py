"""Vertices, edges and normals of triangle meshes, as whole-array operations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, IndexArray

IntArray = NDArray[np.integer]


@dataclass(frozen=True, slots=True, eq=False)
class MeshEdges:
    """The undirected edges of a mesh.

    ``ends`` (E, 2) are vertex indices, the smaller first; ``of_face`` (F, 3) is the edge from corner k to corner k + 1
    of each face.
    """

    ends: IndexArray
    of_face: IndexArray


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
    return unit(sum_at_vertices(faces, area, len(vertices)))


def sum_at_vertices(faces: IntArray, per_face: FloatArray, n_vertices: int) -> FloatArray:
    """Add a quantity (F, k) of each face to its three vertices: (V, k)."""
    corners = np.ascontiguousarray(faces.T).ravel()
    # bincount adds in the order of the faces: the same sums on every machine.
    columns = [np.bincount(corners, np.tile(column, 3), n_vertices) for column in per_face.T]
    return np.stack(columns, axis=1)


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors (..., 3) scaled to length 1; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    scaled: FloatArray = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
    return scaled


def tangent_axes(up: FloatArray, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (N, 3) perpendicular to ``up`` (N, 3) and to each other, rotated by angles (N,) about it."""
    # The axis along which `up` is smallest is farthest from parallel.
    helper = np.zeros_like(up)
    np.put_along_axis(helper, np.abs(up).argmin(axis=1)[:, None], 1.0, axis=1)
    first = unit(np.cross(up, helper))
    second = np.cross(up, first)
    cosine, sine = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    return cosine * first + sine * second, cosine * second - sine * first
