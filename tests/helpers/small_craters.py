"""A small cratered sphere, built in seconds, and a camera that looks at it."""

from __future__ import annotations

import numpy as np

from boresight.scenarios.craters import CrateredSurface, cratered_surface
from boresight.scenarios.geometry import Camera, View, look_at
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.craters import CratersSpec

BODY = BodySpec(shape="sphere")
"""Radius 250 m, on facets 17 m wide."""


def craters_spec(**changes: object) -> CratersSpec:
    """Craters of 20 to 120 m."""
    keys: dict[str, object] = {
        "seed": 5,
        "count": 150,
        "min_diameter_m": 20.0,
        "max_diameter_m": 120.0,
        "known_diameter_m": 30.0,
        "edge_m": 4.0,
        "roughness": None,
    }
    return CratersSpec.model_validate({**keys, **changes})


def small_ground(**changes: object) -> CrateredSurface:
    """The surface, from the cache after the first time."""
    return cratered_surface(BODY, craters_spec(**changes))


def small_view(longitude_deg: float = 20.0, phase_deg: float = 50.0, fov_deg: float = 12.0) -> View:
    """From 2 km, with the sphere's middle in the frame."""
    longitude, phase = np.radians([longitude_deg, phase_deg])
    camera = Camera.from_fov(160, 120, float(np.radians(fov_deg)))
    pose = look_at(2000.0 * np.array([np.cos(longitude) * 0.9, np.sin(longitude) * 0.9, np.sqrt(0.19)]), 0.4)
    sun_cam = np.array([np.sin(phase) * 0.6, np.sin(phase) * 0.8, -np.cos(phase)])
    return View(camera, pose, pose.inverse().rotate(sun_cam))
