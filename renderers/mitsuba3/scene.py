"""Mitsuba meshes and scenes of one body, built from arrays."""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from boresight.renderers.mitsuba3.variant import Variant, load_mitsuba
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray, SingleArray
from boresight.scenarios.craters.tiles import facet_normals
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.mesh import by_block

SHAPE_ID = "body"
SUN_ID = "sun"


def build_shape(mi: Any, mesh: TriangleMesh, bsdf: Any = None) -> Any:
    """Build a Mitsuba mesh with flat normals under the active variant of ``mi``, the library ``mitsuba``.

    Mitsuba's coordinates are body coordinates, m, in single precision. A ``bsdf`` of None is Mitsuba's default.
    """
    properties = mi.Properties()
    properties["face_normals"] = True
    if bsdf is not None:
        properties["bsdf"] = bsdf
    shape = mi.Mesh(SHAPE_ID, len(mesh.vertices_m), len(mesh.faces), props=properties)
    if mesh.albedo is not None:
        shape.add_attribute("vertex_albedo", 1, mesh.albedo.astype(np.float32))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices_m.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return shape


@dataclass(frozen=True, slots=True, eq=False)
class DeviceMesh:
    """Mesh in arrays of a variant: scene, normals (3 F,), vertex indices of facets (3 F,), albedo (V,) or None."""

    scene: Any
    facet_normals: Any
    faces: Any
    albedo: Any


# Weak keys: the copies on the device are freed when nothing else uses the mesh.
_held: MutableMapping[TriangleMesh, dict[str, DeviceMesh]] = WeakKeyDictionary()


def mesh_on_device(variant: Variant, mesh: TriangleMesh) -> DeviceMesh:
    """Convert a mesh for a variant, cached as long as the mesh exists and shared by all reflectance models.

    Building the tree of a body of millions of facets takes longer than rendering many images.
    """
    by_variant = _held.setdefault(mesh, {})
    if variant.name not in by_variant:
        mi = load_mitsuba(variant)
        shape = build_shape(mi, mesh)
        by_variant[variant.name] = DeviceMesh(
            scene=mi.load_dict({"type": "scene", "body": shape}),
            # Normals of the double-precision mesh, not of its rounded vertices, whose error grows on small facets.
            facet_normals=mi.Float(by_block(mesh.normals_of, np.empty(mesh.faces.shape, np.float32)).ravel()),
            faces=mi.traverse(shape)["faces"],
            albedo=None if mesh.albedo is None else mi.Float(mesh.albedo.astype(np.float32)),
        )
    return by_variant[variant.name]


@dataclass(frozen=True, slots=True, eq=False)
class FacetScene:
    """Scene of loose facets with corners (F, 3, 3), body frame, m."""

    scene: Any
    corners_m: SingleArray

    @classmethod
    def of(cls, mi: Any, corners_m: SingleArray) -> FacetScene:
        """Build the scene under the active variant."""
        properties = mi.Properties()
        properties["face_normals"] = True
        # Corners are not shared: loose facets need no numbering of vertices.
        shape = mi.Mesh("part", 3 * len(corners_m), len(corners_m), props=properties)
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = corners_m.ravel()
        parameters["faces"] = np.arange(3 * len(corners_m), dtype=np.uint32)
        parameters.update()
        # In the robust mode Embree builds the tree without spatial splits, which take longer than they save in the rays
        # of one image.
        return cls(mi.load_dict({"type": "scene", "part": shape, "embree_use_robust_intersections": True}), corners_m)

    def first_hits(self, mi: Any, origins_m: FloatArray, directions: FloatArray) -> tuple[SingleArray, IndexArray]:
        """Distances (N,), m, inf for a miss, and facets (N,) of the first hits of rays (N, 3)."""
        import drjit as dr

        hit = self.scene.ray_intersect_preliminary(_rays(mi, origins_m, directions), coherent=True)
        valid, distance, facet = hit.is_valid(), hit.t, hit.prim_index
        dr.eval(valid, distance, facet)  # together: each by itself would trace all rays again
        met = valid.numpy()
        return np.where(met, distance.numpy(), np.inf).astype(np.float32), np.where(met, facet.numpy(), 0)

    def blocks(self, mi: Any, origins_m: FloatArray, directions: FloatArray) -> BoolArray:
        """(N,) whether a facet blocks each of the rays (N, 3)."""
        blocked: BoolArray = self.scene.ray_test(_rays(mi, origins_m, directions), coherent=True).numpy()
        return blocked

    def normals(self, facets: IndexArray) -> SingleArray:
        """Compute unit normals (N, 3) of facets (N,); 0 for a facet without area."""
        found = np.zeros((len(facets), 3), dtype=np.float32)
        facet_normals(found, self.corners_m, facets)
        return found


def _rays(mi: Any, origins_m: FloatArray, directions: FloatArray) -> Any:
    origin = mi.Point3f(np.ascontiguousarray(origins_m.T, dtype=np.float32))
    return mi.Ray3f(origin, mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32)))
