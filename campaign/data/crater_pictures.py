"""Detection of craters in a picture of which nothing else is known, and the labels that somebody gave them."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from boresight.campaign.data.label_score import LabelMatches, label_quality, match_labels, score_table
from boresight.estimators.craters.contract import CraterDetections, CraterDetector
from boresight.estimators.craters.detection.preparation import check_image, lit_ground
from boresight.estimators.craters.learned.heat_map import estimate_sun
from boresight.estimators.craters.learned.heat_map_detector import packaged_heat_map
from boresight.reports.figures.craters import draw_detections
from boresight.reports.figures.style import save_figure
from boresight.scenarios.arrays import BoolArray, FloatArray, Image
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose
from boresight.scenarios.observation import Frame

PICTURES = (".png", ".pgm", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_MOST_PIXELS = 20_000_000  # of a picture: the layers of a heat map take 100 bytes a pixel
_MOST_PX = 1e6

_ALIKE = {
    "u": "u", "u_px": "u", "c_x": "u", "cx": "u", "x_px": "u", "v": "v", "v_px": "v", "c_y": "v", "cy": "v",
    "y_px": "v", "x": "x", "y": "y", "w": "width", "width": "width", "h": "height", "height": "height",
    "diameter": "diameter", "diameter_px": "diameter", "d": "diameter", "radius": "radius", "radius_px": "radius",
    "r": "radius", "a": "a", "a_px": "a", "b": "b", "b_px": "b", "angle": "angle", "angle_deg": "angle",
}  # fmt: skip

_FOV_RAD = 0.1  # detectors use the size of the camera alone
_RANGE_M = 1e5
_SUN_ELEVATION_RAD = np.radians(30.0)  # above the image plane: unknown, and of little effect on detectors
RADIUS_MIN_PX = 4.0  # of labels that are scored
LARGE_PX = 10.0  # least radius of labels that are scored apart
OPTIONS: Mapping[str, Mapping[str, object]] = {
    "crater-heat-map": {"radius_min_px": 3.0, "blend_from_px": 1e6},
    "crater-learned": {"radius_min_px": 3.0, "proposals": 8000, "blend_from_px": 1e6},
}
"""Options of detectors in pictures: labels are made down to smaller craters than the truth of rendered images has.

The gradient does not move rims: on the images for choices, offsets of labels of 10 px radius and more from the rims of
``crater-heat-map`` scatter by 0.117 radii along the rows with it, and by 0.107 without.
"""


def open_picture(path: Path) -> Image:
    """Read an image (H, W) of 8 or 16 bits as float32; colours become grey.

    Raise BoresightError if the file is missing or no image.
    """
    try:
        stored = np.frombuffer(path.read_bytes(), dtype=np.uint8)
        found = cv2.imdecode(stored, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE) if len(stored) else None
    except (OSError, cv2.error) as error:
        raise BoresightError(f"{path}: cannot be read: {error}") from error
    if found is None:
        raise BoresightError(f"{path}: no image of a known format ({', '.join(PICTURES)})")
    if found.size > _MOST_PIXELS:
        raise BoresightError(
            f"{path}: {found.size / 1e6:.0f} megapixels are more than {_MOST_PIXELS / 1e6:.0f}: cut it"
        )
    return np.asarray(found, dtype=np.float32)


def read_labels(path: Path, columns: str = "") -> Ellipses:
    """Read a table of boxes, circles or ellipses, separated by commas, semicolons or tabs, as rims.

    Its first line names the columns: ``x, y, w, h`` of boxes with x and y at their upper left corner; ``x, y`` (or
    ``u, v``) and ``radius`` or ``diameter`` of circles; ``u, v, a, b, angle_deg`` of ellipses with semi-axes a and b.
    All are continuous pixels. ``columns`` are the names for a table without such a line.

    Raise BoresightError, with file and line, if the table is none of these or a number is impossible.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BoresightError(f"{path}: cannot be read: {error}") from error
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line[0] != "#"]
    try:
        rows = [(k, next(csv.reader([line.replace("\t", ",").replace(";", ",")]))) for k, line in lines]
    except csv.Error as error:
        raise BoresightError(f"{path}: not readable as a table: {error}") from error
    names = columns.split(",") if columns else rows.pop(0)[1] if rows else []
    meant = [_ALIKE.get(name.strip().lower(), "") for name in names]
    place = {name: meant.index(name) for name in meant if name}
    wanted = _kind_of(path, set(place), names)
    if twice := [name for name in wanted if meant.count(name) > 1]:
        where = "--columns" if columns else "line 1"
        raise BoresightError(f"{path}: {where}: two columns are {twice[0]}: leave one out, or name it otherwise")
    if not rows:
        raise BoresightError(f"{path}: the table has no craters")
    numbers = np.array([_numbers(path, k, row, [place[name] for name in wanted], wanted) for k, row in rows])
    return _rims(dict(zip(wanted, numbers.T, strict=True)))


