"""Sequences: an orbit, the ground below it, and what a vision layer tracks of it."""

from scenarios.sequences.draw import SequenceTruth, draw_sequence
from scenarios.sequences.ground import Ground, MeshGround, SphereGround

__all__ = ["Ground", "MeshGround", "SequenceTruth", "SphereGround", "draw_sequence"]
