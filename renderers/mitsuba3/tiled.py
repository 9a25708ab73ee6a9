"""Images of a cratered surface that is cut finely where the camera looks."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from renderers.brdf import brdf_value
from renderers.mitsuba3.parts import Part, Pieces, clear_of
from renderers.mitsuba3.rays import Window, body_window, grid_positions, outline_points, ray_bundle
from renderers.mitsuba3.renderer import MitsubaRenderer
from renderers.mitsuba3.surface import check_outside
from renderers.mitsuba3.variant import Variant, choose_variant, load_mitsuba
from renderers.mitsuba3.wavefront import drjit_math
from scenarios.craters import CrateredSurface
from scenarios.geometry import SurfaceHits, TriangleMesh, View
from scenarios.spec.brdf import BrdfSpec
from scenarios.spec.scenario import ScenarioSpec

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

_SHADOW_OFFSET = 1e-5
_MARGIN_PX = 20.0
_BEYOND = -0.1  # cosine: ground that faces away by more is neither seen nor lit, whatever its relief
_MOST_FACETS = 12_000_000


class BodyRenderer(Protocol):
    """What renders a body, however it is made."""

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
    """Renders a cratered body lit by the Sun alone, with hard shadows, as `MitsubaRenderer` does a mesh.

    Pieces of the fine surface are traced one by one, each in a scene of its own that stays in memory, and the nearest
    hit counts; below them lies the coarse body. So an image costs no tree of all its facets, and there is no gap
    where the fine surface ends.

    Parameters
    ----------
    ground
        The surface.
    brdf
        The scenario's ``brdf`` section.
    samples_per_pixel
        A square number.
    variant
        The Mitsuba variant; without LLVM or CUDA the same facets are traced as one mesh, slowly.
    """

    name: ClassVar[str] = "mitsuba-tiled"
    version: ClassVar[int] = 1

    ground: CrateredSurface
    brdf: BrdfSpec
    samples_per_pixel: int = 4
    variant: Variant = field(default_factory=choose_variant)
    _parts: OrderedDict[int, Part] = field(default_factory=OrderedDict)

    def render(self, view: View) -> SingleArray:
        """Radiance factor I/F of every pixel, (H, W); 0 off the body and in shadow.

        Raises
        ------
        BoresightError
            If the camera is inside the body.
        """
        check_outside(self.ground.under, view.T_cam_body.camera_position_m)
        if not self.variant.is_wavefront:
            return self._as_one_mesh(view).render(view)
        image = np.zeros((view.camera.height_px, view.camera.width_px), dtype=np.float32)
        window = body_window(view, self.outline_m)
        if window is not None:
            image[window.slices] = self._window(view, window)
        return image

    @cached_property
    def outline_m(self) -> FloatArray:
        """Points (N, 3) of the body frame whose hull holds the body."""
        return outline_points(TriangleMesh(self.ground.corners_m * 1.01, self.ground.tiling.mesh.faces))

    def surface(self, view: View, uv_px: FloatArray) -> SurfaceHits:
        """De-project pixel positions (N, 2), as `MitsubaRenderer.surface` does, to single precision (millimetres).

        ``facets`` are 0 where the body is hit: its facets have no lasting numbers.
        """
        uv = np.asarray(uv_px, dtype=np.float64)
        origins, directions = ray_bundle(view, self._radius_m, (0.0, 0.0)).at(uv)
        hits = self._trace(view, uv, origins, directions)
        met = np.isfinite(hits.distance_m)
        points = np.where(met[:, None], origins + directions * np.where(met, hits.distance_m, 0.0)[:, None], np.nan)
        normals = np.where(met[:, None], hits.normal.astype(np.float64), np.nan)
        lit = np.zeros(len(met), dtype=bool)
        lit[met] = self._lit(view, points[met], hits.normal[met])
        return SurfaceHits(points, normals, np.where(met, 0, -1), lit)

    def clear(self, view: View, points_m: FloatArray, direction: FloatArray) -> BoolArray:
        """(N,): whether nothing that a view shows stands on the rays from points (N, 3) along a unit vector (3,)."""
        return clear_of(self._mi, self._shown(view), points_m, direction)

    @property
    def _mi(self) -> Any:
        return load_mitsuba(self.variant)

    @cached_property
    def _radius_m(self) -> float:
        return 1.01 * float(np.linalg.norm(self.ground.corners_m, axis=1).max())

    @cached_property
    def _pieces(self) -> Pieces:
        return Pieces.of(self.ground)

    @cached_property
    def _under(self) -> Part:
        return Part.of(self._mi, self.ground.under.vertices_m.astype(np.float32), self.ground.under.faces)

    def _shown(self, view: View) -> list[Part]:
        """Make the pieces that a view needs, or take those of earlier views, with the coarse body."""
        numbers = self._pieces.needed(view, _MARGIN_PX, _BEYOND)
        for number in numbers:
            if number in self._parts:
                self._parts.move_to_end(number)
            else:
                self._parts[number] = Part.of(self._mi, *self._pieces.mesh(number))
        total = sum(part.n_facets for part in self._parts.values())
        while total > _MOST_FACETS and len(self._parts) > len(numbers):
            total -= self._parts.popitem(last=False)[1].n_facets
        return [self._under, *(self._parts[number] for number in numbers)]

    def _window(self, view: View, window: Window) -> SingleArray:
        """Radiance factor (height, width) of the pixels of a window."""
        spp = self.samples_per_pixel
        rows, columns = np.indices((window.height, window.width))
        corner = np.stack([columns + window.column, rows + window.row], axis=-1).reshape(-1, 1, 2)
        uv = (corner + grid_positions(spp)).reshape(-1, 2)
        origins, directions = ray_bundle(view, self._radius_m, (0.0, 0.0)).at(uv)
        hits = self._trace(view, uv, origins, directions)
        met = np.flatnonzero(np.isfinite(hits.distance_m))
        normals = hits.normal[met]
        points = origins[met] + directions[met] * hits.distance_m[met, None]
        lit = self._lit(view, points, normals)
        value = np.zeros(len(uv), dtype=np.float32)
        value[met[lit]] = self._radiance_factor(view, normals[lit], directions[met[lit]])
        pixels: SingleArray = value.reshape(window.height, window.width, spp).mean(axis=2, dtype=np.float32)
        return pixels

    def _trace(self, view: View, uv_px: FloatArray, origins_m: FloatArray, directions: FloatArray) -> _Hits:
        """Nearest hit on all parts of the ray of each pixel position (N, 2)."""
        n = len(origins_m)
        hits = _Hits(np.full(n, np.inf, dtype=np.float32), np.zeros((n, 3), dtype=np.float32))
        for part in self._shown(view):
            rows = part.box.rows_within(view, uv_px)
            if not len(rows):
                continue
            distance, facet = part.first_hits(self._mi, origins_m[rows], directions[rows])
            nearer = distance < hits.distance_m[rows]
            hits.distance_m[rows[nearer]] = distance[nearer]
            hits.normal[rows[nearer]] = part.normals[facet[nearer]]
        return hits

    def _lit(self, view: View, points_m: FloatArray, normals: SingleArray) -> BoolArray:
        """(N,): whether the Sun shines on points of facets with given normals."""
        sun = view.sun_dir_body
        lit = normals @ sun.astype(np.float32) > 0.0
        start = points_m[lit] + normals[lit] * (_SHADOW_OFFSET * self._radius_m)
        lit[lit] = self.clear(view, start, sun)
        return lit

    def _radiance_factor(self, view: View, normals: SingleArray, directions: FloatArray) -> SingleArray:
        """I/F = pi f_r cos(i) where rays along unit directions (N, 3) meet facets of normals (N, 3)."""
        import drjit as dr

        mi, sun = self._mi, view.sun_dir_body
        cos_i = np.maximum(normals @ sun, 0.0)
        cos_e = -np.einsum("ni,ni->n", normals, directions)
        phase = 2.0 * np.arctan2(np.linalg.norm(sun + directions, axis=1), np.linalg.norm(sun - directions, axis=1))
        mu0, mu, g = (mi.Float(x.astype(np.float32)) for x in (cos_i, cos_e, phase))
        value = np.pi * brdf_value(self.brdf, mu0, mu, g, drjit_math(dr))
        return np.asarray(np.broadcast_to(np.asarray(value, dtype=np.float32), cos_i.shape) * cos_i, dtype=np.float32)

    def _as_one_mesh(self, view: View) -> MitsubaRenderer:
        return MitsubaRenderer(self.one_mesh(view), self.brdf, self.samples_per_pixel, "flat", self.variant)

    def one_mesh(self, view: View) -> TriangleMesh:
        """All facets that a view is rendered with, as one mesh."""
        vertices, faces = [self.ground.under.vertices_m], [self.ground.under.faces.astype(np.int64)]
        count = len(vertices[0])
        for number in self._pieces.needed(view, _MARGIN_PX, _BEYOND):
            piece_m, piece_faces = self._pieces.mesh(number)
            vertices.append(piece_m.astype(np.float64))
            faces.append(piece_faces + count)
            count += len(piece_m)
        return TriangleMesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32))


def renderer_version(spec: ScenarioSpec) -> tuple[str, int]:
    """Name and version of what renders a scenario's images."""
    kind = MitsubaRenderer if spec.craters is None else TiledRenderer
    return kind.name, kind.version
