"""Images of NEAR's MSI for crater detectors: pose and Sun from the header, square pixels, no distortion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import spiceypy
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from boresight.renderers.images import open_product
from boresight.renderers.images.product import ImageProduct
from boresight.renderers.spice import INSTRUMENTS
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, pixel_to_opencv
from boresight.scenarios.limits import LARGEST_NUMBER
from boresight.scenarios.observation import Frame
from boresight.scenarios.spice.kernels import find_kernels, loaded_kernels

IMAGE = "images/near_msi/m0126865998f4_2p_iof.lbl"
KERNELS = tuple(
    f"near_msi_m0126888978/{name}"
    for name in ("naif0012.tls", "pck00009.tpc", "eros_fixed.tf", "msi15.ti", "msiAddendum002.ti", "near_171.tsc")
)
_QUATERNION, _CRAFT, _TARGET = (19, 20, 21, 22), (23, 24, 25), (27, 28, 29)
_POSE_SIGMA = (
    np.array([1e-4] * 3),
    np.array([40.0, 40.0, 200.0]),
)  # rad, m: the header's pose has an error of about a pixel


@dataclass(frozen=True, slots=True, eq=False)
class MsiImage:
    """Frame with square pixels, and its view by the pose and Sun of the header."""

    name: str
    frame: Frame
    view: View


def open_msi(path: Path | None = None, search_dirs: Sequence[Path] = ()) -> MsiImage:
    """Open an image by its label or FITS file, by default the one in ``$BORESIGHT_DATA``.

    Raise BoresightError if a file is missing, the header has no pose, or the size of the image is not one of MSI's.
    """
    product = open_product(path or find_data_file(IMAGE, search_dirs, ".", "image"))
    msi = INSTRUMENTS["near-msi"]
    with loaded_kernels(find_kernels(KERNELS, search_dirs, "kernels")):
        et = msi.middle_et(product)
        R_body_j2000 = spiceypy.pxform("J2000", "EROS_FIXED", et)
        R_cam_craft = spiceypy.pxform("NEAR_SC_BUS_PRIME", msi.frame, et)
        camera = msi.camera(msi.constants())
    # The header's quaternion (w, x, y, z) is SPICE's: from J2000 to the spacecraft.
    rotation = R_cam_craft @ spiceypy.q2m(_numbers(product, _QUATERNION)) @ R_body_j2000.T
    craft, target = _numbers(product, _CRAFT), _numbers(product, _TARGET)
    pose = Pose(rotation, -rotation @ (1e3 * R_body_j2000 @ (craft - target)))
    # SUN_SC_POSITION_VECTOR is from the Sun to the spacecraft; the header's position of Eros is from the Sun too.
    sun = -R_body_j2000 @ target
    sun = sun / np.linalg.norm(sun)
    pixels = product.pixels()
    image, square = square_pixels(pixels, camera_of_lines(camera, pixels.shape, product.path))
    covariance = np.diag(np.concatenate(_POSE_SIGMA) ** 2)
    frame = Frame(image, rotation @ sun, pose, covariance, et)
    return MsiImage(product.path.stem, frame, View(square, pose, sun))


def _numbers(product: ImageProduct, keys: Sequence[int]) -> FloatArray:
    """Read numeric keywords of the header; some products write them as text."""
    values = [product.keywords.get(f"NEAR-{key:03d}") for key in keys]
    try:
        numbers = np.array([float(str(value)) for value in values])
    except ValueError:
        numbers = np.full(len(keys), np.nan)
    if not (np.abs(numbers) <= LARGEST_NUMBER).all():
        raise BoresightError(
            f"{product.path}: the FITS header has no numbers NEAR-{keys[0]:03d} to NEAR-{keys[-1]:03d}: {values}"
        )
    return numbers


def camera_of_lines(camera: Camera, shape: tuple[int, ...], path: Path) -> Camera:
    """Return the camera of an image (lines, samples): the detector's, or the same with its lines resampled to squares.

    MSI's pixels are 1.7 times as high as wide; products of 412 lines have square pixels, with distortion. Raise
    BoresightError if the image is of neither size.
    """
    square = round(camera.height_px * camera.fx_px / camera.fy_px)
    if shape not in {(lines, camera.width_px) for lines in (camera.height_px, square)}:
        raise BoresightError(
            f"{path}: the image is {shape[1]} x {shape[0]} pixels, but images of NEAR's MSI are {camera.width_px} x"
            f" {camera.height_px}, or {camera.width_px} x {square} with square pixels"
        )
    ratio = shape[0] / camera.height_px
    return replace(camera, height_px=shape[0], fy_px=ratio * camera.fy_px, cy_px=ratio * camera.cy_px)


def square_pixels(image: NDArray[np.float32], camera: Camera) -> tuple[NDArray[np.float32], Camera]:
    """Resample an image once, by cubic splines, to square pixels of a pinhole camera of the same field of view."""
    height = round(camera.height_px * camera.fx_px / camera.fy_px)
    ratio = height / camera.height_px
    square = Camera(camera.width_px, height, camera.fx_px, camera.fy_px * ratio, camera.cx_px, camera.cy_px * ratio)
    columns, rows = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(height) + 0.5)
    place = pixel_to_opencv(camera.distorted(np.stack([columns, rows / ratio], axis=-1)))
    found: NDArray[np.float32] = map_coordinates(
        image, [place[..., 1], place[..., 0]], output=np.float32, order=3, mode="nearest"
    )
    return found, square
