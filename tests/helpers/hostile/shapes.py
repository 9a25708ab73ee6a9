"""Readers of shapes, through the checks that a body must pass before it is rendered."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from boresight.scenarios.bodies import load_body
from boresight.scenarios.bodies.readers.icq import cube_lattice
from boresight.scenarios.spec.body import BodySpec
from hostile.target import Target

_VERTICES = ("1 0 0", "0 1 0", "0 0 1", "-1 -1 -1")
_FACES = ((1, 2, 3), (1, 4, 2), (2, 4, 3), (3, 4, 1))


def targets() -> dict[str, Target]:
    """All formats of shapes, each by its suffix or by name."""
    return {
        "obj": _target("x.obj", "auto", lambda: (_obj(), _exported("obj")), _OBJ_WORDS),
        "ply": _target("x.ply", "auto", _plys, _PLY_WORDS),
        "pds-plates": _target("x.tab", "pds-plates", lambda: (_obj(), _counted())),
        "pds-grid": _target("x.tab", "pds-grid", lambda: (_grid(),)),
        "icq": _target("x.icq", "icq", lambda: (_icq(1), _icq(2)), (b"16384", b"9999")),
        "shape": _target("x.tab", "auto", lambda: (_obj(), _counted(), _grid(), _icq(1), *_plys())),
    }


_OBJ_WORDS = (
    b"f 1/2/3 2//1 -1", b"\\\n", b"mtllib ../../../../etc/passwd", b"usemtl x", b"v 1 2 3 4 5 6", b"f 1 2 3 4 5 6 7",
    b"vt 1 2", b"vn 1 2 3", b"g x", b"o x", b"l 1 2", b"f -1 -2 -3", b"vp 1", b"f 1 2 3 #", b"f " + b"1 " * 5000,
)  # fmt: skip
_PLY_WORDS = (
    b"format binary_little_endian 1.0", b"format binary_big_endian 1.0", b"format ascii 1.0", b"element vertex",
    b"element face", b"element edge 3", b"property float x", b"property list uchar int vertex_indices", b"uint64",
    b"property list double double x", b"comment", b"end_header", b"int8", b"property list uint8 float32 vertex_indices",
    b"comment TextureFile ../../../../etc/passwd", b"property uchar red", b"element vertex 0",
)  # fmt: skip


def _target(name: str, file_format: str, seeds: object, words: tuple[bytes, ...] = ()) -> Target:
    return Target(partial(_read, name, file_format), seeds, words)  # type: ignore[arg-type]


def _read(name: str, file_format: str, content: bytes, folder: Path) -> object:
    (folder / name).write_bytes(content)
    spec = BodySpec.model_validate({"shape": name, "format": file_format, "expected_diameter_m": (0.1, 1e9)})
    return load_body(spec, [folder]).mesh.normals


def _obj() -> bytes:
    faces = ("f {} {} {}".format(*face) for face in _FACES)
    return "\n".join([*(f"v {v}" for v in _VERTICES), *faces, ""]).encode()


def _counted() -> bytes:
    vertices = (f"{i} {v}" for i, v in enumerate(_VERTICES, 1))
    faces = ("{} {} {} {}".format(i, *face) for i, face in enumerate(_FACES, 1))
    return "\n".join(["4", *vertices, "4", *faces, ""]).encode()


def _grid() -> bytes:
    return "".join(f"{lat} {lon} 2.0\n" for lat in range(-90, 91, 45) for lon in range(0, 361, 90)).encode()


def _icq(q: int) -> bytes:
    points = cube_lattice(q) / (0.5 * q) - 1.0
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    return "\n".join([str(q), *(" ".join(f"{x:.6f}" for x in row) for row in points), ""]).encode()


def _plys() -> tuple[bytes, ...]:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = ("3 {} {} {}".format(*(i - 1 for i in face)) for face in _FACES)
    return "\n".join([head.strip(), *_VERTICES, *faces, ""]).encode(), _exported("ply")


def _exported(file_type: str) -> bytes:
    box = trimesh.creation.box()
    written = box.export(file_type=file_type)
    return written if isinstance(written, bytes) else written.encode()
