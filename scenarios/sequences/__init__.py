"""Image sequences: camera trajectory, landmark surface, simulated or real tracks, and onboard knowledge."""

from boresight.scenarios.dynamics.propagation import OrbitLostError
from boresight.scenarios.sequences.draw import SequenceTruth, draw_sequence
from boresight.scenarios.sequences.ground import LandmarkGround, MeshGround, SphereGround
from boresight.scenarios.sequences.onboard import FrameTracks, measured_ranges, onboard_sequence
from boresight.scenarios.sequences.track_table import TrackTable, draw_real_sequence
from boresight.scenarios.sequences.trajectory import (
    CameraTrajectory,
    camera_trajectory,
    draw_unmodelled_m_s2,
    nominal_trajectory,
)

__all__ = [
    "CameraTrajectory",
    "FrameTracks",
    "LandmarkGround",
    "MeshGround",
    "OrbitLostError",
    "SequenceTruth",
    "SphereGround",
    "TrackTable",
    "camera_trajectory",
    "draw_real_sequence",
    "draw_sequence",
    "draw_unmodelled_m_s2",
    "measured_ranges",
    "nominal_trajectory",
    "onboard_sequence",
]
