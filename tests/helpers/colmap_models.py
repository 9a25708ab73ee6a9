"""Models of COLMAP, binary and text, written after its description, and the points that those of others hold."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PINHOLE = (1, (1500.0, 1490.0, 500.0, 380.0))


def write_model(
    folder: Path,
    poses: Mapping[str, Sequence[float]],
    camera: tuple[int, Sequence[float]] = PINHOLE,
    size: tuple[int, int] = (1000, 800),
) -> None:
    """Write ``cameras.bin`` and ``images.bin``: of each image quaternion (w, x, y, z), translation and two points."""
    kind, parameters = camera
    head = struct.pack("<QiiQQ", 1, 7, kind, *size)
    (folder / "cameras.bin").write_bytes(head + struct.pack(f"<{len(parameters)}d", *parameters))
    content = struct.pack("<Q", len(poses))
    for number, (name, pose) in enumerate(poses.items(), 1):
        content += struct.pack("<I7dI", number, *pose, 7) + name.encode() + b"\0"
        content += struct.pack("<Q", 2) + struct.pack("<ddQ", 1.5, 2.5, 3) * 2
    (folder / "images.bin").write_bytes(content)


def write_text_model(
    folder: Path,
    poses: Mapping[str, Sequence[float]],
    camera: tuple[str, Sequence[float]] = ("PINHOLE", PINHOLE[1]),
    size: tuple[int, int] = (1000, 800),
) -> None:
    """Write ``cameras.txt`` and ``images.txt`` as `write_model` writes the binary files."""
    model, parameters = camera
    line = " ".join(map(repr, parameters))
    (folder / "cameras.txt").write_text(f"# CAMERA_ID, ...\n7 {model} {size[0]} {size[1]} {line}\n")
    lines = ["# IMAGE_ID, ..."]
    for number, (name, pose) in enumerate(poses.items(), 1):
        lines += [f"{number} {' '.join(map(repr, map(float, pose)))} 7 {name}", "1.5 2.5 3 1.5 2.5 -1"]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


def sightings(folder: Path) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return the points (N, 3) of a model and their pixels (N, 2) in each image that saw them, by its name."""
    content = (folder / "points3D.bin").read_bytes()
    points, at = {}, 8
    for _ in range(*struct.unpack_from("<Q", content)):
        point, *position = struct.unpack_from("<Q3d", content, at)
        points[point] = position
        (track,) = struct.unpack_from("<Q", content, at + 43)
        at += 51 + 8 * track
    content, at, found = (folder / "images.bin").read_bytes(), 8, {}
    for _ in range(*struct.unpack_from("<Q", content)):
        end = content.index(b"\0", at + 64)
        name, (count,) = content[at + 64 : end].decode(), struct.unpack_from("<Q", content, end + 1)
        seen = [struct.unpack_from("<ddq", content, end + 9 + 24 * k) for k in range(count)]
        seen = [one for one in seen if one[2] in points]
        found[name] = np.array([points[k] for *_, k in seen]), np.array([uv for *uv, _ in seen])
        at = end + 9 + 24 * count
    return found
