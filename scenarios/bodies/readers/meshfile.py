"""Readers of OBJ and PLY by trimesh, after checks for faults that trimesh accepts silently."""

from __future__ import annotations

import io
import re
import struct
import warnings

import numpy as np

from boresight.scenarios.bodies.readers.source import RawShape, ShapeFile

# trimesh documents no exceptions of its own for broken files: these are what its parsers raise.
_PARSER_FAULTS = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError, NameError, RuntimeError,
    TypeError, ValueError, struct.error,
)  # fmt: skip

_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_CORNER = rb"-?[1-9]\d*(?:/-?\d*){0,2}"
_BAD_OBJ_LINE = re.compile(
    rb"^[ \t]*(?:v[ \t](?![ \t]*" + _NUMBER + rb"(?:[ \t]+" + _NUMBER + rb"){2,}[ \t\r]*(?:#[^\n]*)?$)"
    rb"|f[ \t](?![ \t]*" + _CORNER + rb"(?:[ \t]+" + _CORNER + rb"){2,}[ \t\r]*(?:#[^\n]*)?$))[^\n]*",
    re.MULTILINE,
)
_PLY_BYTES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2, "int": 4,
    "uint": 4, "float": 4, "int32": 4, "uint32": 4, "float32": 4, "double": 8, "float64": 8, "int64": 8, "uint64": 8,
}  # fmt: skip
_MAX_HEADER_BYTES = 1 << 16


def read_obj(source: ShapeFile) -> RawShape:
    """Read a Wavefront OBJ file; polygons are split into triangles, groups and materials are ignored."""
    # A backslash continues a line; the blank keeps the numbers apart.
    text = "\n".join(source.lines()).replace("\\\n", " ").encode()
    bad = _BAD_OBJ_LINE.search(text)
    if bad:
        line = text.count(b"\n", 0, bad.start()) + 1
        what = bad.group()[:60].decode(errors="replace").strip()
        raise source.fault(f"{what!r} is not a vertex (v x y z) or a face (f i j k) of an OBJ file", line)
    return _parse(source, text, "obj")


def read_ply(source: ShapeFile) -> RawShape:
    """Read a PLY file: text, binary little endian or binary big endian; polygons are split into triangles."""
    _check_ply_header(source)
    return _parse(source, source.data, "ply")


def _parse(source: ShapeFile, data: bytes, file_type: str) -> RawShape:
    # Imported here: trimesh takes a tenth of the start-up, and most runs find their body in the cache.
    import trimesh

    options = {"skip_materials": True} if file_type == "obj" else {}
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
            mesh = trimesh.load_mesh(
                io.BytesIO(data), file_type=file_type, process=False, maintain_order=True, **options
            )
            vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    except _PARSER_FAULTS as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise source.fault(
            f"not a readable {file_type.upper()} file ({reason}); is it cut, does a face name a vertex that does"
            " not exist, or does a binary file mix triangles with polygons?"
        ) from error
    return source.shape(vertices, faces)


def _check_ply_header(source: ShapeFile) -> None:
    """Raise an error if the header declares more data than the file holds, before memory is allocated."""
    head, mark, _ = source.data[:_MAX_HEADER_BYTES].partition(b"end_header")
    lines = head.decode("ascii", errors="replace").splitlines()
    if not mark or not head.startswith(b"ply"):
        raise source.fault("not a PLY file: it must start with ply and have an end_header line")
    body = source.data[len(head) + len(mark) :]
    is_text = any(line.split()[:2] == ["format", "ascii"] for line in lines)
    counts, sizes = _ply_elements(source, lines)
    if not {"vertex", "face"} <= counts.keys():
        raise source.fault("a PLY shape needs the elements vertex and face")
    if is_text:
        promised, held, what = sum(counts.values()), sum(1 for line in body.splitlines() if line.strip()), "lines"
    else:
        promised, held, what = sum(counts[name] * sizes[name] for name in counts), len(body), "bytes"
    if promised > held:
        raise source.fault(f"the header promises at least {promised} {what} of data, the file holds {held}: it is cut")


def _ply_elements(source: ShapeFile, lines: list[str]) -> tuple[dict[str, int], dict[str, int]]:
    """Return the number of records and the minimum size of a binary record in bytes, by element."""
    counts: dict[str, int] = {}
    sizes: dict[str, int] = {}
    element = ""
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if words[:1] == ["element"]:
            if len(words) != 3 or not (words[2].isascii() and words[2].isdigit() and len(words[2]) < 16):
                raise source.fault(f"{line[:60]!r} is not 'element name count'", number)
            element = words[1]
            counts[element], sizes[element] = int(words[2]), 0
        elif words[:1] == ["property"]:
            types = words[2:4] if words[1:2] == ["list"] else words[1:2]
            if element not in sizes or not types or any(name not in _PLY_BYTES for name in types):
                raise source.fault(f"{line[:60]!r} is not a property of a PLY element", number)
            # A list of a face has three indices at least, other lists may be empty.
            least_entries = 3 if element == "face" else 0
            sizes[element] += _PLY_BYTES[types[0]] + sum(least_entries * _PLY_BYTES[name] for name in types[1:])
    return counts, sizes
