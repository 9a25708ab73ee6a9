"""Random crater populations, and the relief of a surface with them: profiles from the oldest on, and roughness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgesv
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies.noise import Band
from boresight.scenarios.bodies.topology import tangent_axes
from boresight.scenarios.craters.kernels import add_crater, add_octave, rim_equations
from boresight.scenarios.craters.tiles import Tiling
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.mesh import unit
from boresight.scenarios.spec.body import RoughnessSpec
from boresight.scenarios.spec.craters import CratersSpec

_ROOM, _LEAST_FACING = 1.2, 0.5  # radii about a crater, and cosine of 60 deg
_MOST_DRAWS = 200  # of the place of a crater
_SCATTER = 0.25  # share of the depth range that is random; the rest follows from degradation


@dataclass(frozen=True, slots=True, eq=False)
class Craters:
    """n craters from the oldest to the youngest.

    ``centre_m`` (n, 3) are on the smooth surface, body frame, with its unit normals ``axis_body`` (n, 3); ``radius_m``
    (n,) is that of the crest. ``degradation`` (n,) goes from 0 (fresh) to 1, descending with decreasing age.
    ``depth_ratio`` (n,) is depth over diameter, from the crest to the floor.
    """

    centre_m: FloatArray
    axis_body: FloatArray
    radius_m: FloatArray
    degradation: FloatArray
    depth_ratio: FloatArray

    def __len__(self) -> int:
        return len(self.radius_m)


def draw_craters(spec: CratersSpec, smooth: TriangleMesh, up: FloatArray) -> Craters:
    """Draw a population, uniform over the area of a smooth surface with unit normals ``up`` (V, 3) at its vertices.

    Ages are uniform; degradation is proportional to age. Diameters follow a truncated power law. A crater is drawn
    again at another place if the surface normal within 1.2 radii deviates by 60 deg or more. Raise BoresightError if
    the body is too strongly curved everywhere for one of the craters.
    """
    rng = np.random.default_rng(np.random.SeedSequence(spec.seed).spawn(1)[0])
    n = spec.count
    # Inversion of N(>D) ~ D**-exponent between the bounds: D**-exponent is uniform.
    least, most = spec.max_diameter_m**-spec.exponent, spec.min_diameter_m**-spec.exponent
    diameter_m = rng.uniform(least, most, n) ** (-1.0 / spec.exponent)
    centre_m, axis_body = _places(smooth, up, n, rng)
    # Sorted from old to young: positions and sizes, drawn independently, need no sorting.
    degradation = np.sort(rng.uniform(0.0, 1.0, n))[::-1]
    low, high = spec.depth_ratio
    # Share of the range of depths: 0 for the shallowest, 1 for the deepest.
    share = (1.0 - _SCATTER) * (1.0 - degradation) + _SCATTER * rng.uniform(0.0, 1.0, n)
    _move_from_edges(centre_m, axis_body, 0.5 * diameter_m, smooth, up, rng)
    return Craters(centre_m, axis_body, 0.5 * diameter_m, degradation, low + (high - low) * share)


def _places(smooth: TriangleMesh, up: FloatArray, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw points (n, 3), uniform over the area, and the unit normals there."""
    area = np.cumsum(smooth.areas_m2)
    facet = np.minimum(np.searchsorted(area, rng.uniform(0.0, area[-1], n)), len(area) - 1)
    weights = rng.dirichlet(np.ones(3), n)  # uniform over each triangle
    corners = smooth.faces[facet]
    points = np.einsum("nk,nki->ni", weights, smooth.vertices_m[corners])
    return points, unit(np.einsum("nk,nki->ni", weights, up[corners]))


