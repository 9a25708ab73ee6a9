"""Rendering of a cratered surface, finely tessellated only where the camera needs it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np

from boresight.renderers.brdf import brdf_value, phase_of_rays
from boresight.renderers.mitsuba3.rays import (
    PixelWindow,
    body_window,
    check_outside,
    grid_positions,
    outline_points,
    ray_bundle,
)
from boresight.renderers.mitsuba3.renderer import MitsubaRenderer
from boresight.renderers.mitsuba3.scene import FacetScene
from boresight.renderers.mitsuba3.variant import Variant, choose_variant, load_mitsuba
from boresight.renderers.mitsuba3.wavefront import drjit_math
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray, SingleArray
from boresight.scenarios.craters import CrateredSurface
from boresight.scenarios.craters.ray_culling import RayProjection, candidate_facets
from boresight.scenarios.craters.tiles import may_face, overlap
from boresight.scenarios.geometry import SurfaceHits, TriangleMesh, View
from boresight.scenarios.spec.brdf import BrdfSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

_SHADOW_OFFSET = 1e-5  # of the body's radius: distance from the surface at which shadow rays start
_RELIEF_PX = 5.0  # how far a facet may lie outside the bounding box of its tile's corners
_SHADOWS_PX = 20.0  # how far outside the frame fine facets cast shadows; beyond, the coarse body alone does
_SINGLE = 1e-4  # rad, more than the rounding of single precision


class BodyRenderer(Protocol):
    """A renderer of a body, as a mesh or as a cratered surface."""

    @property
    def outline_m(self) -> FloatArray:
        """Points (N, 3) of the body frame whose hull holds the body."""
        ...

    def render(self, view: View) -> SingleArray:
        """Radiance factor I/F of every pixel, (H, W)."""
        ...

    def surface(self, view: View, uv_px: FloatArray) -> SurfaceHits:
        """De-project pixel positions (N, 2)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    """Nearest hits on N rays: distances (N,), inf where there is none, and (N, 3) unit normals of the facets."""

    distance_m: SingleArray
    normal: SingleArray


