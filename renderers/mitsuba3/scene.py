"""A Mitsuba scene of one body, built from arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

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
