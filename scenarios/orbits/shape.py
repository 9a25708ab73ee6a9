"""Star-shaped body as spherical harmonics of its radius: the a priori shape of Cheng et al. (2003), degree 2 to 34."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.dynamics.harmonics import normalisation, solid_harmonics
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh

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
        """Return a closed mesh through the table."""
        return _lattice_mesh(self.radii_m)


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
    table = _basis(_directions(latitudes[:, None], longitudes[None, :]).reshape(-1, 3), degree) @ found
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


def _directions(latitude: FloatArray, longitude: FloatArray) -> FloatArray:
    """(..., 3) unit vectors."""
    parts = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)
    return np.stack(np.broadcast_arrays(*parts), -1)


def _solid_angles(mesh: TriangleMesh, vertices: int) -> FloatArray:
    """(V,) sum of a third of the solid angles of the adjacent facets; facets that face inward count as zero."""
    middles = mesh.corners_m.mean(axis=1)
    # Solid angle of a small facet: its area across the line of sight over the squared distance.
    angles = np.einsum("fi,fi->f", middles, mesh.area_vectors_m2) / np.linalg.norm(middles, axis=1) ** 3
    found = np.zeros(vertices)
    np.add.at(found, mesh.faces, np.maximum(angles, 0.0)[:, None] / 3.0)
    return found


def _lattice_mesh(radii: FloatArray) -> TriangleMesh:
    """Make a closed mesh of the table; the first and last rows become one vertex each."""
    latitudes, longitudes = _lattice()
    rows, columns = len(latitudes), len(longitudes) - 1
    unit = _directions(latitudes[1:-1, None], longitudes[None, :-1])
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
