"""Surface detail: refine a coarse shape smoothly and add boulders, craters, roughness and albedo variation."""

from __future__ import annotations

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies.detail.features import RefinedSurface, boulder_heights, crater_heights
from boresight.scenarios.bodies.detail.noise import Band, SmallScaleSeed, fractal_field
from boresight.scenarios.bodies.detail.subdivide import interpolating_control, refine, rounds_for, smoothed
from boresight.scenarios.bodies.topology import IntArray, find_edges, unit, vertex_normals
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.spec.body import AlbedoSpec, DetailSpec

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
    smaller than two edges of the refined mesh are left out.

    Return the detailed mesh, and a note for each kind of feature of which some are too small for it. Raise
    BoresightError if both the mesh and the spec have an albedo.
    """
    if mesh.albedo is not None and spec.albedo is not None:
        raise BoresightError("detail.albedo: the shape has an albedo of its own; remove the key")
    ground, faces, coarse_albedo = _refined(mesh, spec)
    # One stream for each kind of feature: adding a kind leaves the others as they are.
    boulders, craters, roughness, albedo = np.random.SeedSequence(spec.seed).spawn(4)
    small_boulders, small_craters, small_roughness = _redrawn(spec)
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
            ground.points_m, band, ground.resolution_m, roughness, small_roughness
        )
        heights += spec.roughness.rms_m * relief
    factor = coarse_albedo
    if spec.albedo is not None:
        factor, omitted["octaves of albedo"] = _albedo(spec.albedo, ground, albedo)
    points_m = ground.points_m + heights[:, None] * ground.up
    notes = tuple(
        f"{count} {what} are smaller than two facet edges ({ground.resolution_m:.3g} m) and were left out"
        for what, count in omitted.items()
        if count
    )
    return TriangleMesh(points_m, faces.astype(np.int32), factor), notes


def _redrawn(spec: DetailSpec) -> list[SmallScaleSeed | None]:
    """Return the separate seeds of small boulders, craters and roughness; None where there is none."""
    if spec.redrawn is None:
        return [None, None, None]
    return [
        SmallScaleSeed(spec.redrawn.below_m, seed) for seed in np.random.SeedSequence(spec.redrawn.seed).spawn(4)[:3]
    ]


def _refined(mesh: TriangleMesh, spec: DetailSpec) -> tuple[RefinedSurface, IntArray, FloatArray | None]:
    """Return the refined surface with its displacement directions, its faces, and the refined albedo or None."""
    coarse_m, coarse_faces = mesh.vertices_m, mesh.faces
    # Directions are smoothed on the coarse mesh, so that they do not depend on the number of facets.
    edges = find_edges(coarse_faces)
    coarse_edge_m = float(np.linalg.norm(np.diff(coarse_m[edges.ends], axis=1), axis=-1).mean())
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
    field, omitted = fractal_field(ground.points_m, band, ground.resolution_m, seed)
    return np.clip(1.0 + spec.sigma * field, *_ALBEDO_RANGE), omitted
