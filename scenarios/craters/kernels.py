"""Compiled kernels of cratered surfaces: vertices of curved tiles, facets, relief and crest curves."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray, SingleArray
from boresight.scenarios.compiled import compiler

kernel, inner = compiler(Path(__file__).parent)
"""The decorators of the kernels of this package."""


class TileLayout(NamedTuple):
    """Subdivision of tiles: corners and edges of tiles, ends and pieces of edges, and offsets of their vertices."""

    faces: IndexArray
    of_face: IndexArray
    ends: IndexArray
    edge_pieces: IndexArray
    edge_start: IndexArray
    tile_pieces: IndexArray
    tile_start: IndexArray


@inner
def _bend(out: FloatArray, p: FloatArray, q: FloatArray, normal: FloatArray) -> None:
    """Write the control point b_210 of Vlachos et al. (2001): p + (q - p) / 3, projected to the tangent plane at p."""
    # b_210 = p + (d - (d . n) n) / 3 with d = q - p.
    along = (q[0] - p[0]) * normal[0] + (q[1] - p[1]) * normal[1] + (q[2] - p[2]) * normal[2]
    for x in range(3):
        out[x] = p[x] + (q[x] - p[x] - along * normal[x]) / 3.0


@inner
def _normalise(v: FloatArray, row: int) -> None:
    length = np.sqrt(v[row, 0] * v[row, 0] + v[row, 1] * v[row, 1] + v[row, 2] * v[row, 2])
    for x in range(3):
        v[row, x] /= length


@kernel
def place_edge_vertices(
    points: FloatArray, up: FloatArray, normals: FloatArray, ends: IndexArray, pieces: IndexArray, start: IndexArray
) -> None:
    """Write the inner vertices of each edge on its cubic Bezier curve, from its first end to its second."""
    near, far = np.empty(3), np.empty(3)
    for e in range(len(ends)):
        a, b = ends[e, 0], ends[e, 1]
        _bend(near, points[a], points[b], normals[a])
        _bend(far, points[b], points[a], normals[b])
        for k in range(1, pieces[e]):
            t = k / pieces[e]
            s = 1.0 - t
            row = start[e] + k - 1
            for x in range(3):
                # Bernstein polynomials s^3, 3 s^2 t, 3 s t^2, t^3.
                inner = 3.0 * s * t * (s * near[x] + t * far[x])
                points[row, x] = s * s * s * points[a, x] + inner + t * t * t * points[b, x]
                up[row, x] = s * up[a, x] + t * up[b, x]
            _normalise(up, row)


@kernel
def place_inner_vertices(
    points: FloatArray, up: FloatArray, normals: FloatArray, faces: IndexArray, pieces: IndexArray, start: IndexArray
) -> None:
    """Write the inner vertices of each tile on its cubic Bezier triangle, row by row."""
    side = np.empty((6, 3))
    middle = np.empty(3)
    for f in range(len(faces)):
        n, row = pieces[f], start[f]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        # Control points b_210, b_120, b_021, b_012, b_102 and b_201. Those of an edge are the same from both of its
        # tiles.
        _bend(side[0], points[a], points[b], normals[a])
        _bend(side[1], points[b], points[a], normals[b])
        _bend(side[2], points[b], points[c], normals[b])
        _bend(side[3], points[c], points[b], normals[c])
        _bend(side[4], points[c], points[a], normals[c])
        _bend(side[5], points[a], points[c], normals[a])
        for x in range(3):
            mean = (side[0, x] + side[1, x] + side[2, x] + side[3, x] + side[4, x] + side[5, x]) / 6.0
            # b_111 = E + (E - V) / 2, E the mean of the six and V that of the corners.
            middle[x] = mean + 0.5 * (mean - (points[a, x] + points[b, x] + points[c, x]) / 3.0)
        for i in range(1, n - 1):
            for j in range(1, n - i):
                # Barycentric coordinates (u, v, w) of the corners a, b, c.
                v, w = i / n, j / n
                u = 1.0 - v - w
                for x in range(3):
                    corners = u * u * u * points[a, x] + v * v * v * points[b, x] + w * w * w * points[c, x]
                    sides = u * v * (u * side[0, x] + v * side[1, x])
                    sides += v * w * (v * side[2, x] + w * side[3, x])
                    sides += w * u * (w * side[4, x] + u * side[5, x])
                    points[row, x] = corners + 3.0 * sides + 6.0 * u * v * w * middle[x]
                    up[row, x] = u * up[a, x] + v * up[b, x] + w * up[c, x]
                _normalise(up, row)
                row += 1


@inner
def _on_edge(corner: int, other: int, first: int, pieces: int, start: int, step: int, n: int) -> int:
    """Return the vertex of an edge that is nearest to the fraction step / n from one end to the other."""
    # round(step / n * pieces) in integers.
    k = (2 * step * pieces + n) // (2 * n)
    if k == 0:
        return corner
    if k == pieces:
        return other
    # Vertices of an edge are numbered from its first end, which may be the tile's second corner.
    return start + (k - 1 if first == corner else pieces - 1 - k)


@inner
def tile_buffer(layout: TileLayout) -> IndexArray:
    """Return an array that is large enough for the vertex numbers of any tile."""
    most = 0
    for pieces in layout.tile_pieces:
        most = max(most, pieces)
    return np.empty((most + 1, most + 1), dtype=np.int64)


@inner
def number_tile(ids: IndexArray, f: int, layout: TileLayout) -> int:
    """Write the vertex numbers of a tile, [i, j] at barycentric coordinates (n - i - j, i, j) / n, and return n."""
    a, b, c = layout.faces[f, 0], layout.faces[f, 1], layout.faces[f, 2]
    ends, pieces, edge_start = layout.ends, layout.edge_pieces, layout.edge_start
    n, row = layout.tile_pieces[f], layout.tile_start[f]
    for i in range(1, n - 1):
        for j in range(1, n - i):
            ids[i, j] = row
            row += 1
    e, g, h = layout.of_face[f, 0], layout.of_face[f, 1], layout.of_face[f, 2]
    # Where an edge has fewer pieces than the tile has rows, several of its positions get one vertex.
    for k in range(n + 1):
        ids[k, 0] = _on_edge(a, b, ends[e, 0], pieces[e], edge_start[e], k, n)
        ids[n - k, k] = _on_edge(b, c, ends[g, 0], pieces[g], edge_start[g], k, n)
        ids[0, n - k] = _on_edge(c, a, ends[h, 0], pieces[h], edge_start[h], k, n)
    return int(n)


@kernel
def cut_tiles(found: IndexArray, tiles: IndexArray, layout: TileLayout) -> int:
    """Write the facets of the given tiles and return their number; facets with repeated vertices are left out."""
    count, ids = 0, tile_buffer(layout)
    for f in tiles:
        n = number_tile(ids, f, layout)
        for i in range(n):
            for j in range(n - i):
                # Each cell of the grid has an upward and a downward triangle; the cells on the hypotenuse have the
                # first alone.
                for half in range(1 if i + j == n - 1 else 2):
                    p = ids[i + half, j]
                    q = ids[i + 1, j + half]
                    r = ids[i, j + 1]
                    # Facets that collapsed on a coarser edge.
                    if p != q and q != r and r != p:
                        found[count, 0], found[count, 1], found[count, 2] = p, q, r
                        count += 1
    return count


@kernel
def profile_height(r: float, rim: float, rounding: float, stretch: float, scale: float) -> float:
    """Height in diameters of one crater at one distance in radii, as `Profiles.heights` for an array.

    The constants 3 and 2 (in the taper) are its REACH and the start of the taper.
    """
    if r >= 3.0:
        return 0.0
    x = r * stretch
    square = x * x
    bowl = rim - (1.0 - square)
    blanket = rim * np.sqrt(1.5 / (0.5 + square * square * square))
    # A smooth minimum: (b + e) / 2 - sqrt((b - e)^2 / 4 + w^2).
    half = 0.5 * (bowl - blanket)
    height = 0.5 * (bowl + blanket) - np.sqrt(half * half + rounding * rounding)
    taper = min(1.0, 3.0 - r)
    return float(scale * height * taper * taper * (3.0 - 2.0 * taper))


@kernel
def add_crater(
    heights: FloatArray,
    points: FloatArray,
    up: FloatArray,
    runs: IndexArray,
    centre: FloatArray,
    frame: FloatArray,
    radius: float,
    shape: FloatArray,
    plane: FloatArray,
) -> None:
    """Add one crater to the existing relief, ``heights`` (N,) along ``up``, in place: see `scenarios.craters.relief`.

    ``runs`` (R, 2) are ranges of the vertices that may be affected, ``frame`` (3, 3) the axes of the crater, the last
    one up, ``shape`` (4,) rim, rounding, stretch and scale of `profile_height`, ``plane`` (3,) the solution of
    `rim_equations`.
    """
    offset = np.empty(3)
    for k in range(len(runs)):
        for v in range(runs[k, 0], runs[k, 1]):
            facing = up[v, 0] * frame[2, 0] + up[v, 1] * frame[2, 1] + up[v, 2] * frame[2, 2]
            for axis in range(3):
                offset[axis] = points[v, axis] - centre[axis]
            r = np.sqrt(offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]) / radius
            # facing: cosine between the direction of relief and the crater's axis. A ball about the crater may include
            # the opposite side of a thin part.
            if r >= 3.0 or facing <= 0.2:
                continue
            change = 2.0 * radius * profile_height(r, shape[0], shape[1], shape[2], shape[3])
            if r < 1.0:
                # Inheritance of the old relief: 0 within half the radius, a smoothstep to 1 at the rim.
                t = min(max(2.0 * r - 1.0, 0.0), 1.0)
                kept = t * t * (3.0 - 2.0 * t)
                x = offset[0] * frame[0, 0] + offset[1] * frame[0, 1] + offset[2] * frame[0, 2]
                y = offset[0] * frame[1, 0] + offset[1] * frame[1, 1] + offset[2] * frame[1, 2]
                z = offset[0] * frame[2, 0] + offset[1] * frame[2, 1] + offset[2] * frame[2, 2]
                # Heights along the crater's axis: what is missing from the old surface to the plane about the rim.
                level = plane[0] + plane[1] * x + plane[2] * y
                change += (1.0 - kept) * (level - z - heights[v] * facing)
            # A height h along the axis is h / facing along the vertex's own direction.
            heights[v] += change / facing


@kernel
def rim_equations(
    heights: FloatArray,
    points: FloatArray,
    up: FloatArray,
    runs: IndexArray,
    centre: FloatArray,
    frame: FloatArray,
    radius: float,
) -> tuple[FloatArray, FloatArray]:
    """Return normal equations (3, 3), (3,) of the old surface's plane at 0.8 to 1.2 radii; parameters of `add_crater`.

    The unknowns are a constant and slopes along the frame's axes. The caller solves: numba compiles a call of LAPACK
    for three seconds.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    row, offset = np.empty(3), np.empty(3)
    row[0] = 1.0
    for k in range(len(runs)):
        for v in range(runs[k, 0], runs[k, 1]):
            for axis in range(3):
                offset[axis] = points[v, axis] - centre[axis]
            r = np.sqrt(offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]) / radius
            facing = up[v, 0] * frame[2, 0] + up[v, 1] * frame[2, 1] + up[v, 2] * frame[2, 2]
            if r < 0.8 or r > 1.2 or facing <= 0.2:
                continue
            row[1] = offset[0] * frame[0, 0] + offset[1] * frame[0, 1] + offset[2] * frame[0, 2]
            row[2] = offset[0] * frame[1, 0] + offset[1] * frame[1, 1] + offset[2] * frame[1, 2]
            z = offset[0] * frame[2, 0] + offset[1] * frame[2, 1] + offset[2] * frame[2, 2] + heights[v] * facing
            for i in range(3):
                # Sums in the order of the vertices.
                right[i] += row[i] * z
                for j in range(3):
                    normal[i, j] += row[i] * row[j]
    return normal, right


