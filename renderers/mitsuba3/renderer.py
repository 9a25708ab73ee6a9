"""Rendering and de-projection of a body by ray tracing."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from boresight.renderers.mitsuba3.derivatives import image_and_derivatives
from boresight.renderers.mitsuba3.rays import (
    body_window,
    check_outside,
    corner_weights,
    interpolate,
    outline_points,
    ray_bundle,
    vertex_normals,
)
from boresight.renderers.mitsuba3.scalar import ScalarTracer
from boresight.renderers.mitsuba3.variant import Variant, choose_variant
from boresight.renderers.mitsuba3.wavefront import WavefrontTracer
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import SurfaceHits, TriangleMesh, View
from boresight.scenarios.spec.brdf import BrdfSpec

# Samples traced at once, which bounds the memory for large images.
_MAX_SAMPLES = 1 << 22


class MitsubaRenderer:
    """Renderer of one body with one reflectance model, lit by the Sun as a point source, with hard shadows.

    Images are deterministic: each pixel is the mean of a regular grid of ``samples_per_pixel``, a square number. The
    mesh is closed, with outward normals; its albedo multiplies ``brdf``. ``shading`` is ``flat``, by the normals of the
    facets, or ``smooth``, by those of the vertices, interpolated. ``variant`` is by default the fastest that works.
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
        self._outline_m = outline_points(mesh)
        self._vertex_normals = vertex_normals(mesh) if shading == "smooth" else None
        tracer = WavefrontTracer if self.variant.is_wavefront else ScalarTracer
        self._tracer = tracer(self.variant, mesh, brdf, samples_per_pixel, self._vertex_normals)

    @property
    def outline_m(self) -> NDArray[np.float64]:
        """Points (N, 3) of the body frame whose convex hull contains the body."""
        return self._outline_m

    def render(self, view: View) -> NDArray[np.float32]:
        """Radiance factor I/F = pi f_r cos(i) of every pixel, (H, W); 0 off the body and in shadow.

        Raise `BoresightError` if the camera is inside the body.
        """
        check_outside(self._mesh, view.T_cam_body.camera_position_m)
        image = np.zeros((view.camera.height_px, view.camera.width_px), dtype=np.float32)
        window = body_window(view, self._outline_m)
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
        window = body_window(view, self._outline_m)
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
            return self._mesh.normals[facets]
        normals = interpolate(self._mesh, self._vertex_normals, facets, weights)
        unit: NDArray[np.float64] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return unit