def _kind_of(path: Path, there: set[str], names: list[str]) -> list[str]:
    """Return the columns of the first kind of shape that are all there."""
    kinds = [[*centre, *size] for size in (["a", "b", "angle"], ["radius"], ["diameter"]) for centre in ("uv", "xy")]
    for kind in [*kinds[:2], ["x", "y", "width", "height"], *kinds[2:]]:
        if there.issuperset(kind):
            return kind
    raise BoresightError(
        f"{path}: line 1: columns {', '.join(name.strip() for name in names) or 'none'} are no boxes (x, y, w, h),"
        " circles (x, y, radius or diameter) or ellipses (u, v, a, b, angle_deg): name the columns by --columns"
    )


def _numbers(path: Path, line: int, row: list[str], places: list[int], names: list[str]) -> FloatArray:
    try:
        values = np.array([float(row[i]) for i in places])
    except (ValueError, IndexError):
        raise BoresightError(f"{path}: line {line}: {', '.join(names)} are not all numbers") from None
    sizes = [value for name, value in zip(names, values, strict=True) if name not in ("u", "v", "x", "y", "angle")]
    if not np.all(np.abs(values) < _MOST_PX) or min(sizes) <= 0.0:
        shown = ", ".join(f"{name} {value:g}" for name, value in zip(names, values, strict=True))
        raise BoresightError(f"{path}: line {line}: {shown} cannot be a crater in an image")
    return values