@kernel
def add_octave(
    heights: FloatArray, points: FloatArray, lattice: FloatArray, turn: FloatArray, shift: FloatArray, size: float
) -> None:
    """Add a cubic B-spline of a periodic lattice (n, n, n), n a power of two, at rotated and shifted points."""
    n = lattice.shape[0]
    flat, weights, place = lattice.ravel(), np.empty((3, 4)), np.empty((3, 4), dtype=np.uint64)
    for v in range(len(points)):
        for axis in range(3):
            x = turn[axis, 0] * points[v, 0] + turn[axis, 1] * points[v, 1] + turn[axis, 2] * points[v, 2] + shift[axis]
            whole = np.floor(x)
            t = x - whole
            s = 1.0 - t
            # B-spline weights, with s = 1 - t: s^3/6, (4 - 6 t^2 + 3 t^3)/6, (4 - 6 s^2 + 3 s^3)/6, t^3/6.
            weights[axis, 0] = s * s * s / 6.0
            weights[axis, 1] = (4.0 - 3.0 * t * t * (2.0 - t)) / 6.0
            weights[axis, 2] = (4.0 - 3.0 * s * s * (2.0 - s)) / 6.0
            weights[axis, 3] = t * t * t / 6.0
            # A cubic B-spline spans four lattice points: one before the cell, its two ends and one after. The period is
            # a power of two, so that a mask is the modulo, of negative indices too.
            for k in range(4):
                place[axis, k] = ((np.int64(whole) - 1 + k) & (n - 1)) * n ** (2 - axis)
        w, c = weights[2], place[2]
        total = 0.0
        for i in range(4):
            for j in range(4):
                base = place[0, i] + place[1, j]
                # Unrolled, which halves the time.
                line = w[0] * flat[base + c[0]] + w[1] * flat[base + c[1]] + w[2] * flat[base + c[2]]
                total += weights[0, i] * weights[1, j] * (line + w[3] * flat[base + c[3]])
        heights[v] += size * total


