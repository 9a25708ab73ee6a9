"""The files that the scenarios name: shapes, sets of images and a mission with its kernels."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import trimesh
from tiny_mission import make_mission


def write_files(folder: Path) -> None:
    """Write an egg of 600 m, a grid, two image sets of two images, and a mission of three."""
    trimesh.creation.icosphere(subdivisions=2, radius=200.0).apply_scale([1.5, 1.0, 0.8]).export(folder / "egg.obj")
    lines = [
        f"{latitude:9.3f} {longitude:9.3f} {200 + 30 * np.sin(np.radians(longitude)):9.3f}"
        for latitude in range(-90, 91, 15)
        for longitude in range(0, 361, 15)
    ]
    (folder / "grid.tab").write_text("\n".join(lines) + "\n")
    for number, name in enumerate(("set", "other")):
        _write_image_set(folder / name, np.random.default_rng(number))
    mission = make_mission(folder / "mission")
    for number, name in enumerate(("a", "b", "c")):
        mission.write_image(name, np.random.default_rng(number).uniform(0, 100, (64, 64)), 600.0 * number)
    (mission.folder / "still.tf").write_text("KPL/PCK\n\\begindata\nBODY2025143_PM = ( 0.0 0.0 0.0 )\n\\begintext\n")


def _write_image_set(folder: Path, rng: np.random.Generator) -> None:
    folder.mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(folder / name), rng.integers(0, 255, (40, 48), dtype=np.uint8))
    for table, shift in (("poses.csv", 0.0), ("more.csv", 5.0)):
        with (folder / table).open("w", newline="") as stream:
            writer = csv.writer(stream)
            head = ["file", "time_s", "sun_body_x", "sun_body_y", "sun_body_z"]
            prefixes = ("ref", "label", "third")
            parts = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
            writer.writerow(head + [f"{prefix}_{part}" for prefix in prefixes for part in parts])
            for time_s, name in enumerate(("a.png", "b.png")):
                poses = [[1, 0, 0, 0, k + shift, 80 * time_s, 2000] for k in range(3)]
                writer.writerow([name, time_s, 0, 0, -1, *(x for pose in poses for x in pose)])
