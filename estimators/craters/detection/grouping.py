"""Grouping of convex rim edges into pairs of a lit and a shaded arc.

On a rim the brightness rises towards the Sun on both sides: from the ground outside to the lit wall, and from the
shaded wall to the ground. An edge whose gradient points towards the Sun is therefore the graph of a function over the
axis across the Sun's direction, and its gradient rotates one way along a shaded rim, the other way along a lit one.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from boresight.estimators.craters.detection.preparation import EdgePixels, PreparedImage
from boresight.scenarios.arrays import FloatArray, IndexArray

_LINK_PX = 1.9  # distance of neighbours: a pixel's diagonal plus the subpixel offsets


@dataclass(frozen=True, slots=True, eq=False)
class RimArc:
    """A convex edge on one side of a rim: points (n, 2), ordered across the Sun's direction.

    ``outward`` (n, 2) are unit normals, out of the crater that it would belong to. ``lit`` is whether it is a lit
    wall's: the side away from the Sun.
    """

    uv_px: FloatArray
    outward: FloatArray
    lit: bool


def sunward_edges(edges: EdgePixels, picture: PreparedImage, within_rad: float) -> EdgePixels:
    """Keep the edge pixels whose brightness rises towards the Sun."""
    along = edges.gradient @ picture.sun_px
    keep = along > np.cos(within_rad) * np.linalg.norm(edges.gradient, axis=1)
    return EdgePixels(edges.uv_px[keep], edges.gradient[keep], edges.mask)


def edge_chains(edges: EdgePixels, bend_rad: float) -> list[IndexArray]:
    """Link neighbouring pixels whose gradients differ by less than ``bend_rad``; return the rows of each chain."""
    n = len(edges.uv_px)
    if n == 0:
        return []
    unit = edges.gradient / np.linalg.norm(edges.gradient, axis=1, keepdims=True)
    # Neighbours whose gradients point elsewhere belong to another edge, as where two rims meet.
    pairs = cKDTree(edges.uv_px).query_pairs(_LINK_PX, output_type="ndarray")
    pairs = pairs[np.einsum("ij,ij->i", unit[pairs[:, 0]], unit[pairs[:, 1]]) > np.cos(bend_rad)]
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def turning_points(angle: FloatArray, least: float) -> list[int]:
    """Split a sequence (n,) into rises and falls of at least ``least``.

    Return the indices where they meet, with the first and the last of the sequence. A change of trend counts only once
    the sequence has gone back by ``least``, so that noise does not cut an arc into pieces.
    """
    knots, low, high, trend = [0], 0, 0, 0
    for i in range(1, len(angle)):
        low = i if angle[i] < angle[low] else low
        high = i if angle[i] > angle[high] else high
        if trend >= 0 and angle[high] - angle[i] >= least:
            if trend > 0 or high > knots[-1]:
                knots.append(high)
            trend, low = -1, i
            high = i
        elif trend <= 0 and angle[i] - angle[low] >= least:
            if trend < 0 or low > knots[-1]:
                knots.append(low)
            trend, high = 1, i
            low = i
    knots.append(len(angle) - 1)
    return knots


def rim_arcs(
    edges: EdgePixels, picture: PreparedImage, least_turn_rad: float, bend_rad: float, least_points: int
) -> list[RimArc]:
    """Cut the chains of sunward edges into convex arcs and classify them as lit or shaded.

    ``least_turn_rad`` is the least rotation of the normal along an arc, ``bend_rad`` the largest one between neighbours
    of an arc, and ``least_points`` the least number of points of an arc.
    """
    sun = picture.sun_px
    across = np.array([-sun[1], sun[0]])
    arcs: list[RimArc] = []
    for rows in edge_chains(edges, bend_rad):
        if len(rows) < least_points:
            continue
        # A sunward edge is the graph of a function over this axis, so that sorting by it follows the chain.
        rows = rows[np.argsort(edges.uv_px[rows] @ across, kind="stable")]
        # The direction of the gradient from the Sun's: monotonic along one side of a convex rim.
        unit = _smoothed(edges.gradient[rows])
        # No wrap of 2 pi: only gradients within 90 deg of the Sun are left.
        angle = np.arctan2(unit @ across, unit @ sun)
        knots = turning_points(angle, least_turn_rad)
        for start, stop in pairwise(knots):
            turn = float(angle[stop] - angle[start])
            if abs(turn) < least_turn_rad or stop - start + 1 < least_points:
                continue
            part = rows[start : stop + 1]
            # With growing place across the Sun an outward normal turns towards +across. On the shaded side (towards the
            # Sun) the gradient is that normal, on the lit side its opposite, which turns the other way.
            lit = turn < 0.0
            arcs.append(RimArc(edges.uv_px[part], (-1.0 if lit else 1.0) * unit[start : stop + 1], lit))
    return arcs


def _smoothed(gradient: FloatArray) -> FloatArray:
    """Return unit gradients, each averaged with its neighbours along the chain."""
    padded = np.concatenate([gradient[:1], gradient[:1], gradient, gradient[-1:], gradient[-1:]])
    # Triangular weights 1 2 3 2 1: the angle of one gradient is too noisy to be tested for monotony.
    summed = padded[:-4] + 2 * padded[1:-3] + 3 * padded[2:-2] + 2 * padded[3:-1] + padded[4:]
    return np.asarray(summed / np.linalg.norm(summed, axis=1, keepdims=True), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class ArcTable:
    """Measures of n arcs for pairing, each (n,) px.

    ``low``, ``high`` and ``across`` are coordinates of the ends and their mean, on the axis across the direction of the
    Sun, ``along`` is the median coordinate on the axis towards the Sun, and ``radius`` that from the normals, as in
    `arc_radius`.
    """

    low: FloatArray
    high: FloatArray
    along: FloatArray
    across: FloatArray
    radius: FloatArray

    @classmethod
    def of(cls, arcs: list[RimArc], picture: PreparedImage) -> ArcTable:
        """Measure arcs."""
        sun = picture.sun_px
        side = np.array([-sun[1], sun[0]])
        # Along the Sun the median, as the ends of an arc bend away from its middle.
        t = [arc.uv_px @ side for arc in arcs]
        p = [float(np.median(arc.uv_px @ sun)) for arc in arcs]
        low, high = np.array([x.min() for x in t]), np.array([x.max() for x in t])
        return cls(low, high, np.array(p), 0.5 * (low + high), np.array([arc_radius(arc) for arc in arcs]))


def arc_radius(arc: RimArc) -> float:
    """Return the radius, px, of the circle x = c + R n that fits points and outward normals by least squares."""
    # Centring eliminates c; R is the regression of the points on the normals. An arc with nearly parallel normals does
    # not determine it; the floor of 1 px keeps logarithms of it finite.
    dx = arc.uv_px - arc.uv_px.mean(axis=0)
    dn = arc.outward - arc.outward.mean(axis=0)
    return float(max(np.sum(dx * dn) / max(np.sum(dn * dn), 1e-12), 1.0))


def pair_arcs(
    shaded: list[RimArc], lit: list[RimArc], picture: PreparedImage, radius_px: tuple[float, float]
) -> IndexArray:
    """Pair shaded arcs with lit ones that can be two sides of one rim: (k, 2) rows of both lists.

    The lit one lies away from the Sun, within the diameter estimated from the arcs' curvatures; their extents across
    the Sun overlap; their radii are similar.
    """
    if not shaded or not lit:
        return np.empty((0, 2), dtype=np.int64)
    a, b = ArcTable.of(shaded, picture), ArcTable.of(lit, picture)
    # Positive where the shaded arc is nearer to the Sun; in the other order two arcs cannot be one rim.
    gap = a.along[:, None] - b.along[None]
    common = np.minimum(a.high[:, None], b.high[None]) - np.maximum(a.low[:, None], b.low[None])
    width = np.minimum((a.high - a.low)[:, None], (b.high - b.low)[None])
    ratio = np.log(a.radius[:, None] / b.radius[None])
    mean = np.sqrt(a.radius[:, None] * b.radius[None])
    # The gap is the diameter along the Sun: 2 radii for a circle, less where the rim is foreshortened.
    possible = (
        (gap > 0.8 * radius_px[0])
        & (gap < np.minimum(2.0 * radius_px[1], 2.6 * mean))
        & (gap > 0.25 * mean)
        & (common > 0.3 * width)
        & (np.abs(ratio) < np.log(3.0))
        & (np.abs(a.across[:, None] - b.across[None]) < 0.7 * mean)
    )
    return np.argwhere(possible)
