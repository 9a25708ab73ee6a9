"""Mission cameras: camera models from the constants of their kernels, and start times of their exposures.

Camera axes are x along the stored samples, y along the stored lines and z forward. For both cameras here these are the
axes of the kernel's frame: line 1 is at the top, whatever the labels state about displays. (ISIS flips the lines on
import and compensates with a negative TRANSY. A rendering of Eros correlates with NEAR's M0126865998F4 by 0.97 in the
order of the file, and by less than 0.5 in any other.)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import spiceypy

from boresight.renderers.images.product import ImageMetadata, ImageProduct
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, RadialDistortion
from boresight.scenarios.spice.kernels import Constants


@dataclass(frozen=True, slots=True)
class Instrument:
    """A camera of a mission.

    ``names`` are its names in labels (INSTRUMENT_ID). ``spacecraft`` and ``frame``, the camera's, are NAIF names, and
    ``kernel_id`` is the camera's NAIF identifier. ``exposure_unit_s`` is the unit of an exposure time without one, in
    seconds. ``camera`` creates the camera from the constants in the kernel pool. ``start_et`` returns the start of an
    exposure, s past J2000 TDB; kernels must be loaded.
    """

    names: tuple[str, ...]
    spacecraft: str
    frame: str
    kernel_id: int
    exposure_unit_s: float
    camera: Callable[[Constants], Camera]
    start_et: Callable[[ImageProduct, ImageMetadata], float]

    def constants(self) -> Constants:
        """Constants of the instrument in the kernel pool."""
        return Constants(self.kernel_id)

    def middle_et(self, product: ImageProduct) -> float:
        """Middle of an exposure, s past J2000 TDB; kernels must be loaded.

        Raise `BoresightError` if label and header do not give it.
        """
        metadata = product.metadata(self.exposure_unit_s)
        if metadata.exposure_s is None:
            raise BoresightError(f"{product.path}: neither label nor header gives the length of the exposure")
        return self.start_et(product, metadata) + 0.5 * metadata.exposure_s


def _amica(constants: Constants) -> Camera:
    """Camera AMICA of kernel amica31.ti, with the distortion of Ishiguro et al. (2010) from USGS's addendum.

    CENTER = (511.5, 511.5) counts pixel centres from 0, so that the field of view of the kernel is symmetric. (ISIS
    counts from 1, an error of one pixel, 20 arcsec.) OD_K holds k0, k1 and k2 of 1 - k0 - k1 r^2 - k2 r^4.
    """
    # FOCAL_LENGTH and PIXEL_SIZE are in metres in this kernel.
    samples, lines = (int(constants.above_zero(name)) for name in ("PIXEL_SAMPLES", "PIXEL_LINES"))
    focal_mm, pitch_mm = 1e3 * constants.above_zero("FOCAL_LENGTH"), 1e3 * constants.above_zero("PIXEL_SIZE")
    centre = constants.numbers("CENTER", 2) + 0.5
    k0, k1, k2 = constants.numbers("OD_K", 3).tolist()
    if k0 != 0.0:
        raise BoresightError(
            f"INS{constants.kernel_id}_OD_K: k0 = {k0:g} would change the focal length; 0 is all that is known"
        )
    focal_px = focal_mm / pitch_mm
    # r = focal_mm times the slope, so that k1 r^2 = (k1 f^2) slope^2; this package has plus signs.
    lens = RadialDistortion(-k1 * focal_mm**2, -k2 * focal_mm**4)
    return Camera(samples, lines, focal_px, focal_px, float(centre[0]), float(centre[1]), lens)


def _amica_start_et(product: ImageProduct, metadata: ImageMetadata) -> float:
    """Start of an exposure by the clock of the FITS header, as START_TIME is truncated to whole seconds."""
    del metadata
    count = product.keywords.get("TI_0")
    if not isinstance(count, (int, str)):
        raise BoresightError(f"{product.path}: the FITS header has no TI_0, the clock at the start of the exposure")
    return float(spiceypy.scs2e(-130, str(count)))


_MSI_SAMPLES, _MSI_LINES, _MSI_DETECTOR_LINES = 537, 244, 412


def _msi(constants: Constants) -> Camera:
    """NEAR's MSI of kernel msi15.ti in USGS's revision 1.5b, whose frame looks along +z, with USGS's addendum.

    The addendum refers to 412 lines of square pixels of 0.016 mm; the images have 244 lines, higher by 412 / 244.
    BORESIGHT_SAMPLE and _LINE count from 1.
    """
    focal_mm, pitch_mm = constants.above_zero("FOCAL_LENGTH"), constants.above_zero("PIXEL_PITCH")
    # Height of a detector line in image lines.
    height = _MSI_LINES / _MSI_DETECTOR_LINES
    # From centres that count from 1 to continuous pixels: the centre of the first one is 0.5.
    cx_px = constants.number("BORESIGHT_SAMPLE") - 0.5
    from_last_line = constants.number("BORESIGHT_LINE") - 0.5  # ISIS flips the lines
    lens = RadialDistortion(constants.number("K1") * focal_mm**2)
    focal_px = focal_mm / pitch_mm
    # Counted from the first line, then scaled to the image's lines.
    cy_px = (_MSI_DETECTOR_LINES - from_last_line) * height
    return Camera(_MSI_SAMPLES, _MSI_LINES, focal_px, focal_px * height, cx_px, cy_px, lens)


def _start_time_et(product: ImageProduct, metadata: ImageMetadata) -> float:
    if metadata.start_utc is None:
        raise BoresightError(f"{product.path}: neither label nor header gives the start of the exposure")
    return float(spiceypy.str2et(metadata.start_utc))


INSTRUMENTS: Mapping[str, Instrument] = MappingProxyType(
    {
        "hayabusa-amica": Instrument(("AMICA",), "HAYABUSA", "HAYABUSA_AMICA", -130102, 1.0, _amica, _amica_start_et),
        "near-msi": Instrument(("MSI",), "NEAR", "NEAR_MSI", -93001, 1e-3, _msi, _start_time_et),
    }
)
