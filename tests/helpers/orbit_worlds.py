"""A small world for orbit determination: a lumpy body of 300 m, seen from 3 km."""

import numpy as np
import trimesh

from boresight.scenarios.geometry import Camera, TriangleMesh
from boresight.scenarios.orbits.world import Asteroid, OnboardShape, OrbitWorld
from boresight.scenarios.spec.orbit import OrbitSpec

CAMERA = Camera.from_fov(512, 400, np.radians(6.0))
SECTION = {
    "arc": {"semi_major_axis_m": 3000.0, "days": 2.0, "predicted_days": 0.5},
    "asteroid": {"gm_m3_s2": 5.0, "gravity_degree": 4},
    "light": {"area_to_mass_m2_kg": 0.01},
    "sightings": {"images": 60, "craters": 80, "per_image": 8.0, "noise_px": 0.5, "wrong_share": 0.0},
    "radiometry": {"range_sigma_m": 2.0, "range_rate_sigma_m_s": 1e-4, "range_bias_sigma_m": 5.0},
    "knowledge": {"position_m": 30.0, "shape_degree": 4},
}


def orbit_world(**changes):
    """Build it with changes of the section, by group: ``orbit_world(sightings={"wrong_share": 0.1})``."""
    parts = {key: {**SECTION.get(key, {}), **changes.get(key, {})} for key in SECTION | changes}
    if "approach" in parts["arc"]:
        del parts["arc"]["semi_major_axis_m"]
    section = OrbitSpec.model_validate(parts)
    asteroid = Asteroid.of(lump(), section, 3)
    return OrbitWorld(section, CAMERA, asteroid, OnboardShape.of(asteroid, section, section.knowledge.shape_degree))


def lump():
    """Return an ellipsoid with a dent."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = np.array(ball.vertices) * [300.0, 220.0, 160.0]
    vertices *= 1.0 - 0.2 * np.exp(-np.sum((ball.vertices - np.array([0.6, 0.8, 0.0])) ** 2, axis=1) / 0.2)[:, None]
    return TriangleMesh(vertices, np.array(ball.faces))
