"""Files of data sets that are derived from raw files: an ICQ from a PLY, and Apophis scaled."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from boresight.scenarios.bodies.readers import read_shape
from boresight.scenarios.errors import BoresightError

_APOPHIS_KM = 0.375
"""Volume-equivalent diameter of Apophis in Table 1 of Delpech et al. (2015)."""


def icq(raw: Path) -> bytes:
    """Write the vertices of a PLY, six faces of a cube of (Q + 1)**2 vertices each, as an ICQ of the same unit.

    Raise BoresightError if the file is no PLY or its vertices are not those of six such faces.
    """
    vertices = read_shape(raw, "ply").vertices
    side = round(np.sqrt(len(vertices) / 6.0))
    if 6 * side**2 != len(vertices):
        raise BoresightError(f"{raw}: {len(vertices)} vertices are not six grids of (Q + 1)**2: no ICQ")
    lines = [f"{side - 1}", *("".join(f"{x:10.5f}" for x in vertex) for vertex in vertices)]
    return ("\n".join(lines) + "\n").encode()


def apophis(raw: Path) -> bytes:
    """Scale an OBJ to a volume-equivalent diameter of 0.375 km, with the origin at the centre of volume.

    Raise BoresightError if the file is no OBJ or its faces enclose no volume.
    """
    vertices, faces = read_shape(raw, "obj")
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volumes = np.einsum("fi,fi->f", a, np.cross(b, c))  # six times those of the tetrahedra to the origin
    if not volumes.sum() > 0.0:
        raise BoresightError(f"{raw}: the faces enclose no volume, so it cannot be scaled")
    centre = np.einsum("f,fi->i", volumes, a + b + c) / (4.0 * volumes.sum())
    scale = _APOPHIS_KM / np.cbrt(volumes.sum() / np.pi)
    scaled = (vertices - centre) * scale
    head = (
        "# 99942 Apophis, light-curve inversion shape, km, scaled to a volume-equivalent diameter of"
        f" {_APOPHIS_KM:g} km\n"
    )
    points = "".join("v {:.7f} {:.7f} {:.7f}\n".format(*point) for point in scaled)
    return (head + points + "".join("f {} {} {}\n".format(*face) for face in faces + 1)).encode()


DERIVATIONS: Mapping[str, Callable[[Path], bytes]] = MappingProxyType({"icq": icq, "apophis": apophis})
