"""Ray tracing of all samples of an image at once, with the LLVM and CUDA variants."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.renderers.brdf import ArrayMath, brdf_value, phase_angle
from boresight.renderers.mitsuba3.rays import PixelWindow, RayBundle, grid_positions, ray_bundle
from boresight.renderers.mitsuba3.scene import mesh_on_device
from boresight.renderers.mitsuba3.variant import Variant, load_mitsuba
from boresight.scenarios.geometry import OpenCVDistortion, TriangleMesh, View
from boresight.scenarios.spec.brdf import BrdfSpec

# Distance from the surface at which shadow rays start, in units of the body's radius: ten times what single precision
# needs.
_SHADOW_OFFSET = 1e-5
# Size of a facet, in distances between samples, from which Embree traces neighbouring rays as one packet. Packets of
# smaller facets fall apart in the tree: without them, an image takes two thirds of the time with facets of 0.7, and
# five quarters with facets of 11.
_COHERENT_FACET = 2.0
# Newton steps to the ideal position: each doubles the digits, and single precision has seven.
_LENS_STEPS = 6


def opaque(mi: Any, vector: NDArray[np.float64]) -> Any:
    """Pass a 3-vector to a kernel as data: as literals it would require a new compilation for every pose."""
    import drjit as dr

    return mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in vector))


def drjit_math(drjit: Any) -> ArrayMath:
    """Elementwise functions of Dr.Jit."""
    return ArrayMath(
        sqrt=drjit.sqrt,
        exp=drjit.exp,
        log=drjit.log,
        sin=drjit.sin,
        cos=drjit.cos,
        atan2=drjit.atan2,
        maximum=drjit.maximum,
        minimum=drjit.minimum,
        where=drjit.select,
    )


class WavefrontTracer:
    """Tracer of one body by one kernel for all samples of an image.

    Samples are independent and those of a pixel are added in a fixed order, so images are identical bit for bit for any
    number of threads. Poses enter the kernel as data, so it is compiled once.
    """

    def __init__(
        self,
        variant: Variant,
        mesh: TriangleMesh,
        brdf: BrdfSpec,
        samples_per_pixel: int,
        vertex_normals: NDArray[np.float64] | None,
    ) -> None:
        mi = load_mitsuba(variant)
        self.variant = variant
        self._brdf = brdf
        self.radius_m = mesh.radius_m
        self._facet_m = float(np.sqrt(mesh.areas_m2.mean()))
        self._mesh = mesh_on_device(variant, mesh)
        self._vertex_normals = None if vertex_normals is None else mi.Float(vertex_normals.astype(np.float32).ravel())
        grid = grid_positions(samples_per_pixel)
        self.samples_per_pixel = samples_per_pixel
        self._grid_u, self._grid_v = (mi.Float(axis.astype(np.float32)) for axis in grid.T)

    def image(self, view: View, window: PixelWindow) -> NDArray[np.float32]:
        """Radiance factor (height, width) of the pixels of a window."""
        import drjit as dr

        mi = load_mitsuba(self.variant)
        rays = ray_bundle(view, self.radius_m, (window.column, window.row))
        sun = opaque(mi, view.sun_dir_body)
        origin, direction = self.camera_rays(mi, rays, window)
        hit, normal, lit = self.trace(mi, origin, direction, sun, self.coherent(view))
        normal, albedo = self.shading(mi, hit, normal)
        value = albedo * self.radiance_factor(normal, direction, sun)
        # The samples of a pixel are neighbours in the array, added in their order.
        value = dr.block_sum(dr.select(lit, value, 0.0), self.samples_per_pixel) / self.samples_per_pixel
        pixels: NDArray[np.float32] = value.numpy()
        return pixels.reshape(window.height, window.width)

    def first_hits(
        self, view: View, origins_m: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Facets (N,), -1 where missed, and whether the Sun shines on the hits, for rays (N, 3) in the body frame."""
        import drjit as dr

        mi = load_mitsuba(self.variant)
        origin = mi.Point3f(origins_m.T.astype(np.float32))
        direction = mi.Vector3f(directions.T.astype(np.float32))
        hit, _, lit = self.trace(mi, origin, direction, opaque(mi, view.sun_dir_body), self.coherent(view))
        valid, facet = hit.is_valid(), hit.prim_index
        dr.eval(valid, facet, lit)  # together: each by itself would trace all rays again
        return np.where(valid.numpy(), facet.numpy().astype(np.int64), -1), lit.numpy()

    def camera_rays(self, mi: Any, rays: RayBundle, window: PixelWindow) -> tuple[Any, Any]:
        """Origins and unit directions of all samples, pixel by pixel."""
        import drjit as dr

        index = dr.arange(mi.UInt32, window.width * window.height * self.samples_per_pixel)
        pixel = index // self.samples_per_pixel
        sample = index - pixel * self.samples_per_pixel
        # As data, so that windows of all sizes share one kernel.
        width = dr.opaque(mi.UInt32, window.width)
        row = pixel // width
        within_u, within_v = self.grid(sample)
        u, v = mi.Float(pixel - row * width) + within_u, mi.Float(row) + within_v
        if rays.camera.distortion is not None:
            u, v = _undistorted(mi, rays, u, v)
        origin = opaque(mi, rays.origin_m) + u * opaque(mi, rays.origin_u_m) + v * opaque(mi, rays.origin_v_m)
        direction = opaque(mi, rays.direction) + u * opaque(mi, rays.direction_u) + v * opaque(mi, rays.direction_v)
        return mi.Point3f(origin), dr.normalize(direction)

    def grid(self, sample: Any) -> tuple[Any, Any]:
        """Positions of samples within their pixels, by sample number."""
        import drjit as dr

        mi = load_mitsuba(self.variant)
        return dr.gather(mi.Float, self._grid_u, sample), dr.gather(mi.Float, self._grid_v, sample)

    def coherent(self, view: View) -> bool:
        """Return whether facets are so large in a view that rays of neighbouring samples are traced as one packet."""
        # At the nearest point that the body may have.
        distance_m = max(0.0, float(np.linalg.norm(view.T_cam_body.translation_m)) - self.radius_m)
        spacing_m = distance_m / view.camera.fx_px / self.samples_per_pixel**0.5
        return bool(self._facet_m > _COHERENT_FACET * spacing_m)

    def trace(self, mi: Any, origin: Any, direction: Any, sun: Any, coherent: bool) -> tuple[Any, Any, Any]:
        """First hits, normals of their facets, and whether the Sun illuminates them.

        ``coherent`` says how Embree traces; a ray that meets an edge within rounding may then hit the other facet.
        """
        import drjit as dr

        # As data, so that views from all distances share one kernel.
        packets = dr.opaque(mi.Bool, coherent)
        hit = self._mesh.scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=packets)
        valid = hit.is_valid()
        normal = dr.gather(mi.Vector3f, self._mesh.facet_normals, hit.prim_index, valid)
        facing = valid & (dr.dot(normal, sun) > 0.0)
        # Off the surface along the normal, so that a ray does not hit its own facet.
        start = origin + direction * hit.t + normal * (_SHADOW_OFFSET * self.radius_m)
        # Facets that face away from the Sun need no shadow ray.
        shadowed = self._mesh.scene.ray_test(mi.Ray3f(start, sun), coherent=packets, active=facing)
        return hit, normal, facing & ~shadowed

    def shading(self, mi: Any, hit: Any, normal: Any) -> tuple[Any, Any]:
        """Shading normals and albedo factors at hits on facets of given normals."""
        import drjit as dr

        if self._vertex_normals is not None:
            normal = dr.normalize(self._interpolate(mi, mi.Vector3f, self._vertex_normals, hit))
        return normal, 1.0 if self._mesh.albedo is None else self._interpolate(mi, mi.Float, self._mesh.albedo, hit)

    def radiance_factor(self, normal: Any, direction: Any, sun: Any) -> Any:
        """I/F = pi f_r cos(i) where rays of unit ``direction`` hit a surface of albedo factor 1."""
        import drjit as dr

        cos_i = dr.maximum(dr.dot(normal, sun), 0.0)
        cos_e = -dr.dot(normal, direction)
        xp = drjit_math(dr)
        phase_rad = phase_angle(dr.squared_norm(sun + direction), dr.squared_norm(sun - direction), xp)
        return dr.pi * brdf_value(self._brdf, cos_i, cos_e, phase_rad, xp) * cos_i

    def _interpolate(self, mi: Any, kind: Any, values: Any, hit: Any) -> Any:
        """Interpolate values of the vertices at the hits."""
        import drjit as dr

        valid = hit.is_valid()
        corners = dr.gather(mi.Vector3u, self._mesh.faces, hit.prim_index, valid)
        v0, v1, v2 = (dr.gather(kind, values, corner, valid) for corner in corners)
        # Barycentric coordinates of the second and third corner.
        w1, w2 = hit.prim_uv
        return v0 * (1.0 - w1 - w2) + v1 * w1 + v2 * w2


