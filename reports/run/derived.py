"""Figures that follow from the scenario alone: what a pixel is on the body, as a length, a turn and a displacement."""

from __future__ import annotations

import math

from pydantic import ValidationError

from reports.run.data import RunData
from reports.schema.records import DERIVED, Record
from reports.schema.tables import unit_of
from scenarios.spec.camera import CameraSpec


def derived_records(run: RunData, radius_m: float) -> tuple[Record, ...]:
    """Work out, for each scenario, what one pixel on the boresight amounts to at the median range of its trials.

    ``pixel_scale_m`` on the near side of a ball of that radius; ``pixel_rotation_deg``, the turn of the ball that moves
    its near side by a pixel; ``pixel_displacement_m``, the camera's own displacement in the body frame that looks the
    same (Rowell et al. 2015, sections 4.2 and 4.3).
    """
    records: list[Record] = []
    for name, scenario in run.manifest.scenarios.items():
        try:
            camera = CameraSpec.model_validate(scenario.get("camera", {})).camera()
        except (AttributeError, ValidationError):
            continue
        rows = run.rows[run.rows["scenario"] == name]
        if rows["range_m"].notna().any():
            records += _of_a_pixel(str(name), camera.pixel_angle_rad, float(rows["range_m"].median()), radius_m)
    return tuple(records)


def _of_a_pixel(scenario: str, angle_rad: float, range_m: float, radius_m: float) -> list[Record]:
    scale_m = angle_rad * (range_m - radius_m)
    values = {
        "pixel_scale_m": scale_m,
        "pixel_rotation_deg": math.degrees(scale_m / radius_m),
        "pixel_displacement_m": scale_m / radius_m * range_m,
    }
    return [
        Record(scenario, "", DERIVED, "", name, unit_of(name), "value", value, value, value, 1, 1)
        for name, value in values.items()
    ]
