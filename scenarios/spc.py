"""Files of stereophotoclinometry (SPC, R. Gaskell): images (SUM), landmarks (LMK), and folders of both.

A SUM file has camera, pose, Sun, epoch and landmarks of one image. The second line is the epoch. Each later line ends
with the name of what it holds; the standard deviations are written and not read:

================= =================================================================================
NPX, NLN, THRSH   samples and lines of the image; thresholds of brightness
MMFL, CTR         focal length, mm; sample and line of the principal point
SCOBJ             vector from the spacecraft to the origin of the body, body axes, km
CX, CY, CZ        axes of the camera in body axes, right-handed, CZ along the boresight
SZ                unit vector to the Sun, body axes
K-MATRIX          K in rows of three, pixels a mm: (a, 0, 0), (0, b, 0)
DISTORTION        four coefficients of NEAR's camera, zero for others
SIGMA_VSO         standard deviations of the components of SCOBJ, km; 0 if unknown
SIGMA_PTG         standard deviations of the rotation about CX, CY and CZ, rad; 0 if unknown
LANDMARKS         alone; then lines of name, sample and line, up to LIMB FITS or END FILE
================= =================================================================================

A point at X, Y, Z along CX, CY, CZ from the spacecraft is in sample and line CTR + MMFL K (X/Z, Y/Z). The centre of the
first pixel is (1, 1).

The axes are right-handed, and no camera is a mirror. So lines that count against CY (a negative second diagonal element
of K) count from the bottom of the image, as FITS images are often stored. A rendering of Bennu correlates with a MapCam
image by 0.90 in this order, and by less than 0.63 in each of the other seven. Whether pixels count from 0 or from 1 it
does not tell: with facets of 48 pixels, the best shift depends on the reflectance by 4 pixels. Lines of sight of
landmarks do not depend on it, as CTR counts alike.

An LMK file has one landmark. Its first line begins with the name, the last one is END FILE. Of the others VLM alone is
read: the landmark in body axes, km. The others are size and scale of its maplet, axes (UX, UY, UZ), standard deviations
(SIGMA_LMK), and where images, limbs and other maplets have it: those of images are in the SUM files too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.reading import LARGEST_NUMBER, number_in

_COUNTS = {
    "NPX, NLN, THRSH": 4, "MMFL, CTR": 3, "SCOBJ": 3, "CX": 3, "CY": 3, "CZ": 3, "SZ": 3, "K-MATRIX": 6,
    "DISTORTION": 4,
}  # fmt: skip
_AXES_TOLERANCE = 1e-6  # the file of Bennu is within 1e-11; others may have fewer digits
_SUN_TOLERANCE = 1e-3
_MOST_BYTES = 1 << 24
_OFF_SHARE, _OFF_RAD, _FEWEST = 0.05, 1e-4, 3  # residuals of SPC are a pixel or two
_J2000 = datetime(2000, 1, 1, 12)
_PIXELS_A_MM = 10.0  # of written files: SUM files divide the focal length in pixels by the pitch
_WIDTH = 62
_END = ["END", "FILE"]
_STATE = ("time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
_SIGHTING = ("track", "frame", "x_normalised", "y_normalised")
_FORMATS = ("%Y %b %d %H:%M:%S.%f", "%Y %b %d %H:%M:%S")


@dataclass(frozen=True, slots=True, eq=False)
class Sumfile:
    """Content of a checked SUM file, for the image with its top row first.

    ``time_s`` is the epoch, seconds of UTC past 2000-01-01 12:00 UTC without leap seconds. ``camera`` has x right (CX)
    and y down (CY); ``sun_dir_body`` (3,) is a unit vector towards the Sun.
    """

    time_s: float
    camera: Camera
    T_cam_body: Pose
    sun_dir_body: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SumLandmarks:
    """Landmarks of an image, with its epoch and pose as in `Sumfile`.

    ``rays`` has x / z and y / z, camera axes, (2,), of each landmark by its name.
    """

    time_s: float
    T_cam_body: Pose
    rays: Mapping[str, FloatArray]


def read_sumfile(path: Path) -> Sumfile:
    """Read and check a SUM file.

    Raise `BoresightError` with file and keyword if the file is missing or damaged, lacks a keyword, or holds what no
    undistorted camera in front of a body has.
    """
    lines = _lines(path, "SUM")
    values = _values(path, lines[2:], _COUNTS, "SUM")
    pose = _pose(path, values)
    sun, length = values["SZ"], float(np.linalg.norm(values["SZ"]))
    if abs(length - 1.0) > _SUN_TOLERANCE:
        raise BoresightError(f"{path}: SZ: the length is {length:.6g}, not 1 within {_SUN_TOLERANCE:g}")
    return Sumfile(_time_s(path, lines[1]), _camera(path, values), pose, sun / length)


def read_sum_landmarks(path: Path) -> SumLandmarks:
    """Read the landmarks of a SUM file, through any K whose third column is zero, with their epoch and pose.

    Raise `BoresightError` with file and keyword or line if it is missing, damaged or cut short.
    """
    lines = _lines(path, "SUM")
    at = next((number for number, line in enumerate(lines) if line.split() == ["LANDMARKS"]), len(lines))
    values = _values(path, lines[2:at], _COUNTS, "SUM")
    _refuse_distortion(path, values)
    focal_mm, *centre = values["MMFL, CTR"].tolist()
    matrix = values["K-MATRIX"].reshape(2, 3)
    to_px = focal_mm * matrix[:, :2]
    if np.any(matrix[:, 2]) or not 1.0 <= abs(np.linalg.det(to_px)) <= LARGEST_NUMBER:
        raise BoresightError(
            f"{path}: MMFL, K-MATRIX: only (a, b, 0), (c, d, 0) of focal lengths above a pixel is read"
        )
    to_rays = np.linalg.inv(to_px)
    rays: dict[str, FloatArray] = {}
    for number, line in enumerate(lines[at + 1 :], start=at + 2):
        cells = line.split()
        if cells in (["LIMB", "FITS"], _END):
            return SumLandmarks(_time_s(path, lines[1]), _pose(path, values), rays)
        if not cells:
            continue
        # Some lines have a mark of SPC's behind the numbers.
        if len(cells) - (cells[-1] in ("-", "*")) != 3:
            raise BoresightError(f"{path}: line {number}: {line.strip()[:40]!r} is no landmark, sample and line")
        if cells[0] in rays:
            raise BoresightError(f"{path}: line {number}: the landmark {cells[0]!r} appears twice")
        pixel = [_number(path, f"line {number}", cell) for cell in cells[1:3]]
        rays[cells[0]] = to_rays @ np.subtract(pixel, centre)
    raise BoresightError(f"{path}: LANDMARKS: missing, or without LIMB FITS or END FILE after them: cut short")


def read_lmk(path: Path) -> FloatArray:
    """Return the landmark of an LMK file, (3,), body frame, m.

    Raise `BoresightError` if it is missing, damaged, cut short, or that of another landmark than its name says.
    """
    lines = _lines(path, "LMK")
    if lines[0].split()[:1] != [path.stem]:
        raise BoresightError(f"{path}: line 1: {lines[0].strip()[:40]!r} does not begin with the name {path.stem}")
    if not any(line.split() == _END for line in lines):
        raise BoresightError(f"{path}: END FILE: missing: no LMK file, or cut short")
    return 1e3 * _values(path, lines[1:], {"VLM": 3}, "LMK")["VLM"]


def spc_files(folder: Path) -> Iterator[Path]:
    """Yield the SUM and LMK files of SUMFILES and LMKFILES in a folder, or of itself if it lacks them; sorted."""
    try:
        inside = {path.name.upper(): path for path in folder.iterdir() if path.is_dir()}
        for kind in ("SUM", "LMK"):
            files = inside.get(f"{kind}FILES", folder).iterdir()
            yield from sorted(path for path in files if path.suffix.upper() == f".{kind}" and path.is_file())
    except OSError as error:
        raise BoresightError(f"{folder}: cannot be read: {error.strerror or error}") from error


def read_spc(folder: Path) -> tuple[dict[str, FloatArray], dict[str, FloatArray], FloatArray]:
    """Read a folder: tables of poses, in the order of time, and of sightings, as real tracks have them, and landmarks.

    Landmarks (T, 3) are in the body frame, m; NaN without LMK file. Those of one image are left out, and images without
    others. Raise `BoresightError` if a file is wrong, two images have one epoch, no landmark is in two images, or
    landmarks are not where K and pose of an image put them.
    """
    files = list(spc_files(folder))
    images = [(read_sum_landmarks(path), path.name) for path in files if path.suffix.upper() == ".SUM"]
    counts = Counter(name for image, _ in images for name in image.rays)
    numbers = {name: k for k, name in enumerate(sorted(name for name in counts if counts[name] > 1))}
    if not numbers:
        raise BoresightError(f"{folder}: no landmark is in two of its {len(images)} SUM files")
    kept = sorted((one for one in images if numbers.keys() & one[0].rays), key=lambda one: one[0].time_s)
    for (before, name), (after, other) in pairwise(kept):
        if before.time_s == after.time_s:
            raise BoresightError(f"{folder}: {name} and {other} have one epoch: leave one of them out")
    seen = [(frame, name, ray) for frame, (image, _) in enumerate(kept) for name, ray in image.rays.items()]
    rows = np.array([(numbers[name], frame, *ray) for frame, name, ray in seen if name in numbers])
    points = np.full((len(numbers), 3), np.nan)
    for path in files:
        if path.suffix.upper() == ".LMK" and path.stem in numbers:
            points[numbers[path.stem]] = read_lmk(path)
    known = {name: point for name, point in zip(numbers, points, strict=True) if np.isfinite(point).all()}
    for image, name in kept:
        _check_sightings(image, f"{folder}: {name}", known)
    from scipy.spatial.transform import Rotation  # 0.1 s, which images do without

    places = np.array([image.T_cam_body.camera_position_m for image, _ in kept])
    attitudes = Rotation.from_matrix([image.T_cam_body.rotation for image, _ in kept]).as_quat(scalar_first=True)
    states = np.column_stack([[image.time_s for image, _ in kept], places, attitudes])
    return dict(zip(_STATE, states.T, strict=True)), dict(zip(_SIGHTING, rows.T, strict=True)), points


def _check_sightings(image: SumLandmarks, where: str, landmarks: Mapping[str, FloatArray]) -> None:
    """Refuse an image most of whose landmarks are elsewhere; single ones may be."""
    off = list[float]()
    for name in image.rays.keys() & landmarks.keys():
        x, y, z = image.T_cam_body.transform(landmarks[name])
        planned = np.array([x / z, y / z]) if z > 0.0 else np.full(2, np.inf)
        most = max(_OFF_SHARE * float(np.linalg.norm(image.rays[name])), _OFF_RAD)
        off.append(float(np.linalg.norm(image.rays[name] - planned)) / most)
    if len(off) >= _FEWEST and not np.median(off) <= 1.0:
        raise BoresightError(
            f"{where}: half of its {len(off)} landmarks with LMK files are more than {100 * _OFF_SHARE:g} % of their"
            " distance from the principal point off: check MMFL, K-MATRIX, pose and VLM"
        )


def _lines(path: Path, kind: str) -> list[str]:
    try:
        if not path.is_file():
            raise BoresightError(f"{path}: no such {kind} file")
        if path.stat().st_size > _MOST_BYTES:
            raise BoresightError(f"{path}: larger than any {kind} file, {_MOST_BYTES >> 20} MiB")
        lines = path.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise BoresightError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(lines) < 3:
        raise BoresightError(f"{path}: no {kind} file: it has {len(lines)} lines")
    return lines


def _values(path: Path, lines: list[str], counts: Mapping[str, int], kind: str) -> dict[str, FloatArray]:
    """Return the numbers of every keyword, as many as ``counts`` says."""
    found: dict[str, FloatArray] = {}
    for line in lines:
        cells = line.split()
        name = next((name for name in counts if cells[-len(name.split()) :] == name.split()), None)
        if name is None:
            continue
        if name in found:
            raise BoresightError(f"{path}: {name}: appears twice")
        cells = cells[: -len(name.split())]
        if len(cells) != counts[name]:
            raise BoresightError(f"{path}: {name}: {len(cells)} numbers, not {counts[name]}")
        found[name] = np.array([_number(path, name, cell) for cell in cells])
    missing = [name for name in counts if name not in found]
    if missing:
        raise BoresightError(f"{path}: {missing[0]}: missing: no {kind} file, or cut short")
    return found


def _number(path: Path, name: str, text: str) -> float:
    value = number_in(text.upper().replace("D", "E"))  # Fortran's exponents
    if not abs(value) <= LARGEST_NUMBER:
        raise BoresightError(f"{path}: {name}: {text!r} is not a number that this can be")
    return value


def _pose(path: Path, values: dict[str, FloatArray]) -> Pose:
    rotation = np.array([values[name] for name in ("CX", "CY", "CZ")])
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off <= _AXES_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise BoresightError(
            f"{path}: CX, CY, CZ: not right-handed unit vectors at right angles within {_AXES_TOLERANCE:g}"
        )
    translation_m = 1e3 * rotation @ values["SCOBJ"]
    if not translation_m[2] > 0.0:
        raise BoresightError(
            f"{path}: SCOBJ: {translation_m[2]:g} m along CZ puts the body behind the camera: SCOBJ points to the body"
        )
    return Pose(rotation, translation_m)


def _refuse_distortion(path: Path, values: dict[str, FloatArray]) -> None:
    if np.any(values["DISTORTION"]):
        raise BoresightError(f"{path}: DISTORTION: only zeros are read: resample the image to a pinhole")


def _camera(path: Path, values: dict[str, FloatArray]) -> Camera:
    """Return the camera of the image with its top row first."""
    focal_mm, sample, line = values["MMFL, CTR"].tolist()
    across, down = values["K-MATRIX"][[0, 4]].tolist()
    if np.any(values["K-MATRIX"][[1, 2, 3, 5]]) or not across > 0.0 or down == 0.0:
        raise BoresightError(
            f"{path}: K-MATRIX: only (a, 0, 0), (0, b, 0) with a > 0 is read: no skew, samples that count along CX"
        )
    _refuse_distortion(path, values)
    width, height = values["NPX, NLN, THRSH"][:2].tolist()
    focal_px = focal_mm * across, focal_mm * abs(down)
    sizes_are_whole = all(1.0 <= size <= 1e5 and size == int(size) for size in (width, height))
    if not sizes_are_whole or not all(1.0 <= focal <= 1e9 for focal in focal_px) or max(abs(sample), abs(line)) > 1e6:
        raise BoresightError(
            f"{path}: NPX, NLN, MMFL, CTR, K-MATRIX: no camera has {width:g} x {height:g} pixels, focal lengths of"
            f" {focal_px[0]:g} and {focal_px[1]:g} px and its centre at {sample:g}, {line:g}"
        )
    # The centre of the first pixel is (1, 1) there and (0.5, 0.5) here; lines against CY count from the bottom.
    cy_px = line - 0.5 if down > 0.0 else height + 0.5 - line
    return Camera(int(width), int(height), *focal_px, sample - 0.5, cy_px)


def _time_s(path: Path, text: str) -> float:
    for form in _FORMATS:
        try:
            return (datetime.strptime(text.strip(), form) - _J2000).total_seconds()
        except ValueError:
            continue
    raise BoresightError(f"{path}: line 2: {text.strip()!r} is not a time such as 2019 MAR 14 19:01:23.961")


def sumfile_text(
    name: str,
    content: Sumfile,
    sigma_km_rad: FloatArray | None = None,
    landmarks_px: Mapping[int, FloatArray] | None = None,
) -> str:
    """Return a SUM file of an image, in the columns of SPC.

    ``name`` is that of the image. ``sigma_km_rad`` (6,) are SIGMA_VSO and SIGMA_PTG. ``landmarks_px`` are the pixels
    (2,) of landmarks by their numbers, which become names of six digits. Numbers have 11 significant digits, the ratio
    of the focal lengths 6 decimals, landmarks 2, the epoch milliseconds. Raise BoresightError if the epoch is not one
    of the calendar.
    """
    camera, pose = content.camera, content.T_cam_body
    try:
        epoch = _J2000 + timedelta(milliseconds=round(1e3 * content.time_s))
    except OverflowError as error:
        raise BoresightError(f"{name}: {content.time_s:g} s after J2000 is no time of a SUM file") from error
    size = f"{camera.width_px:6d}{camera.height_px:6d}{0:6d}{65535:6d}"
    ratio = _PIXELS_A_MM * camera.fy_px / camera.fx_px
    sigma = np.zeros(6) if sigma_km_rad is None else sigma_km_rad
    centre = camera.cx_px + 0.5, camera.cy_px + 0.5
    lines = [
        name,
        f"{epoch:%Y %b %d %H:%M:%S}.{epoch.microsecond // 1000:03d}".upper(),
        f"{size:{_WIDTH}}NPX, NLN, THRSH",
        _line("MMFL, CTR", (camera.fx_px / _PIXELS_A_MM, *centre)),
        _line("SCOBJ", 1e-3 * pose.rotation.T @ pose.translation_m),
        *(_line(axis, row) for axis, row in zip(("CX", "CY", "CZ"), pose.rotation, strict=True)),
        _line("SZ", content.sun_dir_body),
        f"{''.join(f'{value:10.6f}' for value in (_PIXELS_A_MM, 0.0, 0.0, 0.0, ratio, 0.0)):{_WIDTH}}K-MATRIX",
        f"{4 * f'{0.0:15.5f}':{_WIDTH}}DISTORTION",
        _line("SIGMA_VSO", sigma[:3]),
        _line("SIGMA_PTG", sigma[3:]),
        "LANDMARKS",
        *(f"{number:06d}{u + 0.5:10.2f}{v + 0.5:10.2f}" for number, (u, v) in sorted((landmarks_px or {}).items())),
        "LIMB FITS",
        "END FILE",
    ]
    return "\n".join(lines) + "\n"


def _line(name: str, numbers: Iterable[float]) -> str:
    text = "".join(f"{value:20.10E}" for value in numbers).replace("E", "D")
    return f"{text:{_WIDTH}}{name}"
