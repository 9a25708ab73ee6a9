"""The data base of maplets, patches of heights and albedo on local planes, and its file format."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from boresight.estimators.archive import Archive
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.reading import LARGEST_NUMBER

FILE = "maplets.npz"

_ARCHIVE = Archive(FILE, "maplets", "boresight-maplets", version=1)
_LEAST_STEP_M = 0.01
_NOTHING = np.iinfo(np.int16).min
_MOST_STEPS = np.iinfo(np.int16).max
_ALBEDO_STEPS = np.iinfo(np.uint16).max
_OVERLAP = 3.0  # steps of the grid by which maplets overlap in the common mesh
_SAME_SURFACE = 1.5  # largest height, in steps of the grid, of a point that counts as on a maplet


@dataclass(frozen=True, eq=False)
class MapletDatabase:
    """N maplets of S x S nodes each.

    ``centres_m`` (N, 3) are the middles of the reference planes, body frame: on or near the surface. The rows of
    ``axes`` (N, 3, 3) are the unit vectors along columns and rows and the upward normal, right-handed, body frame.
    ``heights_m`` (N, S, S) are above the planes, NaN where the surface is not seen from above, at nodes ``spacing_m``
    apart. ``albedo`` (N, S, S) is a factor on the reflectance, or None for 1 everywhere. ``provenance`` has origin and
    options, as JSON values. Raises BoresightError if shapes disagree, S is even, the middle of a maplet has no height
    or axes are not right-handed and orthonormal.
    """

    centres_m: FloatArray
    axes: FloatArray
    heights_m: FloatArray
    spacing_m: float
    albedo: FloatArray | None = None
    provenance: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, side = len(self.centres_m), self.heights_m.shape[-1]
        shapes = (self.centres_m.shape, self.axes.shape, self.heights_m.shape)
        if shapes != ((n, 3), (n, 3, 3), (n, side, side)) or n == 0 or side < 3 or side % 2 == 0:
            raise BoresightError(f"maplets need (N, 3) centres, (N, 3, 3) axes and (N, S, S) heights, not {shapes}")
        if self.albedo is not None and self.albedo.shape != self.heights_m.shape:
            raise BoresightError(f"maplets with heights {self.heights_m.shape} cannot have albedo {self.albedo.shape}")
        rotation_error = np.abs(self.axes @ np.swapaxes(self.axes, 1, 2) - np.eye(3)).max()
        if not (rotation_error < 1e-6 and (np.linalg.det(self.axes) > 0.0).all()):
            raise BoresightError("the axes of a maplet are not right-handed and orthonormal")
        if not 0.0 < self.spacing_m <= LARGEST_NUMBER:
            raise BoresightError(f"the nodes of maplets cannot be {self.spacing_m} m apart")
        if not (
            (np.abs(self.centres_m) <= LARGEST_NUMBER).all()
            and np.isfinite(self.heights_m[:, side // 2, side // 2]).all()
        ):
            raise BoresightError("a maplet has no surface at its centre")

    def __len__(self) -> int:
        return len(self.centres_m)

    @property
    def side(self) -> int:
        """Number of nodes along each side, S."""
        return int(self.heights_m.shape[-1])

    @property
    def half_m(self) -> float:
        """Distance from the centre of a maplet to its edge, m."""
        return 0.5 * (self.side - 1) * self.spacing_m

    @property
    def anchors_m(self) -> FloatArray:
        """(N, 3) surface points at the middle of each maplet, body frame."""
        middle = self.heights_m[:, self.side // 2, self.side // 2]
        return self.centres_m + middle[:, None] * self.axes[:, 2]

    @property
    def nodes_m(self) -> FloatArray:
        """(N, S, S, 3) all nodes in the body frame; NaN where there is no height."""
        steps = (np.arange(self.side) - self.side // 2) * self.spacing_m
        x, y = np.meshgrid(steps, steps)
        local = np.stack([np.broadcast_to(x, self.heights_m.shape), np.broadcast_to(y, self.heights_m.shape)], axis=-1)
        local = np.concatenate([local, self.heights_m[..., None]], axis=-1)
        nodes: FloatArray = np.einsum("nrck,nkj->nrcj", local, self.axes) + self.centres_m[:, None, None, :]
        return nodes

    def subset(self, indices: NDArray[np.intp]) -> MapletDatabase:
        """Keep some maplets, in the order of ``indices``."""
        albedo = None if self.albedo is None else self.albedo[indices]
        return replace(
            self,
            centres_m=self.centres_m[indices],
            axes=self.axes[indices],
            heights_m=self.heights_m[indices],
            albedo=albedo,
        )

    def contains(self, index: int, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return whether points (P, 3) lie on one maplet: above its grid without the rim, and at its height."""
        local = (points_m - self.centres_m[index]) @ self.axes[index].T
        inside = np.maximum(*np.abs(local[:, :2].T)) <= self.half_m - self.spacing_m
        grid = np.round(local[:, :2] / self.spacing_m).astype(np.int64) + self.side // 2
        column, row = np.where(inside[:, None], grid, 0).T
        off_m = np.abs(self.heights_m[index, row, column] - local[:, 2])
        found: NDArray[np.bool_] = inside & (off_m <= _SAME_SURFACE * self.spacing_m)
        return found

    def mesh(self) -> TriangleMesh:
        """Return one mesh over all maplets, which overlap by one or two steps of the grid.

        Where several maplets cover the same surface, the one with the nearest centre is used: layers of slightly
        different heights would cast shadows on each other.
        """
        nodes = self.nodes_m
        kept = self._own_nodes(nodes)
        # A square between four kept nodes gives two facets.
        quads = kept[:, :-1, :-1] & kept[:, :-1, 1:] & kept[:, 1:, :-1] & kept[:, 1:, 1:]
        number = np.arange(kept.size).reshape(kept.shape)
        near, far = slice(None, -1), slice(1, None)
        a, b, c, d = (number[:, row, column][quads] for row in (near, far) for column in (near, far))
        faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
        used, faces = np.unique(faces, return_inverse=True)
        albedo = None if self.albedo is None else self.albedo.reshape(-1)[used]
        return TriangleMesh(nodes.reshape(-1, 3)[used], faces.reshape(-1, 3).astype(np.int32), albedo)

    def _own_nodes(self, nodes_m: FloatArray) -> NDArray[np.bool_]:
        """Mask (N, S, S) of nodes that no maplet with a nearer centre covers, widened by the overlap."""
        kept = np.isfinite(self.heights_m)
        # Twice the distance from the centre of a cube to its corner: maplets farther apart have no point in common.
        reach_m = 2.0 * np.sqrt(3.0) * self.half_m
        pairs = cKDTree(self.centres_m).query_pairs(reach_m, output_type="ndarray")
        # Both ways: each of two neighbours gives up the nodes that are nearer to the other.
        for mine, other in np.concatenate([pairs, pairs[:, ::-1]]):
            row, column = np.nonzero(kept[mine])
            points = nodes_m[mine, row, column]
            own, others = (np.linalg.norm(points - self.centres_m[i], axis=1) for i in (mine, other))
            # Each maplet keeps half of the overlap beyond the plane midway between both centres.
            nearer = np.flatnonzero(others + _OVERLAP * self.spacing_m < own)
            lost = nearer[self.contains(int(other), points[nearer])]
            kept[mine, row[lost], column[lost]] = False
        return kept

    def save(self, folder: Path) -> None:
        """Write ``maplets.npz`` into ``folder``, which is made if absent.

        Heights are integer steps in 16 bits, see `height_step_m`; attitudes are quaternions (w, x, y, z); albedo is in
        16-bit fractions of its maximum.
        """
        step_m = height_step_m(float(np.nanmax(np.abs(self.heights_m))))
        steps = np.round(self.heights_m / step_m)
        arrays: dict[str, NDArray[np.generic]] = {
            "centres_m": self.centres_m,
            "quat_wxyz": Rotation.from_matrix(self.axes).as_quat(canonical=True, scalar_first=True),
            "heights": np.where(np.isfinite(steps), steps, _NOTHING).astype(np.int16),
        }
        head = {
            "spacing_m": self.spacing_m,
            "height_step_m": step_m,
            "provenance": dict(self.provenance),
        }
        if self.albedo is not None:
            head["albedo_max"] = greatest = float(np.nanmax(self.albedo))
            arrays["albedo"] = np.round(np.nan_to_num(self.albedo) / greatest * _ALBEDO_STEPS).astype(np.uint16)
        _ARCHIVE.save(folder, head, arrays)

    @classmethod
    def load(cls, folder: Path) -> MapletDatabase:
        """Read what ``save`` wrote.

        Raise BoresightError if the file is missing or its content is wrong; the message gives its path.
        """
        return _ARCHIVE.load(folder, cls._made)

    @classmethod
    def _made(cls, head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> MapletDatabase:
        stored = arrays["heights"]
        heights_m = np.where(stored == _NOTHING, np.nan, stored * float(head["height_step_m"]))
        albedo = arrays["albedo"] * (head["albedo_max"] / _ALBEDO_STEPS) if "albedo" in arrays else None
        axes = Rotation.from_quat(arrays["quat_wxyz"], scalar_first=True).as_matrix()
        return cls(arrays["centres_m"], axes, heights_m, float(head["spacing_m"]), albedo, head["provenance"])


def height_step_m(largest_m: float) -> float:
    """Return the step for storing heights up to ``largest_m`` in 16 bits: a centimetre, doubled until they fit."""
    return _LEAST_STEP_M * 2.0 ** math.ceil(math.log2(max(1.0, largest_m / (_MOST_STEPS * _LEAST_STEP_M))))
