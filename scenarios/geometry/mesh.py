"""Triangle meshes as immutable values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError

IndexArray = NDArray[np.int32]


_T = TypeVar("_T", bound=np.generic)
_Made = TypeVar("_Made")
_ROWS_AT_ONCE = 1 << 19


def sealed(array: NDArray[_T]) -> NDArray[_T]:
    """Return a copy in the same layout that cannot be made writable: its memory is that of an immutable object."""
    order: Literal["C", "F"] = "F" if array.flags.fnc else "C"
    return np.frombuffer(array.tobytes(order), array.dtype).reshape(array.shape, order=order)


def unit(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) scaled to length 1; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    scaled: FloatArray = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
    return scaled


def by_block(value: Callable[[slice], FloatArray], out: NDArray[_T]) -> NDArray[_T]:
    """Fill an array with the values of its rows, block by block: of millions of faces, temporaries would be larger."""
    for start in range(0, len(out), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        out[rows] = value(rows)
    return out


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles over shared vertices (V, 3) in the body frame.

    ``faces`` (F, 3) are vertex indices, counter-clockwise seen from outside: the outward normal is (v1 - v0) x (v2 -
    v0), equation (1) of Rowell et al. (2015). ``albedo`` (V,) is a factor on the reflectance at each vertex, None for 1
    everywhere.
    """

    vertices_m: FloatArray
    faces: IndexArray
    albedo: FloatArray | None = None

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices_m, dtype=np.float64)
        faces = np.array(self.faces, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise BoresightError(
                f"a mesh needs (V, 3) vertices and (F, 3) faces, not {vertices.shape} and {faces.shape}"
            )
        if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise BoresightError(f"a face names vertex {int(faces.max())}, but the mesh has {len(vertices)} vertices")
        arrays: dict[str, NDArray[np.float64] | NDArray[np.int32]] = {"vertices_m": vertices, "faces": faces}
        if self.albedo is not None:
            arrays["albedo"] = np.array(self.albedo, dtype=np.float64)
            if arrays["albedo"].shape != (len(vertices),):
                raise BoresightError(f"albedo has shape {arrays['albedo'].shape}, not ({len(vertices)},)")
        for name, value in arrays.items():
            # Meshes are shared, also by methods and the truth, and their derived quantities cached.
            object.__setattr__(self, name, sealed(value))

    @property
    def corners_m(self) -> FloatArray:
        """(F, 3, 3) the three corners of each face; not kept, as they take more memory than all else of a mesh."""
        return self.vertices_m[self.faces]

    def corners_of(self, faces: NDArray[np.integer]) -> FloatArray:
        """(n, 3, 3) the corners of some faces by their numbers, without those of the others."""
        corners: FloatArray = self.vertices_m[self.faces[faces]]
        return corners

    @cached_property
    def area_vectors_m2(self) -> FloatArray:
        """(F, 3) outward normals whose length is the face's area."""
        return sealed(by_block(self._area_vectors, np.empty((len(self.faces), 3))))

    @property
    def areas_m2(self) -> FloatArray:
        """(F,) areas of the faces; not kept."""
        return by_block(lambda faces: np.linalg.norm(self._area_vectors(faces), axis=1), np.empty(len(self.faces)))

    @cached_property
    def normals(self) -> FloatArray:
        """(F, 3) outward unit normals; zero where a face has no area."""
        return sealed(by_block(self.normals_of, np.empty((len(self.faces), 3))))

    def normals_of(self, faces: NDArray[np.integer] | slice) -> FloatArray:
        """(n, 3) the normals of some faces by their numbers, without those of the others."""
        return unit(self._area_vectors(faces))

    def _area_vectors(self, faces: NDArray[np.integer] | slice) -> FloatArray:
        first, second, third = np.moveaxis(self.vertices_m[self.faces[faces]], -2, 0)
        return np.asarray(0.5 * np.cross(second - first, third - first))  # eq. (1)

    @cached_property
    def volume_m3(self) -> float:
        """Signed volume: positive for a closed mesh whose normals point outward."""
        # Divergence theorem: the sum of tetrahedra between the origin and the facets.
        return float(np.einsum("fi,fi->", self.corners_m[:, 0], self.area_vectors_m2) / 3.0)

    @cached_property
    def radius_m(self) -> float:
        """The largest distance of a vertex from the origin."""
        return float(np.linalg.norm(self.vertices_m, axis=1).max())

    def distance_along_m(self, direction: FloatArray) -> float:
        """Return the distance from the origin to the outermost facet along a unit vector, (3,).

        Raise BoresightError if no facet lies in that direction.
        """
        # Coordinates across and along the ray: it meets a facet if the origin lies within its projection.
        first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
        x, y, along = (self.vertices_m @ axis for axis in (first, np.cross(direction, first), direction))
        i, j, k = self.faces.T
        # Barycentric coordinates times twice the projected area; exact opposites on the two sides of an edge.
        weights = np.stack([x[b] * y[c] - x[c] * y[b] for b, c in ((j, k), (k, i), (i, j))], axis=1)
        met = ((weights >= 0.0).all(axis=1) | (weights <= 0.0).all(axis=1)) & weights.any(axis=1)
        weights = weights[met]
        distances = np.einsum("fk,fk->f", weights, along[self.faces[met]]) / weights.sum(axis=1)
        if not distances.max(initial=0.0) > 0.0:
            raise BoresightError(f"from the body's origin no surface lies towards {direction.round(4).tolist()}")
        return float(distances.max())

    @property
    def extent_m(self) -> FloatArray:
        """(3,) size of the axis-aligned box."""
        extent: FloatArray = np.ptp(self.vertices_m, axis=0)
        return extent


def solid_angles(corners: FloatArray, distances: FloatArray) -> FloatArray:
    """(F,) signed solid angles, sr, of facets as seen from the origin: van Oosterom and Strackee (1983), equation (8).

    ``corners`` (F, 3, 3) are relative to that origin, and ``distances`` (F, 3) their lengths.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    r_a, r_b, r_c = distances.T
    dots = [np.einsum("fi,fi->f", x, y) for x, y in ((a, b), (b, c), (c, a))]
    triple = np.einsum("fi,fi->f", a, np.cross(b, c))
    # atan2 holds for angles beyond a half-space.
    solid: FloatArray = 2.0 * np.arctan2(triple, r_a * r_b * r_c + r_c * dots[0] + r_a * dots[1] + r_b * dots[2])
    return solid


def winding_number(mesh: TriangleMesh, point_m: FloatArray) -> float:
    """Compute the winding number of a closed mesh about a point (3,): 1 inside, 0 outside.

    The sum of the facets' signed solid angles over 4 pi.
    """

    def angles(faces: slice) -> FloatArray:
        corners = mesh.vertices_m[mesh.faces[faces]] - point_m
        return solid_angles(corners, np.linalg.norm(corners, axis=2))

    return float(by_block(angles, np.empty(len(mesh.faces))).sum() / (4.0 * np.pi))


def kept_with_mesh(make: Callable[[TriangleMesh], _Made]) -> Callable[[TriangleMesh], _Made]:
    """Keep what is made of a mesh for as long as the mesh lives: methods and scenarios of one body share it.

    What is made must not hold the mesh itself, and nobody may change it.
    """
    made: WeakKeyDictionary[TriangleMesh, _Made] = WeakKeyDictionary()

    def of(mesh: TriangleMesh) -> _Made:
        found = made.get(mesh)
        if found is None:
            found = made[mesh] = make(mesh)
        return found

    return of
