"""A body like (433) Eros, made from formulas: long, bent, with a saddle on one side."""

from __future__ import annotations

import numpy as np

from scenarios.bodies.detail.noise import Band, fractal_field
from scenarios.bodies.topology import FloatArray, IndexArray, vertex_normals
from scenarios.geometry import TriangleMesh

_EROS_BOX_M = np.array([34_000.0, 17_000.0, 12_000.0])
_EDGE_M = 350.0
_EROS_LUMPS = Band(longest_m=9000.0, shortest_m=1500.0, hurst=1.2)
_EROS_LUMPS_RMS_M = 350.0
_EROS_LUMPS_SEED = 433
_STEPS = 4000


def eros_like() -> TriangleMesh:
    """Make a body of 34 x 17 x 12 km with even facets about 350 m wide.

    Rings of even points about a long axis that is bent like a banana are joined to a net, whose poles are the ends; a
    saddle is pressed into the hollow side, as Himeros is on Eros, lumps are added, always the same, and the whole is
    scaled to the box. The origin is the centre of volume.
    """
    along, radius = _rings()
    points, faces = _net(along, radius)
    lumps, _ = fractal_field(points, _EROS_LUMPS, 0.0, np.random.SeedSequence(_EROS_LUMPS_SEED))
    points = points + _EROS_LUMPS_RMS_M * lumps[:, None] * vertex_normals(points, faces)
    points = points * (_EROS_BOX_M / np.ptp(points, axis=0))
    return TriangleMesh(points - _centre_of_volume(points, faces), faces.astype(np.int32))


def _rings() -> tuple[FloatArray, FloatArray]:
    """Places (R,) along the axis and radii (R,) of rings a row of even triangles apart, from end to end."""
    half = 0.5 * _EROS_BOX_M[0]
    t = np.linspace(0.0, np.pi, _STEPS)
    x, r = -half * np.cos(t), 0.5 * _EROS_BOX_M[2] * np.sin(t) ** 0.8 * (1.0 - 0.12 * np.cos(t))
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(r)))])
    count = round(arc[-1] / (_EDGE_M * np.sqrt(0.75)))
    wanted = np.linspace(0.0, arc[-1], count + 1)
    return np.interp(wanted, arc, x), np.interp(wanted, arc, r)


def _net(along: FloatArray, radius: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Points (V, 3) and faces (F, 3) of rings joined to each other, with a point at each end."""
    counts = np.maximum(np.rint(2.0 * np.pi * radius / _EDGE_M).astype(int), 5)
    counts[[0, -1]] = 1
    start = np.concatenate([[0], np.cumsum(counts)])
    points = [_ring(x, r, n, 0.5 * (row % 2)) for row, (x, r, n) in enumerate(zip(along, radius, counts, strict=True))]
    faces = [
        _band(counts[row], counts[row + 1], start[row], start[row + 1], 0.5 * (row % 2), 0.5 * ((row + 1) % 2))
        for row in range(len(counts) - 1)
    ]
    return np.concatenate(points), np.concatenate(faces)


def _ring(x: float, radius: float, count: int, shift: float) -> FloatArray:
    """Points (count, 3) of a ring about the bent axis, from the azimuth of ``shift`` steps."""
    azimuth = 2.0 * np.pi * (np.arange(count) + shift) / count
    share = x / (0.5 * _EROS_BOX_M[0])
    bend_m = 0.25 * _EROS_BOX_M[1] * (share**2 - 0.5)
    saddle = (
        0.45
        * np.exp(-((share / 0.3) ** 2))
        * np.exp(-((((azimuth - 0.5 * np.pi + np.pi) % (2 * np.pi) - np.pi) / 0.8) ** 2))
    )
    r = 0.0 if count == 1 else radius
    return np.stack(
        [
            np.full(count, x),
            bend_m + r * (1.0 - saddle) * np.cos(azimuth - 0.5 * np.pi),
            r * np.sin(azimuth - 0.5 * np.pi),
        ],
        axis=1,
    )


def _band(n: int, m: int, first: int, second: int, shift: float, next_shift: float) -> IndexArray:
    """Faces between two rings of n and m points, by going round both and taking the nearer step."""
    faces, i, j = [], 0, 0
    while i < (n if n > 1 else 0) or j < (m if m > 1 else 0):
        next_i, next_j = (i + 1 + shift) / n, (j + 1 + next_shift) / m
        a, b = first + i % n, second + j % m
        if n > 1 and i < n and (m == 1 or j >= m or next_i <= next_j):
            faces.append([a, first + (i + 1) % n, b])
            i += 1
        else:
            faces.append([a, second + (j + 1) % m, b])
            j += 1
    return np.array(faces, dtype=np.int64)
