"""Build a data base of maplets from a shape: choose their places and sample heights and albedo there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial import cKDTree

from boresight.estimators.contract import NoProductError
from boresight.estimators.maplets.database import MapletDatabase
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.spec.base import SpecModel, length, optional

METHOD = "shape-maplets"
METHOD_VERSION = 2

_LEAST_GAIN = 0.003  # share of its facets that a further maplet must cover for the first time
_LEAST_FACING = 0.1  # cosine of the angle between a facet's normal and a maplet's
_EDGE_TOLERANCE = 1e-9
_BLOCK = 256  # points that are passed over together


class MapletOptions(SpecModel):
    """Options of the maplets of a shape."""

    source: Literal["shape", "survey"] = optional(
        "Albedo of the maplets: the shape's, or that with which they look like the real images of the"
        " scenario's images.survey; only places in these are then covered",
        "shape",
    )
    spacing_m: float = length(2.4, "Between neighbouring heights", px=1.9, body=0.01, gt=0)
    side: int = Field(25, ge=5, le=999, description="Heights along each side of a maplet, odd")
    seed: int | None = Field(None, ge=0, description="Seed of the first place; default: the farthest from the origin")
    separation: float = Field(0.6, gt=0, le=1, description="Least distance of two centres, as a share of the width")

    @model_validator(mode="after")
    def _odd(self) -> Self:
        if self.side % 2 == 0:
            raise ValueError("side must be odd, so that a height lies in the middle")
        return self

    @property
    def width_m(self) -> float:
        """Width of a maplet, m."""
        return (self.side - 1) * self.spacing_m


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A square grid of S x S nodes in a local frame; S is odd, so that its middle, ``centre_m``, is a node.

    ``centre_m`` (3,) is in the body frame. The rows of ``axes`` (3, 3) are the unit vectors x and y along the columns
    and the rows of the grid, and the upward normal, right-handed, body frame. ``spacing_m`` is between neighbouring
    nodes.
    """

    centre_m: FloatArray
    axes: FloatArray
    spacing_m: float
    side: int

    @property
    def half_m(self) -> float:
        """From the centre to an edge of the grid."""
        return 0.5 * (self.side - 1) * self.spacing_m


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh to sample heights from, with a search tree of its facets."""

    mesh: TriangleMesh

    @cached_property
    def centroids_m(self) -> FloatArray:
        """(F, 3) middles of the facets."""
        return np.asarray(self.mesh.corners_m.mean(axis=1), dtype=np.float64)

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the facets' middles."""
        return cKDTree(self.centroids_m)

    @cached_property
    def reach_m(self) -> float:
        """The largest distance of a facet's corner from its middle."""
        return float(np.linalg.norm(self.mesh.corners_m - self.centroids_m[:, None], axis=2).max())

    def mean_normal(self, centre_m: FloatArray, radius_m: float) -> FloatArray:
        """Return the mean unit normal (3,) of the surface within a radius of a point, weighted by area.

        Facets that face away from the nearest one belong to another part of the body and are left out.
        """
        nearest = int(self.tree.query(centre_m)[1])
        near = np.asarray(self.tree.query_ball_point(centre_m, radius_m), dtype=np.int64)
        area_vectors = self.mesh.area_vectors_m2[near]
        total = area_vectors[area_vectors @ self.mesh.area_vectors_m2[nearest] > 0.0].sum(axis=0)
        if not total.any():
            total = self.mesh.area_vectors_m2[nearest]
        unit: FloatArray = total / np.linalg.norm(total)
        return unit


def build_maplets(
    mesh: TriangleMesh, options: MapletOptions, wanted: NDArray[np.bool_] | None = None
) -> MapletDatabase:
    """Cut maplets out of a shape so that they cover it, or its ``wanted`` facets (F,).

    Candidates cover the surface at half the wanted separation. They are accepted in descending order of relief, unless
    an accepted one is too near (Poisson-disc sampling that prefers contrast); then others fill the gaps. Raise
    NoProductError if the shape is smaller than a maplet, or than the steps of its grid.
    """
    surface = Surface(mesh)
    separation_m = options.separation * options.width_m
    facets = np.arange(len(mesh.faces)) if wanted is None else np.flatnonzero(wanted)
    if not len(facets):
        raise NoProductError(
            "the images show the middle of no facet at less than 70 deg from its normal: give smaller facets"
        )
    places = facets[spread_points(surface.centroids_m[facets], 0.5 * separation_m, options.seed)]
    candidates = _cut(surface, places, options)
    strength = [relief(heights, options.spacing_m) for heights in candidates.heights_m]
    order = sorted(range(len(candidates)), key=lambda i: -strength[i])
    # Strong relief first: maplets with contrast are matched more accurately.
    taken = _separated(candidates.centres_m, order, separation_m)
    taken += _gap_fillers(candidates, taken, surface, facets)
    chosen = candidates.subset(np.array(taken))
    if not len(chosen.mesh().faces):
        raise NoProductError(
            f"the shape is too small for maplets with nodes {options.spacing_m:g} m apart, which span no facet: lower"
            f" the option spacing_m ({options.spacing_m:g}) of the maplets"
        )
    provenance = {
        "method": METHOD,
        "method_version": METHOD_VERSION,
        "options": options.model_dump(mode="json", exclude_none=True),
        "shape_facets": len(mesh.faces),
        "candidates": len(candidates),
    }
    return replace(chosen, provenance=provenance)


