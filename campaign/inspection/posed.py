"""Frames of one camera with their poses, true and estimated, and what was seen in them of which landmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """One image of a trajectory.

    Parameters
    ----------
    name
        Of its file.
    time_s
        Epoch; the number of the trial where images have none.
    true, estimated
        T_cam_world. The world is the body of single images, and of sequences inertial space in a trajectory and the
        body, as the spacecraft knows its axes, in a model.
    landmarks, uv_px
        (n,) and (n, 2): which landmarks were seen in it, and where.
    """

    name: str
    time_s: float
    true: Pose
    estimated: Pose
    landmarks: IndexArray
    uv_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrames:
    """Frames of one camera in the order of time, and the estimated place of each landmark, world axes, m."""

    camera: Camera
    frames: Sequence[PosedFrame]
    places_m: dict[int, FloatArray]
