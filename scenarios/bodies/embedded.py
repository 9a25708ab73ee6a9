"""Built-in bodies from formulas: spheres, a contact binary, and bodies like Eros, Itokawa, Didymos and others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies.noise import Band, fractal_field
from boresight.scenarios.bodies.readers.pds import cube_lattice, cube_quads, weld_seams
from boresight.scenarios.bodies.topology import vertex_normals
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.mesh import unit
from boresight.scenarios.spec.body import EMBEDDED_NAMES

EMBEDDED_VERSION = 1
"""Part of the digest of every built-in body: increase it when a formula gives another mesh."""

# The contact binary.
_GRID, _FINE_GRID = 32, 64  # cells along the side of a cube face
_BISECTIONS = 50  # of 560 m: 5e-13 m
_SPHERE_ROUNDS = 4
_LUMPS = Band(longest_m=180.0, shortest_m=22.0, hurst=1.0)
_LUMPS_RMS_M = 5.0
_LUMPS_SEED = 25143

# The body like Eros.
_EROS_BOX_M = np.array([34_000.0, 17_000.0, 12_000.0])
_EDGE_M = 350.0
_EROS_LUMPS = Band(longest_m=9000.0, shortest_m=1500.0, hurst=1.2)
_EROS_LUMPS_RMS_M = 350.0
_EROS_LUMPS_SEED = 433
_STEPS = 4000  # points on the meridian, from which the rings are chosen


def eros_like() -> TriangleMesh:
    """Make a body of 34 x 17 x 12 km with facets of similar size, about 350 m wide.

    Rings of evenly spaced points about a bent long axis are joined by triangles. A saddle is subtracted on the concave
    side, as Himeros on Eros, a fractal height field with a fixed seed is added, and the mesh is scaled to the box. The
    origin is the centre of volume.
    """
    along, radius = _rings()
    points, faces = _net(along, radius)
    lumps, _ = fractal_field(points, _EROS_LUMPS, 0.0, np.random.SeedSequence(_EROS_LUMPS_SEED))
    points = points + _EROS_LUMPS_RMS_M * lumps[:, None] * vertex_normals(points, faces)
    points = points * (_EROS_BOX_M / np.ptp(points, axis=0))
    return TriangleMesh(points - _centre_of_volume(points, faces), faces.astype(np.int32))


def _rings() -> tuple[FloatArray, FloatArray]:
    """Positions (R,) along the axis and radii (R,) of rings, spaced by the height of an equilateral triangle."""
    half = 0.5 * _EROS_BOX_M[0]
    t = np.linspace(0.0, np.pi, _STEPS)
    # A meridian that is blunter than an ellipse (exponent below 1) and thicker at one end.
    x, r = -half * np.cos(t), 0.5 * _EROS_BOX_M[2] * np.sin(t) ** 0.8 * (1.0 - 0.12 * np.cos(t))
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(r)))])
    # Rings at even arc length, so that facets at the ends are no smaller than in the middle.
    count = round(arc[-1] / (_EDGE_M * np.sqrt(0.75)))
    wanted = np.linspace(0.0, arc[-1], count + 1)
    return np.interp(wanted, arc, x), np.interp(wanted, arc, r)


def _net(along: FloatArray, radius: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Points (V, 3) and faces (F, 3) of the mesh that joins the rings, with one point at each end."""
    # At least five points on a ring; the first and the last ring are the poles of the long axis.
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
    """Points (count, 3) of a ring about the bent axis, starting at the azimuth of ``shift`` steps."""
    azimuth = 2.0 * np.pi * (np.arange(count) + shift) / count
    share = x / (0.5 * _EROS_BOX_M[0])
    # The axis is a parabola.
    bend_m = 0.25 * _EROS_BOX_M[1] * (share**2 - 0.5)
    # A Gaussian dent about the middle of the length, at azimuth 90 deg.
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
    """Faces between two rings of n and m points; each triangle advances on the ring whose next azimuth is smaller."""
    faces, i, j = [], 0, 0
    # A ring of one point, an end of the body, does not advance: its triangles make a fan.
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


def icosphere(rounds: int, radius_m: float) -> TriangleMesh:
    """Make a sphere of 20 * 4**rounds facets by subdividing an icosahedron ``rounds`` times."""
    # Imported here: trimesh takes a tenth of the start-up, and most runs find their body in the cache.
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=rounds, radius=radius_m)
    return TriangleMesh(np.array(ball.vertices), np.array(ball.faces))


