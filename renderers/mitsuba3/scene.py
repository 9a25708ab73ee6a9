"""A Mitsuba scene of one body, built from arrays."""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from renderers.mitsuba3.variant import Variant, load_mitsuba
from scenarios.geometry import TriangleMesh

SHAPE_ID = "body"
SUN_ID = "sun"


def build_shape(mi: Any, mesh: TriangleMesh, bsdf: Any = None) -> Any:
    """Build a Mitsuba mesh with flat normals under the active variant.

    Parameters
    ----------
    mi
        The library ``mitsuba``.
    mesh
        The body; Mitsuba's coordinates are body coordinates in metres, in single precision.
    bsdf
        A Mitsuba BSDF; Mitsuba's default one where it is None.
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
    """A mesh as a variant holds it: its scene, unit normals (3 F,), vertices of facets (3 F,), albedo (V,) or None."""

    scene: Any
    facet_normals: Any
    faces: Any
    albedo: Any


_held: MutableMapping[TriangleMesh, dict[str, DeviceMesh]] = WeakKeyDictionary()


def mesh_on_device(variant: Variant, mesh: TriangleMesh) -> DeviceMesh:
    """Give a mesh to a variant, once for all reflectances, as long as the mesh is in use.

    The tree of a body of some million facets takes longer than many images.
    """
    by_variant = _held.setdefault(mesh, {})
    if variant.name not in by_variant:
        mi = load_mitsuba(variant)
        by_variant[variant.name] = DeviceMesh(
            scene=mi.load_dict({"type": "scene", "body": build_shape(mi, mesh)}),
            facet_normals=mi.Float(mesh.normals.astype(np.float32).ravel()),
            faces=mi.UInt32(mesh.faces.astype(np.uint32).ravel()),
            albedo=None if mesh.albedo is None else mi.Float(mesh.albedo.astype(np.float32)),
        )
    return by_variant[variant.name]
