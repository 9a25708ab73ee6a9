"""Named craters of Eros in a real image: predicted by gazetteer and shape model, and compared with detections."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.campaign.data.msi_image import MsiImage, open_msi
from boresight.estimators.craters.contract import CraterDetections, CraterDetector
from boresight.estimators.craters.detection.classic import CraterClassic, DetectionStages
from boresight.reports.figures.craters import draw_detections, draw_stages
from boresight.reports.figures.style import save_figure
from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.atomic import write_text
from boresight.scenarios.bodies import load_body
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses, TriangleMesh, View, project_circles
from boresight.scenarios.limits import LARGEST_NUMBER
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.body import BodySpec

GAZETTEER = "craters/eros_named_craters_iau.csv"
_FAR = 3.0  # body radii from which rays are cast down onto a crater
_EDGE_ON = 0.1  # cosine of emission below which a rim is seen edge-on

EROS = BodySpec(shape="eros022540.tab", unit="km", expected_diameter_m=(1e4, 5e4))
_NEAR, _ALIKE = 0.5, 0.5  # of the radius and of the log ratio of radii: gazetteer and pose are no better than that


@dataclass(frozen=True, slots=True)
class NamedCrater:
    """Entry of the gazetteer: planetocentric latitude, east longitude, diameter."""

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
class PredictedCraters:
    """Named craters expected in an image, with the ellipses of their rims as plane circles."""

    names: tuple[str, ...]
    ellipses: Ellipses
    lit: BoolArray


def read_gazetteer(search_dirs: Sequence[Path] = ()) -> tuple[NamedCrater, ...]:
    """Read the gazetteer in ``$BORESIGHT_DATA``; raise BoresightError if it is missing or a row is invalid."""
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


def predict(craters: Sequence[NamedCrater], mesh: TriangleMesh, view: View) -> PredictedCraters:
    """Place craters on the outermost surface in their direction, and project those visible to the camera.

    The rim is a circle in the mean plane of the facets within its radius.
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
    return PredictedCraters(
        tuple(craters[int(i)].name for i in rows), ellipses, normals[rows] @ view.sun_dir_body > 0.0
    )


def _plane(mesh: TriangleMesh, point_m: FloatArray, radius_m: float, normal: FloatArray) -> FloatArray:
    """Return the mean normal of the facets within a radius; the given normal if there are none."""
    near = np.linalg.norm(mesh.corners_m.mean(axis=1) - point_m, axis=1) < radius_m
    total = mesh.area_vectors_m2[near].sum(axis=0) if near.any() else normal
    return np.asarray(total / np.linalg.norm(total), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class RealDetection:
    """Detections in a real image, and the craters expected in it.

    ``nearest`` (k,) is the index of the detection matched with each named crater, -1 if none is similar in position and
    radius. ``stages`` are intermediate results of the classic detector, None for others.
    """

    image: MsiImage
    detections: CraterDetections
    predicted: PredictedCraters
    nearest: NDArray[np.int64]
    stages: DetectionStages | None

    def summary(self) -> list[str]:
        """Return one line for each expected crater."""
        lines = []
        for k, name in enumerate(self.predicted.names):
            u, v = self.predicted.ellipses.centre_px[k]
            text = f"{name}: expected at ({u:.0f}, {v:.0f}), radius {self.predicted.ellipses.radius_px[k]:.0f} px"
            row = int(self.nearest[k])
            if row >= 0:
                u, v = self.detections.ellipses.centre_px[row]
                text += f"; found at ({u:.1f}, {v:.1f}), radius {self.detections.ellipses.radius_px[row]:.1f} px"
            else:
                text += "; not found" if self.predicted.lit[k] else "; its ground faces away from the Sun"
            lines.append(text)
        return lines


def detect_real(detector: CraterDetector, path: Path | None = None) -> RealDetection:
    """Open an image of NEAR's MSI, detect craters, and match them with the named ones.

    Raise BoresightError if a file is missing or the image shows nothing.
    """
    image = open_msi(path)
    predicted = predict(read_gazetteer(), load_body(EROS).mesh, image.view)
    stages = detector.stages(image.frame, image.view.camera) if isinstance(detector, CraterClassic) else None
    found = stages.detections if stages else detector.detect(image.frame, image.view.camera)
    return RealDetection(image, found, predicted, _nearest(found, predicted), stages)


def _nearest(found: CraterDetections, predicted: PredictedCraters) -> NDArray[np.int64]:
    radius = predicted.ellipses.radius_px
    apart = np.linalg.norm(predicted.ellipses.centre_px[:, None] - found.ellipses.centre_px[None], axis=2)
    ratio = np.abs(np.log(found.ellipses.radius_px[None] / radius[:, None]))
    unlike = apart / radius[:, None] / _NEAR + ratio / _ALIKE
    unlike[(apart > _NEAR * radius[:, None]) | (ratio > _ALIKE)] = np.inf
    if unlike.shape[1] == 0:
        return np.full(len(radius), -1, dtype=np.int64)
    best = unlike.argmin(axis=1)
    return np.where(np.isfinite(unlike[np.arange(len(best)), best]), best, -1)


def write_real(found: RealDetection, folder: Path) -> list[Path]:
    """Write figures and a table of the detections; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    picture = np.sqrt(np.maximum(found.image.frame.image, 0.0))  # brightens dark regions for display
    figure = draw_detections(
        picture, found.detections.ellipses, found.predicted.ellipses, found.predicted.names,
        f"{found.image.name}: detected craters, and named craters where gazetteer, shape and header put them (dashed)",
    )  # fmt: skip
    written = list(save_figure(figure, folder / "detections"))
    if found.stages is not None:
        small, large = found.stages.edges
        arcs = {"shaded": [a.uv_px for a in found.stages.shaded], "lit": [a.uv_px for a in found.stages.lit]}
        figure = draw_stages(picture, small.mask | large.mask, arcs, found.detections.ellipses)
        written += save_figure(figure, folder / "stages")
    write_text(folder / "detections.csv", _table(found))
    return [*written, folder / "detections.csv"]


def _table(found: RealDetection) -> str:
    """CSV of the detections by decreasing confidence, with the named crater matched with each."""
    names = {int(row): name for row, name in zip(found.nearest, found.predicted.names, strict=True) if row >= 0}
    rims = found.detections.ellipses
    numbers = np.column_stack([rims.centre_px, rims.semi_axes_px, np.degrees(rims.angle_rad)])
    table = pd.DataFrame(numbers, columns=["u_px", "v_px", "a_px", "b_px", "angle_deg"]).map("{:.2f}".format)
    table["confidence"] = [f"{value:.4f}" for value in found.detections.confidence]
    table["name"] = [names.get(k, "") for k in range(len(rims))]
    return table.to_csv(index=False, lineterminator="\n")