@dataclass(eq=False)
class TiledRenderer:
    """Renderer of a cratered body lit by the Sun alone, with hard shadows, as `MitsubaRenderer` for a mesh.

    Mitsuba gets only the facets of the fine surface that a bundle of rays can hit. They are found by projecting rays
    and facets onto a plane, which costs much less than a tree of all facets. The coarse body below it, in a separate
    scene, closes the gaps where the fine surface ends; the nearer hit counts. ``samples_per_pixel`` is a square number.
    The scalar variant traces the same facets as one mesh, slowly.
    """

    name: ClassVar[str] = "mitsuba-tiled"
    version: ClassVar[int] = 5

    ground: CrateredSurface
    brdf: BrdfSpec
    samples_per_pixel: int = 4
    variant: Variant = field(default_factory=choose_variant)

    def render(self, view: View) -> SingleArray:
        """Radiance factor I/F of every pixel, (H, W); 0 off the body and in shadow.

        Raise `InsideBodyError` if the camera is inside the body.
        """
        check_outside(self.ground.under, view.T_cam_body.camera_position_m)
        if not self.variant.is_wavefront:
            whole = MitsubaRenderer(self.one_mesh(view), self.brdf, self.samples_per_pixel, "flat", self.variant)
            return whole.render(view)
        image = np.zeros((view.camera.height_px, view.camera.width_px), dtype=np.float32)
        window = body_window(view, self.outline_m)
        if window is not None:
            image[window.slices] = self._window(view, window)
        return image

    @cached_property
    def outline_m(self) -> FloatArray:
        """Points (N, 3) of the body frame whose hull holds the body."""
        # 1 % more than the corners of the tiles, for vertices within tiles that stand out.
        return outline_points(TriangleMesh(self.ground.corners_m * 1.01, self.ground.tiling.mesh.faces))

    def surface(self, view: View, uv_px: FloatArray) -> SurfaceHits:
        """De-project pixel positions (N, 2), as `MitsubaRenderer.surface` does, in single precision (millimetres).

        ``facets`` are 0 where the body is hit, as facets of the fine surface have no permanent numbers.
        """
        points, hits = self._first(view, uv_px)
        met = np.isfinite(hits.distance_m)
        normals = np.where(met[:, None], hits.normal.astype(np.float64), np.nan)
        lit = np.zeros(len(met), dtype=bool)
        lit[met] = self._lit(view, points[met], hits.normal[met])
        return SurfaceHits(points, normals, np.where(met, 0, -1), lit)

    def first_points(self, view: View, uv_px: FloatArray) -> FloatArray:
        """Points (N, 3) of the surface on the lines of sight at pixel positions (N, 2); NaN off the body."""
        return self._first(view, uv_px)[0]

    def clear(self, view: View, points_m: FloatArray, direction: FloatArray) -> BoolArray:
        """(N,) whether no facet near a view's frame blocks the rays from points (N, 3) along a unit vector (3,)."""
        fan = RayProjection.of_parallel(direction)
        clear = np.ones(len(points_m), dtype=bool)
        along = np.broadcast_to(direction, (len(points_m), 3))
        # Rays that are blocked already are not traced again.
        for part in self._parts(tiles_casting(self.ground, view), fan, fan.of_points(points_m)):
            if not clear.any():
                break
            clear[clear] = ~part.blocks(self._mi, points_m[clear], along[clear])
        return clear

    @property
    def _mi(self) -> Any:
        return load_mitsuba(self.variant)

    @cached_property
    def _radius_m(self) -> float:
        return 1.01 * float(np.linalg.norm(self.ground.corners_m, axis=1).max())

    @cached_property
    def _under(self) -> FacetScene:
        under = self.ground.under
        return FacetScene.of(self._mi, under.vertices_m.astype(np.float32)[under.faces])

    def _parts(self, tiles: IndexArray, fan: RayProjection, rays: FloatArray) -> list[FacetScene]:
        """Scenes of the coarse body and of the fine facets, if any, of tiles that rays (N, 3) of a fan may hit."""
        corners_m = candidate_facets(self.ground, tiles, fan, rays)
        return [self._under, FacetScene.of(self._mi, corners_m)] if len(corners_m) else [self._under]

    def _window(self, view: View, window: PixelWindow) -> SingleArray:
        """Radiance factor (height, width) of the pixels of a window."""
        spp = self.samples_per_pixel
        rows, columns = np.indices((window.height, window.width))
        corner = np.stack([columns + window.column, rows + window.row], axis=-1).reshape(-1, 1, 2)
        uv = (corner + grid_positions(spp)).reshape(-1, 2)
        origins, directions = ray_bundle(view, self._radius_m, (0.0, 0.0)).at(uv)
        hits = self._trace(view, origins, directions)
        met = np.flatnonzero(np.isfinite(hits.distance_m))
        normals = hits.normal[met]
        points = origins[met] + directions[met] * hits.distance_m[met, None]
        lit = self._lit(view, points, normals)
        value = np.zeros(len(uv), dtype=np.float32)
        value[met[lit]] = self._radiance_factor(view, normals[lit], directions[met[lit]])
        pixels: SingleArray = value.reshape(window.height, window.width, spp).mean(axis=2, dtype=np.float32)
        return pixels

    def _first(self, view: View, uv_px: FloatArray) -> tuple[FloatArray, _Hits]:
        uv = np.asarray(uv_px, dtype=np.float64)
        origins, directions = ray_bundle(view, self._radius_m, (0.0, 0.0)).at(uv)
        hits = self._trace(view, origins, directions)
        met = np.isfinite(hits.distance_m)[:, None]
        return np.where(met, origins + directions * np.where(met, hits.distance_m[:, None], 0.0), np.nan), hits

    def _trace(self, view: View, origins_m: FloatArray, directions: FloatArray) -> _Hits:
        """Nearest hits of lines of sight (N, 3)."""
        n = len(origins_m)
        # inf for a miss, so that the nearest of all parts is a plain comparison.
        hits = _Hits(np.full(n, np.inf, dtype=np.float32), np.zeros((n, 3), dtype=np.float32))
        if n == 0:
            return hits
        fan = RayProjection.of_view(view)
        for part in self._parts(tiles_seen(self.ground, view), fan, fan.of_directions(directions)):
            distance, facet = part.first_hits(self._mi, origins_m, directions)
            nearer = distance < hits.distance_m
            hits.distance_m[nearer] = distance[nearer]
            hits.normal[nearer] = part.normals(facet[nearer])
        return hits

    def _lit(self, view: View, points_m: FloatArray, normals: SingleArray) -> BoolArray:
        """(N,) whether the Sun shines on points of facets with given normals."""
        sun = view.sun_dir_body
        # A facet that faces away from the Sun is dark without any shadow ray.
        lit = normals @ sun.astype(np.float32) > 0.0
        start = points_m[lit] + normals[lit] * (_SHADOW_OFFSET * self._radius_m)
        lit[lit] = self.clear(view, start, sun)
        return lit

    def _radiance_factor(self, view: View, normals: SingleArray, directions: FloatArray) -> SingleArray:
        """I/F = pi f_r cos(i) where rays along unit directions (N, 3) hit facets of normals (N, 3)."""
        import drjit as dr

        if not len(directions):  # Dr.Jit cannot combine an empty array with a number
            return np.zeros(0, dtype=np.float32)
        mi, sun = self._mi, view.sun_dir_body
        cos_i = np.maximum(normals @ sun, 0.0)
        cos_e = -np.einsum("ni,ni->n", normals, directions)
        angles = (cos_i, cos_e, phase_of_rays(sun, directions))
        mu0, mu, g = (mi.Float(x.astype(np.float32)) for x in angles)
        # By Dr.Jit in single precision, as the wavefront tracer does.
        value = np.pi * brdf_value(self.brdf, mu0, mu, g, drjit_math(dr))
        return np.asarray(np.broadcast_to(np.asarray(value, dtype=np.float32), cos_i.shape) * cos_i, dtype=np.float32)

    def one_mesh(self, view: View) -> TriangleMesh:
        """Return all facets that a view is rendered with, as one mesh."""
        tiles = np.union1d(tiles_seen(self.ground, view), tiles_casting(self.ground, view))
        under, facets = self.ground.under, self.ground.tiling.facets(tiles)
        used, faces = np.unique(facets, return_inverse=True)
        vertices_m = np.concatenate([under.vertices_m, self.ground.vertices_m[used].astype(np.float64)])
        faces = faces.reshape(-1, 3) + len(under.vertices_m)
        return TriangleMesh(vertices_m, np.concatenate([under.faces, faces]).astype(np.int32))


