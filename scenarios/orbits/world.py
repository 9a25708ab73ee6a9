"""Objects common to many trials of an orbit scenario: body, craters with their horizons, forces and onboard models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.dynamics.field import HarmonicField, UniformRotation
from boresight.scenarios.dynamics.gravity import Harmonics, homogeneous_harmonics, normalisation, solid_harmonics
from boresight.scenarios.dynamics.propagation import radiation_pressure
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, plane_axes, spherical_direction
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.orbit import OrbitSpec

_STEP_DEG = 2.0  # of the table of radii
_MARCHES = 256  # points on a ray through the enclosing sphere
_BISECTIONS = 30  # of the step in which a ray enters


@dataclass(frozen=True, eq=False)
class StarShape:
    """A surface with one radius in each direction, tabulated over latitude and longitude.

    ``radii_m`` (91, 181) are at steps of 2 deg: latitudes from -90 to 90, longitudes from 0 to 360. ``rms_m`` is the
    RMS deviation of the fit.
    """

    radii_m: FloatArray
    rms_m: float

    def radius(self, directions: FloatArray) -> FloatArray:
        """(...,) radius, m, in directions (..., 3) of any length."""
        x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
        latitude = (np.degrees(np.arctan2(z, np.hypot(x, y))) + 90.0) / _STEP_DEG
        longitude = np.degrees(np.arctan2(y, x)) % 360.0 / _STEP_DEG
        return np.asarray(map_coordinates(self.radii_m, [latitude, longitude], order=1, mode="nearest"))

    def intersect(self, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
        """(n, 3) first intersections of rays (n, 3); for misses, the surface point below the ray's nearest point."""
        reach = float(self.radii_m.max())
        # Distance along the ray of the point nearest to the origin.
        middle = -np.einsum("ni,ni->n", origins_m, directions)
        near, far = np.maximum(middle - reach, 0.0), middle + reach
        marks = near[:, None] + (far - near)[:, None] * np.linspace(0.0, 1.0, _MARCHES)
        inside = self._height(origins_m, directions, marks) < 0.0
        # A body thinner along the ray than a step between marks is missed.
        first = np.argmax(inside, axis=1)
        low = np.take_along_axis(marks, np.maximum(first - 1, 0)[:, None], 1)
        high = np.take_along_axis(marks, first[:, None], 1)
        for _ in range(_BISECTIONS):
            half = 0.5 * (low + high)
            below = self._height(origins_m, directions, half) < 0.0
            low, high = np.where(below, low, half), np.where(below, half, high)
        missed = ~inside.any(axis=1)
        points = origins_m + np.where(missed, middle, high[:, 0])[:, None] * directions
        # The nearest point of a ray that misses, moved radially to the surface.
        points[missed] *= (self.radius(points[missed]) / np.linalg.norm(points[missed], axis=1))[:, None]
        return points

    def _height(self, origins_m: FloatArray, directions: FloatArray, marks: FloatArray) -> FloatArray:
        points = origins_m[:, None] + marks[..., None] * directions[:, None]
        return np.asarray(np.linalg.norm(points, axis=2) - self.radius(points))

    def mesh(self) -> TriangleMesh:
        """Return a closed mesh through the table; its first and last rows become one vertex each."""
        radii, (latitudes, longitudes) = self.radii_m, _lattice()
        rows, columns = len(latitudes), len(longitudes) - 1
        unit = spherical_direction(longitudes[None, :-1], latitudes[1:-1, None])
        # The last longitude repeats the first and is left out.
        ring = (unit * radii[1:-1, :-1, None]).reshape(-1, 3)
        poles = np.array([[0.0, 0.0, -radii[0, 0]], [0.0, 0.0, radii[-1, 0]]])
        here = np.arange(columns)
        there, last = (here + 1) % columns, (rows - 3) * columns
        south, north = np.full(columns, len(ring)), np.full(columns, len(ring) + 1)
        faces = [np.column_stack([there, here, south]), np.column_stack([last + here, last + there, north])]
        for row in range(rows - 3):
            a, b = row * columns + here, row * columns + there
            faces += [np.column_stack([a, b, b + columns]), np.column_stack([a, b + columns, a + columns])]
        return TriangleMesh(np.vstack([ring, poles]), np.concatenate(faces).astype(np.int32))


def fit_star_shape(mesh: TriangleMesh, degree: int) -> StarShape:
    """Fit harmonics to the radii of a mesh's vertices, each weighted by the area about it as seen from the origin.

    Raise BoresightError if the mesh has too few vertices for the degree.
    """
    if 2 * (degree + 1) ** 2 > len(mesh.vertices_m):
        raise BoresightError(
            f"orbit.knowledge.shape_degree: {degree} asks for {(degree + 1) ** 2} coefficients, but the shape has"
            f" {len(mesh.vertices_m)} vertices: choose at most {int((len(mesh.vertices_m) / 2) ** 0.5) - 1}"
        )
    radii = np.linalg.norm(mesh.vertices_m, axis=1)
    unit = mesh.vertices_m / radii[:, None]
    weights, basis = _solid_angles(mesh, len(radii)), _basis(unit, degree)
    # Normal equations: vertices crowd where the mesh is fine, so that each counts by its solid angle.
    heavy = basis * weights[:, None]
    found = np.linalg.solve(heavy.T @ basis, heavy.T @ radii)
    rms = np.sqrt(np.average((basis @ found - radii) ** 2, weights=weights))
    latitudes, longitudes = _lattice()
    table = _basis(spherical_direction(longitudes[None, :], latitudes[:, None]).reshape(-1, 3), degree) @ found
    return StarShape(table.reshape(len(latitudes), len(longitudes)), float(rms))


