"""Named craters of Eros in a real image: predicted by gazetteer and shape model, and compared with detections."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import spiceypy
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from boresight.campaign.data.crater_pictures import detections_table
from boresight.estimators.craters.contract import CraterDetections, CraterDetector
from boresight.estimators.craters.detection.classic import CraterClassic, DetectionStages
from boresight.renderers.images import open_product
from boresight.renderers.images.product import ImageProduct
from boresight.renderers.spice import INSTRUMENTS
from boresight.reports.figures.craters import draw_detections, draw_stages
from boresight.reports.figures.style import save_figure
from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.atomic import write_text
from boresight.scenarios.bodies import load_body
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import (
    Camera,
    Ellipses,
    Pose,
    TriangleMesh,
    View,
    pixel_to_opencv,
    project_circles,
    spherical_direction,
)
from boresight.scenarios.observation import Frame
from boresight.scenarios.reading import LARGEST_NUMBER
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spice import find_kernels, loaded_kernels

IMAGE = "images/near_msi/m0126865998f4_2p_iof.lbl"
KERNELS = tuple(
    f"near_msi_m0126888978/{name}"
    for name in ("naif0012.tls", "pck00009.tpc", "eros_fixed.tf", "msi15.ti", "msiAddendum002.ti", "near_171.tsc")
)
_QUATERNION, _CRAFT, _TARGET = (19, 20, 21, 22), (23, 24, 25), (27, 28, 29)
_POSE_SIGMA = (
    np.array([1e-4] * 3),
    np.array([40.0, 40.0, 200.0]),
)  # rad, m: the header's pose has an error of about a pixel

GAZETTEER = "craters/eros_named_craters_iau.csv"
_FAR = 3.0  # body radii from which rays are cast down onto a crater
_EDGE_ON = 0.1  # cosine of emission below which a rim is seen edge-on

EROS = BodySpec(shape="eros022540.tab", unit="km", expected_diameter_m=(1e4, 5e4))
_NEAR, _ALIKE = 0.5, 0.5  # of the radius and of the log ratio of radii: gazetteer and pose are no better than that


@dataclass(frozen=True, slots=True, eq=False)
class MsiImage:
    """Frame with square pixels, and its view by the pose and Sun of the header."""

    name: str
    frame: Frame
    view: View


def open_msi(path: Path | None = None) -> MsiImage:
    """Open an image by its label or FITS file, by default the one in ``$BORESIGHT_DATA``.

    Raise BoresightError if a file is missing, the header has no pose, or the size of the image is not one of MSI's.
    """
    product = open_product(path or find_data_file(IMAGE, (), ".", "image"))
    msi = INSTRUMENTS["near-msi"]
    with loaded_kernels(find_kernels(KERNELS, (), "kernels")):
        et = msi.middle_et(product)
        R_body_j2000 = spiceypy.pxform("J2000", "EROS_FIXED", et)
        R_cam_craft = spiceypy.pxform("NEAR_SC_BUS_PRIME", msi.frame, et)
        camera = msi.camera(msi.constants())
    # The header's quaternion (w, x, y, z) is SPICE's: from J2000 to the spacecraft.
    rotation = R_cam_craft @ spiceypy.q2m(_numbers(product, _QUATERNION)) @ R_body_j2000.T
    craft, target = _numbers(product, _CRAFT), _numbers(product, _TARGET)
    pose = Pose(rotation, -rotation @ (1e3 * R_body_j2000 @ (craft - target)))
    # SUN_SC_POSITION_VECTOR is from the Sun to the spacecraft; the header's position of Eros is from the Sun too.
    sun = -R_body_j2000 @ target
    sun = sun / np.linalg.norm(sun)
    pixels = product.pixels()
    image, square = square_pixels(pixels, camera_of_lines(camera, pixels.shape, product.path))
    covariance = np.diag(np.concatenate(_POSE_SIGMA) ** 2)
    frame = Frame(image, rotation @ sun, pose, covariance, et)
    return MsiImage(product.path.stem, frame, View(square, pose, sun))


def _numbers(product: ImageProduct, keys: Sequence[int]) -> FloatArray:
    """Read numeric keywords of the header; some products write them as text."""
    values = [product.keywords.get(f"NEAR-{key:03d}") for key in keys]
    try:
        numbers = np.array([float(str(value)) for value in values])
    except ValueError:
        numbers = np.full(len(keys), np.nan)
    if not (np.abs(numbers) <= LARGEST_NUMBER).all():
        raise BoresightError(
            f"{product.path}: the FITS header has no numbers NEAR-{keys[0]:03d} to NEAR-{keys[-1]:03d}: {values}"
        )
    return numbers


def camera_of_lines(camera: Camera, shape: tuple[int, ...], path: Path) -> Camera:
    """Return the camera of an image (lines, samples): the detector's, or the same with its lines resampled to squares.

    MSI's pixels are 1.7 times as high as wide; products of 412 lines have square pixels, with distortion. Raise
    BoresightError if the image is of neither size.
    """
    square = round(camera.height_px * camera.fx_px / camera.fy_px)
    if shape not in {(lines, camera.width_px) for lines in (camera.height_px, square)}:
        raise BoresightError(
            f"{path}: the image is {shape[1]} x {shape[0]} pixels, but images of NEAR's MSI are {camera.width_px} x"
            f" {camera.height_px}, or {camera.width_px} x {square} with square pixels"
        )
    ratio = shape[0] / camera.height_px
    return replace(camera, height_px=shape[0], fy_px=ratio * camera.fy_px, cy_px=ratio * camera.cy_px)


def square_pixels(image: NDArray[np.float32], camera: Camera) -> tuple[NDArray[np.float32], Camera]:
    """Resample an image once, by cubic splines, to square pixels of a pinhole camera of the same field of view."""
    height = round(camera.height_px * camera.fx_px / camera.fy_px)
    ratio = height / camera.height_px
    square = Camera(camera.width_px, height, camera.fx_px, camera.fy_px * ratio, camera.cx_px, camera.cy_px * ratio)
    columns, rows = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(height) + 0.5)
    place = pixel_to_opencv(camera.distorted(np.stack([columns, rows / ratio], axis=-1)))
    found: NDArray[np.float32] = map_coordinates(
        image, [place[..., 1], place[..., 0]], output=np.float32, order=3, mode="nearest"
    )
    return found, square


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
        return spherical_direction(self.longitude_rad, self.latitude_rad)


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
        with path.open(encoding="utf-8-sig", newline="") as file:
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
    # With the named crater matched with each detection.
    names = {int(row): name for row, name in zip(found.nearest, found.predicted.names, strict=True) if row >= 0}
    table = detections_table(found.detections).assign(name=lambda rows: [names.get(k, "") for k in rows.index])
    write_text(folder / "detections.csv", table.to_csv(index=False, lineterminator="\n"))
    return [*written, folder / "detections.csv"]