def _move_from_edges(
    centre_m: FloatArray,
    axis_body: FloatArray,
    radius_m: FloatArray,
    smooth: TriangleMesh,
    up: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Redraw positions in place until the surface is flat enough about each crater."""
    tree = cKDTree(smooth.vertices_m)
    left = np.arange(len(radius_m))
    for _ in range(_MOST_DRAWS):
        near = tree.query_ball_point(centre_m[left], _ROOM * radius_m[left])
        steep = [
            bool(len(rows)) and float((up[rows] @ axis_body[crater]).min()) < _LEAST_FACING
            for crater, rows in zip(left, near, strict=True)
        ]
        left = left[np.array(steep, dtype=bool)]
        if not len(left):
            return
        centre_m[left], axis_body[left] = _places(smooth, up, len(left), rng)
    raise BoresightError(
        f"craters.max_diameter_m: the body has no place for a crater of {2.0 * radius_m[left].max():.4g} m: it turns"
        " away within the rim everywhere; make it smaller"
    )


_LATTICE = 64  # points along each side of a periodic lattice; a power of two, as `add_octave` needs
_SPLINE_RMS = 0.3321
"""RMS of a cubic B-spline of white noise of variance 1: (151 / 315)^(3/2) = 0.3319 by the mean squares of its weights.

The value in use is 0.06 % higher, which makes the roughness as much lower; another one would change every surface.
"""

REACH = 3.0
"""The ejecta blanket ends at this many radii."""

_TAPER_FROM = 2.0  # radii at which the blanket begins to be faded out
_FRESH_ROUNDING, _OLD_ROUNDING = 0.03, 0.08  # w
_OLD_RIM = 0.5  # of a fresh rim's height
_BISECTIONS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """n crater profiles: height, in diameters, over the distance r from the centre, in radii.

    A paraboloid b(r) = k - (1 - r^2) and a blanket e(r) = k sqrt(1.5 / (0.5 + r^6)), which falls as r^-3 (McGetchin,
    Settle and Head 1973, Earth Planet. Sci. Lett. 20, 226), meet in a crest rounded over a width w, s(r) = (b + e) / 2
    - sqrt((b - e)^2 / 4 + w^2). A crater that decays by the creep of its regolith (Soderblom 1970, J. Geophys. Res. 75,
    2655; Fassett and Thomson 2014, J. Geophys. Res. Planets 119, 2255) gets a lower and rounder rim. Distance and
    height are scaled so that the crest, where s is greatest, lies at r = 1 and the floor a given depth below it:
    ``rim`` is k, ``rounding`` w, ``stretch`` the r at which s is greatest before the scaling, ``scale`` the factor on
    s, (n,) each.
    """

    rim: FloatArray
    rounding: FloatArray
    stretch: FloatArray
    scale: FloatArray

    @classmethod
    def of(
        cls, degradation: FloatArray, depth_ratio: FloatArray, rim_ratio: float, fresh_depth_ratio: float
    ) -> Profiles:
        """Make profiles of degradations (n,), 0 to 1, and depths (n,) over diameter."""
        # In units of the depth of a fresh crater: the bowl is 1 deep before the scaling.
        rim = rim_ratio / fresh_depth_ratio * (1.0 - (1.0 - _OLD_RIM) * degradation)
        rounding = _FRESH_ROUNDING + (_OLD_ROUNDING - _FRESH_ROUNDING) * degradation
        stretch = _crest(rim, rounding)
        one = np.ones_like(rim)
        # From the crest to the floor, before the scaling.
        depth = _rounded(rim, rounding, stretch) - _rounded(rim, rounding, 0.0 * one)
        return cls(rim, rounding, stretch, depth_ratio / depth)

    def heights(self, r: FloatArray) -> FloatArray:
        """Heights (n, m), in diameters, at distances (n, m) or (m,) in radii."""
        rim, rounding, stretch, scale = (x[:, None] for x in (self.rim, self.rounding, self.stretch, self.scale))
        taper = np.clip((REACH - r) / (REACH - _TAPER_FROM), 0.0, 1.0)
        return np.asarray(scale * _rounded(rim, rounding, r * stretch) * taper * taper * (3.0 - 2.0 * taper))


def _rounded(rim: FloatArray, rounding: FloatArray, r: FloatArray) -> FloatArray:
    bowl = rim - (1.0 - r * r)
    blanket = rim * np.sqrt(1.5 / (0.5 + r**6))
    return np.asarray(0.5 * (bowl + blanket) - np.sqrt(0.25 * (bowl - blanket) ** 2 + rounding**2))


def _crest(rim: FloatArray, rounding: FloatArray) -> FloatArray:
    """Find the maximum of s at r > 0 by bisection of its derivative."""
    low, high = np.full_like(rim, 0.5), np.full_like(rim, 2.5)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        half = 0.5 * (rim - (1.0 - middle**2) - rim * np.sqrt(1.5 / (0.5 + middle**6)))
        bowl, blanket = 2.0 * middle, -3.0 * rim * np.sqrt(1.5) * middle**5 * (0.5 + middle**6) ** -1.5
        # ds/dr = (b' + e') / 2 - (b - e)(b' - e') / (4 sqrt((b - e)^2 / 4 + w^2)), with half = (b - e) / 2.
        rises = 0.5 * (bowl + blanket) - 0.5 * half * (bowl - blanket) / np.sqrt(half**2 + rounding**2) > 0.0
        low, high = np.where(rises, middle, low), np.where(rises, high, middle)
    return 0.5 * (low + high)


def crater_frames(craters: Craters) -> FloatArray:
    """(n, 3, 3) axes of each crater, the last one up."""
    first, second = tangent_axes(craters.axis_body, np.zeros(len(craters)))
    return np.stack([first, second, craters.axis_body], axis=1)


def crater_relief(
    spec: CratersSpec, craters: Craters, tiling: Tiling, points_m: FloatArray, up: FloatArray
) -> FloatArray:
    """Heights (N,) along ``up`` after all impacts, over the smooth surface.

    A crater replaces the old relief within its rim and is added to it outside, as in the model of Howard (2007,
    Geomorphology 91, 332) with an inheritance that grows from 0, within half the radius, to 1 at the rim. The new bowl
    is measured from the least-squares plane of the old surface about the rim, so that depths are right on slopes and
    on the curved body. Distances r are chords.
    """
    heights = np.zeros(len(points_m))
    profiles = Profiles.of(craters.degradation, craters.depth_ratio, spec.rim_ratio, spec.depth_ratio[1])
    shapes = np.stack([profiles.rim, profiles.rounding, profiles.stretch, profiles.scale], axis=1)
    middles, runs = tiling.runs
    tree = cKDTree(middles, balanced_tree=False, compact_nodes=False)
    frames = crater_frames(craters)
    for k in range(len(craters)):
        # Runs of vertices whose centres are so near may have a vertex within reach.
        reach_m = REACH * craters.radius_m[k] + tiling.reach_m
        # Sorted, as sums over the vertices must not depend on the order of the tree.
        near = np.sort(np.asarray(tree.query_ball_point(craters.centre_m[k], reach_m), dtype=np.int64))
        place = heights, points_m, up, runs[near], craters.centre_m[k], frames[k], float(craters.radius_m[k])
        _, _, plane, failed = dgesv(*rim_equations(*place))
        if failed:
            raise np.linalg.LinAlgError("Matrix is singular to machine precision.")
        add_crater(*place, shapes[k], plane)
    return heights


def add_roughness(
    heights_m: FloatArray, points_m: FloatArray, spec: RoughnessSpec, seed: np.random.SeedSequence
) -> None:
    """Add a band-limited random field to heights (N,): octaves of cubic splines of white noise on lattices."""
    band = Band(spec.max_wavelength_m, spec.min_wavelength_m, spec.hurst)
    octaves = zip(band.wavelengths_m, band.amplitudes, seed.spawn(len(band.wavelengths_m)), strict=True)
    for wavelength_m, amplitude, stream in octaves:
        rng = np.random.default_rng(stream)
        lattice = rng.standard_normal((_LATTICE,) * 3, dtype=np.float32).astype(np.float64)
        # Two lattice steps make a wavelength.
        steps_per_m = 2.0 / wavelength_m
        turn, shift = Rotation.random(rng=rng).as_matrix() * steps_per_m, rng.uniform(0.0, _LATTICE, 3)
        add_octave(heights_m, points_m, lattice, turn, shift, float(spec.rms_m * amplitude / _SPLINE_RMS))
