"""Rays a second of the renderer beside Embree's own rate on the same rays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.ratio import Absent, Ratio
from benchmarks.scene import SAMPLES, SpeedScene, speed_scene
from benchmarks.timing import Settings, in_turn, timed
from boresight.renderers.mitsuba3 import choose_variant, limit_threads
from boresight.renderers.mitsuba3.rays import grid_positions, ray_bundle
from boresight.renderers.mitsuba3.scene import build_shape
from boresight.renderers.mitsuba3.variant import load_mitsuba
from boresight.scenarios.arrays import SingleArray
from boresight.scenarios.geometry import TriangleMesh

WORK = "primary and shadow rays of an image of 3.1 M facets"
AIM = 0.7
_OFFSET = 1e-5
_LEAST_SHARE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class RaySet:
    """The rays (N, 3) of an image from its samples, and those (M, 3) of its shadows from where they meet facets."""

    origins_m: SingleArray
    directions: SingleArray
    starts_m: SingleArray
    sun: SingleArray
    facets: NDArray[np.int64]

    @property
    def count(self) -> int:
        """Rays of both kinds."""
        return len(self.origins_m) + len(self.starts_m)


def ray_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time whole images beside the intersections alone, on one thread: by Mitsuba's Embree, and by embreex."""
    limit_threads(1)
    scene = speed_scene(settings.facets, 1)
    view, variant = scene.views[0], choose_variant()
    if not variant.is_wavefront:
        yield Absent(WORK, f"the variant {variant.name} traces no prepared rays")
        return
    renderer = scene.renderer(variant)
    mi = load_mitsuba(variant)
    tree = mi.load_dict({"type": "scene", "body": build_shape(mi, scene.mesh)})
    rays = rays_of(scene, tree, mi)
    raw = partial(_traced, tree, _on_device(mi, rays))
    ours, alone = in_turn(settings.rounds, timed(partial(renderer.render, view)), timed(raw))
    yield Ratio(WORK, "Mitsuba's intersections alone", "cpu", ours.cpu, alone.cpu, AIM, f"{rays.count:,} rays")
    yield _beside_embreex(scene.mesh, rays, partial(renderer.render, view), settings.rounds)


def rays_of(scene: SpeedScene, tree: Any, mi: Any) -> RaySet:
    """Work out the rays of the first image's window, and of its shadows where facets face the Sun."""
    mesh, view, window = scene.mesh, scene.views[0], scene.window(0)
    rows, columns = np.indices((window.height, window.width))
    corner = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    uv = (corner + grid_positions(SAMPLES)).reshape(-1, 2)
    bundle = ray_bundle(view, mesh.radius_m, (window.column, window.row))
    origins, directions = (x.astype(np.float32) for x in bundle.at(uv))
    hit = tree.ray_intersect_preliminary(_rays(mi, origins, directions), coherent=True)
    met = hit.is_valid().numpy()
    facets = np.where(met, hit.prim_index.numpy().astype(np.int64), -1)
    normals = mesh.normals[facets[met]]
    points = origins[met] + directions[met] * hit.t.numpy()[met, None]
    facing = normals @ view.sun_dir_body > 0.0
    starts = (points + normals * (_OFFSET * mesh.radius_m))[facing].astype(np.float32)
    return RaySet(origins, directions, starts, view.sun_dir_body.astype(np.float32), facets)


def _rays(mi: Any, origins: SingleArray, directions: SingleArray) -> Any:
    return mi.Ray3f(mi.Point3f(np.ascontiguousarray(origins.T)), mi.Vector3f(np.ascontiguousarray(directions.T)))


def _on_device(mi: Any, rays: RaySet) -> tuple[Any, Any]:
    import drjit as dr

    along = np.broadcast_to(rays.sun, rays.starts_m.shape)
    both = _rays(mi, rays.origins_m, rays.directions), _rays(mi, rays.starts_m, along)
    dr.eval(both)
    dr.sync_thread()
    return both


def _traced(tree: Any, rays: tuple[Any, Any]) -> None:
    import drjit as dr

    # Facets of this size are traced faster without packets.
    hit = tree.ray_intersect_preliminary(rays[0], coherent=False)
    dr.eval(hit.t, hit.prim_index)
    dr.eval(tree.ray_test(rays[1], coherent=False))
    dr.sync_thread()


def _beside_embreex(mesh: TriangleMesh, rays: RaySet, render: Any, rounds: int) -> Ratio | Absent:
    try:
        scenes, meshes = import_module("embreex.rtcore_scene"), import_module("embreex.mesh_construction")
    except ImportError as error:
        return Absent(WORK, f'embreex: cannot be imported ({error}); install it: pip install -e ".[speed]"')
    tree = scenes.EmbreeScene()
    kept = meshes.TriangleMesh(tree, mesh.vertices_m.astype(np.float32), mesh.faces.astype(np.int32))
    along = np.ascontiguousarray(np.broadcast_to(rays.sun, rays.starts_m.shape))
    found = tree.run(rays.origins_m, rays.directions)
    same = float((found == rays.facets).mean())

    def raw() -> None:
        tree.run(rays.origins_m, rays.directions)
        tree.run(rays.starts_m, along, query="OCCLUDED")

    ours, alone = in_turn(rounds, timed(render), timed(raw))
    del kept
    if same < _LEAST_SHARE:
        return Absent(WORK, f"embreex names the same facet on {same:.2%} of the rays only")
    return Ratio(WORK, "embreex", "cpu", ours.cpu, alone.cpu, AIM, f"the same facet on {same:.2%} of the rays")
