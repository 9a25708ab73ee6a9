"""Models of COLMAP, binary or text: camera and poses of images.

=========== ==========================================================================================================
cameras.bin  number of cameras; of each its number, model, width, height and parameters in pixels
images.bin   number of images; of each its number, quaternion (w, x, y, z) and translation of x_cam = R(q) x + t,
             camera, name, and the points seen in it, which are not read
cameras.txt  a line for each camera: the same, the model by its name
images.txt   two lines for each image: the same, and its points, which may be none
=========== ==========================================================================================================

Where a folder has both, the binary model is read. The axes of the camera and the centre of the first pixel, (0.5, 0.5),
are those of this package. Frame and unit of a model are its author's: those of a shape only where the model was aligned
with it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, OpenCVDistortion, Pose
from boresight.scenarios.reading import LARGEST_NUMBER, number_in, read_bytes

IMAGES = ("images.bin", "images.txt")
_PINHOLE = 4  # numbers of fx, fy, cx, cy
_LENSES = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2), "PINHOLE": (0, 1, 2, 3), "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
    "RADIAL": (0, 0, 1, 2, 3, 4), "OPENCV": tuple(range(8)), "FULL_OPENCV": tuple(range(12)),
}  # fmt: skip
"""Places of fx, fy, cx, cy and the coefficients of OpenCV's polynomial in the parameters of a model."""
_NAMES = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION",
    "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR",
)  # fmt: skip
"""Models by their number in binary files."""
_POINT_BYTES, _POINT_CELLS = 24, 3
_CAMERA_CELLS, _IMAGE_CELLS = 4, 10
_QUATERNION_TOLERANCE = 1e-3


class _CameraRecord(NamedTuple):
    """One camera of a file; ``place`` is the file, with the line in a text."""

    place: str
    number: float
    model: str
    width: float
    height: float
    parameters: Sequence[float]


class _ImageRecord(NamedTuple):
    """One image of a file: ``pose`` are quaternion (w, x, y, z) and translation."""

    place: str
    number: float
    pose: Sequence[float]
    camera: float
    name: str


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


def cameras_file(images: Path) -> Path:
    """Return the file of cameras that belongs to a file of images."""
    return images.with_name(f"cameras{images.suffix}")


def read_colmap(images: Path, unit_m: float) -> Mapping[str, tuple[Camera, Pose]]:
    """Read camera and pose of every image of a model, by name; a unit of the model is ``unit_m`` metres.

    ``images`` is images.bin or images.txt. Raise `BoresightError` with the file, and the line of a text, if a file is
    missing or damaged, the lens of a camera is none of OpenCV's, or a pose is none.
    """
    path = cameras_file(images)
    binary = images.suffix == ".bin"
    cameras: dict[float, Camera] = {}
    for one in _binary_cameras(path) if binary else _text_cameras(path):
        if one.number in cameras:
            raise BoresightError(f"{one.place}: camera {one.number:g} appears twice")
        cameras[one.number] = _camera(one)
    found: dict[str, tuple[Camera, Pose]] = {}
    for place, number, pose, camera, name in _binary_images(images) if binary else _text_images(images):
        quat_wxyz = np.array(pose[:4])
        if abs(float(np.linalg.norm(quat_wxyz)) - 1.0) > _QUATERNION_TOLERANCE:
            raise BoresightError(f"{place}: {name}: the quaternion does not have length 1")
        if name in found:
            raise BoresightError(f"{place}: {name} appears twice")
        if camera not in cameras:
            raise BoresightError(f"{place}: {name}: camera {camera:g} of image {number:g} is not in {path.name}")
        found[name] = cameras[camera], Pose.from_quat_wxyz(quat_wxyz, unit_m * np.array(pose[4:]))
    return found


