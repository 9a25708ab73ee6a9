"""The same look as a recording for rerun, a viewer of its own (the extra ``rerun``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from reports.pages.look import PointSet, View3D
from scenarios.errors import BoresightError

_GREY = (154, 160, 166)


def write_recording(look: View3D, path: Path) -> None:
    """Write an ``.rrd`` with the body, landmarks and cameras, body axes, m.

    Raises
    ------
    BoresightError
        If rerun is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise BoresightError("--rerun: rerun is not installed: pip install 'boresight[rerun]'") from error
    path.parent.mkdir(parents=True, exist_ok=True)
    # The name of a recording is drawn at random unless it is given.
    recording = rerun.RecordingStream("boresight", recording_id=path.stem, send_properties=False)
    recording.save(path)
    body = rerun.Mesh3D(
        vertex_positions=look.vertices_m.astype(np.float32),
        triangle_indices=look.faces.astype(np.uint32),
        albedo_factor=[*_GREY, 255],
    )
    recording.log("body", body, static=True)
    for marks in look.marks:
        points = rerun.Points3D(marks.points_m, colors=_colours(marks), labels=list(marks.texts), show_labels=False)
        recording.log(f"landmarks/{_entity(marks.name)}", points, static=True)
    for cameras in look.cameras:
        colour = [round(255 * part) for part in to_rgb(cameras.colour)]
        entity = f"cameras/{_entity(cameras.name)}"
        recording.log(
            entity, rerun.Points3D(cameras.points_m, colors=[colour], labels=list(cameras.texts), show_labels=False),
            static=True,
        )  # fmt: skip
        if cameras.joined and len(cameras.points_m):
            recording.log(f"{entity}/path", rerun.LineStrips3D([cameras.points_m], colors=[colour]), static=True)
    recording.flush()
    recording.disconnect()


def _colours(marks: PointSet) -> NDArray[np.uint8]:
    known = np.isfinite(marks.values)
    top = float(np.percentile(marks.values[known], 95)) if known.any() else 1.0
    colours = np.tile(np.array(_GREY, dtype=np.uint8), (len(marks.values), 1))
    shades = colormaps["viridis"](np.clip(marks.values[known] / (top or 1.0), 0.0, 1.0))[:, :3]
    colours[known] = np.round(255 * shades).astype(np.uint8)
    return colours


def _entity(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)