@dataclass(frozen=True, slots=True)
class _Lobe:
    """An ellipsoid: centre and semi-axes in metres, turned by ``yaw_deg`` about z and ``pitch_deg`` about y."""

    centre_m: tuple[float, float, float]
    semi_axes_m: tuple[float, float, float]
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0

    def distance_m(self, points_m: FloatArray) -> FloatArray:
        """Signed distance of points (N, 3), to first order in the distance: negative inside."""
        yaw, pitch = np.radians([self.yaw_deg, self.pitch_deg])
        x, y, z = (points_m - self.centre_m).T
        # To the axes of the ellipsoid: the opposite of its rotation.
        x, y = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
        x, z = np.cos(pitch) * x - np.sin(pitch) * z, np.cos(pitch) * z + np.sin(pitch) * x
        a, b, c = self.semi_axes_m
        norm = np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
        slope = np.sqrt((x / a**2) ** 2 + (y / b**2) ** 2 + (z / c**2) ** 2)
        # (norm - 1) / |gradient of norm|, the gradient being slope / norm; 1e-12 for the centre.
        distance_m: FloatArray = (norm - 1.0) * norm / np.maximum(slope, 1e-12)
        return distance_m


@dataclass(frozen=True, slots=True)
class _Lobed:
    """The smooth union of lobes, star-shaped about ``neck_m``, in a box of ``box_m``.

    Bisection along a ray from the neck finds the only crossing of the surface. ``blend_m`` is the width of the joints.
    """

    box_m: tuple[float, float, float]
    lobes: tuple[_Lobe, ...]
    blend_m: float
    neck_m: tuple[float, float, float]

    def distance_m(self, points_m: FloatArray) -> FloatArray:
        """Signed distance of points (N, 3) to the surface."""
        distances = np.stack([lobe.distance_m(points_m) for lobe in self.lobes])
        nearest, k = distances.min(axis=0), self.blend_m
        # -k log(sum exp(-d / k)), a smooth minimum; relative to the nearest lobe no exponential overflows.
        union_m: FloatArray = nearest - k * np.log(np.exp((nearest - distances) / k).sum(axis=0))
        return union_m

    def surface(self, q: int) -> tuple[FloatArray, IndexArray]:
        """Points (6 q**2 + 2, 3) where rays from the neck leave the body, by bisection, and faces (12 q**2, 3)."""
        first, group = weld_seams(q)
        # A cube grid on the unit sphere. The tangent spaces it by equal angles: cells at the corners of the cube are
        # not much smaller.
        directions = unit(np.tan(np.pi / 4.0 * (2.0 * cube_lattice(q)[first] / q - 1.0)))
        quads = group[cube_quads(q)]
        faces = np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
        directions = unit(directions * self.box_m)
        inner, outer = np.zeros(len(directions)), np.full(len(directions), self.box_m[0])
        for _ in range(_BISECTIONS):
            middle = 0.5 * (inner + outer)
            inside = self.distance_m(self.neck_m + middle[:, None] * directions) < 0.0
            inner, outer = np.where(inside, middle, inner), np.where(inside, outer, middle)
        return self.neck_m + inner[:, None] * directions, faces

    def fine(self) -> TriangleMesh:
        """Make the body with 49,152 facets."""
        return self.mesh(*self.surface(_FINE_GRID))

    def mesh(self, points_m: FloatArray, faces: IndexArray) -> TriangleMesh:
        """Scale points of the surface to the box, with the origin at the centre of volume."""
        points_m = points_m * (self.box_m / np.ptp(points_m, axis=0))
        return TriangleMesh(points_m - _centre_of_volume(points_m, faces), faces.astype(np.int32))


# A long body and a smaller head in contact with it, as on (25143) Itokawa; the other lobes break the symmetry.
_CONTACT_BINARY = _Lobed(
    (560.0, 305.0, 243.0),
    (
        _Lobe((-70.0, 0.0, 0.0), (190.0, 135.0, 112.0), yaw_deg=6.0, pitch_deg=4.0),
        _Lobe((190.0, 40.0, 10.0), (98.0, 98.0, 86.0), yaw_deg=-25.0),
        _Lobe((-150.0, -35.0, 18.0), (95.0, 90.0, 85.0)),
        _Lobe((-40.0, 60.0, -25.0), (105.0, 75.0, 70.0), yaw_deg=-20.0),
        _Lobe((225.0, -5.0, -20.0), (60.0, 65.0, 60.0)),
    ),
    blend_m=25.0,
    neck_m=(90.0, 15.0, 0.0),
)


def contact_binary() -> TriangleMesh:
    """Make an Itokawa-like body of 560 x 305 x 243 m: two lobes with a concave neck, 12,288 facets.

    A cube grid is projected, along rays from the neck, to the smooth union of a few ellipsoids; then a fractal
    height field with a fixed seed is added and the mesh is scaled to the box. The origin is the centre of volume.
    """
    points_m, faces = _CONTACT_BINARY.surface(_GRID)
    lumps, _ = fractal_field(points_m, _LUMPS, 0.0, np.random.SeedSequence(_LUMPS_SEED))
    points_m = points_m + _LUMPS_RMS_M * lumps[:, None] * vertex_normals(points_m, faces)
    return _CONTACT_BINARY.mesh(points_m, faces)


