"""Named craters of Eros: where the gazetteer and the plate model put them in an image."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenarios.data import find_data_file
from scenarios.errors import BoresightError
from scenarios.geometry import Ellipses, TriangleMesh, View, project_circles
from scenarios.limits import LARGEST_NUMBER
from scenarios.sequences.ground import MeshGround

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

GAZETTEER = "craters/eros_named_craters_iau.csv"
_FAR = 3.0  # lengths of the body from which lines of sight come down on a crater
_EDGE_ON = 0.1  # cosine of emission below which a rim's image is a line


@dataclass(frozen=True, slots=True)
class NamedCrater:
    """One entry: planetocentric latitude, east longitude, diameter."""

    name: str
    latitude_rad: float
    longitude_rad: float
    diameter_m: float

    @property
    def direction(self) -> FloatArray:
        """(3,) unit vector from the body's centre."""
        c = np.cos(self.latitude_rad)
        return np.array([c * np.cos(self.longitude_rad), c * np.sin(self.longitude_rad), np.sin(self.latitude_rad)])


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Named craters that an image should show, with the images of their rims as plane circles."""

    names: tuple[str, ...]
    ellipses: Ellipses
    lit: BoolArray


def read_gazetteer(search_dirs: Sequence[Path] = ()) -> tuple[NamedCrater, ...]:
    """Read the table under ``$BORESIGHT_DATA``.

    Raises
    ------
    BoresightError
        If it is missing or a row is not one.
    """
    path = find_data_file(GAZETTEER, search_dirs, ".", "craters")
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader((line for line in file if not line.startswith("#")), strict=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BoresightError(f"{path}: cannot be read as a CSV table: {error}") from error
    if not rows:
        raise BoresightError(f"{path}: the table has no craters")
    return tuple(_crater(row, f"{path}: crater {number}") for number, row in enumerate(rows, start=1))


def _crater(row: Mapping[str, str | None], place: str) -> NamedCrater:
    try:
        lat_deg, lon_deg, diameter_km = (float(row[key] or "") for key in ("lat_deg", "lon_east_deg", "diam_km"))
        name = str(row["name"] or "")
    except (KeyError, ValueError) as error:
        raise BoresightError(f"{place} is not name, lat_deg, lon_east_deg, diam_km: {error}") from error
    if not (name and abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0 and 0.0 < diameter_km <= LARGEST_NUMBER):
        raise BoresightError(f"{place}: {name} at {lat_deg:g} and {lon_deg:g} deg, {diameter_km:g} km wide, cannot be")
    return NamedCrater(name, float(np.radians(lat_deg)), float(np.radians(lon_deg)), 1e3 * diameter_km)


def predict(craters: Sequence[NamedCrater], mesh: TriangleMesh, view: View) -> Predicted:
    """Put craters on the outermost surface in their direction and project those in sight of the camera.

    A rim lies in the mean plane of the facets within its radius.
    """
    ground = MeshGround(mesh)
    down = -np.array([crater.direction for crater in craters])
    points, normals = ground.intersect(-_FAR * ground.reach_m * down, down)
    radius = np.array([0.5 * crater.diameter_m for crater in craters])
    normals = np.array([_plane(mesh, p, r, n) for p, r, n in zip(points, radius, normals, strict=True)])
    camera_m = view.T_cam_body.camera_position_m
    toward = camera_m - points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    raised = points + 0.05 * radius[:, None] * normals
    seen = ground.in_sight(raised, normals, camera_m) & (np.einsum("ni,ni->n", normals, toward) > _EDGE_ON)
    uv = view.camera.project(points @ view.T_cam_body.rotation.T + view.T_cam_body.translation_m)
    rows = np.flatnonzero(seen & view.camera.contains(uv))
    ellipses = project_circles(view, points[rows], normals[rows], radius[rows]) if len(rows) else Ellipses.none()
    return Predicted(tuple(craters[int(i)].name for i in rows), ellipses, normals[rows] @ view.sun_dir_body > 0.0)


def _plane(mesh: TriangleMesh, point_m: FloatArray, radius_m: float, normal: FloatArray) -> FloatArray:
    """Return the mean normal of facets within a radius; the given one where there is no facet's middle."""
    near = np.linalg.norm(mesh.corners_m.mean(axis=1) - point_m, axis=1) < radius_m
    total = mesh.area_vectors_m2[near].sum(axis=0) if near.any() else normal
    return np.asarray(total / np.linalg.norm(total), dtype=np.float64)
