"""Load the body of a scenario: read or generate the shape, check it, cache its detail."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies.checks import checked_mesh
from boresight.scenarios.bodies.detail import DETAIL_VERSION, add_detail
from boresight.scenarios.bodies.detail.noise import Band, fractal_field
from boresight.scenarios.bodies.detail.subdivide import rounds_for
from boresight.scenarios.bodies.embedded import EMBEDDED, EMBEDDED_VERSION, icosphere
from boresight.scenarios.bodies.readers import READER_VERSION, read_shape
from boresight.scenarios.bodies.topology import find_edges, vertex_normals
from boresight.scenarios.cache import Cache, default_cache
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.spec.body import BodySpec, FurtherHeightErrorSpec, HeightErrorSpec

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
    """Return the facets of a body from those of its shape file."""
    if spec.even_facets is not None:
        count = _ICOSAHEDRON_FACETS * 4 ** rounds_for(_ICOSAHEDRON_FACETS, spec.even_facets)
    return count if spec.detail is None else count * 4 ** rounds_for(count, spec.detail.facets)


def with_height_error(mesh: TriangleMesh, spec: HeightErrorSpec) -> TriangleMesh:
    """Move the vertices along their normals by a fractal field of RMS ``spec.rms_m``.

    Octaves shorter than the mesh's mean edge cannot be resolved and are left out; the field of the remaining octaves is
    scaled to an RMS of ``rms_m`` over the vertices.
    """
    if isinstance(spec, FurtherHeightErrorSpec):
        mesh = with_height_error(mesh, spec.on)
    ends = find_edges(mesh.faces).ends
    edge_m = float(np.linalg.norm(mesh.vertices_m[ends[:, 0]] - mesh.vertices_m[ends[:, 1]], axis=1).mean())
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
    """Read or make the shape, check it, and add the detail; a body already in use in this process is shared.

    A relative shape file is looked for in ``search_dirs``, then under BORESIGHT_DATA. Detailed bodies are kept in
    ``cache``, by default the user's. Raise BoresightError if the shape is not found or not valid, or a key of the spec
    does not apply to it.
    """
    path, cache, digest = _shape_path(spec, search_dirs), cache or default_cache(), body_digest(spec, search_dirs)
    # The expected diameter and the path are not part of the digest, but decide about errors and names.
    key = (digest, path, spec.expected_diameter_m, cache)
    body = _in_use.get(key)
    if body is None:
        mesh, notes = _mesh(spec, path, search_dirs, cache)
        name, source = (spec.shape, "embedded") if path is None else (path.name, str(path))
        _in_use[key] = body = Body(mesh, name, source, digest, notes)
    return body


def _mesh(
    spec: BodySpec, path: Path | None, search_dirs: Sequence[Path], cache: Cache
) -> tuple[TriangleMesh, tuple[str, ...]]:
    if spec.detail is None:
        mesh, notes = _coarse(spec, path)
    else:
        # Detailed bodies are cached without the height error, which is added afterwards: several errors share one.
        true_heights = spec.model_copy(update={"height_error": None})
        mesh, notes = _detailed(spec, path, body_digest(true_heights, search_dirs), cache)
    return (mesh if spec.height_error is None else with_height_error(mesh, spec.height_error)), notes


def body_digest(spec: BodySpec, search_dirs: Sequence[Path] = ()) -> str:
    """Digest (hexadecimal SHA-256) of what determines the mesh, without making it.

    It covers the bytes of the shape file (not its path) or the name of the embedded body, the keys that change
    how it is read, resampling, detail and height error, and the versions of the code. Shading and the expected
    diameter are not in it: they do not change the mesh.
    """
    path = _shape_path(spec, search_dirs)
    content: dict[str, object] = {
        "shape": spec.shape if path is None else hashlib.sha256(_bytes(path)).hexdigest(),
        "reading": None if path is None else [spec.unit, spec.format, spec.longitude, path.suffix.lower()],
        "detail": None if spec.detail is None else spec.detail.model_dump(mode="json"),
        "versions": [READER_VERSION, EMBEDDED_VERSION, DETAIL_VERSION],
    }
    if spec.even_facets is not None:
        content["even"] = [spec.even_facets, EVEN_VERSION]
    if spec.height_error is not None:
        content["height_error"] = [spec.height_error.model_dump(mode="json"), HEIGHT_ERROR_VERSION]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _shape_path(spec: BodySpec, search_dirs: Sequence[Path]) -> Path | None:
    """Path of the shape file, or None for an embedded body."""
    if spec.shape not in EMBEDDED:
        known = ", ".join(EMBEDDED)
        return find_data_file(spec.shape, search_dirs, "shapes", f"body.shape (a file, or one of {known})")
    for key in ("unit", "format", "longitude"):
        if getattr(spec, key) != BodySpec.model_fields[key].default:
            raise BoresightError(
                f"body.{key}: {getattr(spec, key)} has no meaning for the embedded body {spec.shape}; remove the key"
            )
    return None


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BoresightError(f"{path}: cannot read the shape file: {error.strerror or error}") from error


def _coarse(spec: BodySpec, path: Path | None) -> tuple[TriangleMesh, tuple[str, ...]]:
    mesh, notes = _original(spec, path)
    # Keys that are not given are left out: digests of bodies without them stay as they are.
    if spec.even_facets is not None:
        mesh = evenly_meshed(mesh, spec.even_facets, spec.shape if path is None else str(path))
    return mesh, notes


def _original(spec: BodySpec, path: Path | None) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Return the shape of the file or the built-in one, before resampling and detail."""
    if path is None:
        return EMBEDDED[spec.shape](), ()
    shape = read_shape(path, spec.format, west_longitudes=spec.longitude == "west")
    return checked_mesh(shape, path, spec.unit, spec.expected_diameter_m)


def _detailed(spec: BodySpec, path: Path | None, digest: str, cache: Cache) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Take the detailed mesh from the cache, or make it; the coarse shape is checked in either case."""
    detail = spec.detail
    if detail is None:
        return _coarse(spec, path)
    coarse, notes = _coarse(spec, path)

    def build(folder: Path) -> None:
        mesh, detail_notes = add_detail(coarse, detail)
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
    return mesh, (*notes, *json.loads((folder / "notes.json").read_text()))
