"""Pose, Sun and camera from SPICE kernels."""

from renderers.spice.image_set import Actors, Sighting, SpiceImageSet, sight
from renderers.spice.instruments import INSTRUMENTS, Instrument
from renderers.spice.kernels import Constants, loaded

__all__ = ["INSTRUMENTS", "Actors", "Constants", "Instrument", "Sighting", "SpiceImageSet", "loaded", "sight"]
