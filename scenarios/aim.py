"""Views that look at ground of a kind: below the camera, near the lit limb, near the terminator."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenarios.draw import draw_lit_view
from scenarios.geometry import Camera, Pose, TriangleMesh, View, look_at
from scenarios.spec.world import LightingSpec, ViewpointSpec

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_LIMB_EMISSION_DEG = (50.0, 70.0)
_TERMINATOR_INCIDENCE_DEG = (55.0, 75.0)
_MOST_DEG = 80.0

Kind = Literal["nadir", "limb", "terminator"]
KINDS: tuple[Kind, ...] = ("nadir", "limb", "terminator")


def draw_aimed_view(
    viewpoint: ViewpointSpec, lighting: LightingSpec, camera: Camera, shape: TriangleMesh, rng: np.random.Generator
) -> View:
    """Draw a place of the camera and a Sun as `draw_lit_view` does, and point at sunlit ground of one of the kinds.

    This is how Cheng et al. (2003) plan images: the nadir when it is lit, and regions near the lit limb and the
    terminator. Ground is a facet of ``shape`` by its area; that another part may hide it is left to chance. Where none
    is of the kind, the lit facet nearest to the nadir is taken; where none is lit, the body's centre.
    """
    view = draw_lit_view(viewpoint, lighting, camera, rng)
    kind, turn_rad = str(rng.choice(viewpoint.targets)), float(rng.uniform(0.0, 2.0 * np.pi))
    position = view.T_cam_body.camera_position_m
    places = shape.corners_m.mean(axis=1)
    emission, incidence = angles_deg(places, shape.normals, position, view.sun_dir_body)
    lit = is_lit(emission, incidence)
    chosen = lit & of_kind(kind, emission, incidence)
    area = np.linalg.norm(shape.area_vectors_m2, axis=1)
    if chosen.any():
        total = np.cumsum(np.where(chosen, area, 0.0))
        target = places[int(np.searchsorted(total, rng.uniform(0.0, total[-1]), side="right"))]
    elif lit.any():
        target = places[_nearest_to_nadir(places, position, lit)]
    else:
        target = np.zeros(3)
    if kind == "nadir" and lit.any():
        target = places[_nearest_to_nadir(places, position, lit)]
    turned = look_at(position - target, turn_rad)
    return View(camera, Pose(turned.rotation, -turned.rotation @ position), view.sun_dir_body)


def angles_deg(
    points_m: FloatArray, normals: FloatArray, position_m: FloatArray, sun_dir_body: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n,) angles of emission and incidence of points (n, 3) with normals (n, 3) for a camera and a Sun, (3,) each."""
    to_camera = position_m - points_m
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    emission = np.degrees(np.arccos(np.clip(np.einsum("fi,fi->f", normals, to_camera), -1.0, 1.0)))
    return emission, np.degrees(np.arccos(np.clip(normals @ sun_dir_body, -1.0, 1.0)))


def is_lit(emission_deg: FloatArray, incidence_deg: FloatArray) -> BoolArray:
    """(n,) whether ground is in the light and towards the camera, well enough to show anything."""
    return (emission_deg < _MOST_DEG) & (incidence_deg < _MOST_DEG)


def of_kind(kind: str, emission_deg: FloatArray, incidence_deg: FloatArray) -> BoolArray:
    """(n,) whether ground lies near the limb or near the terminator, as ``kind`` says."""
    if kind == "limb":
        return (emission_deg > _LIMB_EMISSION_DEG[0]) & (emission_deg < _LIMB_EMISSION_DEG[1])
    low, high = _TERMINATOR_INCIDENCE_DEG
    return (incidence_deg > low) & (incidence_deg < high) & (emission_deg < _LIMB_EMISSION_DEG[0])


def _nearest_to_nadir(places_m: FloatArray, position_m: FloatArray, lit: BoolArray) -> int:
    """Index of the lit place whose direction from the origin is nearest to the camera's."""
    cosine = places_m @ position_m / np.linalg.norm(places_m, axis=1)
    return int(np.where(lit, cosine, -np.inf).argmax())
