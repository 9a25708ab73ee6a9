"""Load the body of a scenario: read or generate the shape, check and repair it, cache its detail."""

from __future__ import annotations

import difflib
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies.albedo import ALBEDO_MAP_VERSION, with_albedo_map
from boresight.scenarios.bodies.detail import DETAIL_VERSION, add_detail
from boresight.scenarios.bodies.embedded import EMBEDDED, EMBEDDED_VERSION, icosphere
from boresight.scenarios.bodies.local import LOCAL_VERSION, local_facets, with_local
from boresight.scenarios.bodies.noise import Band, fractal_field
from boresight.scenarios.bodies.readers import READER_VERSION, RawShape, read_shape
from boresight.scenarios.bodies.topology import directed_edge_keys, find_edges, is_closed, rounds_for, vertex_normals
from boresight.scenarios.cache import Cache, default_cache
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry.mesh import TriangleMesh, winding_number
from boresight.scenarios.reading import read_bytes
from boresight.scenarios.spec.body import (
    MOST_FACETS,
    AlbedoMapSpec,
    BodySpec,
    DetailSpec,
    FurtherHeightErrorSpec,
    HeightErrorSpec,
    LocalSpec,
    without_detail,
)

_FLAT = 1e-9  # of the mean area: facets below it are reported as flat
METRES = {"m": 1.0, "km": 1000.0}


