"""Folders of SUM and LMK files as SPC writes them in Fortran, of the exact sightings of `track_tables`."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from slam_sequences import CAMERA
from track_tables import World

from boresight.scenarios.arrays import FloatArray

FOCAL_MM = 50.0
PLAIN = np.array([[CAMERA.fx_px / FOCAL_MM, 0.0, 0.0], [0.0, CAMERA.fy_px / FOCAL_MM, 0.0]])
# Lines from the bottom, a detector that is turned by 0.2 deg and not square.
TURNED = PLAIN @ [[1.0, 0.0035, 0.0], [0.003, -1.002, 0.0], [0.0, 0.0, 0.0]]
CENTRE = (CAMERA.cx_px + 0.5, CAMERA.cy_px + 0.5)
SCENE = """\
body: {shape: apophis-sphere}
camera: {width_px: 1024, height_px: 1024, fov_deg: 30}
sequence:
  tracks: {spc: spc, per_frame: 12}
  knowledge: {range_sigma_m: 0.5}
"""


def d20_10(values: FloatArray) -> str:
    """Write numbers in Fortran's format D20.10: 0.1234567891D+03."""
    words = []
    for value in np.ravel(values):
        mantissa, exponent = f"{value:.9E}".split("E")
        sign, digits = ("-" if value < 0 else ""), mantissa.lstrip("-").replace(".", "")
        words.append(f"{sign}0.{digits}D{int(exponent) + (value != 0):+03d}")
    return "".join(f"{word:>20}" for word in words)


def name_of(number: int) -> str:
    return f"FA{number:04d}"


def sum_text(
    name: str,
    epoch: datetime,
    scobj_km: FloatArray,
    axes: FloatArray,
    pixels: Mapping[str, FloatArray],
    matrix: FloatArray = PLAIN,
) -> str:
    """Write a SUM file; ``pixels`` are samples and lines of landmarks."""
    lines = [
        f"{name:<12}",
        f"{epoch:%Y %b %d %H:%M:%S}.{epoch.microsecond // 1000:03d}".upper(),
        f"{CAMERA.width_px:6d}{CAMERA.height_px:6d}{500:6d}{65535:6d}{'':36}  NPX, NLN, THRSH   ",
        f"{d20_10(np.array([FOCAL_MM, *CENTRE]))}  MMFL, CTR         ",
        f"{d20_10(scobj_km)}  SCOBJ             ",
        *(f"{d20_10(row)}  {axis}                " for axis, row in zip(("CX", "CY", "CZ"), axes, strict=True)),
        f"{d20_10(np.array([0.0, 0.6, 0.8]))}  SZ                ",
        "".join(f"{value:16.10f}" for value in matrix.ravel()) + "  K-MATRIX          ",
        f"{4 * f'{chr(48)}.00000D+00'.rjust(15)}  DISTORTION        ",
        f"{d20_10(np.full(3, 1e-3))}  SIGMA_VSO         ",
        f"{d20_10(np.full(3, 1e-4))}  SIGMA_PTG         ",
        "LANDMARKS",
        *(f"{landmark:<6}{sample:10.2f}{line:10.2f}" for landmark, (sample, line) in pixels.items()),
        "LIMB FITS",
        "END FILE",
    ]
    return "\n".join(lines) + "\n"


def lmk_text(name: str, vlm_km: FloatArray, pictures: Mapping[str, FloatArray]) -> str:
    """Write an LMK file; ``pictures`` are samples and lines in images."""
    lines = [
        f"{name:<6}   T      0.2500  0.0500",
        f"{49:8d}{0.01:12.7f}{'':40}  SIZE, SCALE(KM)  ",
        f"{-1:10d}{-1:10d}{-1:10d}{-1:10d}{'':20}  HORIZON          ",
        f"{d20_10(np.array([5e-3, 1.25]))}{'':20}  SIGKM, RMSLMK    ",
        f"{d20_10(vlm_km)}  VLM              ",
        *(f"{d20_10(row)}  {axis}               " for axis, row in zip(("UX", "UY", "UZ"), np.eye(3), strict=True)),
        f"{d20_10(np.full(3, 5.5e-4))}  SIGMA_LMK        ",
        "PICTURES",
        *(f"{image:<12}{sample:10.2f}{line:10.2f}" for image, (sample, line) in pictures.items()),
        "MAP OVERLAPS",
        "FA9999    66.076     0.078    -0.250",
        "LIMB FITS",
        "END FILE",
    ]
    return "\n".join(lines) + "\n"


def write_spc(world: World, folder: Path, matrix: FloatArray = PLAIN) -> Path:
    """Write SUMFILES and LMKFILES of a world into a folder, and a scenario beside it; return the scenario.

    Names of images run against the time.
    """
    (folder / "SUMFILES").mkdir(parents=True, exist_ok=True)
    (folder / "LMKFILES").mkdir(exist_ok=True)
    places: dict[str, dict[str, FloatArray]] = {}
    for frame, (position, axes) in enumerate(zip(world.positions_m, world.rotations, strict=True)):
        name = f"W{48230000000 + 100 * (len(world.positions_m) - frame)}"
        own = world.sightings[world.sightings["frame"] == frame]
        rays = (own[["u_px", "v_px"]].to_numpy() - [CAMERA.cx_px, CAMERA.cy_px]) / [CAMERA.fx_px, CAMERA.fy_px]
        pixels = FOCAL_MM * rays @ matrix[:, :2].T + CENTRE
        seen = {name_of(number): pixel for number, pixel in zip(own["track"], pixels, strict=True)}
        for landmark, pixel in seen.items():
            places.setdefault(landmark, {})[name] = pixel
        epoch = datetime(2015, 4, 14, 16, 26, 27, 974000) + timedelta(seconds=60 * frame)
        content = sum_text(name, epoch, -position / 1e3, axes, seen, matrix)
        (folder / "SUMFILES" / f"{name}.SUM").write_text(content)
    for number, point in enumerate(world.points_m):
        if name_of(number) in places:
            content = lmk_text(name_of(number), point / 1e3, places[name_of(number)])
            (folder / "LMKFILES" / f"{name_of(number)}.LMK").write_text(content)
    scene = folder.parent / "scene.yaml"
    scene.write_text(SCENE.replace("spc: spc", f"spc: {folder.name}"))
    return scene
