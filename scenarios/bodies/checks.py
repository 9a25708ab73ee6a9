"""Validate and repair shapes: closed meshes with outward facets, in metres, with the origin inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies.readers import RawShape
from boresight.scenarios.bodies.topology import directed_edge_keys, is_closed
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh

_FLAT = 1e-9  # of the mean area: facets below it are reported as flat
METRES = {"m": 1.0, "km": 1000.0}


def checked_mesh(
    shape: RawShape, where: Path, unit: str, expected_diameter_m: tuple[float, float]
) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Convert the vertices and faces of a file, in its ``unit`` m or km, to a valid mesh in metres, and notes about it.

    Repaired, with a note: vertices that no face uses, coincident vertices of an open mesh, facets with a repeated
    vertex, a closed mesh whose facets all face inward. Raise BoresightError for any other defect: the longest side of
    the body's box is outside ``expected_diameter_m``, the mesh is open or inconsistently wound, or the origin lies
    outside. ``where`` is the file, for messages.
    """
    vertices, faces, notes = _repaired(shape.vertices * METRES[unit], shape.faces)
    _check_extent(vertices, where, unit, expected_diameter_m)
    _check_closed(faces, where)
    mesh = TriangleMesh(vertices, faces.astype(np.int32))
    # The winding is consistent here, so that the sign of the volume distinguishes outward from inward facets.
    if mesh.volume_m3 < 0.0:
        mesh = TriangleMesh(vertices, mesh.faces[:, ::-1])
        notes.append("the facets faced inward: all were turned")
    area = np.linalg.norm(mesh.area_vectors_m2, axis=1)
    flat = int(np.count_nonzero(area <= _FLAT * area.mean()))
    if flat:
        notes.append(f"{flat} facets have no area")
    _check_origin(mesh, where)
    return mesh, tuple(notes)


def _repaired(vertices: FloatArray, faces: IndexArray) -> tuple[FloatArray, IndexArray, list[str]]:
    notes = []
    # Only an open mesh is welded: coincident vertices of a closed one may be two parts that touch.
    if not is_closed(faces):
        welded, group = np.unique(vertices, axis=0, return_inverse=True)
        if len(welded) < len(vertices):
            notes.append(f"{len(vertices) - len(welded)} coincident vertices were joined")
            vertices, faces = welded, group.reshape(-1)[faces]
    # Welding can make two corners of a facet one.
    repeated = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if repeated.any():
        notes.append(f"{int(repeated.sum())} facets with a repeated vertex were left out")
        faces = faces[~repeated]
    used, renumbered = np.unique(faces, return_inverse=True)
    if len(used) < len(vertices):
        notes.append(f"{len(vertices) - len(used)} vertices that no facet uses were left out")
        vertices, faces = vertices[used], renumbered.reshape(-1, 3)
    return vertices, faces, notes


def _check_extent(vertices_m: FloatArray, where: Path, unit: str, expected_m: tuple[float, float]) -> None:
    extent = np.ptp(vertices_m, axis=0) if len(vertices_m) else np.zeros(3)
    low, high = expected_m
    longest = float(extent.max())
    if low <= longest <= high:
        return
    other = {"m": "km", "km": "m"}[unit]
    fits = low <= longest * METRES[other] / METRES[unit] <= high
    hint = f"is the file in {other}? set body.unit: {other}" if fits else "check body.unit and body.expected_diameter_m"
    size = " x ".join(f"{side:.4g}" for side in extent)
    raise BoresightError(
        f"{where}: with body.unit {unit} the body is {size} m,"
        f" outside body.expected_diameter_m [{low:g}, {high:g}]; {hint}"
    )


def _check_closed(faces: IndexArray, where: Path) -> None:
    if not len(faces):
        raise BoresightError(f"{where}: every facet repeats a vertex; the shape has no surface")
    if is_closed(faces):
        return
    forward, backward = directed_edge_keys(faces)
    unpaired = ~np.isin(forward, backward)
    _, count = np.unique(forward, return_counts=True)
    if unpaired.any():
        facet = int(np.argmax(unpaired)) // 3
        raise BoresightError(
            f"{where}: the mesh is not closed: {int(unpaired.sum())} facet edges have no partner in the opposite"
            f" direction, the first at facet {facet + 1}; mend the holes and the winding in the shape file"
        )
    raise BoresightError(
        f"{where}: {int((count > 1).sum())} edges are shared by more than two facets; remove doubled facets"
    )


def _check_origin(mesh: TriangleMesh, where: Path) -> None:
    turns = winding_number(mesh, np.zeros(3))
    # 1 inside and 0 outside, within rounding.
    if abs(turns - 1.0) > 0.5:
        centre = mesh.vertices_m.mean(axis=0)
        raise BoresightError(
            f"{where}: the origin lies outside the body (winding number {turns:.2f}); move the shape so that its"
            f" centre, now at {centre.round(3).tolist()} m, is the origin"
        )


def winding_number(mesh: TriangleMesh, point_m: FloatArray) -> float:
    """Compute the winding number of a closed mesh about a point: 1 inside, 0 outside.

    The sum of the facets' signed solid angles over 4 pi (van Oosterom and Strackee 1983, equation 8).
    """
    a, b, c = np.moveaxis(mesh.corners_m - point_m, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("fi,fi->f", a, np.cross(b, c))
    dots = [np.einsum("fi,fi->f", p, q) for p, q in ((a, b), (b, c), (c, a))]
    half = np.arctan2(triple, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)  # eq. (8)
    return float(half.sum() / (2.0 * np.pi))
