"""Detection of craters in a picture of which nothing else is known, and scores against somebody's labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from boresight.campaign.data.crater_labels import open_picture, read_labels
from boresight.campaign.data.label_score import LabelMatches, label_quality, match_labels, score_table
from boresight.estimators.craters.contract import CraterDetections, CraterDetector
from boresight.estimators.craters.detection.preparation import check_image, lit_ground
from boresight.estimators.craters.learned.heat_map_detector import packaged_heat_map
from boresight.estimators.craters.learned.sunward import estimate_sun
from boresight.reports.figures.craters import draw_detections
from boresight.reports.figures.style import save_figure
from boresight.scenarios.arrays import BoolArray, FloatArray, Image
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose
from boresight.scenarios.observation import Frame

_FOV_RAD = 0.1  # detectors use the size of the camera alone
_RANGE_M = 1e5
_SUN_ELEVATION_RAD = np.radians(30.0)  # above the image plane: unknown, and of little effect on detectors
RADIUS_MIN_PX = 4.0  # of labels that are scored
OPTIONS: Mapping[str, Mapping[str, object]] = {
    "crater-heat-map": {"radius_min_px": 3.0},
    "crater-learned": {"radius_min_px": 3.0, "proposals": 8000},
}
"""Options of detectors in pictures: labels are made down to smaller craters than the truth of rendered images has."""


@dataclass(frozen=True, slots=True, eq=False)
class PictureDetection:
    """Detections in a picture; ``sun_px`` (2,) points towards the Sun, ``labels`` are None if there are none."""

    name: str
    image: Image
    sun_px: FloatArray
    detections: CraterDetections
    labels: Ellipses | None = None

    def matches(self) -> LabelMatches:
        """Match the detections with the labels."""
        return match_labels(self.detections, self.labels or Ellipses.none(), self.image, RADIUS_MIN_PX)

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
    camera = Camera.from_fov(image.shape[1], image.shape[0], _FOV_RAD)
    if labels is not None:
        inside = np.all((labels.centre_px >= 0.0) & (labels.centre_px <= image.shape[::-1]), axis=1)
        if not inside.any():
            raise BoresightError(f"{truth}: no crater has its centre in {path}")
        labels = labels[np.flatnonzero(inside)]
    try:
        if sun_deg is None:
            check_image(image, camera)
            sun_px = estimate_sun(packaged_heat_map(), image, lit_ground(image).astype(np.float32))
        else:
            sun_px = np.array([np.cos(np.radians(sun_deg)), np.sin(np.radians(sun_deg))])
        sun = np.array([*(np.cos(_SUN_ELEVATION_RAD) * sun_px), -np.sin(_SUN_ELEVATION_RAD)])
        frame = Frame(image, sun, Pose(np.eye(3), np.array([0.0, 0.0, _RANGE_M])), np.eye(6))
        return PictureDetection(path.name, image, sun_px, detector.detect(frame, camera), labels)
    except BoresightError as error:
        raise BoresightError(f"{path}: {error}") from error


def write_picture(found: PictureDetection, folder: Path) -> list[Path]:
    """Write the figure, the table of detections and, with labels, that of the scores; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    labels = found.labels or Ellipses.none()
    title = f"{found.name}: detected craters" + (", and labels (dashed)" if found.labels is not None else "")
    figure = draw_detections(found.image, found.detections.ellipses, labels, [""] * len(labels), title)
    written = list(save_figure(figure, folder / "detections"))
    rims = found.detections.ellipses
    numbers = np.column_stack([rims.centre_px, rims.semi_axes_px, np.degrees(rims.angle_rad)])
    table = pd.DataFrame(numbers, columns=["u_px", "v_px", "a_px", "b_px", "angle_deg"]).map("{:.2f}".format)
    table["confidence"] = [f"{value:.4f}" for value in found.detections.confidence]
    tables = {"detections.csv": table}
    if found.labels is not None:
        tables["scores.csv"] = score_table(found.matches()).round(4)
    for name, one in tables.items():
        write_text(folder / name, one.to_csv(index=False, lineterminator="\n"))
    return [*written, *(folder / name for name in tables)]
