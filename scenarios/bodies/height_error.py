"""A shape whose heights are wrong, as a shape model worked out of images is."""

from __future__ import annotations

import numpy as np

from scenarios.bodies.detail.noise import Band, fractal_field
from scenarios.bodies.topology import find_edges, vertex_normals
from scenarios.geometry import TriangleMesh
from scenarios.spec.body import HeightErrorSpec

HEIGHT_ERROR_VERSION = 1
"""Part of the key of every body with such an error: raise it when the same spec gives another mesh."""


def with_height_error(mesh: TriangleMesh, spec: HeightErrorSpec) -> TriangleMesh:
    """Move the vertices along their normals by a fractal field of RMS ``spec.rms_m``.

    Octaves shorter than the mesh's mean edge cannot be carried by it and are left out; the field is scaled so that
    its RMS over the vertices is ``rms_m`` whatever octaves are left.
    """
    ends = find_edges(mesh.faces).ends
    edge_m = float(np.linalg.norm(mesh.vertices_m[ends[:, 0]] - mesh.vertices_m[ends[:, 1]], axis=1).mean())
    band = Band(spec.max_wavelength_m, spec.min_wavelength_m, spec.hurst)
    field, _ = fractal_field(np.asarray(mesh.vertices_m), band, edge_m, np.random.SeedSequence(spec.seed))
    deviation = float(field.std())
    heights_m = spec.rms_m * field / deviation if deviation > 0.0 else field
    normals = vertex_normals(np.asarray(mesh.vertices_m), np.asarray(mesh.faces))
    return TriangleMesh(mesh.vertices_m + heights_m[:, None] * normals, mesh.faces, mesh.albedo)