def _basis(unit: FloatArray, degree: int) -> FloatArray:
    """(n, (degree + 1)^2) normalised surface harmonics."""
    c, s = solid_harmonics(unit, degree)
    orders = np.concatenate([np.arange(n + 1) for n in range(degree + 1)])
    scale = normalisation(degree)[:, None]
    # On the unit sphere solid harmonics are surface harmonics. Those of sin(0 lambda) are zero and left out.
    return np.asarray(np.concatenate([c / scale, (s / scale)[orders > 0]]).T)


def _lattice() -> tuple[FloatArray, FloatArray]:
    """Latitudes and longitudes of the table, rad."""
    rows, columns = round(180.0 / _STEP_DEG), round(360.0 / _STEP_DEG)
    return np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1), np.linspace(0.0, 2.0 * np.pi, columns + 1)


def _solid_angles(mesh: TriangleMesh, vertices: int) -> FloatArray:
    """(V,) sum of a third of the solid angles of the adjacent facets; facets that face inward count as zero."""
    middles = mesh.corners_m.mean(axis=1)
    # Solid angle of a small facet: its area across the line of sight over the squared distance.
    angles = np.einsum("fi,fi->f", middles, mesh.area_vectors_m2) / np.linalg.norm(middles, axis=1) ** 3
    found = np.zeros(vertices)
    np.add.at(found, mesh.faces, np.maximum(angles, 0.0)[:, None] / 3.0)
    return found


_BINS = 72  # of azimuth, 5 deg each


@dataclass(frozen=True, eq=False)
class Horizons:
    """Local horizons of n surface points with outward unit normals: elevation of the surrounding terrain by azimuth.

    A line to a distant camera or to the Sun is unobstructed if it is above the horizon. ``first`` and ``second`` (n, 3)
    are tangent unit vectors: azimuth 0 and 90 deg. ``tangents`` (n, bins) are those of the horizon's elevation at the
    azimuths (k + 1/2) 360 deg / bins.
    """

    points_m: FloatArray
    normals: FloatArray
    first: FloatArray
    second: FloatArray
    tangents: FloatArray

    @classmethod
    def of(cls, mesh: TriangleMesh, points_m: FloatArray, normals: FloatArray) -> Horizons:
        """Compute the horizons from the vertices, facet centres and edge midpoints of a mesh."""
        first, second = plane_axes(normals)
        corners = mesh.corners_m
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        ground = np.concatenate([mesh.vertices_m, corners.mean(axis=1), middles.reshape(-1, 3)])
        # Side of the square of ground that one of the points stands for.
        spacing = float(np.sqrt(mesh.areas_m2.sum() / len(ground)))
        tangents = np.zeros((len(points_m), _BINS))
        for i in range(len(points_m)):
            tangents[i] = _horizon_tangents(ground - points_m[i], np.stack([first[i], second[i], normals[i]]), spacing)
        return cls(points_m, normals, first, second, tangents)

    def free(self, rows: NDArray[np.int64], towards: FloatArray) -> BoolArray:
        """(k,) whether lines from the points ``rows`` in directions (k, 3) are unobstructed."""
        x = np.einsum("ki,ki->k", self.first[rows], towards)
        y = np.einsum("ki,ki->k", self.second[rows], towards)
        z = np.einsum("ki,ki->k", self.normals[rows], towards)
        # In bins from the centre of the first one: the horizon is interpolated between centres.
        place = np.arctan2(y, x) / (2.0 * np.pi) * _BINS - 0.5
        low = np.floor(place).astype(np.int64)
        share = place - low
        edge = (1.0 - share) * self.tangents[rows, low % _BINS] + share * self.tangents[rows, (low + 1) % _BINS]
        # tan(elevation) = z / hypot(x, y), compared without a division.
        above: BoolArray = z > edge * np.hypot(x, y)
        return above


def _horizon_tangents(offsets: FloatArray, axes: FloatArray, spacing: float) -> FloatArray:
    """(bins,) tangents of the horizon; terrain nearer than two point spacings is ignored."""
    up = offsets @ axes[2]
    # Terrain below the tangent plane cannot hide what is above it: the horizon is 0 at least.
    offsets, up = offsets[up > 0.0], up[up > 0.0]
    x, y = offsets @ axes[0], offsets @ axes[1]
    away = np.hypot(x, y)
    kept = away > 2.0 * spacing
    x, y, up, away = x[kept], y[kept], up[kept], away[kept]
    azimuth = np.arctan2(y, x) / (2.0 * np.pi) * _BINS
    # Half the azimuth that the ground of a point takes up, in bins.
    half = 0.5 * spacing / away / (2.0 * np.pi) * _BINS
    found = np.zeros(_BINS)
    slope = up / away
    for offset in (-1.0, 0.0, 1.0):
        np.maximum.at(found, np.floor(azimuth + offset * half).astype(np.int64) % _BINS, slope)
    return found


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
        return radiation_pressure(self.spec.light, self.sun_dir)

    @property
    def sun_dir(self) -> FloatArray:
        """(3,) unit vector towards the Sun, inertial axes."""
        sun = np.array(self.spec.light.sun_dir)
        return np.asarray(sun / np.linalg.norm(sun))

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
    found = homogeneous_harmonics(mesh, asteroid.gm_m3_s2, asteroid.gravity_degree, mesh.radius_m)
    c, s = found.c.copy(), found.s.copy()
    c[1], s[1] = 0.0, 0.0
    return Harmonics(found.gm_m3_s2, found.radius_m, c, s)
