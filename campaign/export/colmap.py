"""Poses and landmarks as a COLMAP text model: ``cameras.txt``, ``images.txt`` and ``points3D.txt``.

COLMAP's conventions are ours: x right, y down, z forward, the centre of the first pixel at (0.5, 0.5), and the rotation
from the world to the camera, written with the scalar first. Its identifiers begin at 1.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from campaign.inspection.posed import PosedFrame, PosedFrames
from scenarios.atomic import write_text
from scenarios.geometry import Camera

FloatArray = NDArray[np.float64]

_CAMERA = 1
_NO_POINT = -1
_GREY = "160 160 160"
_Track = list[tuple[int, int, float]]


def write_model(posed: PosedFrames, folder: Path) -> list[Path]:
    """Write a model with the estimated poses and landmarks; a landmark is there if an image with a pose saw it."""
    tracks: dict[int, _Track] = {}
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for image, frame in enumerate(posed.frames, start=1):
        lines += _image(image, frame, posed, tracks)
    texts = {
        "cameras.txt": ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", _camera(posed.camera)],
        "images.txt": lines,
        "points3D.txt": [
            "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)",
            *(_point(number, posed.places_m[number], track) for number, track in sorted(tracks.items())),
        ],
    }
    for name, text in texts.items():
        write_text(folder / name, "\n".join(text) + "\n")
    return [folder / name for name in texts]


def _camera(camera: Camera) -> str:
    numbers = _numbers(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    return f"{_CAMERA} PINHOLE {camera.width_px} {camera.height_px} {numbers}"


def _image(image: int, frame: PosedFrame, posed: PosedFrames, tracks: dict[int, _Track]) -> list[str]:
    """Write the two lines of an image, and note down in ``tracks`` which landmarks it sees and how well they fit."""
    pose, points = frame.estimated, []
    for row, (number, uv_px) in enumerate(zip(frame.landmarks.tolist(), frame.uv_px, strict=True)):
        place = posed.places_m.get(number)
        if place is not None:
            error_px = float(np.linalg.norm(posed.camera.project(pose.transform(place)) - uv_px))
            tracks.setdefault(number, []).append((image, row, error_px))
        points.append(f"{_numbers(*uv_px)} {_NO_POINT if place is None else number + 1}")
    head = f"{image} {_numbers(*pose.quat_wxyz, *pose.translation_m)} {_CAMERA} {frame.name}"
    return [head, " ".join(points)]


def _point(number: int, place_m: FloatArray, track: _Track) -> str:
    """Write a landmark with the mean of its reprojection errors; one behind a camera has none and counts as 0."""
    errors = [error for _, _, error in track if np.isfinite(error)]
    error = float(np.mean(errors)) if errors else 0.0
    seen = " ".join(f"{image} {row}" for image, row, _ in track)
    return f"{number + 1} {_numbers(*place_m)} {_GREY} {_numbers(error)} {seen}"


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.17g}" for value in values)
