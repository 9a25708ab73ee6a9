"""Where features lie, how large they are, and which vertices each one touches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from scenarios.bodies.topology import FloatArray, IndexArray, IntArray

_PAIRS_AT_ONCE = 4_000_000
# A ball about a feature may reach the other side of a thin place: vertices that face away by more than this stay out.
_LEAST_FACING = 0.2


@dataclass(frozen=True, eq=False)
class Ground:
    """The smooth surface that features are put on.

    Parameters
    ----------
    points_m
        (V, 3) vertices.
    up
        (V, 3) unit directions in which vertices are moved.
    edge_m
        Mean length of an edge.
    coarse_m, coarse_faces
        The surface before refinement: features are placed on it, so that their places do not depend on the
        number of facets.
    """

    points_m: FloatArray
    up: FloatArray
    edge_m: float
    coarse_m: FloatArray
    coarse_faces: IntArray

    @property
    def resolution_m(self) -> float:
        """The smallest thing that the mesh can carry: two edges."""
        return 2.0 * self.edge_m

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree over the points."""
        return cKDTree(self.points_m, balanced_tree=False, compact_nodes=False)

    def draw_places(self, count: int, rng: np.random.Generator) -> IndexArray:
        """Draw vertices, uniformly over the area of the coarse surface."""
        corners = self.coarse_m[self.coarse_faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        face = np.searchsorted(np.cumsum(area), rng.uniform(0.0, area.sum(), count))
        weights = rng.dirichlet(np.ones(3), count)  # uniform over each triangle
        places = np.einsum("nk,nki->ni", weights, corners[np.minimum(face, len(area) - 1)])
        return np.asarray(self.tree.query(places)[1], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Pairs of a feature and a vertex within its reach.

    Parameters
    ----------
    feature, vertex
        (P,) indices.
    offset_m
        (P, 3) from the feature's centre to the vertex.
    """

    feature: IndexArray
    vertex: IndexArray
    offset_m: FloatArray


def power_law_diameters(
    count: int, low_m: float, high_m: float, exponent: float, rng: np.random.Generator
) -> FloatArray:
    """Draw diameters between two bounds whose cumulative number falls as D**-exponent, largest first."""
    least, most = high_m**-exponent, low_m**-exponent
    return np.sort(rng.uniform(least, most, count) ** (-1.0 / exponent))[::-1]


def find_patches(ground: Ground, places: IndexArray, reach_m: FloatArray) -> Iterator[Patches]:
    """Find the vertices within ``reach_m`` (N,) of each place (N,), in blocks of bounded size."""
    pairs = np.cumsum(4.0 * (reach_m / ground.edge_m) ** 2 + 1.0)
    block = (pairs / _PAIRS_AT_ONCE).astype(np.int64)
    for features in np.split(np.arange(len(places)), np.flatnonzero(np.diff(block)) + 1):
        found = ground.tree.query_ball_point(ground.points_m[places[features]], reach_m[features], return_sorted=True)
        feature = np.repeat(features, [len(vertices) for vertices in found])
        vertex = np.fromiter((v for vertices in found for v in vertices), np.int64, len(feature))
        facing = np.einsum("ni,ni->n", ground.up[vertex], ground.up[places[feature]]) > _LEAST_FACING
        feature, vertex = feature[facing], vertex[facing]
        yield Patches(feature, vertex, ground.points_m[vertex] - ground.points_m[places[feature]])
