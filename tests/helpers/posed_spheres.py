"""Images of a textured sphere by ray casting alone, with their poses as a user writes them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from slam_sequences import look_down

from boresight.scenarios.arrays import FloatArray

RADIUS_M, RANGE_M, SIDE_PX, FOCAL_PX = 190.0, 900.0, 256, 480.0
STEPS_DEG = (0.0, 6.0, 12.0, 18.0, 24.0, 30.0, 3.0)
"""Where the images are: a short arc, and back to its beginning."""

SCENE = f"""\
body: {{shape: apophis-sphere}}
camera: {{width_px: {SIDE_PX}, height_px: {SIDE_PX}, focal_px: [{FOCAL_PX}, {FOCAL_PX}]}}
images: {{folder: pictures}}
"""


def poses(steps_deg: Sequence[float] = STEPS_DEG) -> tuple[FloatArray, FloatArray]:
    """(F, 3) positions on a circle, and (F, 3, 3) R_cam_body with the boresight on the origin."""
    angles = np.radians(steps_deg)
    positions_m = RANGE_M * np.stack([np.cos(angles), np.sin(angles), 0.05 * np.ones(len(angles))], axis=1)
    return positions_m, np.array([look_down(position) for position in positions_m])


def met(position_m: FloatArray, rays_body: FloatArray) -> FloatArray:
    """(n, 3) where rays (n, 3) meet the sphere: the smaller root of |c + s d| = R; NaN beside it."""
    rays = rays_body / np.linalg.norm(rays_body, axis=1, keepdims=True)
    b = rays @ position_m
    with np.errstate(invalid="ignore"):
        return position_m + (-b - np.sqrt(b**2 - position_m @ position_m + RADIUS_M**2))[:, None] * rays


def picture(position_m: FloatArray, R_cam_body: FloatArray) -> FloatArray:
    """(H, W) brightness of waves in the solid, lit from the middle of the arc."""
    rng = np.random.default_rng(4)
    waves = rng.normal(size=(160, 3))
    waves *= (2.0 * np.pi / np.geomspace(7.0, 60.0, 160) / np.linalg.norm(waves, axis=1))[:, None]
    columns, rows = np.meshgrid(np.arange(SIDE_PX) + 0.5, np.arange(SIDE_PX) + 0.5)
    x, y = (columns.ravel() - SIDE_PX / 2) / FOCAL_PX, (rows.ravel() - SIDE_PX / 2) / FOCAL_PX
    points = met(position_m, np.stack([x, y, np.ones(len(x))], axis=1) @ R_cam_body)
    albedo = 1.0 + 0.04 * np.cos(points @ waves.T + rng.uniform(0.0, 2.0 * np.pi, 160)).sum(axis=1)
    sun = np.array([np.cos(0.26), np.sin(0.26), 0.3])
    light = np.maximum(points @ sun, 0.0) / np.linalg.norm(sun) / RADIUS_M
    return np.nan_to_num(light * np.maximum(albedo, 0.1)).reshape(SIDE_PX, SIDE_PX)


def write_posed(folder: Path, steps_deg: Sequence[float] = STEPS_DEG) -> Path:
    """Write pictures, the table of their poses with the latest first, and a scenario; return the scenario."""
    (folder / "pictures").mkdir()
    positions_m, rotations = poses(steps_deg)
    for k, pose in enumerate(zip(positions_m, rotations, strict=True)):
        grey = np.clip(120.0 * picture(*pose), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / "pictures" / f"{k}.png"), grey)
    table = pd.DataFrame({"file": [f"{k}.png" for k in range(len(positions_m))]})
    table["time_s"] = 60.0 * np.arange(len(table))
    table[[f"ref_q{c}" for c in "wxyz"]] = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
    table[[f"ref_t{c}_m" for c in "xyz"]] = -np.einsum("fij,fj->fi", rotations, positions_m)
    table[["sun_body_x", "sun_body_y", "sun_body_z"]] = [1.0, 0.2, 0.3]
    table[::-1].to_csv(folder / "pictures" / "poses.csv", index=False)
    (folder / "my_images.yaml").write_text(SCENE)
    return folder / "my_images.yaml"
