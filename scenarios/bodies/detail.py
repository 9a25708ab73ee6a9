"""Surface detail: refine a coarse shape smoothly and add boulders, craters, roughness and albedo variation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.bodies.noise import Band, SmallScaleSeed, fractal_field
from boresight.scenarios.bodies.topology import (
    IntArray,
    find_edges,
    interpolating_control,
    refine,
    refine_where,
    rounds_for,
    smoothed,
    smoothstep,
    tangent_axes,
    vertex_normals,
)
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.mesh import unit
from boresight.scenarios.spec.body import AlbedoSpec, BoulderSpec, CraterSpec, DetailSpec, SiteSpec

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SIDES = 7  # of a boulder's footprint
_TOPS = 3  # planes that bound a boulder's top
# Share of the half-width over which a boulder rises. With height_ratio 0.35 the slope at its foot is 67 deg: the rise
# is r (2 - r), of slope 2 / 0.6 per half-width, times 0.35 diameters.
_WALL = 0.6
_RIM_WIDTH = 0.4  # width of the rounded rim, in crater radii
_SITE_FADES = 0.2  # share of a site's radius
_CRATER_REACH = 3.0  # the ejecta blanket ends at this many radii

_PAIRS_AT_ONCE = 4_000_000  # of a feature and a vertex, which bounds the memory
# A ball about a feature may include the opposite side of a thin part; this cosine between normals excludes it.
_LEAST_FACING = 0.2


@dataclass(frozen=True, eq=False)
class RefinedSurface:
    """The refined smooth surface that features are added to.

    ``points_m`` (V, 3) are its vertices, ``up`` (V, 3) the unit vectors along which they are displaced, ``edge_m`` the
    mean length of an edge. Features are placed on the surface before refinement, ``coarse_m`` and ``coarse_faces``, so
    that their positions do not depend on the number of facets. With a ``site``, its centre and radius, m, the first
    ``even`` vertices are those of the surface without it, and only features that reach it are wanted.
    """

    points_m: FloatArray
    up: FloatArray
    edge_m: float
    coarse_m: FloatArray
    coarse_faces: IntArray
    even: int | None = None
    site: tuple[FloatArray, float] | None = None

    @property
    def resolution_m(self) -> float:
        """Smallest feature that the mesh resolves: two edges."""
        return 2.0 * self.edge_m

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree over the points."""
        from scipy.spatial import cKDTree  # 0.3 s, which commands that read coarse shapes do without

        return cKDTree(self.points_m, balanced_tree=False, compact_nodes=False)

    def draw_places(self, count: int, rng: np.random.Generator) -> IndexArray:
        """Draw vertex indices (count,), uniformly over the area of the coarse surface."""
        corners = self.coarse_m[self.coarse_faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        # Inversion of the cumulated area; twice the areas do as well.
        face = np.searchsorted(np.cumsum(area), rng.uniform(0.0, area.sum(), count))
        weights = rng.dirichlet(np.ones(3), count)  # uniform over each triangle
        places = np.einsum("nk,nki->ni", weights, corners[np.minimum(face, len(area) - 1)])
        return np.asarray(self.tree.query(places)[1], dtype=np.int64)

    def wanted(self, places: IndexArray, reach_m: FloatArray) -> IndexArray:
        """Return which of the features at vertices (N,), with effect up to ``reach_m`` (N,), are wanted."""
        if self.site is None:
            return np.arange(len(places))
        centre_m, radius_m = self.site
        return np.flatnonzero(np.linalg.norm(self.points_m[places] - centre_m, axis=1) <= radius_m + reach_m)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureVertices:
    """Pairs, (P,), of a feature and a vertex within its radius of influence, (P, 3) ``offset_m`` from its centre."""

    feature: IndexArray
    vertex: IndexArray
    offset_m: FloatArray


def power_law_diameters(
    count: int, low_m: float, high_m: float, exponent: float, rng: np.random.Generator
) -> FloatArray:
    """Draw diameters between two bounds whose cumulative number falls as D**-exponent, largest first."""
    # Inversion: D**-exponent is uniform where the cumulative number falls as D**-exponent.
    least, most = high_m**-exponent, low_m**-exponent
    return np.sort(rng.uniform(least, most, count) ** (-1.0 / exponent))[::-1]


def find_feature_vertices(ground: RefinedSurface, places: IndexArray, reach_m: FloatArray) -> Iterator[FeatureVertices]:
    """Yield the vertices within ``reach_m`` (N,) of each vertex of ``places`` (N,), in blocks of bounded memory."""
    # Expected vertices within a radius r of a mesh of edge a: pi r^2 / (0.87 a^2) is 3.6 (r / a)^2.
    wanted = ground.wanted(places, reach_m)
    pairs = np.cumsum(4.0 * (reach_m[wanted] / ground.edge_m) ** 2 + 1.0)
    block = (pairs / _PAIRS_AT_ONCE).astype(np.int64)
    for features in np.split(wanted, np.flatnonzero(np.diff(block)) + 1):
        found = ground.tree.query_ball_point(ground.points_m[places[features]], reach_m[features], return_sorted=True)
        feature = np.repeat(features, [len(vertices) for vertices in found])
        vertex = np.fromiter((v for vertices in found for v in vertices), np.int64, len(feature))
        facing = np.einsum("ni,ni->n", ground.up[vertex], ground.up[places[feature]]) > _LEAST_FACING
        feature, vertex = feature[facing], vertex[facing]
        yield FeatureVertices(feature, vertex, ground.points_m[vertex] - ground.points_m[places[feature]])


def boulder_heights(
    spec: BoulderSpec, ground: RefinedSurface, seed: np.random.SeedSequence, small: SmallScaleSeed | None = None
) -> tuple[FloatArray, int]:
    """Heights (V,) of boulders, the maximum where two overlap; and how many are too small for the mesh and left out."""
    places, diameters_m, kept, rng = _scatter(spec, ground, seed, small)
    blocks = _draw_blocks(spec, ground, places, diameters_m, rng)
    heights = np.zeros(len(ground.points_m))
    for patches in find_feature_vertices(ground, places[:kept], 0.5 * diameters_m[:kept]):
        # Several boulders can cover a vertex; plain indexing would keep the last of them.
        np.maximum.at(heights, patches.vertex, blocks.heights_m(patches))
    return heights, spec.count - kept


def crater_heights(
    spec: CraterSpec, ground: RefinedSurface, seed: np.random.SeedSequence, small: SmallScaleSeed | None = None
) -> tuple[FloatArray, int]:
    """Heights (V,) of bowls with raised rims, added up where they overlap; and how many are too small and left out."""
    places, diameters_m, kept, _ = _scatter(spec, ground, seed, small)
    heights = np.zeros(len(ground.points_m))
    for patches in find_feature_vertices(ground, places[:kept], 0.5 * _CRATER_REACH * diameters_m[:kept]):
        diameter_m = diameters_m[patches.feature]
        radii = np.linalg.norm(patches.offset_m, axis=1) / (0.5 * diameter_m)
        heights += np.bincount(patches.vertex, diameter_m * _crater_profile(radii, spec), len(heights))
    return heights, spec.count - kept


def _scatter(
    spec: BoulderSpec | CraterSpec, ground: RefinedSurface, seed: np.random.SeedSequence, small: SmallScaleSeed | None
) -> tuple[IndexArray, FloatArray, int, np.random.Generator]:
    """Draw positions and diameters, largest first, and count those that the mesh resolves."""
    rng = np.random.default_rng(seed)
    diameters_m, places = _draw_sizes_and_places(spec, ground, rng)
    if small is not None:
        _, elsewhere = _draw_sizes_and_places(spec, ground, np.random.default_rng(small.seed))
        # Sizes stay those of the known population; the small ones stand elsewhere.
        places = np.where(diameters_m < small.below_m, elsewhere, places)
    return places, diameters_m, int(np.count_nonzero(diameters_m >= ground.resolution_m)), rng


def _draw_sizes_and_places(
    spec: BoulderSpec | CraterSpec, ground: RefinedSurface, rng: np.random.Generator
) -> tuple[FloatArray, IndexArray]:
    diameters_m = power_law_diameters(spec.count, spec.min_diameter_m, spec.max_diameter_m, spec.exponent, rng)
    return diameters_m, ground.draw_places(spec.count, rng)


def _crater_profile(radii: FloatArray, spec: CraterSpec) -> FloatArray:
    """Height over diameter: a paraboloid inside, an inverse-cube ejecta blanket outside, blended at the rim."""
    # From the rim's height down to rim minus depth in the centre.
    bowl = spec.rim_ratio - spec.depth_ratio * np.maximum(1.0 - radii**2, 0.0)
    # The blanket r^-3 is lowered so that it ends at height 0, and scaled back to the rim's height at r = 1.
    end = _CRATER_REACH**-3
    blanket = spec.rim_ratio * (np.maximum(radii, 1.0) ** -3 - end) / (1.0 - end)
    outside = smoothstep((radii - 1.0) / _RIM_WIDTH + 0.5)
    return (1.0 - outside) * bowl + outside * np.maximum(blanket, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """N boulders with a rounded polygonal footprint, steep walls and a top of several tilted planes.

    ``axes_per_m`` (N, 2, 3) are two tangent unit vectors, divided by the half-widths along them; ``sides`` (N, 7, 2)
    outward normals of the footprint's sides, divided by their distances from the centre; ``tops`` (N, 3, 3) planes
    (constant, two slopes) over the footprint, of which the minimum is the top.
    """

    axes_per_m: FloatArray
    sides: FloatArray
    tops: FloatArray
    height_m: FloatArray

    def heights_m(self, patches: FeatureVertices) -> FloatArray:
        """Height of the block over each pair's vertex."""
        block = patches.feature
        x, y = (np.einsum("ni,ni->n", self.axes_per_m[block, k], patches.offset_m) for k in range(2))
        # An L8 norm of the side distances rounds the polygon's corners; its circular term bounds the footprint.
        norm = (x * x + y * y) ** 4
        for k in range(_SIDES):
            side = np.maximum(self.sides[block, k, 0] * x + self.sides[block, k, 1] * y, 0.0)
            norm += ((side * side) ** 2) ** 2
        rise = np.clip((1.0 - norm**0.125) / _WALL, 0.0, 1.0)
        # The minimum of planes is a convex top with ridges.
        tops = (self.tops[block, k, 0] + self.tops[block, k, 1] * x + self.tops[block, k, 2] * y for k in range(_TOPS))
        top = np.minimum.reduce(list(tops))
        heights_m: FloatArray = self.height_m[block] * rise * (2.0 - rise) * np.maximum(top, 0.0)
        return heights_m


def _draw_blocks(
    spec: BoulderSpec, ground: RefinedSurface, places: IndexArray, diameters_m: FloatArray, rng: np.random.Generator
) -> _Blocks:
    count = len(diameters_m)
    first, second = tangent_axes(ground.up[places], rng.uniform(0.0, 2.0 * np.pi, count))
    narrow = rng.uniform(0.65, 1.0, (count, 1))
    axes = np.stack([first, second / narrow], axis=1) / (0.5 * diameters_m)[:, None, None]
    angle = 2.0 * np.pi * (np.arange(_SIDES) + rng.uniform(-0.35, 0.35, (count, _SIDES))) / _SIDES
    distance = rng.uniform(0.7, 1.0, (count, _SIDES))
    sides = np.stack([np.cos(angle), np.sin(angle)], axis=-1) / distance[..., None]
    tops = np.concatenate(
        [rng.uniform(0.8, 1.1, (count, _TOPS, 1)), rng.uniform(-0.5, 0.5, (count, _TOPS, 2))], axis=-1
    )
    height_m = spec.height_ratio * diameters_m * rng.uniform(0.6, 1.4, count)
    return _Blocks(axes, sides, tops, height_m)


__all__ = ["DETAIL_VERSION", "add_detail"]

DETAIL_VERSION = 1
"""Part of the digest of every detailed body: increase it when the same spec gives another mesh."""

_MAX_SMOOTHING_ROUNDS = 100
# Albedo: a field of five octaves with amplitudes proportional to the root of the wavelength.
_ALBEDO_HURST = 0.5
_ALBEDO_OCTAVES = 5
_ALBEDO_RANGE = (0.2, 2.0)


def add_detail(mesh: TriangleMesh, spec: DetailSpec) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Refine a closed mesh and displace its vertices; the same seed gives the same body, bit for bit.

    The refined surface is Loop's, fitted so that it passes through the coarse vertices (see `interpolating_control`).
    Each vertex is then displaced along one direction, the coarse surface's normal smoothed over twice the height of the
    relief, by the sum of boulders, craters and roughness. The relief is a height field and has no overhangs. Features
    smaller than two edges of the refined mesh are left out. A site has finer facets, and the features that these
    resolve.

    Return the detailed mesh, and a note for each kind of feature of which some are too small for it. Raise
    BoresightError if both the mesh and the spec have an albedo, or the site is not finer than the rest.
    """
    if mesh.albedo is not None and spec.albedo is not None:
        raise BoresightError("detail.albedo: the shape has an albedo of its own; remove the key")
    ground, faces, coarse_albedo = _refined(mesh, spec)
    heights, drawn, notes = _relief(ground, spec)
    points_m, factor = ground.points_m + heights[:, None] * ground.up, coarse_albedo if drawn is None else drawn
    detailed = TriangleMesh(points_m, faces.astype(np.int32), factor)
    return (detailed, notes) if spec.site is None else _with_site(detailed, notes, ground, spec, spec.site)


def _with_site(
    mesh: TriangleMesh, notes: tuple[str, ...], ground: RefinedSurface, spec: DetailSpec, site: SiteSpec
) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Refine the facets of a site and move their vertices to the relief that they resolve."""
    if site.edge_m >= ground.edge_m:
        raise BoresightError(
            f"detail.site.edge_m: {site.edge_m:g} m is not below the {ground.edge_m:.3g} m of all facets; lower it, or"
            " remove detail.site"
        )
    towards = unit(np.array(site.direction))
    centre_m = TriangleMesh(ground.points_m, mesh.faces).distance_along_m(towards) * towards
    columns = [ground.points_m, ground.up, mesh.vertices_m] + ([] if mesh.albedo is None else [mesh.albedo[:, None]])

    def is_near(corners_m: FloatArray, reach_m: FloatArray) -> BoolArray:
        near: BoolArray = np.linalg.norm(corners_m.mean(axis=1) - centre_m, axis=1) <= site.radius_m + reach_m
        return near

    fine, faces = refine_where(np.hstack(columns), mesh.faces, site.edge_m, is_near)
    points_m, up, before_m = fine[:, :3], unit(fine[:, 3:6]), fine[:, 6:9]
    finer = replace(
        ground, points_m=points_m, up=up, edge_m=site.edge_m, even=len(ground.points_m), site=(centre_m, site.radius_m)
    )
    heights, drawn, further = _relief(finer, spec)
    inside = (site.radius_m - np.linalg.norm(points_m - centre_m, axis=1)) / (_SITE_FADES * site.radius_m)
    share = smoothstep(inside)[:, None]
    # As a step from the surface without the site, which is thus left as it is where the share is 0.
    moved_m = before_m + share * (points_m + heights[:, None] * up - before_m)
    factor = None if mesh.albedo is None else fine[:, 9]
    if factor is not None and drawn is not None:
        factor = factor + share[:, 0] * (drawn - factor)
    notes = (*notes, *(f"at the site: {note}" for note in further))
    return TriangleMesh(moved_m, faces.astype(np.int32), factor), notes


def _relief(ground: RefinedSurface, spec: DetailSpec) -> tuple[FloatArray, FloatArray | None, tuple[str, ...]]:
    """Heights (V,) of all features, factor (V,) on the albedo if it varies, and notes on features left out."""
    # One stream for each kind of feature: adding a kind leaves the others as they are.
    boulders, craters, roughness, albedo = np.random.SeedSequence(spec.seed).spawn(4)
    seeds = [] if spec.redrawn is None else np.random.SeedSequence(spec.redrawn.seed).spawn(4)
    small = [SmallScaleSeed(spec.redrawn.below_m, seed) for seed in seeds] if spec.redrawn is not None else [None] * 3
    small_boulders, small_craters, small_roughness = small[:3]
    heights = np.zeros(len(ground.points_m))
    omitted = {}
    if spec.craters is not None:
        relief, omitted["craters"] = crater_heights(spec.craters, ground, craters, small_craters)
        heights += relief
    if spec.boulders is not None:
        relief, omitted["boulders"] = boulder_heights(spec.boulders, ground, boulders, small_boulders)
        heights += relief
    if spec.roughness is not None:
        band = Band(spec.roughness.max_wavelength_m, spec.roughness.min_wavelength_m, spec.roughness.hurst)
        relief, omitted["octaves of roughness"] = fractal_field(
            ground.points_m, band, ground.resolution_m, roughness, small_roughness, ground.even
        )
        heights += spec.roughness.rms_m * relief
    factor = None
    if spec.albedo is not None:
        factor, omitted["octaves of albedo"] = _albedo(spec.albedo, ground, albedo)
    notes = tuple(
        f"{count} {what} are smaller than two facet edges ({ground.resolution_m:.3g} m) and were left out"
        for what, count in omitted.items()
        if count
    )
    return heights, factor, notes


def _refined(mesh: TriangleMesh, spec: DetailSpec) -> tuple[RefinedSurface, IntArray, FloatArray | None]:
    """Return the refined surface with its displacement directions, its faces, and the refined albedo or None."""
    coarse_m, coarse_faces = mesh.vertices_m, mesh.faces
    # Directions are smoothed on the coarse mesh, so that they do not depend on the number of facets.
    edges = find_edges(coarse_faces)
    coarse_edge_m = float(edges.lengths(coarse_m).mean())
    # n rounds of averaging over neighbours spread a value over about sqrt(n) edges.
    smoothing = min(_MAX_SMOOTHING_ROUNDS, int(np.ceil((2.0 * _relief_m(spec) / coarse_edge_m) ** 2)))
    up = unit(smoothed(vertex_normals(coarse_m, coarse_faces), edges, smoothing))
    rounds = rounds_for(len(coarse_faces), spec.facets)
    control = interpolating_control(coarse_m, coarse_faces) if rounds else coarse_m
    # Positions, directions and albedo are subdivided by the same weights.
    columns = [control, up] if mesh.albedo is None else [control, up, mesh.albedo[:, None]]
    fine, faces = refine(np.hstack(columns), coarse_faces, rounds)
    ground = RefinedSurface(fine[:, :3], unit(fine[:, 3:6]), coarse_edge_m / 2**rounds, coarse_m, coarse_faces)
    return ground, faces, None if mesh.albedo is None else fine[:, 6]


def _relief_m(spec: DetailSpec) -> float:
    """Greatest height or depth that the features of a spec reach."""
    boulders = spec.boulders.max_diameter_m * spec.boulders.height_ratio if spec.boulders else 0.0
    craters = spec.craters.max_diameter_m * spec.craters.depth_ratio if spec.craters else 0.0
    return max(boulders, craters, 3.0 * spec.roughness.rms_m if spec.roughness else 0.0)


def _albedo(spec: AlbedoSpec, ground: RefinedSurface, seed: np.random.SeedSequence) -> tuple[FloatArray, int]:
    """Factor (V,) on the reflectance, and the number of octaves left out."""
    shortest_m = spec.wavelength_m / 2 ** (_ALBEDO_OCTAVES - 1)
    band = Band(spec.wavelength_m, shortest_m, _ALBEDO_HURST)
    field, omitted = fractal_field(ground.points_m, band, ground.resolution_m, seed, even=ground.even)
    return np.clip(1.0 + spec.sigma * field, *_ALBEDO_RANGE), omitted