def _rims(columns: dict[str, FloatArray]) -> Ellipses:
    """Build ellipses; the longer axis comes first."""
    centre = np.stack([columns[name] for name in ("uv" if "u" in columns else "xy")], axis=1)
    angle = np.radians(columns.get("angle", np.zeros(len(centre))))
    if "width" in columns:
        axes = 0.5 * np.stack([columns["width"], columns["height"]], axis=1)
        centre = centre + axes
    elif "a" in columns:
        axes = np.stack([columns["a"], columns["b"]], axis=1)
    else:
        radius = columns["radius"] if "radius" in columns else 0.5 * columns["diameter"]
        axes = np.stack([radius, radius], axis=1)
    swap = axes[:, 1] > axes[:, 0]
    axes = np.where(swap[:, None], axes[:, ::-1], axes)
    return Ellipses(centre, axes, (angle + np.where(swap, 0.5 * np.pi, 0.0)) % np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class PictureDetection:
    """Detections in a picture; ``sun_px`` (2,) points towards the Sun, ``labels`` are None if there are none.

    Recall is of the labels that ``wanted`` (n,) names; None: of all.
    """

    name: str
    image: Image
    sun_px: FloatArray
    detections: CraterDetections
    labels: Ellipses | None = None
    wanted: BoolArray | None = None

    def matches(self, radius_min_px: float = RADIUS_MIN_PX) -> LabelMatches:
        """Match the detections with the labels, those of at least a radius."""
        labels = self.labels or Ellipses.none()
        return match_labels(self.detections, labels, self.image, radius_min_px, self.wanted)

    def above_threshold(self, matches: LabelMatches) -> BoolArray:
        """Say which of the matched detections are above the detector's threshold."""
        sure = self.detections.confidence
        return np.asarray(matches.confidence >= (sure[-1] if len(sure) else np.inf))

    def summary(self) -> list[str]:
        """Return lines on the Sun, and on recall and quality of the labels if there are any."""
        angle = np.degrees(np.arctan2(self.sun_px[1], self.sun_px[0]))
        lines = [f"Sun towards {angle:.0f} deg from the columns' direction, clockwise as seen"]
        if self.labels is None:
            return lines
        matches = self.matches()
        n, label = len(matches.radius_px), matches.label[self.above_threshold(matches)]
        found, false = int(np.sum(label >= 0)), int(np.sum(label == -1))
        lines.append(
            f"{found} of {n} labels from {RADIUS_MIN_PX:g} px radius found;"
            f" {false} of {matches.large[self.above_threshold(matches)].sum()} detections of that size fit no label"
        )
        return [*lines, label_quality(matches)]


def detect_in_picture(
    detector: CraterDetector, path: Path, sun_deg: float | None = None, truth: Path | None = None, columns: str = ""
) -> PictureDetection:
    """Detect craters in a picture.

    ``sun_deg`` is the direction towards the Sun, from the columns' direction towards greater rows; None: it is
    estimated from the image. ``truth`` is a table for `read_labels`; labels with their centre outside are left out.

    Raise BoresightError if a file is missing or invalid, or the image shows nothing.
    """
    image = open_picture(path)
    labels = read_labels(truth, columns) if truth is not None else None
    if labels is not None:
        inside = np.all((labels.centre_px >= 0.0) & (labels.centre_px <= image.shape[::-1]), axis=1)
        if not inside.any():
            raise BoresightError(f"{truth}: no crater has its centre in {path}")
        labels = labels[np.flatnonzero(inside)]
    try:
        return PictureDetection(path.name, image, *detect_in_image(detector, image, sun_deg), labels)
    except BoresightError as error:
        raise BoresightError(f"{path}: {error}") from error


def detect_in_image(
    detector: CraterDetector, image: Image, sun_deg: float | None = None
) -> tuple[FloatArray, CraterDetections]:
    """Return (2,) the direction towards the Sun and the craters of an image; see `detect_in_picture`."""
    camera = Camera.from_fov(image.shape[1], image.shape[0], _FOV_RAD)
    if sun_deg is None:
        check_image(image, camera)
        sun_px = estimate_sun(packaged_heat_map(), image, lit_ground(image).astype(np.float32))
    else:
        sun_px = np.array([np.cos(np.radians(sun_deg)), np.sin(np.radians(sun_deg))])
    sun = np.array([*(np.cos(_SUN_ELEVATION_RAD) * sun_px), -np.sin(_SUN_ELEVATION_RAD)])
    frame = Frame(image, sun, Pose(np.eye(3), np.array([0.0, 0.0, _RANGE_M])), np.eye(6))
    return sun_px, detector.detect(frame, camera)


def write_picture(found: PictureDetection, folder: Path) -> list[Path]:
    """Write the figure, the table of detections and, with labels, that of the scores; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    labels = found.labels or Ellipses.none()
    title = f"{found.name}: detected craters" + (", and labels (dashed)" if found.labels is not None else "")
    figure = draw_detections(found.image, found.detections.ellipses, labels, [""] * len(labels), title)
    written = list(save_figure(figure, folder / "detections"))
    tables = {"detections.csv": detections_table(found.detections)}
    if found.labels is not None:
        tables["scores.csv"] = score_table(found.matches()).round(4)
    for name, one in tables.items():
        write_text(folder / name, one.to_csv(index=False, lineterminator="\n"))
    return [*written, *(folder / name for name in tables)]


def detections_table(found: CraterDetections) -> pd.DataFrame:
    """Tabulate detections in words, the most confident first: centre and semi-axes, px, angle, deg, and confidence."""
    rims = found.ellipses
    numbers = np.column_stack([rims.centre_px, rims.semi_axes_px, np.degrees(rims.angle_rad)])
    table = pd.DataFrame(numbers, columns=["u_px", "v_px", "a_px", "b_px", "angle_deg"]).map("{:.2f}".format)
    return table.assign(confidence=[f"{value:.4f}" for value in found.confidence])