def checked_mesh(
    shape: RawShape, where: Path, unit: str, expected_diameter_m: tuple[float, float]
) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Convert the vertices and faces of a file, in its ``unit`` m or km, to a valid mesh in metres, and notes about it.

    A unit that the format prescribes has precedence.

    Repaired, with a note: vertices that no face uses, coincident vertices of an open mesh, facets with a repeated
    vertex, a closed mesh whose facets all face inward. Raise BoresightError for any other defect: the longest side of
    the body's box is outside ``expected_diameter_m``, the mesh is open or inconsistently wound, or the origin lies
    outside. ``where`` is the file, for messages.
    """
    vertices, faces, notes = _repaired(shape.vertices * METRES[shape.unit or unit], shape.faces)
    _check_extent(vertices, where, shape.unit, unit, expected_diameter_m)
    _check_closed(faces, where)
    mesh = TriangleMesh(vertices, faces.astype(np.int32))
    # The winding is consistent here, so that the sign of the volume distinguishes outward from inward facets.
    if mesh.volume_m3 < 0.0:
        mesh = TriangleMesh(vertices, mesh.faces[:, ::-1])
        notes.append("the facets faced inward: all were turned")
    area = mesh.areas_m2
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


def _check_extent(
    vertices_m: FloatArray, where: Path, prescribed: str | None, unit: str, expected_m: tuple[float, float]
) -> None:
    extent = np.ptp(vertices_m, axis=0) if len(vertices_m) else np.zeros(3)
    low, high = expected_m
    longest = float(extent.max())
    if low <= longest <= high:
        return
    unit = prescribed or unit
    other = {"m": "km", "km": "m"}[unit]
    fits = low <= longest * METRES[other] / METRES[unit] <= high
    hint = f"is the file in {other}? set body.unit: {other}" if fits else "check body.unit and body.expected_diameter_m"
    size = " x ".join(f"{side:.4g}" for side in extent)
    if prescribed:
        hint = f"is the file in {other}? write it in {unit}" if fits else "check body.expected_diameter_m"
        hint = f"this format has no other unit: {hint}"
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
        if turns > 1.5:
            raise BoresightError(f"{where}: {turns:.0f} closed surfaces lie about the origin: keep the outer one")
        centre = mesh.vertices_m.mean(axis=0)
        raise BoresightError(
            f"{where}: the origin lies outside the body (winding number {turns:.2f}); move the shape so that its"
            f" centre, now at {centre.round(3).tolist()} m, is the origin"
        )


HEIGHT_ERROR_VERSION = 1
"""Part of the digest of every body with a height error: increase it when the same spec gives another mesh."""


EVEN_VERSION = 1
"""Part of the digest of every resampled body: increase it when the same spec gives another mesh."""

_ICOSAHEDRON_FACETS = 20
_PAIRS_AT_ONCE = 1 << 22  # pairs of a direction and a facet


def evenly_meshed(mesh: TriangleMesh, facets: int, source: str) -> TriangleMesh:
    """Resample a star-shaped mesh at the directions of the vertices of an icosphere.

    It has at least ``facets`` and less than four times as many. A direction d intersects a facet with corners a, b, c
    if d ~ (d.(b x c)) a + (d.(c x a)) b + (d.(a x b)) c has no negative weight; the normalised weights are the
    barycentric coordinates of the intersection. The new vertices lie on the shape; the facets between them cut its
    edges, so that a convex body loses a little volume. Raise BoresightError, which names the ``source``, if a facet
    does not face away from the origin, so that the shape is not star-shaped.
    """
    corners = np.asarray(mesh.corners_m, dtype=np.float64)
    # For corners a, b, c: b x c, c x a, a x b, whose products with d are the weights of a, b, c.
    opposite = np.cross(np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1))
    hidden = int((np.einsum("fi,fi->f", corners[:, 0], opposite[:, 0]) <= 0.0).sum())
    if hidden:
        raise BoresightError(
            f"{source}: body.even_facets: {hidden} facets cannot be seen from the body's origin, so that one net over"
            " all directions does not fit; remove the key"
        )
    net = icosphere(rounds_for(_ICOSAHEDRON_FACETS, facets), 1.0)
    directions = net.vertices_m
    facet, weights = _intersections(directions, opposite)
    points_m = np.einsum("nk,nki->ni", weights, corners[facet])
    albedo = None if mesh.albedo is None else np.einsum("nk,nk->n", weights, mesh.albedo[mesh.faces[facet]])
    return TriangleMesh(points_m, net.faces, albedo)


def _intersections(directions: FloatArray, opposite: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """(n,) facet that each direction intersects, and barycentric coordinates (n, 3) of the intersection."""
    found = np.empty(len(directions), dtype=np.int64)
    weights = np.empty((len(directions), 3))
    step = max(1, _PAIRS_AT_ONCE // len(opposite))
    for first in range(0, len(directions), step):
        part = slice(first, first + step)
        products = np.einsum("ni,fki->nfk", directions[part], opposite, optimize=True)
        total = products.sum(axis=2)
        # The direction intersects the facet whose smallest weight is largest. Where all weights are negative the facet
        # lies on the opposite side.
        least = np.where(total > 0.0, products.min(axis=2) / np.where(total > 0.0, total, 1.0), -np.inf)
        found[part] = least.argmax(axis=1)
        rows = np.arange(len(found[part]))
        weights[part] = products[rows, found[part]] / total[rows, found[part], None]
    # Rounding leaves weights of -1e-17 on shared edges.
    return found, np.clip(weights, 0.0, 1.0) / np.clip(weights, 0.0, 1.0).sum(axis=1, keepdims=True)


def detailed_count(spec: BodySpec, count: int) -> int:
    """Return the facets of a body from those of its shape file, without those of a site and of local shapes."""
    if spec.even_facets is not None:
        count = _ICOSAHEDRON_FACETS * 4 ** rounds_for(_ICOSAHEDRON_FACETS, spec.even_facets)
    return count if spec.detail is None else count * 4 ** rounds_for(count, spec.detail.facets)


def expected_facets(spec: BodySpec, search_dirs: Sequence[Path] = ()) -> int:
    """Return how many facets a body will have, without making its detail; those of site and local shapes are estimated.

    Raise BoresightError if a shape is not found or not valid.
    """
    count = detailed_count(spec, len(load_body(without_detail(spec), search_dirs).mesh.faces))
    site = 0 if spec.detail is None or spec.detail.site is None else spec.detail.site.facets
    local = (local_facets(*_local_shape(one, _local_path(one, search_dirs)), one) for one in spec.local or ())
    return count + site + sum(local)


def _check_facets(count: int, spec: DetailSpec) -> None:
    """Refuse a detail that makes more facets than `MOST_FACETS` of the ``count`` of a shape, before it is made."""
    made = count * 4 ** rounds_for(count, spec.facets)
    if made > max(count, MOST_FACETS):
        raise BoresightError(
            f"detail.facets: {spec.facets:,} makes {made:,} facets of the {count:,} of the shape, each four of one, and"
            f" {MOST_FACETS:,} are the most: give {made // 4} or less"
        )
    if spec.site is not None and made + spec.site.facets > MOST_FACETS:
        left = MOST_FACETS - made
        remedy = "lower detail.facets"
        if left > 0:
            edge_m = spec.site.edge_m * math.sqrt(spec.site.facets / left)
            remedy = f"give {math.ceil(100.0 * edge_m) / 100.0:g} or more"
        raise BoresightError(
            f"detail.site.edge_m: {spec.site.edge_m:g} m makes about {spec.site.facets:,} facets beside the {made:,} of"
            f" the body, and {MOST_FACETS:,} are the most: {remedy}"
        )


def with_height_error(mesh: TriangleMesh, spec: HeightErrorSpec) -> TriangleMesh:
    """Move the vertices along their normals by a fractal field of RMS ``spec.rms_m``.

    Octaves shorter than the mesh's mean edge cannot be resolved and are left out; the field of the remaining octaves is
    scaled to an RMS of ``rms_m`` over the vertices.
    """
    if isinstance(spec, FurtherHeightErrorSpec):
        mesh = with_height_error(mesh, spec.on)
    edge_m = float(find_edges(mesh.faces).lengths(mesh.vertices_m).mean())
    band = Band(spec.max_wavelength_m, spec.min_wavelength_m, spec.hurst)
    field, _ = fractal_field(np.asarray(mesh.vertices_m), band, edge_m, np.random.SeedSequence(spec.seed))
    deviation = float(field.std())
    # fractal_field keeps the variance of omitted octaves out of the field: here the whole RMS is wanted.
    heights_m = spec.rms_m * field / deviation if deviation > 0.0 else field
    normals = vertex_normals(np.asarray(mesh.vertices_m), np.asarray(mesh.faces))
    return TriangleMesh(mesh.vertices_m + heights_m[:, None] * normals, mesh.faces, mesh.albedo)


@dataclass(frozen=True, slots=True, weakref_slot=True, eq=False)
class Body:
    """A body's mesh, closed and outward, m, body frame, with its source and digest.

    ``name`` is that of the shape's file or of the embedded body, ``source`` the path of the file or ``embedded``,
    ``sha256`` the digest of everything that determines the mesh (see `body_digest`). ``notes`` are repairs of the
    shape, and features left out of the detail.
    """

    mesh: TriangleMesh
    name: str
    source: str
    sha256: str
    notes: tuple[str, ...] = ()


_in_use: WeakValueDictionary[tuple[object, ...], Body] = WeakValueDictionary()


def load_body(spec: BodySpec, search_dirs: Sequence[Path] = (), cache: Cache | None = None) -> Body:
    """Read or make the shape, check it, add detail and local shapes; a body already in use in this process is shared.

    A relative shape file is looked for in ``search_dirs``, then under BORESIGHT_DATA. Detailed bodies are kept in
    ``cache``, by default the user's. Raise BoresightError if the shape is not found or not valid, or a key of the spec
    does not apply to it.
    """
    path, cache, digest = _shape_path(spec, search_dirs), cache or default_cache(), body_digest(spec, search_dirs)
    # The expected diameter and the path are not part of the digest, but decide about errors and names.
    key = (digest, path, spec.expected_diameter_m, cache)
    body = _in_use.get(key)
    if body is None:
        bare = without_detail(spec)
        if bare == spec:
            mesh, notes = _coarse(spec, path)
        else:
            # Where a caller holds it, the file is not read again.
            coarse = load_body(bare, search_dirs, cache)
            mesh, notes = coarse.mesh, coarse.notes
        if spec.even_facets is not None:
            mesh = evenly_meshed(mesh, spec.even_facets, spec.shape if path is None else str(path))
        if spec.detail is not None or spec.local:
            # Cached without height error and albedo map, which are added afterwards: several share one detailed body.
            # The coarse shape is checked in either case.
            without = body_digest(spec.model_copy(update={"height_error": None, "albedo_map": None}), search_dirs)
            if spec.detail is not None:
                _check_facets(len(mesh.faces), spec.detail)
            mesh, more = _detailed(mesh, spec, search_dirs, without, cache)
            notes = (*notes, *more)
        if spec.height_error is not None:
            mesh = with_height_error(mesh, spec.height_error)
        if spec.albedo_map is not None:
            mesh = with_albedo_map(mesh, spec.albedo_map, _map_path(spec.albedo_map, search_dirs))
        name, source = (spec.shape, "embedded") if path is None else (path.name, str(path))
        _in_use[key] = body = Body(mesh, name, source, digest, notes)
    return body


def body_digest(spec: BodySpec, search_dirs: Sequence[Path] = ()) -> str:
    """Digest (hexadecimal SHA-256) of what determines the mesh, without making it.

    It covers the bytes of the shape file (not its path) or the name of the embedded body, the keys that change
    how it is read, resampling, detail, local shapes, height error and albedo map, and the versions of the code.
    Shading and the expected diameter are not in it: they do not change the mesh.
    """
    path = _shape_path(spec, search_dirs)
    content: dict[str, object] = {
        "shape": spec.shape if path is None else hashlib.sha256(read_bytes(path)).hexdigest(),
        "reading": None if path is None else [spec.unit, spec.format, spec.longitude, path.suffix.lower()],
        "detail": None if spec.detail is None else spec.detail.model_dump(mode="json"),
        "versions": [READER_VERSION, EMBEDDED_VERSION, DETAIL_VERSION],
    }
    if spec.even_facets is not None:
        content["even"] = [spec.even_facets, EVEN_VERSION]
    if spec.local:
        files = [_local_path(one, search_dirs) for one in spec.local]
        content["local"] = [
            [
                hashlib.sha256(read_bytes(file)).hexdigest(),
                file.suffix.lower(),
                one.model_dump(mode="json", exclude={"shape"}),
            ]
            for one, file in zip(spec.local, files, strict=True)
        ]
        content["local_version"] = LOCAL_VERSION
    if spec.height_error is not None:
        content["height_error"] = [spec.height_error.model_dump(mode="json"), HEIGHT_ERROR_VERSION]
    if spec.albedo_map is not None:
        file = hashlib.sha256(read_bytes(_map_path(spec.albedo_map, search_dirs))).hexdigest()
        content["albedo_map"] = [file, spec.albedo_map.left_deg, spec.albedo_map.unity, ALBEDO_MAP_VERSION]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _shape_path(spec: BodySpec, search_dirs: Sequence[Path]) -> Path | None:
    """Path of the shape file, or None for an embedded body."""
    if spec.shape not in EMBEDDED:
        try:
            return find_data_file(spec.shape, search_dirs, "shapes", "body.shape")
        except BoresightError as error:
            near = difflib.get_close_matches(spec.shape, EMBEDDED, n=1)
            hint = f"did you mean {near[0]}?" if near else f"or give one of {', '.join(EMBEDDED)}"
            raise BoresightError(f"{error}; {hint}") from None
    for key in ("unit", "format", "longitude"):
        if getattr(spec, key) != BodySpec.model_fields[key].default:
            raise BoresightError(
                f"body.{key}: {getattr(spec, key)} has no meaning for the embedded body {spec.shape}; remove the key"
            )
    return None


def _local_path(spec: LocalSpec, search_dirs: Sequence[Path]) -> Path:
    return find_data_file(spec.shape, search_dirs, "shapes", "body.local.shape")


def _local_shape(spec: LocalSpec, path: Path) -> tuple[FloatArray, IndexArray]:
    """Read the vertices, m, and the faces of a local shape."""
    shape = read_shape(path, spec.format)
    vertices_m, faces, _ = _repaired(shape.vertices * METRES[shape.unit or spec.unit], shape.faces)
    return vertices_m, faces


def _map_path(spec: AlbedoMapSpec, search_dirs: Sequence[Path]) -> Path:
    return find_data_file(spec.file, search_dirs, "shapes", "body.albedo_map.file")


def _coarse(spec: BodySpec, path: Path | None) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Return the shape of the file or the built-in one, before anything is added."""
    if path is None:
        return EMBEDDED[spec.shape](), ()
    shape = read_shape(path, spec.format, west_longitudes=spec.longitude == "west")
    return checked_mesh(shape, path, spec.unit, spec.expected_diameter_m)