def sample_heights(surface: Surface, plane: Plane) -> tuple[FloatArray, FloatArray | None]:
    """Sample the heights of the surface above the nodes of a plane, and its albedo there.

    Of several layers of the surface the highest is sampled that faces up and is no farther from the plane than half the
    grid's width. Return heights (S, S), m, rows along y, NaN where there is no surface, and the albedo (S, S), None
    where the mesh has none.
    """
    mesh = surface.mesh
    # To the corners of the box of half the grid's width above and below the plane, plus the size of a facet.
    reach_m = float(np.hypot(np.sqrt(2.0) * plane.half_m, plane.half_m)) + surface.reach_m
    near = np.asarray(surface.tree.query_ball_point(plane.centre_m, reach_m), dtype=np.int64)
    middles_m = np.abs((surface.centroids_m[near] - plane.centre_m) @ plane.axes.T)
    near = near[_largest(middles_m - [surface.reach_m, surface.reach_m, 0.0]) <= plane.half_m]
    # Only facets seen from above: those of the far side and overhangs have no height over the plane.
    near = near[mesh.normals[near] @ plane.axes[2] > _LEAST_FACING]
    # One product of matrices is three times as quick as one for each facet.
    corners = ((mesh.corners_of(near) - plane.centre_m).reshape(-1, 3) @ plane.axes.T).reshape(-1, 3, 3)
    within = _largest(np.abs(corners[:, :, 2])) <= plane.half_m
    near, corners = near[within], corners[within]
    grid = corners[:, :, :2] / plane.spacing_m + (plane.side - 1) / 2
    facet, node, weights = _covered_nodes(grid, plane.side)
    heights = np.einsum("nk,nk->n", weights, corners[facet, :, 2])
    order = np.argsort(heights, kind="stable")  # the highest is written last and remains
    heights_m = np.full(plane.side**2, np.nan)
    heights_m[node[order]] = heights[order]
    shape = (plane.side, plane.side)
    if mesh.albedo is None:
        return heights_m.reshape(shape), None
    values = np.einsum("nk,nk->n", weights, mesh.albedo[mesh.faces[near[facet]]])
    albedo = np.full(plane.side**2, np.nan)
    albedo[node[order]] = values[order]
    return heights_m.reshape(shape), albedo.reshape(shape)


def _covered_nodes(corners: FloatArray, side: int) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Find the nodes, ``side`` along each axis, under facets (F, 3, 2) in grid units, x (column) and y (row).

    Return pairs of facet and node (P,), nodes numbered row by row, and barycentric coordinates (P, 3).
    """
    low = np.clip(np.ceil(-_largest(-corners) - _EDGE_TOLERANCE), 0, side).astype(np.int64)
    high = np.clip(np.floor(_largest(corners) + _EDGE_TOLERANCE), -1, side - 1).astype(np.int64)
    size = np.maximum(high - low + 1, 0)
    count = size[:, 0] * size[:, 1]
    facet = np.repeat(np.arange(len(corners)), count)
    offset = np.arange(len(facet)) - np.repeat(np.cumsum(count) - count, count)
    # All nodes of the bounding boxes of all facets, without a loop: the number within its box gives row and column.
    column = low[facet, 0] + offset % np.maximum(size[facet, 0], 1)
    row = low[facet, 1] + offset // np.maximum(size[facet, 0], 1)
    first, second, third = corners[facet, 0], corners[facet, 1], corners[facet, 2]
    # Barycentric coordinates are ratios of signed areas, so that either orientation of a facet in the plane will do.
    area = _cross(second - first, third - first)
    point = np.stack([column, row], axis=1).astype(np.float64)
    w1 = _cross(point - first, third - first)
    w2 = _cross(second - first, point - first)
    weights = np.stack([area - w1 - w2, w1, w2], axis=1) / np.where(area == 0.0, np.nan, area)[:, None]
    inside = -_largest(-weights) >= -_EDGE_TOLERANCE
    return facet[inside], (row * side + column)[inside], weights[inside]


def _largest(values: FloatArray) -> FloatArray:
    """Return the largest along the second axis, of length 3: numpy's reduction of so short an axis is slow."""
    return np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    value: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return value


