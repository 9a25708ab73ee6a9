"""Ray tracing without LLVM or CUDA, by Mitsuba's own integrators and with the reflectance on NumPy arrays.

In the scalar variant a BSDF written in Python would be called for every ray. Instead, Mitsuba renders a diffuse body
whose colour encodes the facet and whose brightness shows where the Sun shines; the reflectance is then computed on
arrays, with the same formulas as in the other variants.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.renderers.brdf import brdf_value, phase_of_rays
from boresight.renderers.mitsuba3.rays import PixelWindow, corner_weights, interpolate, ray_bundle
from boresight.renderers.mitsuba3.scene import SHAPE_ID, SUN_ID, build_shape
from boresight.renderers.mitsuba3.variant import Variant, load_mitsuba
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, TriangleMesh, View
from boresight.scenarios.spec.brdf import BrdfSpec

# The index of a facet is encoded as the colour (1, index // _BASE, index % _BASE), whose ratios are exact enough in
# single precision.
_BASE = 4096
# Distance from the surface at which shadow rays of single positions start, in units of the body's radius.
_SHADOW_OFFSET = 1e-5


class ScalarTracer:
    """Tracer of one body in compiled code, one sample at a time.

    The samples are those of the wavefront tracer: the film has n x n pixels for each pixel of the image, sampled at
    their centres. Shadows are slightly shorter next to the edges that cast them: Mitsuba starts shadow rays 9e-5 of the
    largest coordinate off the surface, the wavefront tracer 1e-5 of the radius.
    """

    def __init__(
        self,
        variant: Variant,
        mesh: TriangleMesh,
        brdf: BrdfSpec,
        samples_per_pixel: int,
        vertex_normals: FloatArray | None,
    ) -> None:
        self._variant = variant
        self._mesh = mesh
        self._brdf = brdf
        self._grid = round(samples_per_pixel**0.5)
        self._vertex_normals = vertex_normals
        self._scene = _coded_scene(load_mitsuba(variant), mesh)

    def image(self, view: View, window: PixelWindow) -> NDArray[np.float32]:
        """Radiance factor (height, width) of the pixels of a window."""
        n = self._grid
        facets = self._lit_facets(view, window)
        row, column = np.nonzero(facets >= 0)
        uv = _sample_positions(window, n, row, column)
        value = np.zeros(facets.shape)
        value[row, column] = self._radiance_factor(view, uv, facets[row, column])
        pixels: FloatArray = value.reshape(window.height, n, window.width, n).mean(axis=(1, 3))
        return pixels.astype(np.float32)

    def _lit_facets(self, view: View, window: PixelWindow) -> IndexArray:
        """Facet of every sample, in rows and columns of the finer film; -1 off the body and in shadow."""
        if view.camera.distortion is not None:
            return self._lit_facets_one_by_one(view, window)
        light = self._colours(view, window)
        # The first channel is the radiance of colour 1: 0 in shadow. Divided by it, the others are the digits of the
        # index, whatever the incidence.
        lit = light[..., 0] > 0.0
        high, low = np.rint(light[lit][:, 1:] / light[lit][:, :1]).astype(np.int64).T
        facets = np.full(lit.shape, -1, dtype=np.int64)
        facets[lit] = high * _BASE + low
        return facets

    def _lit_facets_one_by_one(self, view: View, window: PixelWindow) -> IndexArray:
        """Return the same for a camera with distortion, which Mitsuba lacks, by slow single rays."""
        shape = (window.height * self._grid, window.width * self._grid)
        row, column = (index.ravel() for index in np.indices(shape))
        uv = _sample_positions(window, self._grid, row, column)
        facets, lit = self.first_hits(view, *ray_bundle(view, self._mesh.radius_m, (0.0, 0.0)).at(uv))
        return np.where(lit, facets, -1).reshape(shape)

    def first_hits(
        self, view: View, origins_m: FloatArray, directions: FloatArray
    ) -> tuple[IndexArray, NDArray[np.bool_]]:
        """Facets (N,), -1 where missed, and whether the Sun shines on the hits, for rays (N, 3) in the body frame."""
        mi = load_mitsuba(self._variant)
        facets = np.full(len(origins_m), -1, dtype=np.int64)
        lit = np.zeros(len(origins_m), dtype=np.bool_)
        sun = view.sun_dir_body
        for k, (origin, direction) in enumerate(zip(origins_m, directions, strict=True)):
            hit = self._scene.ray_intersect_preliminary(mi.Ray3f(list(origin), list(direction)))
            if not hit.is_valid():
                continue
            facets[k] = hit.prim_index
            # The offset along the normal keeps the shadow ray from hitting its own facet.
            normal = self._mesh.normals[facets[k]]
            start = origin + direction * hit.t + normal * (_SHADOW_OFFSET * self._mesh.radius_m)
            lit[k] = normal @ sun > 0.0 and not self._scene.ray_test(mi.Ray3f(list(start), list(sun)))
        return facets, lit

    def _colours(self, view: View, window: PixelWindow) -> NDArray[np.float32]:
        """Colours (rows, columns, 3) of every sample, in rows and columns of the finer film; black where unlit."""
        mi = load_mitsuba(self._variant)
        stretch = _stretch(view)
        scene = self._scene
        if stretch is not None:
            # Mitsuba's camera has square pixels. Hits and shadows are invariant under an affine map of the world,
            # so the body is stretched instead, in a scene built for this rare case.
            scene = _coded_scene(mi, TriangleMesh(self._mesh.vertices_m @ stretch.T, self._mesh.faces))
        _point_sun(mi, scene, view.sun_dir_body if stretch is None else stretch @ view.sun_dir_body)
        sensor = _sensor(mi, view, window, self._grid, self._mesh.radius_m)
        return np.array(mi.render(scene, sensor=sensor, spp=1))

    def _radiance_factor(self, view: View, uv_px: FloatArray, facets: IndexArray) -> FloatArray:
        """I/F = pi f_r cos(i), times the local albedo, at lit pixel positions (N, 2) on facets (N,)."""
        mesh, sun = self._mesh, view.sun_dir_body
        origins, directions = ray_bundle(view, mesh.radius_m, (0.0, 0.0)).at(uv_px)
        normals = mesh.normals[facets]
        factor = np.ones(len(facets))
        if self._vertex_normals is not None or mesh.albedo is not None:
            weights = corner_weights(mesh, facets, origins, directions)
            if self._vertex_normals is not None:
                normals = interpolate(mesh, self._vertex_normals, facets, weights)
                normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            if mesh.albedo is not None:
                factor = interpolate(mesh, mesh.albedo, facets, weights)
        # Smooth normals can turn away from the Sun where the facet does not.
        cos_i = np.maximum(normals @ sun, 0.0)
        cos_e = -np.einsum("ni,ni->n", normals, directions)
        value: FloatArray = (
            np.pi * brdf_value(self._brdf, cos_i, cos_e, phase_of_rays(sun, directions)) * cos_i * factor
        )
        return value


def _sample_positions(window: PixelWindow, grid: int, row: IndexArray, column: IndexArray) -> FloatArray:
    """Pixel positions (N, 2) of samples at rows and columns of a film with grid x grid samples per pixel."""
    return np.stack([window.column + (column + 0.5) / grid, window.row + (row + 0.5) / grid], axis=1)


def _coded_scene(mi: Any, mesh: TriangleMesh) -> Any:
    """Build a scene of the body with facets coloured by their index, under a white Sun."""
    colour = {"type": "mesh_attribute", "name": "face_code"}
    shape = build_shape(mi, mesh, mi.load_dict({"type": "diffuse", "reflectance": colour}))
    index = np.arange(len(mesh.faces))
    code = np.stack([np.ones_like(index), index // _BASE, index % _BASE], axis=1)
    shape.add_attribute("face_code", 3, code.astype(np.float32).ravel())
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {
                "type": "direct",
                "emitter_samples": 1,
                # The Sun's direction is known: no other direction carries light.
                "bsdf_samples": 0,
                "hide_emitters": True,
                "block_size": 64,
            },
            SHAPE_ID: shape,
            SUN_ID: {"type": "directional", "direction": [0.0, 0.0, -1.0], "irradiance": {"type": "rgb", "value": 1.0}},
        }
    )


def _point_sun(mi: Any, scene: Any, sun_dir: FloatArray) -> None:
    # look_at needs any vector that is not parallel to the direction.
    up = [0.0, 0.0, 1.0] if abs(sun_dir[2]) < 0.9 * np.linalg.norm(sun_dir) else [1.0, 0.0, 0.0]
    # Mitsuba's emitter shines along its z axis: away from the Sun.
    target = [float(-x) for x in sun_dir]
    parameters = mi.traverse(scene)
    parameters[f"{SUN_ID}.to_world"] = mi.ScalarTransform4f().look_at(origin=[0.0] * 3, target=target, up=up)
    parameters.update()


def _stretch(view: View) -> FloatArray | None:
    """Map (3, 3) of the body frame that compensates for pixels that are not square; None for square pixels."""
    camera = view.camera
    if camera.fx_px == camera.fy_px:
        return None
    rotation = view.T_cam_body.rotation
    # v = fy y / z = fx (fy / fx y) / z: stretching y in camera axes by fy / fx gives square pixels of fx.
    scale = np.diag([1.0, camera.fy_px / camera.fx_px, 1.0])
    return rotation.T @ scale @ rotation


def _sensor(mi: Any, view: View, window: PixelWindow, grid: int, radius_m: float) -> Any:
    camera, pose = view.camera, view.T_cam_body
    to_world = np.eye(4)
    # The body's origin keeps its image if the camera's y coordinate is stretched likewise.
    centre_cam_m = pose.translation_m * np.array([1.0, camera.fy_px / camera.fx_px, 1.0])
    # Mitsuba's camera has x left and y up, z forward.
    to_world[:3, :3] = pose.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    to_world[:3, 3] = -pose.rotation.T @ centre_cam_m
    # Near and far planes about the body keep the precision of depths.
    reach_m = 1.01 * radius_m * max(1.0, camera.fy_px / camera.fx_px)
    far_m = float(centre_cam_m[2]) + reach_m
    return mi.load_dict(
        {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.degrees(2.0 * np.arctan(0.5 * camera.width_px / camera.fx_px))),
            # In shares of the image, positive to the left and up.
            "principal_point_offset_x": float(0.5 - camera.cx_px / camera.width_px),
            "principal_point_offset_y": float(0.5 - camera.cy_px / camera.height_px),
            "near_clip": max(far_m - 2.0 * reach_m, 1e-6 * far_m),
            "far_clip": far_m,
            "to_world": mi.ScalarTransform4f(to_world),
            # One sample in the middle of each pixel of the film.
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
            "film": _film(camera, window, grid),
        }
    )


def _film(camera: Camera, window: PixelWindow, grid: int) -> dict[str, object]:
    return {
        "type": "hdrfilm",
        "width": camera.width_px * grid,
        "height": camera.height_px * grid,
        "crop_offset_x": window.column * grid,
        "crop_offset_y": window.row * grid,
        "crop_width": window.width * grid,
        "crop_height": window.height * grid,
        # Each pixel of the film gets its own sample alone.
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
