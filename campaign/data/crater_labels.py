"""Pictures in common formats, and tables of the craters that somebody labelled in them."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses

PICTURES = (".png", ".pgm", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_MOST_PIXELS = 20_000_000  # of a picture: the layers of a heat map take 100 bytes a pixel
_MOST_PX = 1e6

_ALIKE = {
    "u": "u", "u_px": "u", "c_x": "u", "cx": "u", "x_px": "u", "v": "v", "v_px": "v", "c_y": "v", "cy": "v",
    "y_px": "v", "x": "x", "y": "y", "w": "width", "width": "width", "h": "height", "height": "height",
    "diameter": "diameter", "diameter_px": "diameter", "d": "diameter", "radius": "radius", "radius_px": "radius",
    "r": "radius", "a": "a", "a_px": "a", "b": "b", "b_px": "b", "angle": "angle", "angle_deg": "angle",
}  # fmt: skip


def open_picture(path: Path) -> Image:
    """Read an image (H, W) of 8 or 16 bits as float32; colours become grey.

    Raise BoresightError if the file is missing or no image.
    """
    try:
        stored = np.frombuffer(path.read_bytes(), dtype=np.uint8)
        found = cv2.imdecode(stored, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE) if len(stored) else None
    except (OSError, cv2.error) as error:
        raise BoresightError(f"{path}: cannot be read: {error}") from error
    if found is None:
        raise BoresightError(f"{path}: no image of a known format ({', '.join(PICTURES)})")
    if found.size > _MOST_PIXELS:
        raise BoresightError(
            f"{path}: {found.size / 1e6:.0f} megapixels are more than {_MOST_PIXELS / 1e6:.0f}: cut it"
        )
    return np.asarray(found, dtype=np.float32)


def read_labels(path: Path, columns: str = "") -> Ellipses:
    """Read a table of boxes, circles or ellipses, separated by commas, semicolons or tabs, as rims.

    Its first line names the columns: ``x, y, w, h`` of boxes with x and y at their upper left corner; ``x, y`` (or
    ``u, v``) and ``radius`` or ``diameter`` of circles; ``u, v, a, b, angle_deg`` of ellipses with semi-axes a and b.
    All are continuous pixels. ``columns`` are the names for a table without such a line.

    Raise BoresightError, with file and line, if the table is none of these or a number is impossible.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BoresightError(f"{path}: cannot be read: {error}") from error
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line[0] != "#"]
    try:
        rows = [(k, next(csv.reader([line.replace("\t", ",").replace(";", ",")]))) for k, line in lines]
    except csv.Error as error:
        raise BoresightError(f"{path}: not readable as a table: {error}") from error
    names = columns.split(",") if columns else rows.pop(0)[1] if rows else []
    meant = [_ALIKE.get(name.strip().lower(), "") for name in names]
    place = {name: meant.index(name) for name in meant if name}
    wanted = _kind_of(path, set(place), names)
    if not rows:
        raise BoresightError(f"{path}: the table has no craters")
    numbers = np.array([_numbers(path, k, row, [place[name] for name in wanted], wanted) for k, row in rows])
    return _rims(dict(zip(wanted, numbers.T, strict=True)))


def _kind_of(path: Path, there: set[str], names: list[str]) -> list[str]:
    """Return the columns of the first kind of shape that are all there."""
    kinds = [[*centre, *size] for size in (["a", "b", "angle"], ["radius"], ["diameter"]) for centre in ("uv", "xy")]
    for kind in [*kinds[:2], ["x", "y", "width", "height"], *kinds[2:]]:
        if there.issuperset(kind):
            return kind
    raise BoresightError(
        f"{path}: line 1: columns {', '.join(name.strip() for name in names) or 'none'} are no boxes (x, y, w, h),"
        " circles (x, y, radius or diameter) or ellipses (u, v, a, b, angle_deg): name the columns by --columns"
    )


def _numbers(path: Path, line: int, row: list[str], places: list[int], names: list[str]) -> FloatArray:
    try:
        values = np.array([float(row[i]) for i in places])
    except (ValueError, IndexError):
        raise BoresightError(f"{path}: line {line}: {', '.join(names)} are not all numbers") from None
    sizes = [value for name, value in zip(names, values, strict=True) if name not in ("u", "v", "x", "y", "angle")]
    if not np.all(np.abs(values) < _MOST_PX) or min(sizes) <= 0.0:
        shown = ", ".join(f"{name} {value:g}" for name, value in zip(names, values, strict=True))
        raise BoresightError(f"{path}: line {line}: {shown} cannot be a crater in an image")
    return values


def _rims(columns: dict[str, FloatArray]) -> Ellipses:
    """Build ellipses; the longer axis comes first."""
    centre = np.stack([columns[name] for name in ("uv" if "u" in columns else "xy")], axis=1)
    angle = np.radians(columns.get("angle", np.zeros(len(centre))))
    if "width" in columns:
        axes = 0.5 * np.stack([columns["width"], columns["height"]], axis=1)
        centre = centre + axes
    elif "a" in columns:
        axes = np.stack([columns["a"], columns["b"]], axis=1)
    else:
        radius = columns["radius"] if "radius" in columns else 0.5 * columns["diameter"]
        axes = np.stack([radius, radius], axis=1)
    swap = axes[:, 1] > axes[:, 0]
    axes = np.where(swap[:, None], axes[:, ::-1], axes)
    return Ellipses(centre, axes, (angle + np.where(swap, 0.5 * np.pi, 0.0)) % np.pi)
