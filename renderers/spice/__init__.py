"""Real images with poses, directions to the Sun and camera models from SPICE kernels."""

from boresight.renderers.spice.image_set import SpiceImageSet
from boresight.renderers.spice.instruments import INSTRUMENTS, Instrument

__all__ = ["INSTRUMENTS", "Instrument", "SpiceImageSet"]
