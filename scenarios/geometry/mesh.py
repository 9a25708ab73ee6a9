"""Triangle meshes as immutable values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError

IndexArray = NDArray[np.int32]


_T = TypeVar("_T", bound=np.generic)


def sealed(array: NDArray[_T]) -> NDArray[_T]:
    """Return a copy in the same layout that cannot be made writable: its memory is that of an immutable object."""
    order: Literal["C", "F"] = "F" if array.flags.fnc else "C"
    return np.frombuffer(array.tobytes(order), array.dtype).reshape(array.shape, order=order)


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

    @cached_property
    def corners_m(self) -> FloatArray:
        """(F, 3, 3) the three corners of each face."""
        return sealed(self.vertices_m[self.faces])

    @cached_property
    def area_vectors_m2(self) -> FloatArray:
        """(F, 3) outward normals whose length is the face's area."""
        corners = self.corners_m
        return sealed(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))  # eq. (1)

    @cached_property
    def normals(self) -> FloatArray:
        """(F, 3) outward unit normals; zero where a face has no area."""
        length = np.linalg.norm(self.area_vectors_m2, axis=1, keepdims=True)
        unit: FloatArray = np.divide(
            self.area_vectors_m2, length, out=np.zeros_like(self.area_vectors_m2), where=length > 0.0
        )
        return sealed(unit)

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
