"""How large a cratered surface will be, told before any of it is made."""

from __future__ import annotations

import math

import numpy as np

from scenarios.bodies.topology import find_edges
from scenarios.craters.tiles import SHORTENED
from scenarios.errors import BoresightError
from scenarios.geometry import TriangleMesh
from scenarios.limits import installed_memory_bytes
from scenarios.spec.craters import CratersSpec

_TILE_M = 100.0
# Peak of a build of 82 thousand to 1.3 million tiles with 0.7 to 10 million vertices, less that of the process itself.
_TILE_BYTES, _VERTEX_BYTES = 800, 70


def tile_rounds(edge_m: float) -> int:
    """Return how often facets with edges of a typical length are cut into four, until they are tiles of about 100 m."""
    return max(0, math.ceil(math.log2(edge_m / _TILE_M)))


def expected_size(mesh: TriangleMesh, spec: CratersSpec) -> tuple[int, int]:
    """Return about how many tiles and facets a surface over a mesh has."""
    length = np.linalg.norm(np.diff(mesh.vertices_m[find_edges(mesh.faces).ends], axis=1), axis=-1)
    typical_m = float(np.median(length))
    rounds = tile_rounds(typical_m)
    tiles = len(mesh.faces) * 4**rounds
    return tiles, tiles * max(1, math.ceil(typical_m / 2**rounds / (SHORTENED * spec.edge_m))) ** 2


def check_size(mesh: TriangleMesh, spec: CratersSpec) -> None:
    """Refuse a surface that this machine has no room for.

    Raises
    ------
    BoresightError
        With what it would take, and what to change.
    """
    tiles, facets = expected_size(mesh, spec)
    parts, room = (tiles * _TILE_BYTES, facets // 2 * _VERTEX_BYTES), installed_memory_bytes()
    if sum(parts) <= room:
        return
    remedy = f"raise craters.edge_m ({spec.edge_m:g}), with min_diameter_m four times as much, or take a smaller body"
    if parts[0] > room:
        remedy = f"take a smaller body: without any craters its tiles take {parts[0] / 1e9:.3g} GB"
    raise BoresightError(
        f"craters: a surface of {facets:.3g} facets on a body {2e-3 * mesh.radius_m:.3g} km across takes about"
        f" {sum(parts) / 1e9:.3g} GB of memory, and this machine has {room / 1e9:.3g} GB: {remedy}"
    )
