"""Albedo of a body by a map: an image of equal steps of longitude and latitude."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.reading import read_bytes
from boresight.scenarios.spec.body import AlbedoMapSpec

ALBEDO_MAP_VERSION = 1
"""Part of the digest of every body with an albedo map: increase it when the same map gives other factors."""


def read_albedo_map(path: Path) -> FloatArray:
    """Read a map, (H, 2 H): rows from north to south, longitude growing eastward along a row.

    Raise BoresightError if it is not a readable grey image, not twice as wide as high, or a value is not positive.
    """
    # Imported here: OpenCV takes 0.1 s, which commands that list scenarios do without.
    from boresight.scenarios.bitmap import read_bitmap

    image = read_bitmap(read_bytes(path), path)
    if image.ndim != 2 or image.shape[1] != 2 * image.shape[0]:
        size = " x ".join(map(str, (image.shape[1], image.shape[0], *image.shape[2:])))
        raise BoresightError(
            f"{path}: body.albedo_map is a grey image of 360 x 180 deg, twice as wide as high, not {size}; resample it"
        )
    values = image.astype(np.float64)
    bad = ~(np.isfinite(values) & (values > 0.0))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise BoresightError(
            f"{path}: {int(bad.sum())} pixels of body.albedo_map are not above 0, the first in row {row}, column"
            f" {column}; fill what has no data"
        )
    return values


def with_albedo_map(mesh: TriangleMesh, spec: AlbedoMapSpec, path: Path) -> TriangleMesh:
    """Multiply the albedo of the vertices by the map's value in their direction from the origin over ``spec.unity``.

    Values are interpolated bilinearly between the centres of pixels, across the edge of the map and, beyond the first
    and last row, across the poles. Raise BoresightError as `read_albedo_map` does.
    """
    values = read_albedo_map(path)
    height, width = values.shape
    latitude_rad = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    # The mean over the sphere: a row has the area of its circle of latitude.
    unity = spec.unity or float(np.average(values.mean(axis=1), weights=np.cos(latitude_rad)))
    x, y, z = mesh.vertices_m.T
    column = (np.degrees(np.arctan2(y, x)) - spec.left_deg) % 360.0 * width / 360.0 - 0.5
    row = (0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * height - 0.5
    # A row beyond each pole: the nearest one, half a turn on.
    framed = np.concatenate([np.roll(values[:1], height, axis=1), values, np.roll(values[-1:], height, axis=1)])
    i, j = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    down, right = row - i, column - j
    left, next_ = j % width, (j + 1) % width
    # Rows of `framed` are one further down than those of the map.
    upper, lower = ((1.0 - right) * framed[k, left] + right * framed[k, next_] for k in (i + 1, i + 2))
    factor = ((1.0 - down) * upper + down * lower) / unity
    return TriangleMesh(mesh.vertices_m, mesh.faces, factor if mesh.albedo is None else factor * mesh.albedo)
