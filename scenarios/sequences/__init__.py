"""Sequences: an orbit, the ground below it, and what a vision layer tracks of it."""

from scenarios.dynamics.propagation import OrbitLostError
from scenarios.sequences.draw import SequenceTruth, draw_sequence
from scenarios.sequences.ground import Ground, MeshGround, SphereGround
from scenarios.sequences.knowledge import Sighting, known_sequence, measured_ranges
from scenarios.sequences.path import Path, travel, undisturbed, unmodelled

__all__ = [
    "Ground",
    "MeshGround",
    "OrbitLostError",
    "Path",
    "SequenceTruth",
    "Sighting",
    "SphereGround",
    "draw_sequence",
    "known_sequence",
    "measured_ranges",
    "travel",
    "undisturbed",
    "unmodelled",
]
