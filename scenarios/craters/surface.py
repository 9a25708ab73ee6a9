"""Cratered surface of a body: built once from a scenario and cached; facets are generated where they are needed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, SingleArray
from boresight.scenarios.bodies.load import Body, body_digest, load_body
from boresight.scenarios.bodies.topology import (
    find_edges,
    interpolating_control,
    limit,
    refine,
    smoothed,
    vertex_normals,
)
from boresight.scenarios.cache import Cache, default_cache
from boresight.scenarios.craters.kernels import least_heights
from boresight.scenarios.craters.relief import Craters, add_roughness, crater_relief, draw_craters
from boresight.scenarios.craters.tiles import Tiling, check_size, expected_bytes, normal_cones, tile_rounds
from boresight.scenarios.craters.truth import Rims, find_rims
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.mesh import unit
from boresight.scenarios.reading import installed_memory_bytes
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.craters import CratersSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

CRATERS_VERSION = 3
"""Part of the digest of every cratered surface: increase it when the same spec gives another surface."""

_CLEARANCE_M = 0.5  # of the coarse body below the lowest vertex


def lower_envelope(tiling: Tiling, vertices_m: NDArray[np.float32]) -> FloatArray:
    """(V, 3) corners of tiles moved inward until no flat tile lies above its own refined surface.

    At the border of the refined tiles their edges lie above the coarse body, which is closed: rays cannot pass between
    them. The coarse body is too low by the relief within a tile, and so are limbs and shadows cast by it.
    """
    mesh = tiling.mesh
    normals = mesh.normals
    least = np.empty(len(mesh.faces))
    least_heights(least, vertices_m, mesh.corners_m[:, 0], normals, tiling.layout)
    # A corner moves as far inward as any of its tiles demands.
    corner_least = np.full(len(mesh.vertices_m), np.inf)
    steep = np.einsum("tki,ti->tk", tiling.up[mesh.faces], normals)
    # A corner that moves by h along its own direction moves by h times the cosine along the tile's normal.
    for k in range(3):
        # The smaller of both: a negative height becomes larger by the division, a positive one must not.
        np.minimum.at(corner_least, mesh.faces[:, k], np.minimum(least / np.maximum(steep[:, k], 0.2), least))
    return np.asarray(mesh.vertices_m + (corner_least - _CLEARANCE_M)[:, None] * tiling.up)


@dataclass(frozen=True, eq=False)
class CrateredSurface:
    """A body's surface with craters, as tiles that are subdivided into facets where they are needed.

    ``tiling`` has the smooth surface's tiles and their subdivision, ``vertices_m`` (N, 3) all its vertices with the
    relief, ``under_m`` (V, 3) the corners of the tiles moved below the relief (`lower_envelope`), ``cones`` (T, 4)
    those of each tile's normals (`normal_cones`). ``rims`` are of the larger ``craters`` of the population. ``sha256``
    is the digest of everything that the surface depends on.
    """

    tiling: Tiling
    vertices_m: SingleArray
    under_m: FloatArray
    cones: FloatArray
    craters: Craters
    rims: Rims
    sha256: str

    @cached_property
    def under(self) -> TriangleMesh:
        """The coarse closed mesh that lies below the relief everywhere."""
        return TriangleMesh(self.under_m, self.tiling.mesh.faces)

    @cached_property
    def corners_m(self) -> FloatArray:
        """(V, 3) corners of the tiles with the relief."""
        return np.asarray(self.vertices_m[: len(self.under_m)], dtype=np.float64)

    @cached_property
    def middles_m(self) -> FloatArray:
        """(T, 3) means of the corners of each tile."""
        return np.asarray(self.corners_m[self.tiling.mesh.faces].mean(axis=1))

    def distance_along_m(self, direction: FloatArray) -> float:
        """Return the distance from the origin to the outermost facet along a unit vector, (3,).

        Raise BoresightError if no facet lies in that direction.
        """
        along = self.middles_m @ direction
        across_m = np.linalg.norm(self.middles_m - along[:, None] * direction, axis=1)
        near = np.flatnonzero((across_m < 2.0 * self.tiling.reach_m) & (along > 0.0))
        used, faces = np.unique(self.tiling.facets(near), return_inverse=True)
        vertices_m = self.vertices_m[used].astype(np.float64)
        return TriangleMesh(vertices_m, faces.reshape(-1, 3).astype(np.int32)).distance_along_m(direction)


def cratered_surface(
    body: BodySpec, craters: CratersSpec, search_dirs: Sequence[Path] = (), cache: Cache | None = None
) -> CrateredSurface:
    """Build a cratered surface or take it from the cache; the same sections give the same one, bit for bit.

    Raise BoresightError if it would take more memory than this machine has; see `check_size`.
    """
    sha256 = surface_digest(body, craters, search_dirs)
    carrier = load_body(body, search_dirs, cache)
    check_size(carrier.mesh, craters)
    smooth = smooth_tiles(carrier, craters)
    tiling = Tiling.of(*smooth, craters.edge_m)
    # Population and tiling are made in every process; what takes long is cached by `build`.
    population = draw_craters(craters, *smooth)

    def build(folder: Path) -> None:
        points_m, up = tiling.places()
        heights_m = crater_relief(craters, population, tiling, points_m, up)
        if craters.roughness is not None:
            seed = np.random.SeedSequence(craters.seed).spawn(2)[1]
            add_roughness(heights_m, points_m, craters.roughness, seed)
        vertices_m = (points_m + heights_m[:, None] * up).astype(np.float32)
        np.save(folder / "vertices_m.npy", vertices_m)
        np.save(folder / "under_m.npy", lower_envelope(tiling, vertices_m))
        np.save(folder / "cones.npy", normal_cones(tiling, vertices_m))
        rims = find_rims(population, craters.listed_from_m, tiling, points_m, vertices_m)
        np.savez(folder / "rims.npz", allow_pickle=False, **{f.name: getattr(rims, f.name) for f in fields(rims)})

    folder = (cache or default_cache()).folder("craters", sha256, build)
    with np.load(folder / "rims.npz") as stored:
        rims = Rims(**stored)
    vertices_m = np.load(folder / "vertices_m.npy", mmap_mode="r")
    under_m, cones = (np.load(folder / f"{name}.npy") for name in ("under_m", "cones"))
    return CrateredSurface(tiling, vertices_m, under_m, cones, population, rims, sha256)


def build_surfaces(
    body: BodySpec,
    populations: Sequence[CratersSpec],
    search_dirs: Sequence[Path],
    threads: int,
    report: Callable[[str], None] | None = None,
) -> None:
    """Build cratered surfaces of one body into the cache, as many at once as threads and half of the memory allow.

    ``report`` is called with a message if some of them are not in the cache. Raise BoresightError as `cratered_surface`
    does.
    """
    mesh = load_body(body, search_dirs).mesh
    most = max(sum(expected_bytes(mesh, craters)) for craters in populations)
    digests = {surface_digest(body, craters, search_dirs) for craters in populations}
    absent = sum(default_cache().find("craters", sha256) is None for sha256 in digests)
    if report is not None and absent:
        report(f"building {absent} cratered surface(s) of about {most / 2**30:.1f} GiB each")
    # A thread drops its surface when it has built it.
    with ThreadPoolExecutor(max(1, min(threads, installed_memory_bytes() // (2 * most)))) as pool:
        list(pool.map(lambda craters: cratered_surface(body, craters, search_dirs).sha256, populations))


def surface_digest(body: BodySpec, craters: CratersSpec, search_dirs: Sequence[Path] = ()) -> str:
    """Digest (hexadecimal SHA-256) of everything that determines a cratered surface, without building it."""
    content = [body_digest(body, search_dirs), craters.model_dump(mode="json"), CRATERS_VERSION]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def shape_digest(spec: ScenarioSpec, search_dirs: Sequence[Path] = ()) -> str:
    """Digest of all that determines the shapes of a scenario's bodies, cratered or not, without building them."""
    if spec.craters is None:
        return "+".join(body_digest(body, search_dirs) for body in spec.bodies)
    return surface_digest(spec.body, spec.craters, search_dirs)


