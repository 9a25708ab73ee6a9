"""Spheres of even triangles."""

from __future__ import annotations

import numpy as np

from scenarios.geometry import TriangleMesh


def icosphere(rounds: int, radius_m: float) -> TriangleMesh:
    """Make a sphere of 20 * 4**rounds facets: an icosahedron whose edges are halved so often."""
    # Imported here: trimesh takes a tenth of the start-up, and most runs find their body in the cache.
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=rounds, radius=radius_m)
    return TriangleMesh(np.array(ball.vertices), np.array(ball.faces))
