"""Trajectories as TUM files, which evo and others read.

A line a pose, ``timestamp tx ty tz qx qy qz qw``: seconds, the camera in the world in metres, and the rotation from the
camera's axes to those of the world as a unit quaternion with the scalar last. Numbers have 17 digits, so that they come
back bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from campaign.inspection.posed import PosedFrame
from scenarios.atomic import write_text
from scenarios.geometry import Pose


def write_trajectory(name: str, frames: Sequence[PosedFrame], out: Path) -> list[Path]:
    """Write ``NAME.truth.tum`` and ``NAME.estimate.tum``, with the same timestamps."""
    ordered = sorted(frames, key=lambda frame: frame.time_s)
    paths = [out / f"{name}.{what}.tum" for what in ("truth", "estimate")]
    for path, poses in zip(paths, zip(*[(f.true, f.estimated) for f in ordered], strict=True), strict=True):
        lines = [_line(frame.time_s, pose) for frame, pose in zip(ordered, poses, strict=True)]
        write_text(path, "# timestamp tx ty tz qx qy qz qw\n" + "".join(lines))
    return paths


def _line(time_s: float, T_cam_world: Pose) -> str:
    quat_xyzw = Rotation.from_matrix(T_cam_world.rotation.T).as_quat(canonical=True)
    return " ".join(f"{x:.17g}" for x in np.concatenate([[time_s], T_cam_world.camera_position_m, quat_xyzw])) + "\n"