def smooth_tiles(body: Body, spec: CratersSpec) -> tuple[TriangleMesh, FloatArray]:
    """Refine a body to tiles on Loop's smooth surface through its vertices, see `tile_rounds`; also return its normals.

    The relief is applied along the unit normals (V, 3), so they are smoothed over the depth of the deepest crater to
    keep the surface from folding.
    """
    mesh = body.mesh
    edges = find_edges(mesh.faces)
    typical_m = float(np.median(edges.lengths(mesh.vertices_m)))
    rounds = tile_rounds(typical_m, spec.edge_m)
    depth_m = spec.max_diameter_m * spec.depth_ratio[1]
    # n rounds of averaging over neighbours spread a value over about sqrt(n) edges.
    smoothing = int(np.ceil((depth_m / typical_m) ** 2))
    up = unit(smoothed(vertex_normals(mesh.vertices_m, mesh.faces), edges, smoothing))
    control = interpolating_control(mesh.vertices_m, mesh.faces)
    fine, faces = refine(np.hstack([control, up]), mesh.faces, rounds)
    # From control points to points of the limit surface, which the corners of tiles must lie on.
    points_m = limit(fine[:, :3], find_edges(faces))
    return TriangleMesh(points_m, faces.astype(np.int32)), unit(fine[:, 3:])
