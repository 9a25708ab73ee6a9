"""What stands between a point and a camera: a tree of boxes about the facets of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.int64]

_LEAF_FACETS = 4
_SLACK = 1e-9
_PAIRS_AT_ONCE = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class FacetTree:
    """A bounding volume hierarchy, complete and binary: the children of node i are 2 i + 1 and 2 i + 2.

    All rays go down together, a level at a time, as pairs of a ray and a box that it meets.

    Parameters
    ----------
    corners_m
        (L, K, 3, 3) facets of each leaf; places that are left over repeat a facet.
    low_m, high_m
        (2 L - 1, 3) corners of the boxes, those of the leaves last.
    """

    corners_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray

    @classmethod
    def of(cls, mesh: TriangleMesh) -> FacetTree:
        """Halve the facets at the median of their middles, along the longest side, until few are left."""
        corners = mesh.corners_m
        levels = max(0, int(np.ceil(np.log2(len(corners) / _LEAF_FACETS))))
        groups = _halved(corners.mean(axis=1), levels)
        leaves = corners[groups]
        low, high = [leaves.min(axis=(1, 2))], [leaves.max(axis=(1, 2))]
        while len(low[0]) > 1:
            low.insert(0, np.minimum(low[0][0::2], low[0][1::2]))
            high.insert(0, np.maximum(high[0][0::2], high[0][1::2]))
        return cls(leaves, np.concatenate(low), np.concatenate(high))

    def hidden(self, points_m: FloatArray, origin_m: FloatArray) -> BoolArray:
        """(n,): whether a facet stands on the line from ``origin_m``, (3,), to each point, (n, 3).

        The point itself, met at the end of its line but for rounding, does not count.
        """
        rays = points_m - origin_m
        hidden = np.zeros(len(rays), dtype=bool)
        share = max(1, _PAIRS_AT_ONCE // 64)
        for start in range(0, len(rays), share):
            hidden[start : start + share] = self._hidden(rays[start : start + share], origin_m)
        return hidden

    def _hidden(self, rays: FloatArray, origin: FloatArray) -> BoolArray:
        with np.errstate(divide="ignore"):
            inverse = 1.0 / rays
        ray = np.arange(len(rays), dtype=np.int64)
        node = np.zeros(len(rays), dtype=np.int64)
        first_leaf = len(self.corners_m) - 1
        while len(ray):
            meets = self._meets(node, origin, inverse[ray])
            ray, node = ray[meets], node[meets]
            if len(node) and node[0] >= first_leaf:
                break
            ray, node = np.repeat(ray, 2), np.stack([2 * node + 1, 2 * node + 2], axis=1).ravel()
        hidden = np.zeros(len(rays), dtype=bool)
        for k in range(self.corners_m.shape[1]):
            hidden[ray[_blocks(self.corners_m[node - first_leaf, k], origin, rays[ray])]] = True
        return hidden

    def _meets(self, node: IndexArray, origin: FloatArray, inverse: FloatArray) -> BoolArray:
        """(P,): whether each ray meets its box before its end (slabs; Kay and Kajiya 1986)."""
        with np.errstate(invalid="ignore"):
            one, other = (self.low_m[node] - origin) * inverse, (self.high_m[node] - origin) * inverse
        enter = np.fmin(one, other).max(axis=1)
        leave = np.fmax(one, other).min(axis=1)
        met: BoolArray = (enter <= leave + _SLACK) & (leave >= 0.0) & (enter < 1.0)
        return met


def _halved(middles: FloatArray, levels: int) -> IndexArray:
    """(2^levels, K) indices of the middles in each group; where groups differ by one, a facet stands twice."""
    groups = [np.arange(len(middles))]
    for _ in range(levels):
        halves = []
        for group in groups:
            axis = int(np.ptp(middles[group], axis=0).argmax())
            order = group[np.argsort(middles[group, axis], kind="stable")]
            halves += np.array_split(order, 2)
        groups = halves
    size = max(map(len, groups))
    return np.array([np.resize(group, size) for group in groups])


def _blocks(corners: FloatArray, origin: FloatArray, rays: FloatArray) -> BoolArray:
    """(P,): whether each ray meets its facet, (P, 3, 3), before its end, by Moeller and Trumbore (1997).

    The end is the point itself: the facet that it lies on, met at 1 but for rounding, does not count.
    """
    edge1, edge2, offset = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], origin - corners[:, 0]
    p, q = np.cross(rays, edge2), np.cross(offset, edge1)
    determinant = np.einsum("pi,pi->p", edge1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("pi,pi->p", offset, p) / determinant
        v = np.einsum("pi,pi->p", rays, q) / determinant
        t = np.einsum("pi,pi->p", edge2, q) / determinant
    met: BoolArray = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0 - _SLACK)
    return met