def _binary_cameras(path: Path) -> Iterator[_CameraRecord]:
    stream = _Stream(path)
    for _ in range(int(stream.take("Q")[0])):
        number, model, width, height = stream.take("iiQQ")
        name = _NAMES[int(model)] if 0 <= model < len(_NAMES) else f"number {model:g}"
        # The length of the others is not known, but they are refused.
        parameters = stream.take(f"{max(_LENSES[name]) + 1}d") if name in _LENSES else ()
        yield _CameraRecord(str(path), number, name, width, height, parameters)


def _binary_images(path: Path) -> Iterator[_ImageRecord]:
    stream = _Stream(path)
    for _ in range(int(stream.take("Q")[0])):
        number, *pose, camera = stream.take("I7di")
        name = stream.name()
        stream.skip(_POINT_BYTES * int(stream.take("Q")[0]))
        yield _ImageRecord(str(path), number, pose, camera, name)


def _text_cameras(path: Path) -> Iterator[_CameraRecord]:
    for place, line in _lines(path):
        cells = line.split()
        if not cells or line.startswith("#"):
            continue
        if len(cells) < _CAMERA_CELLS:
            raise BoresightError(f"{place}: not CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS of a camera")
        number, width, height, *parameters = _numbers(place, [cells[0], *cells[2:]])
        yield _CameraRecord(place, number, cells[1], width, height, parameters)


def _text_images(path: Path) -> Iterator[_ImageRecord]:
    lines = _lines(path)
    for place, line in lines:
        if not line or line.startswith("#"):
            continue
        cells = line.split(maxsplit=_IMAGE_CELLS - 1)
        if len(cells) < _IMAGE_CELLS:
            raise BoresightError(
                f"{place}: not IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME of an image, which the line of its"
                " points follows"
            )
        number, *pose, camera = _numbers(place, cells[:-1])
        after, points = next(lines, (place, ""))
        if len(points.split()) % _POINT_CELLS:
            raise BoresightError(f"{after}: not X, Y, POINT3D_ID of the points of an image: leave it empty without any")
        yield _ImageRecord(place, number, pose, camera, cells[-1])


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the lines of a text, each with its place, FILE:LINE."""
    text = read_bytes(path).decode("utf-8", errors="replace")
    for number, line in enumerate(text.split("\n"), start=1):
        yield f"{path}:{number}", line.strip()


def _numbers(place: str, cells: Sequence[str]) -> list[float]:
    """Return finite numbers of a possible size."""
    found = []
    for cell in cells:
        value = number_in(cell)
        if not abs(value) <= LARGEST_NUMBER:
            raise BoresightError(f"{place}: {cell[:40]!r} is not a number that this can be")
        found.append(value)
    return found


def _camera(record: _CameraRecord) -> Camera:
    place, number, model, width, height, parameters = record
    if model not in _LENSES:
        raise BoresightError(
            f"{place}: camera {number:g} has the lens {model[:40]}, which is none of {', '.join(_LENSES)}: undistort"
            " the images, as by colmap image_undistorter, and give the model of these"
        )
    places = _LENSES[model]
    if len(parameters) != max(places) + 1:
        raise BoresightError(
            f"{place}: camera {number:g}: {len(parameters)} parameters, not the {max(places) + 1} of {model}"
        )
    fx, fy, cx, cy, *coefficients = (parameters[at] for at in places)
    sizes_are_whole = all(1 <= size <= 1e5 and size == int(size) for size in (width, height))
    if not sizes_are_whole or min(fx, fy) < 1.0:
        raise BoresightError(
            f"{place}: camera {number:g}: no camera has {width:g} x {height:g} pixels and focal lengths of"
            f" {fx:g} and {fy:g} px"
        )
    k1, k2, p1, p2, *further = (*coefficients, *[0.0] * (_PINHOLE - len(coefficients)))
    lens = OpenCVDistortion(k1, k2, p1, p2, *further) if any(coefficients) else None
    return Camera(int(width), int(height), fx, fy, cx, cy, lens)
