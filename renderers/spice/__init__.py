"""Poses, directions to the Sun and camera models from SPICE kernels."""

from boresight.renderers.spice.image_set import ApparentGeometry, SpiceImageSet, SpiceNames, apparent_geometry
from boresight.renderers.spice.instruments import INSTRUMENTS, Instrument
from boresight.renderers.spice.kernels import Constants, loaded_kernels

__all__ = [
    "INSTRUMENTS",
    "ApparentGeometry",
    "Constants",
    "Instrument",
    "SpiceImageSet",
    "SpiceNames",
    "apparent_geometry",
    "loaded_kernels",
]
