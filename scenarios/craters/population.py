"""Random crater populations: positions, diameters, ages and depths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies.topology import unit
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
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
    area = np.cumsum(np.linalg.norm(smooth.area_vectors_m2, axis=1))
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
