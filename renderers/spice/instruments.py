"""Cameras of missions: what their kernels call their constants, and how their images lie in them.

Camera axes are x along the stored samples, y along the stored lines and z forward. Both cameras here store their
images so that these are the axes of the kernel's frame: line 1 is at the top, whatever the labels say about displays.
(ISIS turns the lines over when it imports them and turns them back by a negative TRANSY. A rendering of Eros agrees
with NEAR's M0126865998F4 with a correlation of 0.97 in the order of the file, and of less than 0.5 in any other.)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import spiceypy

from renderers.images.product import ImageMetadata, ImageProduct
from renderers.spice.kernels import Constants
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, RadialDistortion


@dataclass(frozen=True, slots=True)
class Instrument:
    """A camera of a mission.

    Parameters
    ----------
    names
        What labels call it (INSTRUMENT_ID).
    spacecraft
        NAIF's name of the spacecraft.
    frame
        NAIF's name of the camera's frame.
    kernel_id
        NAIF's number of the camera.
    exposure_unit_s
        Seconds in the unit of an exposure that is given without one.
    camera
        Makes the camera of the constants in the pool.
    start_et
        Finds the start of an exposure, s past J2000 TDB; kernels are loaded.
    """

    names: tuple[str, ...]
    spacecraft: str
    frame: str
    kernel_id: int
    exposure_unit_s: float
    camera: Callable[[Constants], Camera]
    start_et: Callable[[ImageProduct, ImageMetadata], float]

    def constants(self) -> Constants:
        """Return the instrument's constants in the loaded pool."""
        return Constants(self.kernel_id)

    def middle_et(self, product: ImageProduct) -> float:
        """Return the middle of an exposure, s past J2000 TDB; kernels are loaded.

        Raises
        ------
        BoresightError
            If label and header do not tell it.
        """
        told = product.metadata(self.exposure_unit_s)
        if told.exposure_s is None:
            raise BoresightError(f"{product.path}: neither label nor header gives the length of the exposure")
        return self.start_et(product, told) + 0.5 * told.exposure_s


def _amica(constants: Constants) -> Camera:
    """AMICA: kernel amica31.ti; the distortion is that of Ishiguro et al. (2010), in USGS's addendum.

    CENTER = (511.5, 511.5) counts pixels from 0, as the middle of 1024 pixels: so the kernel's field of view is
    symmetric. (ISIS counts it from 1 and lies a pixel, 20 arcsec, off.) OD_K holds the k of 1 - k0 - k1 r2 - k2 r4.
    """
    samples, lines = (int(constants.above_zero(name)) for name in ("PIXEL_SAMPLES", "PIXEL_LINES"))
    focal_mm, pitch_mm = 1e3 * constants.above_zero("FOCAL_LENGTH"), 1e3 * constants.above_zero("PIXEL_SIZE")
    centre = constants.numbers("CENTER", 2) + 0.5
    k0, k1, k2 = constants.numbers("OD_K", 3).tolist()
    if k0 != 0.0:
        raise BoresightError(
            f"INS{constants.kernel_id}_OD_K: k0 = {k0:g} would change the focal length; 0 is all that is known"
        )
    focal_px = focal_mm / pitch_mm
    lens = RadialDistortion(-k1 * focal_mm**2, -k2 * focal_mm**4)
    return Camera(samples, lines, focal_px, focal_px, float(centre[0]), float(centre[1]), lens)


def _amica_start_et(product: ImageProduct, told: ImageMetadata) -> float:
    """Take the clock of the FITS header: START_TIME is cut to whole seconds."""
    del told
    count = product.keywords.get("TI_0")
    if not isinstance(count, (int, str)):
        raise BoresightError(f"{product.path}: the FITS header has no TI_0, the clock at the start of the exposure")
    return float(spiceypy.scs2e(-130, str(count)))


_MSI_SAMPLES, _MSI_LINES, _MSI_DETECTOR_LINES = 537, 244, 412


def _msi(constants: Constants) -> Camera:
    """NEAR MSI: kernel msi15.ti in USGS's revision 1.5b, whose frame looks along +z, and USGS's addendum.

    The addendum counts pixels of 0.016 mm, of which there are 412 lines; the images have 244 lines of 412 / 244
    times that. BORESIGHT_SAMPLE and _LINE count from 1.
    """
    focal_mm, pitch_mm = constants.above_zero("FOCAL_LENGTH"), constants.above_zero("PIXEL_PITCH")
    height = _MSI_LINES / _MSI_DETECTOR_LINES
    cx_px = constants.number("BORESIGHT_SAMPLE") - 0.5
    from_last_line = constants.number("BORESIGHT_LINE") - 0.5  # ISIS turns the lines over
    lens = RadialDistortion(constants.number("K1") * focal_mm**2)
    focal_px = focal_mm / pitch_mm
    cy_px = (_MSI_DETECTOR_LINES - from_last_line) * height
    return Camera(_MSI_SAMPLES, _MSI_LINES, focal_px, focal_px * height, cx_px, cy_px, lens)


def _start_time_et(product: ImageProduct, told: ImageMetadata) -> float:
    if told.start_utc is None:
        raise BoresightError(f"{product.path}: neither label nor header gives the start of the exposure")
    return float(spiceypy.str2et(told.start_utc))


INSTRUMENTS: Mapping[str, Instrument] = MappingProxyType(
    {
        "hayabusa-amica": Instrument(("AMICA",), "HAYABUSA", "HAYABUSA_AMICA", -130102, 1.0, _amica, _amica_start_et),
        "near-msi": Instrument(("MSI",), "NEAR", "NEAR_MSI", -93001, 1e-3, _msi, _start_time_et),
    }
)
