"""Tables of MATLAB files as the toolbox SONIC keeps them: camera poses, and tracks in normalised coordinates."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.errors import one_line
from boresight.scenarios.limits import MOST_FOLD, may_unfold

_HEADER_BYTES, _COMPRESSED = 128, 15  # of MATLAB's level-5 format
_FAULTS = (
    ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, NotImplementedError, OSError, RuntimeError,
    TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip


def read_matlab(path: Path) -> Mapping[str, NDArray[np.float64]]:
    """Read poses (``cam_positions``, ``cam_rots``) or tracks (``Tracks`` of ``viewIds`` and ``meas``) as a table.

    Poses: ``cam_positions``, (3, F) km, points from the camera to the body's origin, so that the camera is at minus it;
    ``cam_rots``, (3, 3, F), takes body to camera axes. The files have no epochs: ``time_s`` is the number of the view,
    from 0. Tracks: view numbers from 1 and coordinates x / z, y / z. Tracks of one sighting are left out, as the
    matcher that wrote them leaves what it did not find again. Raise ValueError if it is no such file.
    """
    # 0.1 s, which most commands do without.
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        _refuse_bombs(path)
        sizes = {name: int(np.prod(shape, dtype=np.float64)) for name, shape, _ in whosmat(path)}
        if max(sizes.values(), default=0) > MOST_FOLD * path.stat().st_size:
            raise ValueError("its variables are larger than the file can hold")
        content = loadmat(path, variable_names=["cam_positions", "cam_rots", "Tracks"])
        return _tracks(content["Tracks"]) if "Tracks" in content else _poses(content)
    except (*_FAULTS, MatReadError) as error:
        raise ValueError(f"not readable as a MATLAB file of poses or tracks: {one_line(error)}") from None


def _refuse_bombs(path: Path) -> None:
    """Raise ValueError if a variable expands to far more than the size of the file."""
    content = path.read_bytes()
    at = _HEADER_BYTES
    while at + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, at)
        if kind == _COMPRESSED:
            stream = zlib.decompressobj()
            most = max(1 << 28, MOST_FOLD * size)
            stream.decompress(content[at + 8 : at + 8 + size], most)
            if stream.unconsumed_tail and not may_unfold(size, most + 1):
                raise ValueError("it would expand to far more than its size")
        at += 8 + size


def _poses(content: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    towards_km, turns = np.asarray(content["cam_positions"]), np.moveaxis(content["cam_rots"], 2, 0)
    if towards_km.shape != (3, len(turns)) or turns.shape[1:] != (3, 3):
        raise ValueError(f"cam_positions {towards_km.shape} and cam_rots are not those of as many views")
    from scipy.spatial.transform import Rotation  # 0.1 s too

    quaternions = Rotation.from_matrix(turns).as_quat(scalar_first=True)
    columns = {"time_s": np.arange(len(turns), dtype=np.float64)}
    columns |= dict(zip(("x_km", "y_km", "z_km"), -towards_km, strict=True))
    return columns | dict(zip(("qw", "qx", "qy", "qz"), quaternions.T, strict=True))


def _tracks(tracks: NDArray[np.void]) -> dict[str, NDArray[np.float64]]:
    views = [np.asarray(one, dtype=np.float64).ravel() for one in tracks["viewIds"].ravel()]
    seen = [np.atleast_2d(np.asarray(one, dtype=np.float64)) for one in tracks["meas"].ravel()]
    several = [k for k in range(len(views)) if len(views[k]) > 1]
    if any(seen[k].shape != (len(views[k]), 2) for k in several):
        raise ValueError("a track has not a row of two meas for each of its viewIds")
    if not several:
        raise ValueError("no track has two sightings")
    places = np.concatenate([seen[k] for k in several])
    return {
        "track": np.repeat(np.array(several, dtype=np.float64), [len(views[k]) for k in several]),
        "frame": np.concatenate([views[k] for k in several]) - 1.0,
        "x_normalised": places[:, 0],
        "y_normalised": places[:, 1],
    }