def spread_points(points_m: FloatArray, radius_m: float, seed: int | None = None) -> list[int]:
    """Choose points, each the farthest from those before it, until all are within ``radius_m`` of one (Gonzalez 1985).

    The first is the point farthest from the origin, or drawn by ``seed``.
    """
    first = int(np.argmax(np.einsum("ni,ni->n", points_m, points_m)))
    chosen = [first if seed is None else int(np.random.default_rng(seed).integers(len(points_m)))]
    # In the order of a search tree neighbours are together: a new point shortens distances in a few blocks alone.
    places = np.resize(cKDTree(points_m).indices, (-(-len(points_m) // _BLOCK), _BLOCK))
    x, y, z = np.moveaxis(points_m[places], 2, 0).copy()
    middle_m = np.stack([x.mean(axis=1), y.mean(axis=1), z.mean(axis=1)], axis=1)
    size_m = np.linalg.norm(points_m[places] - middle_m[:, None], axis=2).max(axis=1)
    distance = np.full(places.shape, np.inf)
    largest = np.full(len(places), np.inf)
    while True:
        a, b, c = new = points_m[chosen[-1]]
        near = np.flatnonzero(np.linalg.norm(middle_m - new, axis=1) <= (1.0 + 1e-9) * (largest + size_m))
        to_new = np.sqrt((x[near] - a) ** 2 + (y[near] - b) ** 2 + (z[near] - c) ** 2)
        distance[near] = np.minimum(distance[near], to_new)
        largest[near] = distance[near].max(axis=1)
        farthest_m = largest.max()
        if farthest_m <= radius_m:
            return chosen
        block = np.flatnonzero(largest == farthest_m)
        chosen.append(int(places[block][distance[block] == farthest_m].min()))


def relief(heights_m: FloatArray, spacing_m: float) -> float:
    """Return the RMS slope of a maplet without its mean curvature, a measure of its contrast in images.

    A plane is fitted to the slopes along each axis and subtracted.
    """
    dy, dx = (np.asarray(slope, dtype=np.float64) for slope in np.gradient(heights_m, spacing_m))
    known = np.isfinite(dx) & np.isfinite(dy)
    if known.sum() < 4:
        return 0.0
    row, column = np.nonzero(known)
    # The slopes of a quadratic surface are linear in x and y: what is left is not its mean curvature.
    design = np.stack([np.ones(len(row)), row, column], axis=1)
    slopes = np.stack([dx[known], dy[known]], axis=1)
    rest = slopes - design @ np.linalg.lstsq(design, slopes, rcond=None)[0]
    return float(np.sqrt((rest**2).sum(axis=1).mean()))


def _cut(surface: Surface, places: IndexArray, options: MapletOptions) -> MapletDatabase:
    """Sample a maplet at each place whose central height is known."""
    planes = [_plane(surface, surface.centroids_m[place], options) for place in places]
    sampled = [(plane, *sample_heights(surface, plane)) for plane in planes]
    middle = options.side // 2
    usable = [(plane, heights, albedo) for plane, heights, albedo in sampled if np.isfinite(heights[middle, middle])]
    if not usable:
        raise NoProductError(
            f"the shape has no place for a maplet of {options.width_m:g} m: lower the options side ({options.side}) or"
            f" spacing_m ({options.spacing_m:g}) of the maplets"
        )
    albedo = [values for _, _, values in usable if values is not None]
    return MapletDatabase(
        np.stack([plane.centre_m for plane, _, _ in usable]),
        np.stack([plane.axes for plane, _, _ in usable]),
        np.stack([heights for _, heights, _ in usable]),
        options.spacing_m,
        np.stack(albedo) if albedo else None,
    )


def _plane(surface: Surface, centre_m: FloatArray, options: MapletOptions) -> Plane:
    normal = surface.mean_normal(centre_m, 0.5 * options.width_m)
    # The axis farthest from the normal, so that their product is not close to zero.
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first)
    return Plane(centre_m, np.stack([first, np.cross(normal, first), normal]), options.spacing_m, options.side)


def _separated(centres_m: FloatArray, order: list[int], separation_m: float) -> list[int]:
    """Accept candidates in ``order``, unless an accepted one is nearer than ``separation_m``."""
    taken: list[int] = []
    for index in order:
        if all(np.linalg.norm(centres_m[index] - centres_m[other]) >= separation_m for other in taken):
            taken.append(index)
    return taken


def _gap_fillers(candidates: MapletDatabase, taken: list[int], surface: Surface, facets: IndexArray) -> list[int]:
    """Choose further candidates, each covering the most ``facets`` not covered yet, until the gain is small."""
    covered = [_facets_on(candidates, index, surface) for index in range(len(candidates))]
    uncovered = np.zeros(len(surface.centroids_m), dtype=bool)
    uncovered[facets] = True
    for index in taken:
        uncovered[covered[index]] = False
    gains = np.array([np.count_nonzero(uncovered[own]) for own in covered])
    gains[taken] = -1
    added: list[int] = []
    while (claimed := gains.max()) >= 0:
        best = int(np.argmax(gains))
        gains[best] = np.count_nonzero(uncovered[covered[best]])
        if gains[best] < claimed:
            continue  # gains only fall: another candidate may be the best now, and none was missed
        if claimed < _LEAST_GAIN * len(covered[best]):
            break
        uncovered[covered[best]] = False
        added.append(best)
        gains[best] = -1
    return added


def _facets_on(database: MapletDatabase, index: int, surface: Surface) -> NDArray[np.int64]:
    """Return the facets whose middles lie on a maplet."""
    reach_m = np.sqrt(3.0) * database.half_m + database.spacing_m
    near = np.asarray(surface.tree.query_ball_point(database.centres_m[index], reach_m), dtype=np.int64)
    return near[database.contains(index, surface.centroids_m[near])]
