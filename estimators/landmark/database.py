"""The landmark data base and its open file format (section 2.5).

A data base is a folder of three text files.

``landmarks.csv``
    A header and one line a landmark, in the order of its index: ``x_m, y_m, z_m`` (mean, body frame), ``sxx_m2, sxy_m2,
    sxz_m2, syy_m2, syz_m2, szz_m2`` (covariance, symmetric) and ``n_observations`` (images that saw it).
``facets.csv``
    A header ``i, j, k`` and one line a facet: indices of landmarks, counter-clockwise seen from outside, so that
    (L1 - L0) x (L2 - L0) points outward, equation (1).
``database.json``
    ``format`` ("boresight-landmarks"), ``version`` (1) and ``provenance``: how the data base was made.

Numbers are written with 17 digits, so that a data base is read back bit for bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.limits import LARGEST_NUMBER
from boresight.scenarios.reading import read_json

FORMAT = "boresight-landmarks"
FORMAT_VERSION = 1
_MEAN = ["x_m", "y_m", "z_m"]
_COVARIANCE = ["sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2"]
_UPPER = np.triu_indices(3)
_COUNT = "n_observations"
_FACET = ["i", "j", "k"]


@dataclass(frozen=True, eq=False)
class LandmarkDatabase:
    """Landmarks and the mesh over them.

    ``means_m`` (N, 3) are positions and ``covariances_m2`` (N, 3, 3) positive definite covariances in the body frame,
    and ``n_observations`` (N,) is the number of images in which each landmark was seen. ``facets`` (F, 3) are a closed
    mesh over the landmarks, outward. ``provenance`` has origin and options, as JSON values. Raises BoresightError if
    shapes disagree, a number is not finite, a covariance is not positive definite or the mesh is not closed.
    """

    means_m: FloatArray
    covariances_m2: FloatArray
    n_observations: NDArray[np.int64]
    facets: NDArray[np.int32]
    provenance: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, dtype in (("means_m", float), ("covariances_m2", float), ("n_observations", np.int64)):
            self._freeze(name, np.array(getattr(self, name), dtype=dtype))
        self._freeze("facets", np.array(self.facets, dtype=np.int32).reshape(-1, 3))
        n = len(self.means_m)
        shapes = (self.means_m.shape, self.covariances_m2.shape, self.n_observations.shape)
        if shapes != ((n, 3), (n, 3, 3), (n,)):
            raise BoresightError(f"landmarks need (N, 3) means, (N, 3, 3) covariances and (N,) counts, not {shapes}")
        _check_numbers(self.means_m, self.covariances_m2)
        _check_facets(self.facets, n)

    def _freeze(self, name: str, value: NDArray[np.generic]) -> None:
        value.setflags(write=False)
        object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.means_m)

    def mesh(self) -> TriangleMesh:
        """Return the mesh over the landmarks."""
        return TriangleMesh(self.means_m, self.facets)

    def landmarks_frame(self) -> pd.DataFrame:
        """One row a landmark, with the columns of ``landmarks.csv``."""
        columns = np.column_stack([self.means_m, self.covariances_m2[:, _UPPER[0], _UPPER[1]]])
        return pd.DataFrame(columns, columns=_MEAN + _COVARIANCE).assign(**{_COUNT: self.n_observations})

    def save(self, folder: Path) -> None:
        """Write the three files into ``folder``, which is made if absent."""
        folder.mkdir(parents=True, exist_ok=True)
        self.landmarks_frame().to_csv(folder / "landmarks.csv", index=False, float_format="%.17g")
        pd.DataFrame(self.facets, columns=_FACET).to_csv(folder / "facets.csv", index=False)
        head = {"format": FORMAT, "version": FORMAT_VERSION, "provenance": dict(self.provenance)}
        (folder / "database.json").write_text(json.dumps(head, indent=2) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> LandmarkDatabase:
        """Read a folder written by ``save`` or by other software in the same format.

        Raise BoresightError if a file is missing or its content is wrong; the message gives the path.
        """
        provenance = _read_head(folder / "database.json")
        landmarks = _read_table(folder / "landmarks.csv", [*_MEAN, *_COVARIANCE, _COUNT])
        facets = _read_table(folder / "facets.csv", _FACET)
        covariances = np.empty((len(landmarks), 3, 3))
        covariances[:, _UPPER[0], _UPPER[1]] = landmarks[:, 3:9]
        covariances[:, _UPPER[1], _UPPER[0]] = landmarks[:, 3:9]
        try:
            _check_whole(landmarks[:, 9], _COUNT)
            _check_whole(facets.ravel(), "facets")
            return cls(
                landmarks[:, :3], covariances, landmarks[:, 9].astype(np.int64), facets.astype(np.int32), provenance
            )
        except BoresightError as error:
            raise BoresightError(f"{folder}: {error}; build the data base again") from error


def _check_numbers(means_m: FloatArray, covariances_m2: FloatArray) -> None:
    if not (np.isfinite(means_m).all() and np.isfinite(covariances_m2).all()):
        raise BoresightError("a landmark holds a number that is NaN or infinite")
    if not len(covariances_m2):
        return
    symmetric = np.allclose(covariances_m2, np.swapaxes(covariances_m2, 1, 2), rtol=1e-9, atol=0.0)
    smallest = np.linalg.eigvalsh(covariances_m2)[:, 0]
    if not symmetric or smallest.min() <= 0.0:
        raise BoresightError(f"the covariance of landmark {int(smallest.argmin())} is not positive definite")


def _check_facets(facets: NDArray[np.int32], n_landmarks: int) -> None:
    if facets.size and (facets.min() < 0 or facets.max() >= n_landmarks):
        worst = facets.min() if facets.min() < 0 else facets.max()
        raise BoresightError(f"a facet names landmark {int(worst)}, but there are {n_landmarks}")
    # In a closed, consistently oriented mesh each directed edge occurs once, and so does its reverse.
    directed = np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]])
    key = directed[:, 0].astype(np.int64) * n_landmarks + directed[:, 1]
    reverse = directed[:, 1].astype(np.int64) * n_landmarks + directed[:, 0]
    if not facets.size or len(np.unique(key)) != len(key) or not np.array_equal(np.sort(key), np.sort(reverse)):
        raise BoresightError("the facets are no closed surface: an edge is not shared by two facets, once each way")


def _check_whole(values: FloatArray, name: str) -> None:
    if not np.array_equal(values, np.round(values)) or np.abs(values).max(initial=0.0) >= 2**31:
        raise BoresightError(f"{name} must be whole numbers")


def _read_head(path: Path) -> Mapping[str, object]:
    try:
        head = read_json(path, "the head of a landmark data base")
    except FileNotFoundError as error:
        raise BoresightError(f"{path}: cannot be read as the head of a landmark data base: {error}") from error
    if not isinstance(head, dict) or head.get("format") != FORMAT or head.get("version") != FORMAT_VERSION:
        raise BoresightError(f"{path}: is not format {FORMAT!r} version {FORMAT_VERSION}; build the data base again")
    provenance = head.get("provenance", {})
    if not isinstance(provenance, dict):
        raise BoresightError(f"{path}: provenance must be a mapping, not {provenance!r}")
    return provenance


def _number(text: object) -> float:
    """Parse a number; NaN if the text is none."""
    try:
        return float(str(text))
    except ValueError:
        return float("nan")


def _read_table(path: Path, columns: list[str]) -> FloatArray:
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise BoresightError(f"{path}: cannot be read as a table: {one_line(error)}") from error
    if list(table.columns) != columns:
        raise BoresightError(f"{path}: the columns must be {columns}, not {[str(name) for name in table.columns]}")
    numbers = np.array([[_number(text) for text in row] for row in table.to_numpy()]).reshape(-1, len(columns))
    bad = np.argwhere(~(np.abs(numbers) <= LARGEST_NUMBER))
    if len(bad):
        row, column = bad[0]
        raise BoresightError(
            f"{path}:{row + 2}: {columns[column]} is no finite number, or far too large: {table.iloc[row, column]!r}"
        )
    return numbers