def _undistorted(mi: Any, rays: RayBundle, u: Any, v: Any) -> tuple[Any, Any]:
    """Convert window positions of a distorting lens to those of the pinhole, as ``Camera.undistorted`` does."""
    import drjit as dr

    camera, lens = rays.camera, rays.camera.distortion
    numbers = (camera.cx_px - rays.corner_px[0], camera.cy_px - rays.corner_px[1], camera.fx_px, camera.fy_px)
    cx, cy, fx, fy = (dr.opaque(mi.Float, float(x)) for x in numbers)
    from_axis_u, from_axis_v = u - cx, v - cy
    if isinstance(lens, OpenCVDistortion):
        seen = (from_axis_u / fx, from_axis_v / fy)
        opaque_lens = OpenCVDistortion(*(dr.opaque(mi.Float, float(number)) for number in astuple(lens)))
        x, y = opaque_lens.newton(*seen, _LENS_STEPS)
        return u + fx * (x - seen[0]), v + fy * (y - seen[1])
    k1, k2 = (dr.opaque(mi.Float, float(k)) for k in ((lens.k1, lens.k2) if lens else (0.0, 0.0)))
    # ideal = seen (1 + k1 r^2 + k2 r^4), written as a correction to u and v so that no digits are lost.
    squared = (from_axis_u / fx) ** 2 + (from_axis_v / fy) ** 2
    factor = squared * (k1 + squared * k2)
    return u + from_axis_u * factor, v + from_axis_v * factor
