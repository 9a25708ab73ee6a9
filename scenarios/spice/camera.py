"""Camera models from instrument kernels of any mission."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import spiceypy

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spice.kernels import SPICE_ERRORS, Constants, find_kernels, loaded_kernels

_AGREES = 0.05  # relative difference of two focal lengths that are the same but for their units
_STRAIGHT = 1e-6
_FOCAL_M, _PIXEL_M = (1e-3, 1.0), (1e-6, 1e-3, 1.0)


@dataclass(frozen=True, slots=True)
class KernelCamera:
    """Size, focal lengths and principal point in pixels, and radial distortion at unit focal length; see `Camera`."""

    width_px: int
    height_px: int
    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float] | None


def read_camera(
    kernels: Sequence[str], instrument: str, size_px: tuple[int, int], folders: Sequence[Path]
) -> KernelCamera:
    """Read the camera of an instrument from its kernel and addenda.

    ``FOV_*`` give the field of view, ``PIXEL_SAMPLES`` and ``PIXEL_LINES`` the size, or else ``size_px``. With
    ``FOCAL_LENGTH`` and ``PIXEL_SIZE`` or ``PIXEL_PITCH`` the focal length is their ratio, in the units (m, mm, um) in
    which it agrees with the field of view. ``OD_K`` is the distortion of ISIS: 1 - k0 - k1 r^2 - k2 r^4, r in mm. The
    principal point is the boresight, which must be the z axis of the camera's frame, x along the samples. Raise
    BoresightError if a kernel is missing, or does not have these.
    """
    with loaded_kernels(find_kernels(kernels, folders, "kernels")):
        try:
            number = int(instrument) if re.fullmatch("-?[0-9]{1,9}", instrument) else spiceypy.bodn2c(instrument)
        except SPICE_ERRORS:
            raise BoresightError(f"the kernels do not have an instrument {instrument}: give its number") from None
        constants = Constants(number)
        shape, _, boresight, _, bounds = spiceypy.getfov(number, 100)
        read = [_above_zero(constants, name) for name in ("PIXEL_SAMPLES", "PIXEL_LINES")]
        width_px, height_px = (int(own or given) for own, given in zip(read, size_px, strict=True))
        focal = _above_zero(constants, "FOCAL_LENGTH")
        pixel = _above_zero(constants, "PIXEL_SIZE") or _above_zero(constants, "PIXEL_PITCH")
        k0, k1, k2 = constants.numbers("OD_K", 3).tolist() if constants.has("OD_K") else (0.0, 0.0, 0.0)
    axis = np.array(boresight) / np.linalg.norm(boresight)
    if np.linalg.norm(axis[:2]) > _STRAIGHT or axis[2] < 0.0:
        raise BoresightError(f"the boresight of {instrument} is {axis.round(6).tolist()}, not the z axis of its frame")
    if shape not in {"RECTANGLE", "POLYGON"} or len(bounds) != 4:
        raise BoresightError(f"the field of view of {instrument} is a {shape.lower()}, not a rectangle")
    slopes = np.array(bounds)[:, :2] / np.array(bounds)[:, 2:]
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    across, down = np.array([width_px, height_px]) / (high - low)
    # The boresight divides the field of view; the field begins at the left and upper edge of the image.
    centre = (float(-low[0] * across), float(-low[1] * down))
    if focal is None or pixel is None:
        return KernelCamera(width_px, height_px, (float(across), float(down)), centre, None)
    # Focal length over pixel in each pair of units, by the unit of the focal length.
    ratios = [(focal * f / (pixel * p), f) for f, p in product(_FOCAL_M, _PIXEL_M)]
    focal_px, unit_m = min(ratios, key=lambda ratio: abs(np.log(ratio[0] / across)))
    if abs(np.log(focal_px / across)) > _AGREES:
        raise BoresightError(
            f"FOCAL_LENGTH and PIXEL_SIZE of {instrument} do not agree with its field of view of {across:.6g} px in any"
            " unit: give camera.focal_px instead"
        )
    if k0 != 0.0:
        raise BoresightError(f"INS{number}_OD_K: k0 = {k0:g} would change the focal length; only 0 is supported")
    focal_mm = 1e3 * unit_m * focal
    lens = (-k1 * focal_mm**2, -k2 * focal_mm**4) if k1 or k2 else None
    return KernelCamera(width_px, height_px, (focal_px, focal_px * float(down / across)), centre, lens)


def _above_zero(constants: Constants, name: str) -> float | None:
    """Return a number of an instrument above 0; None if no kernel has it."""
    return constants.above_zero(name) if constants.has(name) else None
