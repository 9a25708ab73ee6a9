"""Models of COLMAP in its binary format: camera and poses of images.

========== ==========================================================================================================
cameras.bin  number of cameras; of each its number, model, width, height and parameters in pixels
images.bin   number of images; of each its number, quaternion (w, x, y, z) and translation of x_cam = R(q) x + t,
             camera, name, and the points seen in it, which are not read
========== ==========================================================================================================

The axes of the camera and the centre of the first pixel, (0.5, 0.5), are those of this package. Frame and unit of a
model are its author's: those of a shape only where the model was aligned with it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from boresight.renderers.images.pixels import read_bytes
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.reading import LARGEST_NUMBER

CAMERAS, IMAGES = "cameras.bin", "images.bin"
_PINHOLES = {0: (0, 0, 1, 2), 1: (0, 1, 2, 3)}
"""Pinhole models (SIMPLE_PINHOLE, PINHOLE): places of fx, fy, cx, cy in their parameters."""
_POINT_BYTES = 24
_QUATERNION_TOLERANCE = 1e-3


class _Stream:
    """Little-endian values of a file, one after the other."""

    def __init__(self, path: Path) -> None:
        self.path, self._content, self._at = path, read_bytes(path), 0

    def take(self, form: str) -> tuple[float, ...]:
        """Return the next values of a format of `struct`; finite numbers of a possible size."""
        size = struct.calcsize("<" + form)
        part = self._content[self._at : self._at + size]
        if len(part) < size:
            raise self._cut_short()
        self._at += size
        values: tuple[float, ...] = struct.unpack("<" + form, part)
        if not all(abs(value) <= LARGEST_NUMBER for value in values):
            raise BoresightError(f"{self.path}: byte {self._at - size}: a number that is not finite, or far too large")
        return values

    def name(self) -> str:
        """Return the text up to the next zero byte."""
        end = self._content.find(b"\0", self._at)
        if end < 0:
            raise self._cut_short()
        text = self._content[self._at : end].decode("utf-8", errors="replace")
        self._at = end + 1
        return text

    def skip(self, size: int) -> None:
        """Pass over bytes."""
        self._at += size
        if self._at > len(self._content):
            raise self._cut_short()

    def _cut_short(self) -> BoresightError:
        return BoresightError(f"{self.path}: cut short, or not a binary model of COLMAP")


def read_colmap(folder: Path, unit_m: float) -> Mapping[str, tuple[Camera, Pose]]:
    """Read camera and pose of every image of a binary model, by name; a unit of the model is ``unit_m`` metres.

    Raise `BoresightError` with the file if one is missing or damaged, the camera of an image is no pinhole, or a pose
    is none.
    """
    cameras, stream = _cameras(_Stream(folder / CAMERAS)), _Stream(folder / IMAGES)
    found: dict[str, tuple[Camera, Pose]] = {}
    for _ in range(int(stream.take("Q")[0])):
        number, *pose, camera = stream.take("I7di")
        name = stream.name()
        stream.skip(_POINT_BYTES * int(stream.take("Q")[0]))
        quat_wxyz = np.array(pose[:4])
        if abs(float(np.linalg.norm(quat_wxyz)) - 1.0) > _QUATERNION_TOLERANCE:
            raise BoresightError(f"{stream.path}: {name}: the quaternion does not have length 1")
        if name in found:
            raise BoresightError(f"{stream.path}: {name} appears twice")
        if camera not in cameras:
            raise BoresightError(f"{stream.path}: {name}: camera {camera:g} of image {number:g} is not in {CAMERAS}")
        found[name] = cameras[camera], Pose.from_quat_wxyz(quat_wxyz, unit_m * np.array(pose[4:]))
    return found


def _cameras(stream: _Stream) -> dict[float, Camera]:
    found = {}
    for _ in range(int(stream.take("Q")[0])):
        number, model, width, height = stream.take("iiQQ")
        if model not in _PINHOLES:
            raise BoresightError(
                f"{stream.path}: camera {number:g} has a lens (model {model:g}): undistort the images, as by"
                " colmap image_undistorter, and give the model of these"
            )
        places = _PINHOLES[int(model)]
        parameters = stream.take(f"{max(places) + 1}d")
        fx, fy, cx, cy = (parameters[place] for place in places)
        if not (min(width, height) >= 1 and max(width, height) <= 1e5 and min(fx, fy) >= 1.0):
            raise BoresightError(
                f"{stream.path}: camera {number:g}: no camera has {width:g} x {height:g} pixels and focal lengths of"
                f" {fx:g} and {fy:g} px"
            )
        found[number] = Camera(int(width), int(height), fx, fy, cx, cy)
    return found