# Numbers of ours, fitted to silhouettes, box and volume (0.0177 km3) of Gaskell's (25143) Itokawa, in whole metres and
# degrees. Silhouettes overlap by 0.95, mean of intersection over union in 200 views.
_ITOKAWA = _Lobed(
    (562.0, 305.0, 243.0),
    (
        _Lobe((-112.0, -47.0, -15.0), (114.0, 66.0, 53.0), yaw_deg=-21.0, pitch_deg=-7.0),
        _Lobe((-37.0, 53.0, 26.0), (100.0, 22.0, 24.0), yaw_deg=-25.0, pitch_deg=-12.0),
        _Lobe((246.0, 19.0, -56.0), (42.0, 48.0, 24.0), yaw_deg=21.0, pitch_deg=68.0),
    ),
    blend_m=103.0,
    neck_m=(120.0, 5.0, -10.0),
)
# The same for the light-curve shape of (99942) Apophis, scaled to a volume-equivalent diameter of 375 m (0.0277 km3);
# silhouettes overlap by 0.94.
_APOPHIS = _Lobed(
    (523.0, 364.0, 314.0),
    (
        _Lobe((-97.0, 18.0, 6.0), (183.0, 85.0, 92.0), yaw_deg=18.0, pitch_deg=-28.0),
        _Lobe((126.0, -38.0, -26.0), (120.0, 77.0, 37.0), yaw_deg=67.0, pitch_deg=25.0),
    ),
    blend_m=132.0,
    neck_m=(10.0, 0.0, 0.0),
)
# A disk about the equator and a taller core: the spinning top of (101955) Bennu, 0.061 km3.
_BENNU = _Lobed(
    (565.0, 535.0, 508.0),
    (_Lobe((0.0, 0.0, 0.0), (270.0, 255.0, 115.0)), _Lobe((0.0, 0.0, 0.0), (171.0, 166.0, 240.0))),
    blend_m=56.0,
    neck_m=(0.0, 0.0, 0.0),
)
# The same of (162173) Ryugu: radii at the equator and the pole and volume of Watanabe et al. (2019), Science 364, 268.
_RYUGU = _Lobed(
    (1004.0, 1004.0, 875.0),
    (_Lobe((0.0, 0.0, 0.0), (480.0, 480.0, 225.0)), _Lobe((0.0, 0.0, 0.0), (330.0, 330.0, 415.0))),
    blend_m=100.0,
    neck_m=(0.0, 0.0, 0.0),
)
# The ellipsoid of (4) Vesta: semi-axes of Russell et al. (2012), Science 336, 684.
_VESTA = _Lobed(
    (572_600.0, 557_200.0, 446_400.0),
    (_Lobe((0.0, 0.0, 0.0), (286_300.0, 278_600.0, 223_200.0)),),
    blend_m=1000.0,
    neck_m=(0.0, 0.0, 0.0),
)
# Ellipsoids with the extents of (65803) Didymos, Daly et al. (2024), Planetary Science Journal 5, 24, and of its moon
# Dimorphos, Daly et al. (2023), Nature 616, 443.
_DIDYMOS = _Lobed((818.0, 796.0, 590.0), (_Lobe((0.0, 0.0, 0.0), (409.0, 398.0, 295.0)),), 1.0, (0.0, 0.0, 0.0))
_DIMORPHOS = _Lobed((177.0, 174.0, 116.0), (_Lobe((0.0, 0.0, 0.0), (88.5, 87.0, 58.0)),), 1.0, (0.0, 0.0, 0.0))


def sphere() -> TriangleMesh:
    """Make a sphere of 250 m radius from an icosahedron: 5,120 facets."""
    return icosphere(_SPHERE_ROUNDS, 250.0)


def apophis_sphere() -> TriangleMesh:
    """Make the sphere of 190 m radius that represents (99942) Apophis in Delpech et al. (2015): 5,120 facets."""
    return icosphere(_SPHERE_ROUNDS, 190.0)


def _centre_of_volume(points_m: FloatArray, faces: IndexArray) -> FloatArray:
    a, b, c = (points_m[faces[:, k]] for k in range(3))
    volumes = np.einsum("fi,fi->f", a, np.cross(b, c))
    # Tetrahedra between the origin and the facets: each has its centroid at (a + b + c) / 4.
    centre_m: FloatArray = np.einsum("f,fi->i", volumes, a + b + c) / (4.0 * volumes.sum())
    return centre_m


# Made once in a process: most bodies with detail start from one of them.
_LIKE = (_ITOKAWA, _APOPHIS, _BENNU, _VESTA, _DIDYMOS, _DIMORPHOS, _RYUGU)
_MAKERS = map(cache, (contact_binary, sphere, apophis_sphere, eros_like, *(body.fine for body in _LIKE)))
EMBEDDED: Mapping[str, Callable[[], TriangleMesh]] = MappingProxyType(dict(zip(EMBEDDED_NAMES, _MAKERS, strict=True)))
