"""Simulated crater sightings: visibility by local horizons, detection, and wrong or merged numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import TriangleMesh, plane_axes
from boresight.scenarios.spec.orbit import CraterSightingSpec

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
        spacing = float(np.sqrt(np.linalg.norm(mesh.area_vectors_m2, axis=1).sum() / len(ground)))
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


def lit_and_seen(
    horizons: Horizons, camera_position_m: FloatArray, sun_dir: FloatArray, spec: CraterSightingSpec
) -> IndexArray:
    """Return the indices of the visible, sunlit craters within the limits of emission and incidence; body axes."""
    towards = camera_position_m - horizons.points_m
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    emission = np.einsum("ni,ni->n", horizons.normals, towards)
    incidence = horizons.normals @ sun_dir
    limits = np.cos(np.radians([spec.emission_max_deg, spec.incidence_max_deg]))
    rows = np.flatnonzero((emission > limits[0]) & (incidence > limits[1]))
    free = horizons.free(rows, towards[rows])
    rows = rows[free]
    return rows[horizons.free(rows, np.broadcast_to(sun_dir, (len(rows), 3)))]


def draw_found_craters(
    rows: IndexArray, prominence: FloatArray, spec: CraterSightingSpec, rng: np.random.Generator
) -> IndexArray:
    """Draw which of the craters in view are detected: positions in ``rows``, ascending."""
    # Poisson with a gamma-distributed mean, the negative binomial law: images differ in how many craters are found.
    mean = spec.per_image * rng.gamma(spec.per_image_shape) / spec.per_image_shape
    count = min(int(rng.poisson(mean)), len(rows))
    if not count:
        return np.zeros(0, dtype=np.int64)
    # Without replacement: a prominent crater is found more often, none twice.
    weights = prominence[rows] / prominence[rows].sum()
    return np.sort(rng.choice(len(rows), count, replace=False, p=weights))


def merged_numbers(points_m: FloatArray, share: float, rng: np.random.Generator) -> IndexArray:
    """(n,) number of each crater; a share of the craters have the number of their nearest neighbour."""
    numbers = np.arange(len(points_m))
    free = np.ones(len(points_m), dtype=bool)
    wanted = round(share * len(points_m))
    for i in rng.permutation(len(points_m)):
        if wanted <= 0:
            break
        if not free[i]:
            continue
        distance = np.where(free, np.linalg.norm(points_m - points_m[i], axis=1), np.inf)
        distance[i] = np.inf
        other = int(np.argmin(distance))
        numbers[i] = other
        free[[i, other]] = False
        wanted -= 1
    return numbers


def misidentify(
    numbers: IndexArray, chosen: IndexArray, uv_px: FloatArray, spec: CraterSightingSpec, rng: np.random.Generator
) -> tuple[IndexArray, BoolArray]:
    """Return the reported numbers of detected craters, and which of them are wrong.

    ``numbers`` (n,) are the correct ones of the craters in view, ``uv_px`` (n, 2) their pixels, ``chosen`` (k,) the
    rows of the detected ones. A wrong number is that of another crater in view, weighted by a Gaussian of the distance.
    """
    # One draw for each sighting, whatever the share is.
    wrong = rng.uniform(size=len(chosen)) < spec.wrong_share
    reported = numbers[chosen].copy()
    for k in np.flatnonzero(wrong):
        apart = np.sum((uv_px - uv_px[chosen[k]]) ** 2, axis=1)
        # Craters with the same number, the crater itself or one merged with it, are no wrong ones.
        weights = np.exp(-0.5 * apart / spec.wrong_within_px**2) * (numbers != numbers[chosen[k]])
        if weights.sum() > 0.0:
            reported[k] = numbers[rng.choice(len(numbers), p=weights / weights.sum())]
        else:
            wrong[k] = False
    return reported, wrong
