"""Which craters an image shows, where, and under which number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.orbits.horizon import Horizons
from scenarios.spec.orbit import CraterSightingSpec

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def lit_and_seen(
    horizons: Horizons, camera_position_m: FloatArray, sun_dir: FloatArray, spec: CraterSightingSpec
) -> IndexArray:
    """Rows of the craters within the limits of emission and incidence that nothing hides or shades; body axes."""
    towards = camera_position_m - horizons.points_m
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    emission = np.einsum("ni,ni->n", horizons.normals, towards)
    incidence = horizons.normals @ sun_dir
    limits = np.cos(np.radians([spec.emission_max_deg, spec.incidence_max_deg]))
    rows = np.flatnonzero((emission > limits[0]) & (incidence > limits[1]))
    free = horizons.free(rows, towards[rows])
    rows = rows[free]
    return rows[horizons.free(rows, np.broadcast_to(sun_dir, (len(rows), 3)))]


def found_craters(
    rows: IndexArray, prominence: FloatArray, spec: CraterSightingSpec, rng: np.random.Generator
) -> IndexArray:
    """Draw which of the craters in view are found: places in ``rows``, in ascending order."""
    mean = spec.per_image * rng.gamma(spec.per_image_shape) / spec.per_image_shape
    count = min(int(rng.poisson(mean)), len(rows))
    if not count:
        return np.zeros(0, dtype=np.int64)
    weights = prominence[rows] / prominence[rows].sum()
    return np.sort(rng.choice(len(rows), count, replace=False, p=weights))


def merged_numbers(points_m: FloatArray, share: float, rng: np.random.Generator) -> IndexArray:
    """(n,) number of each crater: its own, but for a share of them that carry the number of their neighbour as well."""
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


def mistaken(
    numbers: IndexArray, chosen: IndexArray, uv_px: FloatArray, spec: CraterSightingSpec, rng: np.random.Generator
) -> tuple[IndexArray, BoolArray]:
    """Numbers under which found craters are reported, and which of them are wrong.

    Parameters
    ----------
    numbers
        (n,) right numbers of the craters in view.
    chosen
        (k,) those of them that were found.
    uv_px
        (n, 2) of all of them: a wrong number is that of another crater in view, the nearer the likelier.
    """
    wrong = rng.uniform(size=len(chosen)) < spec.wrong_share
    reported = numbers[chosen].copy()
    for k in np.flatnonzero(wrong):
        apart = np.sum((uv_px - uv_px[chosen[k]]) ** 2, axis=1)
        weights = np.exp(-0.5 * apart / spec.wrong_within_px**2) * (numbers != numbers[chosen[k]])
        if weights.sum() > 0.0:
            reported[k] = numbers[rng.choice(len(numbers), p=weights / weights.sum())]
        else:
            wrong[k] = False
    return reported, wrong
