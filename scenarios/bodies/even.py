"""An even net of facets laid over a shape whose own are slivers, as those of shapes from light curves are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.bodies.detail.subdivide import rounds_for
from scenarios.bodies.icosphere import icosphere
from scenarios.errors import BoresightError
from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]

EVEN_VERSION = 1
"""Part of the key of every such body: raise it when the same spec gives another mesh."""

_ICOSAHEDRON_FACETS = 20
_AT_ONCE = 1 << 22  # pairs of a direction and a facet


def evenly_meshed(mesh: TriangleMesh, facets: int, source: str) -> TriangleMesh:
    """Take a star-shaped mesh where the rays through the vertices of an icosphere leave it.

    With corners a, b, c of a facet, a direction d meets it where d ~ (d.(b x c)) a + (d.(c x a)) b + (d.(a x b)) c
    has no negative weight; the weights over their sum are the barycentric coordinates. The new vertices lie on the
    shape; between them its edges are cut, so that a convex body loses a little volume.

    Parameters
    ----------
    facets
        At least as many, and less than four times as many.
    source
        Of the shape, for the message.

    Raises
    ------
    BoresightError
        If some facet does not face away from the origin: then a ray may leave the shape more than once.
    """
    corners = np.asarray(mesh.corners_m, dtype=np.float64)
    opposite = np.cross(np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1))
    hidden = int((np.einsum("fi,fi->f", corners[:, 0], opposite[:, 0]) <= 0.0).sum())
    if hidden:
        raise BoresightError(
            f"{source}: body.even_facets: {hidden} facets cannot be seen from the body's origin, so that one net over"
            " all directions does not fit; remove the key"
        )
    net = icosphere(rounds_for(_ICOSAHEDRON_FACETS, facets), 1.0)
    directions = net.vertices_m
    facet, weights = _met(directions, opposite)
    points_m = np.einsum("nk,nki->ni", weights, corners[facet])
    albedo = None if mesh.albedo is None else np.einsum("nk,nk->n", weights, mesh.albedo[mesh.faces[facet]])
    return TriangleMesh(points_m, net.faces, albedo)


def _met(directions: FloatArray, opposite: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """(n,) facet that each direction meets, and the barycentric coordinates (n, 3) of where it does."""
    found = np.empty(len(directions), dtype=np.int64)
    weights = np.empty((len(directions), 3))
    step = max(1, _AT_ONCE // len(opposite))
    for first in range(0, len(directions), step):
        part = slice(first, first + step)
        products = np.einsum("ni,fki->nfk", directions[part], opposite, optimize=True)
        total = products.sum(axis=2)
        least = np.where(total > 0.0, products.min(axis=2) / np.where(total > 0.0, total, 1.0), -np.inf)
        found[part] = least.argmax(axis=1)
        rows = np.arange(len(found[part]))
        weights[part] = products[rows, found[part]] / total[rows, found[part], None]
    return found, np.clip(weights, 0.0, 1.0) / np.clip(weights, 0.0, 1.0).sum(axis=1, keepdims=True)
