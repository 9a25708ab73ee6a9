"""What the spacecraft measures beside the image, made from the truth."""

from __future__ import annotations

import numpy as np

from campaign.imaging.world import World
from scenarios.geometry import View
from scenarios.observation import RangeReading


def altimeter_reading(world: World, view: View, rng: np.random.Generator) -> RangeReading | None:
    """Measure the distance from the camera along its boresight to the true surface.

    Returns
    -------
    The reading; None where the scenario has no altimeter, or the boresight misses the body.
    """
    altimeter = world.scenario.spec.sensors.altimeter
    if altimeter is None:
        return None
    camera = view.camera
    hits = world.renderer.surface(view, np.array([[camera.cx_px, camera.cy_px]]))
    if not hits.hit[0]:
        return None
    range_m = float(np.linalg.norm(hits.points_body_m[0] - view.T_cam_body.camera_position_m))
    return RangeReading(range_m + float(rng.normal(0.0, altimeter.sigma_m)), altimeter.sigma_m)
