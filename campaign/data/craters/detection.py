"""Detection in a real image, and what of it lies where named craters should."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from campaign.data.craters.msi_image import RealImage, open_msi
from campaign.data.craters.named_craters import Predicted, predict, read_gazetteer
from estimators.craters.contract import CraterDetections, CraterDetector
from estimators.craters.detection.classic import CraterClassic, DetectionStages
from reports.figures.craters import draw_detections, draw_stages
from reports.figures.style import save_figure
from scenarios.atomic import write_text
from scenarios.bodies import load_body
from scenarios.spec.body import BodySpec

EROS = BodySpec(shape="eros022540.tab", unit="km", expected_diameter_m=(1e4, 5e4))
_NEAR, _ALIKE = 0.5, 0.5  # of the radius and of the log ratio of radii: gazetteer and pose are no better than that


@dataclass(frozen=True, slots=True, eq=False)
class RealDetection:
    """What was found in a real image, and what was expected.

    Parameters
    ----------
    nearest
        (k,) row of the detection that is taken for each named crater; -1 where none is near enough and alike.
    stages
        Of the classic detector; None of others.
    """

    image: RealImage
    detections: CraterDetections
    predicted: Predicted
    nearest: NDArray[np.int64]
    stages: DetectionStages | None

    def summary(self) -> list[str]:
        """One line for each named crater that the image should show."""
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
    """Open an image of NEAR's MSI, detect, and look for the named craters.

    Raises
    ------
    BoresightError
        If a file is missing or the image shows nothing.
    """
    image = open_msi(path)
    predicted = predict(read_gazetteer(), load_body(EROS).mesh, image.view)
    stages = detector.stages(image.frame, image.view.camera) if isinstance(detector, CraterClassic) else None
    found = stages.detections if stages else detector.detect(image.frame, image.view.camera)
    return RealDetection(image, found, predicted, _nearest(found, predicted), stages)


def _nearest(found: CraterDetections, predicted: Predicted) -> NDArray[np.int64]:
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
    """Write the figures and a table of the detections; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    picture = np.sqrt(np.maximum(found.image.frame.image, 0.0))  # for the eye: what is dim shows too
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
    """Rows of the detections, the most confident first, with the named crater that each is taken for."""
    names = {int(row): name for row, name in zip(found.nearest, found.predicted.names, strict=True) if row >= 0}
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["u_px", "v_px", "a_px", "b_px", "angle_deg", "confidence", "name"])
    rims = found.detections.ellipses
    for k in range(len(rims)):
        numbers = [*rims.centre_px[k], *rims.semi_axes_px[k], np.degrees(rims.angle_rad[k])]
        writer.writerow([*(f"{x:.2f}" for x in numbers), f"{found.detections.confidence[k]:.4f}", names.get(k, "")])
    return out.getvalue()
