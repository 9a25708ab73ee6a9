"""Digital shape kernels (DSK), written by SPICE itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import spiceypy

LATITUDINAL = 1


def write_dsk(path: Path, vertices_km: np.ndarray, faces: np.ndarray, segments: int = 1) -> Path:
    """Write a DSK of so many equal segments of type 2."""
    corners, plates = np.asarray(vertices_km, dtype=float), np.asarray(faces) + 1
    handle = spiceypy.dskopn(str(path), "test", 0)
    floats, integers = spiceypy.dskmi2(corners, plates, 1.0, 2, 10000, 10000, 100000, False, 250000)
    low, high = spiceypy.dskrb2(corners, plates, LATITUDINAL, np.zeros(10))
    bounds: Sequence[float] = (-np.pi, np.pi, -np.pi / 2, np.pi / 2, low, high)
    for surface in range(1, segments + 1):
        spiceypy.dskw02(
            handle, 401, surface, 2, "IAU_PHOBOS", LATITUDINAL, np.zeros(10), *bounds, -1e9, 1e9, corners, plates,
            floats, integers,
        )  # fmt: skip
    spiceypy.dskcls(handle, False)
    return path