def _detailed(
    coarse: TriangleMesh, spec: BodySpec, search_dirs: Sequence[Path], digest: str, cache: Cache
) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Take the mesh with its detail and local shapes from the cache, or make it."""

    def build(folder: Path) -> None:
        mesh, detail_notes = (coarse, ()) if spec.detail is None else add_detail(coarse, spec.detail)
        for one in spec.local or ():
            path = _local_path(one, search_dirs)
            mesh, note = with_local(mesh, *_local_shape(one, path), one, path)
            detail_notes = (*detail_notes, note)
        np.save(folder / "vertices_m.npy", mesh.vertices_m)
        np.save(folder / "faces.npy", mesh.faces)
        if mesh.albedo is not None:
            np.save(folder / "albedo.npy", mesh.albedo)
        (folder / "notes.json").write_text(json.dumps(detail_notes))

    folder = cache.folder("bodies", digest, build)
    albedo_file = folder / "albedo.npy"
    mesh = TriangleMesh(
        np.load(folder / "vertices_m.npy", mmap_mode="r"),
        np.load(folder / "faces.npy", mmap_mode="r"),
        np.load(albedo_file, mmap_mode="r") if albedo_file.is_file() else None,
    )
    return mesh, tuple(json.loads((folder / "notes.json").read_text()))
