"""Rendering of a body by ray tracing, its derivatives by the pose with Dr.Jit, and de-projection."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.renderers.mitsuba3.rays import (
    PixelWindow,
    body_window,
    check_outside,
    corner_weights,
    interpolate,
    outline_points,
    ray_bundle,
    vertex_normals,
)
from boresight.renderers.mitsuba3.scalar import ScalarTracer
from boresight.renderers.mitsuba3.variant import Variant, choose_variant, load_mitsuba
from boresight.renderers.mitsuba3.wavefront import WavefrontTracer, opaque
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import SurfaceHits, TriangleMesh, View
from boresight.scenarios.spec.brdf import BrdfSpec

# Samples traced at once, which bounds the memory for large images.
_MAX_SAMPLES = 1 << 22


class MitsubaRenderer:
    """Renderer of one body with one reflectance model, lit by the Sun as a point source, with hard shadows.

    Images are deterministic: each pixel is the mean of a regular grid of ``samples_per_pixel``, a square number. The
    mesh is closed, with outward normals; its albedo multiplies ``brdf``. ``shading`` is ``flat``, by the normals of the
    facets, or ``smooth``, by those of the vertices, interpolated. ``variant`` is by default the fastest that works,
    and ``outline_m`` (N, 3), points whose hull holds the mesh, the vertices of its convex hull.
    Raise `BoresightError` for a mesh without facets, an unknown ``shading`` and samples that are not a square number.
    """

    name: ClassVar[str] = "mitsuba"
    version: ClassVar[int] = 4

    def __init__(
        self,
        mesh: TriangleMesh,
        brdf: BrdfSpec,
        samples_per_pixel: int = 4,
        shading: Literal["flat", "smooth"] = "flat",
        variant: Variant | None = None,
        outline_m: FloatArray | None = None,
    ) -> None:
        if len(mesh.faces) == 0:
            raise BoresightError("the body to render has no facets: give a mesh with at least one")
        if samples_per_pixel < 1 or round(samples_per_pixel**0.5) ** 2 != samples_per_pixel:
            raise BoresightError(f"samples_per_pixel: {samples_per_pixel} is not a square number (1, 4, 9, 16, ...)")
        if shading not in ("flat", "smooth"):
            raise BoresightError(f"shading: {shading!r} is neither 'flat' nor 'smooth'")
        self.variant = variant or choose_variant()
        self._samples_per_pixel = samples_per_pixel
        self._mesh = mesh
        self._given_outline_m = outline_m
        self._vertex_normals = vertex_normals(mesh) if shading == "smooth" else None
        tracer = WavefrontTracer if self.variant.is_wavefront else ScalarTracer
        self._tracer = tracer(self.variant, mesh, brdf, samples_per_pixel, self._vertex_normals)

    @cached_property
    def outline_m(self) -> NDArray[np.float64]:
        """Points (N, 3) of the body frame whose convex hull contains the body."""
        # When it is wanted: predictions render nothing, and the hull takes longer than all else here.
        return outline_points(self._mesh) if self._given_outline_m is None else self._given_outline_m

    def render(self, view: View) -> NDArray[np.float32]:
        """Radiance factor I/F = pi f_r cos(i) of every pixel, (H, W); 0 off the body and in shadow.

        Raise `InsideBodyError` if the camera is inside the body.
        """
        check_outside(self._mesh, view.T_cam_body.camera_position_m)
        image = np.zeros((view.camera.height_px, view.camera.width_px), dtype=np.float32)
        window = body_window(view, self.outline_m)
        if window is not None:
            for strip in window.strips(max(1, _MAX_SAMPLES // (window.width * self._samples_per_pixel))):
                # Strips are whole rows of pixels: the samples of a pixel are never divided.
                image[strip.slices] = self._tracer.image(view, strip)
        return image

    @property
    def differentiable(self) -> bool:
        """Whether `render_with_derivatives` works: Dr.Jit differentiates only in the LLVM and CUDA variants."""
        return self.variant.is_wavefront

    def render_with_derivatives(self, view: View) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Render (H, W) as `render` does except for rounding, with the derivatives (6, H, W) by the pose.

        `image_and_derivatives` states the parameters and what is neglected. Raise `BoresightError` if the camera is
        inside the body or has distortion, or the variant does not differentiate.
        """
        if not isinstance(self._tracer, WavefrontTracer):
            raise BoresightError(f"the Mitsuba variant {self.variant.name} gives no derivatives: {self.variant.advice}")
        check_outside(self._mesh, view.T_cam_body.camera_position_m)
        image = np.zeros((view.camera.height_px, view.camera.width_px), dtype=np.float32)
        derivatives = np.zeros((6, *image.shape), dtype=np.float32)
        window = body_window(view, self.outline_m)
        if window is not None:
            # Each sample is repeated for the six parameters.
            for strip in window.strips(max(1, _MAX_SAMPLES // (6 * window.width * self._samples_per_pixel))):
                rows, columns = strip.slices
                image[rows, columns], derivatives[:, rows, columns] = image_and_derivatives(self._tracer, view, strip)
        return image, derivatives

    def surface(self, view: View, uv_px: NDArray[np.float64]) -> SurfaceHits:
        """De-project pixel positions (N, 2) to the first points of the body on their lines of sight.

        Facets and shadows come from the ray tracer; points and normals are computed in double precision. Raise
        `BoresightError` if the camera is inside the body or ``uv_px`` is not (N, 2).
        """
        check_outside(self._mesh, view.T_cam_body.camera_position_m)
        uv = np.asarray(uv_px, dtype=np.float64)
        if uv.ndim != 2 or uv.shape[1] != 2:
            raise BoresightError(f"pixel positions to de-project must be (N, 2), not {uv.shape}")
        points = np.full((len(uv), 3), np.nan)
        normals = np.full((len(uv), 3), np.nan)
        if len(uv) == 0:
            return SurfaceHits(points, normals, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_))
        origins, directions = ray_bundle(view, self._mesh.radius_m, (0.0, 0.0)).at(uv)
        # Single precision suffices to find the facet; the point on it is computed in double precision.
        facets, lit = self._tracer.first_hits(view, origins, directions)
        hit = facets >= 0
        weights = corner_weights(self._mesh, facets[hit], origins[hit], directions[hit])
        points[hit] = interpolate(self._mesh, self._mesh.vertices_m, facets[hit], weights)
        normals[hit] = self._normals(facets[hit], weights)
        return SurfaceHits(points, normals, facets, lit)

    def _normals(self, facets: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        if self._vertex_normals is None:
            return self._mesh.normals_of(facets)
        normals = interpolate(self._mesh, self._vertex_normals, facets, weights)
        unit: NDArray[np.float64] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return unit


_PARAMETERS = 6
# The filter of a pixel covers its neighbours, whose motion depends on the samples next to them.
_MARGIN_PX = 3
# Samples of the sky within this distance of the limb move with it.
_MOTION_PX = 1.5
# Depth of a sample that misses the body.
_SKY_M = np.float32(1e30)


def image_and_derivatives(tracer: WavefrontTracer, view: View, window: PixelWindow) -> tuple[Image, Image]:
    """Radiance factor (height, width) of the pixels of a window, and its derivatives (6, height, width).

    The radiance is discontinuous at silhouettes, shadows and edges of facets, which derivatives of the samples' shading
    alone ignore. Samples are therefore fixed to the body and move in the image when the pose changes; a pixel is the
    mean of the samples around it, weighted by a continuous filter. This is the reparameterisation of G. Loubet,
    N. Holzschuch and W. Jakob (Reparameterizing discontinuous integrands for differentiable rendering, ACM Trans.
    Graphics 38, 2019), with the motion of a rigid body in closed form.

    The parameters are [rotation_rad, translation_m] of ``Pose.perturbed``, in camera axes, with the Sun fixed in camera
    axes. Two effects are neglected: the motion of cast shadows over the surface as the body rotates, and the motion of
    occluding edges relative to the surface behind them. The derivatives are those of the image filtered by a tent two
    pixels wide, not by the square of a pixel. Raise `BoresightError` if the camera has distortion.
    """
    import drjit as dr

    if view.camera.distortion is not None:
        raise BoresightError("derivatives of images are worked out for a pinhole camera: take camera.pinhole")
    mi = load_mitsuba(tracer.variant)
    grown = PixelWindow(
        window.column - _MARGIN_PX,
        window.row - _MARGIN_PX,
        window.width + 2 * _MARGIN_PX,
        window.height + 2 * _MARGIN_PX,
    )
    samples = _Samples(mi, tracer, view, grown)
    u, v, value = samples.tangents()
    tangent = _filtered(mi, samples, (u, v, value), window)
    inner = (slice(_MARGIN_PX, -_MARGIN_PX), slice(_MARGIN_PX, -_MARGIN_PX))
    pixels = dr.block_sum(samples.value, tracer.samples_per_pixel) / tracer.samples_per_pixel
    image = np.asarray(pixels.numpy(), dtype=np.float32).reshape(grown.height, grown.width)[inner]
    return image, tangent.numpy().reshape(_PARAMETERS, window.height, window.width)


class _Samples:
    """Samples of a window: their hits, and the derivatives of their positions and values."""

    def __init__(self, mi: Any, tracer: WavefrontTracer, view: View, window: PixelWindow) -> None:
        import drjit as dr

        self.mi, self.tracer, self.view, self.window = mi, tracer, view, window
        self.count = window.width * window.height * tracer.samples_per_pixel
        self.sun = opaque(mi, view.sun_dir_body)
        rays = ray_bundle(view, tracer.radius_m, (window.column, window.row))
        origin, direction = tracer.camera_rays(mi, rays, window)
        hit, normal, lit = tracer.trace(mi, origin, direction, self.sun, tracer.coherent(view))
        self.normal, albedo = tracer.shading(mi, hit, normal)
        self.point = mi.Vector3f(origin + direction * hit.t)
        # An albedo of 0 marks samples in shadow, which have no derivative.
        self.albedo = dr.select(lit, albedo, 0.0)
        self.value = self.albedo * tracer.radiance_factor(self.normal, direction, self.sun)
        self.value = dr.select(lit, self.value, 0.0)
        # The third row of R_cam_body is the boresight in body axes.
        forward = opaque(mi, view.T_cam_body.rotation[2])
        depth = dr.select(hit.is_valid(), dr.dot(forward, self.point), float(_SKY_M))
        # Hits are evaluated once, as constants: derivatives are those of fixed body points.
        dr.eval(self.normal, self.point, self.albedo, self.value, depth)
        self.depth = mi.Float(self._surface_about(depth.numpy()))

    def _surface_about(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth, along the boresight from the body's origin, of the surface that each sample moves with.

        It is the depth of the hit on the body, and within 1.5 pixels off the body that of the farthest surface nearby,
        the limb. Samples farther off do not move.
        """
        n, window = round(self.tracer.samples_per_pixel**0.5), self.window
        # Samples come pixel by pixel, n x n each: reorder them as an image for the morphological filter.
        pixels = depth_m.reshape(window.height, window.width, n, n)
        raster = pixels.transpose(0, 2, 1, 3).reshape(window.height * n, window.width * n)
        sky = raster >= _SKY_M
        side = 2 * round(_MOTION_PX * n) + 1
        # The maximum of the depths in the window: the limb is the farthest visible surface. Sky counts as nearest.
        limb = cv2.dilate(np.where(sky, -_SKY_M, raster), np.ones((side, side), dtype=np.uint8))
        raster = np.where(sky & (limb > -_SKY_M), limb, raster)
        blocks = raster.reshape(window.height, n, window.width, n).transpose(0, 2, 1, 3)
        return np.ascontiguousarray(blocks).ravel()

    def tangents(self) -> tuple[Any, Any, Any]:
        """Differentiate position (u, v), px, and value of each sample: all samples for each of six parameters."""
        import drjit as dr

        mi = self.mi
        # Forward mode gives one directional derivative in a pass: the samples are repeated for each parameter, and in
        # each copy that parameter alone depends on the one differentiable number.
        index = dr.arange(mi.UInt32, _PARAMETERS * self.count)
        parameter = index // dr.opaque(mi.UInt32, self.count)
        sample = index - parameter * dr.opaque(mi.UInt32, self.count)
        size = dr.opaque(mi.Float, 0.0)
        dr.enable_grad(size)
        rotation = mi.Vector3f(*(dr.select(parameter == k, size, 0.0) for k in range(3)))
        translation = mi.Vector3f(*(dr.select(parameter == k, size, 0.0) for k in range(3, 6)))
        u, v = self._position(sample, rotation, translation)
        value = self._value(sample, rotation, translation)
        dr.set_grad(size, 1.0)
        forward_to: Any = dr.forward_to  # its type hints allow single arrays only
        tangents: tuple[Any, Any, Any] = forward_to((u, v, value))
        dr.eval(*tangents)
        return tangents

    def _position(self, sample: Any, rotation: Any, translation: Any) -> tuple[Any, Any]:
        """Image positions of the samples' points after a small change of the pose."""
        import drjit as dr

        mi, camera, window = self.mi, self.view.camera, self.window
        pixel, within = sample // self.tracer.samples_per_pixel, sample % self.tracer.samples_per_pixel
        row = pixel // dr.opaque(mi.UInt32, window.width)
        column = pixel - row * dr.opaque(mi.UInt32, window.width)
        grid = self.tracer.grid(within)
        # Offset and principal point are subtracted in double precision first.
        slope_u = (mi.Float(column) + grid[0] + _number(mi, window.column - camera.cx_px)) / _number(mi, camera.fx_px)
        slope_v = (mi.Float(row) + grid[1] + _number(mi, window.row - camera.cy_px)) / _number(mi, camera.fy_px)
        depth = dr.gather(mi.Float, self.depth, sample)
        body = depth < 0.5 * float(_SKY_M)
        origin = opaque(mi, self.view.T_cam_body.translation_m)
        distance = dr.select(body, depth, 0.0) + origin.z
        # x' = t + d + exp(w) (x - t), to first order t + d + arm + w x arm: `Pose.perturbed` leaves the body's origin.
        arm = mi.Vector3f(slope_u * distance, slope_v * distance, distance) - origin
        moved = origin + arm + dr.cross(rotation, arm) + translation
        # Samples in the sky are fixed in the image; their derivative is 0.
        still = dr.select(body, 1.0, 0.0)
        u, v = _number(mi, camera.fx_px) * moved.x / moved.z, _number(mi, camera.fy_px) * moved.y / moved.z
        return still * u, still * v

    def _value(self, sample: Any, rotation: Any, translation: Any) -> Any:
        """Radiance factor of the samples' points after a small change of the pose.

        In body axes the Sun and the camera move: with R' = exp(w) R and t' = t + d the camera is at -R'^T t', to first
        order -R^T (t + d - w x t), and the direction to the Sun is R^T (s - w x s).
        """
        import drjit as dr

        mi, pose = self.mi, self.view.T_cam_body
        to_body = [opaque(mi, row) for row in pose.rotation.T]
        t, sun = opaque(mi, pose.translation_m), opaque(mi, pose.rotation @ self.view.sun_dir_body)
        moved_t, moved_sun = t + translation - dr.cross(rotation, t), sun - dr.cross(rotation, sun)
        # The camera is at -from_camera in body axes, so that point + from_camera is the line of sight.
        from_camera = mi.Vector3f(*(dr.dot(row, moved_t) for row in to_body))
        sun_body = mi.Vector3f(*(dr.dot(row, moved_sun) for row in to_body))
        point, normal = (dr.gather(mi.Vector3f, field, sample) for field in (self.point, self.normal))
        value = self.tracer.radiance_factor(normal, dr.normalize(point + from_camera), sun_body)
        albedo = dr.gather(mi.Float, self.albedo, sample)
        return dr.select(albedo > 0.0, albedo * value, 0.0)


def _filtered(mi: Any, samples: _Samples, tangents: tuple[Any, Any, Any], window: PixelWindow) -> Any:
    """Combine the derivatives of the samples to those of the pixels, for six parameters.

    With weights K of the samples around a pixel and their sum S, I = sum(K f) / S has the derivative
    (sum(K f' + K' f) - I sum(K')) / S.
    """
    import drjit as dr

    n = round(samples.tracer.samples_per_pixel**0.5)
    pixels = dr.opaque(mi.UInt32, window.width * window.height)
    index = dr.arange(mi.UInt32, _PARAMETERS * window.width * window.height)
    parameter = index // pixels
    pixel = index - parameter * pixels
    row = pixel // dr.opaque(mi.UInt32, window.width)
    column = pixel - row * dr.opaque(mi.UInt32, window.width)
    wide = dr.opaque(mi.UInt32, samples.window.width)
    run = parameter * dr.opaque(mi.UInt32, samples.count)
    total, moved, spread, mass = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0), 0.0
    for dv, (weight_v, slope_v) in _tent(n).items():
        for du, (weight_u, slope_u) in _tent(n).items():
            neighbour = (row + (_MARGIN_PX + dv // n)) * wide + column + (_MARGIN_PX + du // n)
            sample = neighbour * n * n + (dv % n) * n + du % n
            f = dr.gather(mi.Float, samples.value, sample)
            f_u, f_v, f_value = (dr.gather(mi.Float, tangent, run + sample) for tangent in tangents)
            weight, change = weight_u * weight_v, slope_u * weight_v * f_u + weight_u * slope_v * f_v
            # K changes with the position of a sample: K' = dK/du u' + dK/dv v'.
            mass += weight
            total += weight * f
            moved += weight * f_value + change * f
            spread += change
    return (moved - total * spread / mass) / mass


def _tent(n: int) -> dict[int, tuple[float, float]]:
    """Weight and slope, by row of samples, of a tent filter two pixels wide around a pixel of n rows.

    Row 0 is the first of the pixel. At the ends of the tent the slope is the mean of both sides.
    """
    result = {}
    for row in range(-n, 2 * n):
        # Offset of the sample row from the middle of the pixel, in pixels.
        x = (row + 0.5) / n - 0.5
        if abs(x) > 1.0 + 1e-9:
            continue
        at_kink = abs(abs(x) - 1.0) < 1e-9
        # Slope by the position of the sample: a sample that moves away from the middle loses weight.
        result[row] = (max(1.0 - abs(x), 0.0), -float(np.sign(x)) * (0.5 if at_kink else 1.0))
    return result


def _number(mi: Any, value: float) -> Any:
    import drjit as dr

    return dr.opaque(mi.Float, float(value))
