"""Interactive 3D view of a body, its landmarks and cameras: a self-contained HTML page."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from boresight.reports.figures.style import BLUE, GREEN, VERMILION
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.atomic import write_text

_BODY = "#9aa0a6"
_SHADES = ((0.0, "#5f6369"), (1.0, "#eceef0"))
_PERCENT = 95
_SCENE = 0.78
"""Share of the width of the page for the drawing; legend and colour bar are to its right."""
_WIDTH = 140
"""Characters of a line below the title."""
_TOP_PX, _LINE_PX = 115, 15
_EYE = {"x": 1.25, "y": 1.25, "z": 0.85}
_LIGHT_DIRECTION = np.array([1.0, 0.4, 1.0]) / np.linalg.norm([1.0, 0.4, 1.0])
_RAISE = 0.02
"""Height of landmarks above the surface, in radii of the body: on the surface, half of a mark would be hidden."""
_AXIS = {
    "showspikes": False,
    "showbackground": False,
    "gridcolor": "#dfe3e8",
    "zeroline": False,
    "tickfont": {"size": 10},
}


@dataclass(frozen=True, slots=True, eq=False)
class PointSet:
    """Points (n, 3), coloured by a number (n,) that ``name`` explains, grey where NaN.

    ``texts`` (n,) are shown under the pointer.
    """

    name: str
    points_m: FloatArray
    values: FloatArray
    texts: Sequence[str]
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class CameraSet:
    """Positions of cameras of one kind, joined by a line if they are a trajectory."""

    name: str
    colour: str
    points_m: FloatArray
    texts: Sequence[str]
    joined: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class View3D:
    """Content of a 3D view of a body (V, 3), (F, 3), body axes, m; of the sets of marks one is shown at a time."""

    title: str
    note: str
    vertices_m: FloatArray
    faces: NDArray[np.int32]
    marks: Sequence[PointSet]
    cameras: Sequence[CameraSet] = field(default=())


GOOD, BAD, FAILED = BLUE, VERMILION, "#000000"
TRUE = GREEN


def write_view3d(look: View3D, path: Path) -> None:
    """Write the page with plotly's own script in it; raise `BoresightError` if it cannot be written."""
    # Half-Lambert shading, in which no side is black, is computed here: plotly's lights are fixed to the screen and
    # leave bodies of some hundred metres dark.
    light = 0.5 * (1.0 + _normals(look.vertices_m[look.faces]) @ _LIGHT_DIRECTION)
    a, b, c = look.faces.T
    body = go.Mesh3d(
        **_coordinates(look.vertices_m), i=a, j=b, k=c, color=_BODY, name="body", hoverinfo="skip", showlegend=True,
        intensity=light.astype(np.float32), intensitymode="cell", cmin=0.0, cmax=1.0, colorscale=_SHADES,
        showscale=False, lighting={"ambient": 1.0, "diffuse": 0.0, "specular": 0.0, "fresnel": 0.0},
    )  # fmt: skip
    marks = [
        go.Scatter3d(
            **_coordinates(raised_points(look, one.points_m)), mode="markers", marker=_marker(one), name=one.name,
            text=list(one.texts), hoverinfo="text", visible=True if k == 0 else "legendonly",
        )
        for k, one in enumerate(look.marks)
    ]  # fmt: skip
    cameras = [
        go.Scatter3d(
            **_coordinates(one.points_m), mode="lines+markers" if one.joined else "markers",
            marker={"size": 3, "color": one.colour, "symbol": "circle" if one.joined else "diamond"},
            line={"color": one.colour, "width": 3}, name=f"{one.name} ({len(one.points_m)})", text=list(one.texts),
            hoverinfo="text",
        )
        for one in look.cameras
    ]  # fmt: skip
    figure = go.Figure([body, *marks])
    figure.add_traces(cameras)
    # Buttons choose which set of landmarks is shown; body and cameras stay.
    at = list(range(1, 1 + len(look.marks)))
    buttons = [
        {
            "label": one.name,
            "method": "restyle",
            "args": [{"visible": [True if k == index else "legendonly" for k in range(len(look.marks))]}, at],
        }
        for index, one in enumerate(look.marks)
    ]
    menu = {"type": "buttons", "direction": "right", "x": 0.01, "y": 1.01, "xanchor": "left", "yanchor": "bottom"}
    note = textwrap.wrap(look.note, _WIDTH) or [""]
    figure.update_layout(
        title={"text": look.title, "subtitle": {"text": "<br>".join(note)}, "y": 0.97, "yanchor": "top"},
        scene={
            "aspectmode": "data",
            "domain": {"x": [0.0, _SCENE], "y": [0.0, 1.0]},
            "camera": {"eye": _EYE},
            **{f"{axis}axis": {"title": {"text": f"{axis}, m"}, **_AXIS} for axis in "xyz"},
        },
        legend={"itemsizing": "constant", "x": _SCENE, "xanchor": "left", "y": 1.0, "yanchor": "top"},
        margin={"l": 0, "r": 10, "b": 0, "t": _TOP_PX + _LINE_PX * len(note)},
        updatemenus=[menu | {"buttons": buttons}] if len(look.marks) > 1 else [],
    )
    page = figure.to_html(include_plotlyjs=True, full_html=True, config={"displaylogo": False, "responsive": True})
    title = look.title.replace("&", "&amp;").replace("<", "&lt;")
    write_text(path, page.replace("<head>", f"<head>\n    <title>{title}</title>", 1))


def _coordinates(points_m: FloatArray) -> dict[str, NDArray[np.float32]]:
    """Return coordinates in single precision, which halves the size of the page."""
    return {axis: points_m[:, k].astype(np.float32) for k, axis in enumerate("xyz")}


def raised_points(look: View3D, points_m: FloatArray) -> FloatArray:
    """Move points (n, 3) a little outward along the normals of the nearest facets of the body."""
    if not len(points_m):
        return points_m
    corners = look.vertices_m[look.faces]
    _, nearest = cKDTree(corners.mean(axis=1)).query(points_m)
    radius_m = float(np.linalg.norm(look.vertices_m, axis=1).max())
    return np.asarray(points_m + _RAISE * radius_m * _normals(corners)[nearest])


def _normals(corners_m: FloatArray) -> FloatArray:
    """Outward unit normals of (F, 3, 3) facets."""
    across = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    return np.asarray(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(float).tiny))


def _marker(marks: PointSet) -> dict[str, object]:
    """Colour points by their number, up to its 95th percentile, with a bar that explains it."""
    known = marks.values[np.isfinite(marks.values)]
    top = float(np.percentile(known, _PERCENT)) if len(known) else 1.0
    title = {"text": f"{marks.name}{f', {marks.unit}' if marks.unit else ''}", "font": {"size": 12}}
    bar = {"title": title, "x": _SCENE, "xanchor": "left", "y": 0.05, "yanchor": "bottom", "len": 0.5, "thickness": 14}
    return {
        "size": 5,
        "color": np.nan_to_num(marks.values, nan=-1.0),
        "cmin": 0.0,
        "cmax": top or 1.0,
        "colorscale": "Viridis",
        "colorbar": bar,
        "line": {"width": 0.5, "color": "white"},
    }