@kernel
def edge_crossings(
    found: FloatArray,
    facets: IndexArray,
    points: FloatArray,
    surface: SingleArray,
    centre: FloatArray,
    radius: float,
) -> int:
    """Write the points where edges of facets cross the distance ``radius`` from a centre; return their number.

    Rows of ``found`` are (smooth point, surface point). An edge is visited from both of its facets, so that a point may
    occur twice.
    """
    count = 0
    r = np.empty(3)
    for f in range(len(facets)):
        for k in range(3):
            v = facets[f, k]
            x, y, z = points[v, 0] - centre[0], points[v, 1] - centre[1], points[v, 2] - centre[2]
            r[k] = np.sqrt(x * x + y * y + z * z) - radius
        for k in range(3):
            m = (k + 1) % 3
            if (r[k] < 0.0) != (r[m] < 0.0):
                v, w = facets[f, k], facets[f, m]
                # Linear interpolation of the distance along the edge.
                t = r[k] / (r[k] - r[m])
                for x in range(3):
                    found[count, x] = (1.0 - t) * points[v, x] + t * points[w, x]
                    found[count, 3 + x] = (1.0 - t) * surface[v, x] + t * surface[w, x]
                count += 1
    return count


@kernel
def least_heights(
    least: FloatArray, vertices: SingleArray, origins: FloatArray, normals: FloatArray, layout: TileLayout
) -> None:
    """Write the least height of each tile's vertices over its plane, given by a point and a normal."""
    ids = tile_buffer(layout)
    for f in range(len(least)):
        n = number_tile(ids, f, layout)
        lowest = np.inf
        for i in range(n + 1):
            for j in range(n + 1 - i):
                v = ids[i, j]
                height = 0.0
                for axis in range(3):
                    # In double precision: the heights are small against coordinates of kilometres.
                    height += (np.float64(vertices[v, axis]) - origins[f, axis]) * normals[f, axis]
                lowest = min(lowest, height)
        least[f] = lowest
