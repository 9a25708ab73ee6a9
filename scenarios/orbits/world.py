"""Objects common to many trials of an orbit scenario: body, craters, forces and onboard models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.dynamics.field import HarmonicField, UniformRotation
from boresight.scenarios.dynamics.harmonics import Harmonics, homogeneous_harmonics
from boresight.scenarios.dynamics.propagation import SUNLIGHT_N_M2
from boresight.scenarios.geometry import Camera, TriangleMesh
from boresight.scenarios.orbits.shape import StarShape, fit_star_shape
from boresight.scenarios.orbits.sightings import Horizons
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.orbit import OrbitSpec, SunEarthSpec

_PROMINENCE = 0.5  # standard deviation of the logarithm of a crater's detection weight


@dataclass(frozen=True, eq=False)
class Asteroid:
    """The true body, centred on its centre of mass for constant density, with its n craters.

    ``centre_m`` (3,) is the centre of mass in the axes of the shape model, ``harmonics`` the gravity for constant
    density to the scenario's degree. Craters have centres and outward unit normals (n, 3), and ``prominence`` (n,), the
    relative weight of detection.
    """

    mesh: TriangleMesh
    centre_m: FloatArray
    harmonics: Harmonics
    points_m: FloatArray
    normals: FloatArray
    prominence: FloatArray

    @classmethod
    def of(cls, mesh: TriangleMesh, spec: OrbitSpec, seed: int) -> Asteroid:
        """Centre a shape and draw its craters, those of number 0."""
        centre = centre_of_mass(mesh)
        centred = TriangleMesh(mesh.vertices_m - centre, mesh.faces)
        bare = cls(centred, centre, shape_gravity(centred, spec), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
        return bare.with_craters(spec, seed, 0)

    def with_craters(self, spec: OrbitSpec, seed: int, number: int) -> Asteroid:
        """Return the same body with another draw of its craters; all trials of one ``number`` share them."""
        rng = generator(seed, Stream.ORBIT_CRATERS, number)
        points, normals = MeshGround(self.mesh).sample(spec.sightings.craters, rng)
        prominence = np.exp(_PROMINENCE * rng.normal(size=len(points)))
        return replace(self, points_m=points, normals=normals, prominence=prominence)

    @cached_property
    def horizons(self) -> Horizons:
        """Local horizons of the craters' centres."""
        return Horizons.of(self.mesh, self.points_m, self.normals)


@dataclass(frozen=True, eq=False)
class OnboardShape:
    """The a priori shape, and its gravity for constant density."""

    shape: StarShape
    harmonics: Harmonics

    @classmethod
    def of(cls, asteroid: Asteroid, spec: OrbitSpec, degree: int) -> OnboardShape:
        """Fit spherical harmonics of the radius to the true shape, up to a degree."""
        shape = fit_star_shape(asteroid.mesh, degree)
        return cls(shape, shape_gravity(shape.mesh(), spec))


@dataclass(frozen=True, eq=False)
class OrbitWorld:
    """Camera, true body and onboard model of a scenario, the same in all trials with one draw of the craters."""

    spec: OrbitSpec
    camera: Camera
    asteroid: Asteroid
    onboard: OnboardShape

    @property
    def rotation(self) -> UniformRotation:
        """True rotation of the body."""
        return UniformRotation(np.eye(3), 2.0 * np.pi / (3600.0 * self.spec.asteroid.rotation_h))

    @property
    def light_m_s2(self) -> FloatArray:
        """(3,) nominal acceleration by solar radiation pressure, m/s2, inertial axes."""
        return solar_pressure(self.spec.light)

    @property
    def coefficient_sigma(self) -> float:
        """A priori sigma of gravity coefficients: anomalies, and half the relative RMS error of the shape."""
        of_shape = 0.5 * self.onboard.shape.rms_m / self.onboard.harmonics.radius_m
        return float(np.hypot(self.spec.asteroid.anomaly_sigma, of_shape))

    def field(
        self, harmonics: Harmonics, light_factor: float = 1.0, rotation: UniformRotation | None = None
    ) -> HarmonicField:
        """Return the force field of these harmonics, with the true rotation or a given one."""
        return HarmonicField(harmonics, rotation or self.rotation, self.light_m_s2 * light_factor)


def centre_of_mass(mesh: TriangleMesh) -> FloatArray:
    """(3,) centroid of a closed mesh: the centre of mass for constant density."""
    corners = mesh.corners_m
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    # Tetrahedra between the origin and the facets: each has its centroid at (a + b + c) / 4.
    return np.asarray(np.einsum("f,fi->i", volumes, corners.sum(axis=1)) / 4.0 / volumes.sum())


def shape_gravity(mesh: TriangleMesh, spec: OrbitSpec) -> Harmonics:
    """Return the harmonics of a homogeneous shape; degree 1 is set to zero (origin at the centre of mass)."""
    asteroid = spec.asteroid
    # The smallest sphere about the body: harmonics converge outside it.
    radius = float(np.linalg.norm(mesh.vertices_m, axis=1).max())
    found = homogeneous_harmonics(mesh, asteroid.gm_m3_s2, asteroid.gravity_degree, radius)
    c, s = found.c.copy(), found.s.copy()
    c[1], s[1] = 0.0, 0.0
    return Harmonics(found.gm_m3_s2, found.radius_m, c, s)


def solar_pressure(light: SunEarthSpec) -> FloatArray:
    """(3,) acceleration by solar radiation pressure, m/s2, away from the Sun (cannonball model)."""
    sun = np.array(light.sun_dir) / np.linalg.norm(light.sun_dir)
    size = SUNLIGHT_N_M2 * light.reflectivity * light.area_to_mass_m2_kg / light.sun_distance_au**2
    return np.asarray(-size * sun, dtype=np.float64)