def tiles_seen(ground: CrateredSurface, view: View) -> IndexArray:
    """Tiles with facets that may be in the frame and face the camera."""
    to_camera = view.T_cam_body.camera_position_m - ground.middles_m
    distance_m = np.linalg.norm(to_camera, axis=1)
    # The direction to the camera varies over a tile by its size over the distance.
    span_rad = 2.0 * ground.tiling.reach_m / distance_m
    facing = may_face(ground.cones, to_camera / distance_m[:, None], span_rad)
    return np.flatnonzero(facing & _near_frame(ground, view, _RELIEF_PX))


def tiles_casting(ground: CrateredSurface, view: View) -> IndexArray:
    """Tiles near the frame with facets that may face the Sun: a ray leaves the body only through such a facet."""
    sun = np.tile(view.sun_dir_body, (len(ground.cones), 1))
    facing = may_face(ground.cones, sun, np.full(len(sun), _SINGLE))
    return np.flatnonzero(facing & _near_frame(ground, view, _SHADOWS_PX))


def _near_frame(ground: CrateredSurface, view: View, margin_px: float) -> BoolArray:
    """(T,) whether the bounding box of a tile's corners in the image overlaps the frame, extended by a margin."""
    seen = view.camera.project(view.T_cam_body.transform(ground.corners_m))
    size = np.array([view.camera.width_px, view.camera.height_px], dtype=np.float64)
    return np.asarray(overlap(ground.tiling.layout.faces, seen, size, margin_px))


def renderer_version(spec: ScenarioSpec) -> tuple[str, int]:
    """Name and version of the renderer of a scenario's images."""
    kind = MitsubaRenderer if spec.craters is None else TiledRenderer
    return kind.name, kind.version
