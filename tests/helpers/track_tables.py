"""Small tables of tracks and reference poses, as a user would write them: exact pixels of points on a sphere."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import savemat
from scipy.spatial.transform import Rotation
from slam_sequences import CAMERA, RADIUS_M, look_down

from boresight.scenarios.arrays import FloatArray

SCENE = """\
body: {shape: apophis-sphere}
camera: {width_px: 1024, height_px: 1024, fov_deg: 30}
sequence:
  tracks: {table: tracks.csv, poses: poses.csv, per_frame: 12}
  knowledge: {range_sigma_m: 0.5}
"""


@dataclass(frozen=True)
class World:
    """Reference positions (F, 3) and rotations (F, 3, 3), landmarks (T, 3), poses and sightings as tables."""

    positions_m: FloatArray
    rotations: FloatArray
    points_m: FloatArray
    poses: pd.DataFrame
    sightings: pd.DataFrame

    def write(self, folder: Path) -> Path:
        """Write the tables and a scenario that names them; return the scenario."""
        self.poses.to_csv(folder / "poses.csv", index=False, float_format="%.17g")
        self.sightings.to_csv(folder / "tracks.csv", index=False, float_format="%.17g")
        (folder / "scene.yaml").write_text(SCENE)
        return folder / "scene.yaml"

    def write_matlab(self, folder: Path) -> None:
        """Write the same as SONIC has it: km from the camera to the body, views from 1, normalised coordinates."""
        towards_km, turns = -self.positions_m.T / 1000.0, np.moveaxis(self.rotations, 0, 2)
        savemat(folder / "poses.mat", {"cam_positions": towards_km, "cam_rots": turns, "K": np.eye(3)})
        tracks = np.empty((len(self.points_m) + 1, 1), dtype=[("viewIds", object), ("meas", object)])
        for number in range(len(self.points_m)):
            own = self.sightings[self.sightings["track"] == number]
            uv = own[["u_px", "v_px"]].to_numpy()
            rays = (uv - [CAMERA.cx_px, CAMERA.cy_px]) / [CAMERA.fx_px, CAMERA.fy_px]
            tracks[number, 0] = (own["frame"].to_numpy(dtype=np.uint8)[:, None] + 1, rays)
        tracks[-1, 0] = (np.array([[2]], dtype=np.uint8), np.array([[0.1, 0.1]]))  # the matcher found it once
        savemat(folder / "tracks.mat", {"Tracks": tracks}, do_compression=True)


def make_world(frames: int = 9, landmarks: int = 60, radius_m: float = 790.0) -> World:
    """Make a camera that goes 5 deg a frame over a sphere; every third landmark is not seen in frame 4."""
    angles = np.radians(5.0) * np.arange(frames)
    positions = radius_m * np.stack([np.cos(angles), np.sin(angles), 0.1 * np.ones(frames)], axis=1)
    rotations = np.array([look_down(position) for position in positions])
    drawn = np.array([2.0, 0.7, 0.0]) + np.random.default_rng(7).normal(size=(landmarks, 3))
    points = RADIUS_M * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    lines = []
    for number, point in enumerate(points):
        for frame, (position, rotation) in enumerate(zip(positions, rotations, strict=True)):
            if point @ (position - point) > 0.2 * RADIUS_M * radius_m and not (frame == 4 and number % 3 == 0):
                u, v = CAMERA.project((rotation @ (point - position))[None])[0]
                lines.append((number, frame, u, v))
    sightings = pd.DataFrame(lines, columns=["track", "frame", "u_px", "v_px"])
    poses = pd.DataFrame({"time_s": 60.0 * np.arange(frames)})
    poses[["x_m", "y_m", "z_m"]] = positions
    poses[["qw", "qx", "qy", "qz"]] = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
    counts = sightings["track"].value_counts()
    return World(positions, rotations, points, poses, sightings[sightings["track"].map(counts) > 1])
