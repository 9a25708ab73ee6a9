"""Shape readers: convert a file to vertices and faces, or raise an error that names file and line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from boresight.scenarios.bodies.readers.dsk import DSK_HEAD, read_dsk
from boresight.scenarios.bodies.readers.meshfile import read_obj, read_ply
from boresight.scenarios.bodies.readers.pds import read_grid, read_icq, read_plates
from boresight.scenarios.bodies.readers.source import RawShape, ShapeFile

__all__ = ["READERS", "READER_VERSION", "RawShape", "ShapeFile", "detect_format", "read_shape"]

READER_VERSION = 1
"""Part of the digest of every body: increase it when the same file gives another mesh."""

READERS: Mapping[str, Callable[[ShapeFile], RawShape]] = MappingProxyType(
    {
        "obj": read_obj,
        "ply": read_ply,
        "pds-plates": read_plates,
        "pds-grid": lambda source: read_grid(source, west=False),
        "pds-grid-west": lambda source: read_grid(source, west=True),
        "icq": read_icq,
        "dsk": read_dsk,
    }
)
_SNIFFED_BYTES = 4096


def read_shape(path: Path, file_format: str = "auto", *, west_longitudes: bool = False) -> RawShape:
    """Read a shape file; coordinates keep the unit of the file.

    ``file_format`` is a key of `READERS` or ``auto``, which detects it; with ``west_longitudes`` those of a
    ``pds-grid`` grow westward. Raise BoresightError if the file is missing or is not a shape of that format, and for
    ``west_longitudes`` of a format without longitudes.
    """
    source = ShapeFile.open(path)
    name = detect_format(source) if file_format == "auto" else file_format
    if west_longitudes:
        if name != "pds-grid":
            raise source.fault(f"body.longitude: west has no meaning for a file of format {name}; remove it")
        name = "pds-grid-west"
    return READERS[name](source)


def detect_format(source: ShapeFile) -> str:
    """Detect the format by the first bytes and, for OBJ and ICQ, by the suffix."""
    head = source.data[:_SNIFFED_BYTES]
    suffix = source.path.suffix.lower()
    if head.startswith(b"ply"):
        return "ply"
    if head.startswith(DSK_HEAD) or suffix == ".bds":
        return "dsk"
    if suffix in (".obj", ".icq", ".ply"):
        return suffix[1:]
    rows = [line.split() for line in head.splitlines() if line.strip() and not line.startswith(b"#")]
    widths = [len(row) for row in rows[:2]]
    if rows and rows[0][0] == b"v":
        return "pds-plates"
    # Numbers on the first two lines: Q or a count, then a vertex without or with its number; or two rows of a grid.
    by_widths = {(1, 3): "icq", (1, 4): "pds-plates", (3, 3): "pds-grid"}
    if tuple(widths) not in by_widths:
        raise source.fault(
            "cannot tell the format of this shape; set body.format to one of obj, ply, pds-plates, pds-grid, icq, dsk"
        )
    return by_widths[widths[0], widths[1]]
