"""The landmark data base, its building from images of known pose (section 2) and its open file format (section 2.5).

The campaign draws the views, renders the images and passes ``deproject``: no renderer is needed here.

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import NoProductError
from boresight.estimators.landmark.clustering import ClusterOptions, ClusterStages, PointCluster, cluster_stages
from boresight.estimators.landmark.corners import CornerOptions, detect_corners
from boresight.estimators.landmark.hull import concave_hull
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.camera import LinesOfSight, triangulation_equations
from boresight.scenarios.reading import LARGEST_NUMBER, number_in, read_json
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.camera import CameraSpec

FORMAT = "boresight-landmarks"
FORMAT_VERSION = 1
_MEAN = ["x_m", "y_m", "z_m"]
_COVARIANCE = ["sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2"]
_UPPER = np.triu_indices(3)
_COUNT = "n_observations"
_FACET = ["i", "j", "k"]

METHOD = "rowell2015-{detector}"
METHOD_VERSION = 1

_HELD = 1e-6


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

    def save(self, folder: Path) -> None:
        """Write the three files into ``folder``, which is made if absent."""
        folder.mkdir(parents=True, exist_ok=True)
        columns = np.column_stack([self.means_m, self.covariances_m2[:, _UPPER[0], _UPPER[1]]])
        landmarks = pd.DataFrame(columns, columns=_MEAN + _COVARIANCE).assign(**{_COUNT: self.n_observations})
        landmarks.to_csv(folder / "landmarks.csv", index=False, float_format="%.17g")
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


def _read_table(path: Path, columns: list[str]) -> FloatArray:
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise BoresightError(f"{path}: cannot be read as a table: {one_line(error)}") from error
    if list(table.columns) != columns:
        raise BoresightError(f"{path}: the columns must be {columns}, not {[str(name) for name in table.columns]}")
    numbers = np.array([[number_in(text) for text in row] for row in table.to_numpy()]).reshape(-1, len(columns))
    bad = np.argwhere(~(np.abs(numbers) <= LARGEST_NUMBER))
    if len(bad):
        row, column = bad[0]
        raise BoresightError(
            f"{path}:{row + 2}: {columns[column]} is no finite number, or far too large: {table.iloc[row, column]!r}"
        )
    return numbers


class CandidateOptions(SpecModel):
    """Options of the images and of the candidate landmarks in them."""

    images: int = Field(500, ge=1, le=100_000, description="Images rendered")
    range_m: float | None = Field(None, gt=0, description="Range of these images; left out: that of the scenario")
    camera: CameraSpec | None = Field(None, description="Camera of these images; left out: that of the scenario")
    phase_deg_max: float = Field(60.0, gt=0, le=180, description="Largest phase angle of those images")
    seed: int = Field(0, ge=0, description="Seed of their views")
    corners: CornerOptions = CornerOptions()


class DatabaseOptions(CandidateOptions):
    """Options of a landmark data base."""

    clusters: ClusterOptions = ClusterOptions()
    min_observations: int = Field(24, ge=2, description="A landmark must be seen in at least this many images")
    position: Literal["mean", "rays"] = Field(
        "mean",
        description="A landmark lies at the mean of its corners on the surface, as in the paper, or where the rays to"
        " them meet best",
    )


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkDatabaseBuild:
    """A data base with the candidates (N, 3) of all images, body frame, and their clusters after each stage."""

    points_m: FloatArray
    clusters: ClusterStages
    database: LandmarkDatabase


def extract_candidates(
    image: NDArray[np.float32], deproject: Callable[[FloatArray], FloatArray], options: CandidateOptions
) -> FloatArray:
    """Return the candidate landmarks of one image: its corners, projected onto the surface (section 2.2).

    ``image`` (H, W) has no noise. ``deproject`` maps pixels (M, 2) to points of the surface (M, 3) in the body frame,
    m; NaN where a pixel is on the sky. The candidates (C, 3) are in the body frame, m, without corners on the sky.
    """
    corners = detect_corners(image, options.corners)
    if not len(corners):
        return np.empty((0, 3))
    points_m = np.asarray(deproject(corners.uv_px), dtype=np.float64)
    return points_m[np.isfinite(points_m).all(axis=1)]


def database_from_candidates(
    candidates: Sequence[FloatArray], cameras_m: FloatArray, options: DatabaseOptions
) -> LandmarkDatabase:
    """Return the data base of `build_database` without the intermediate results."""
    return build_database(candidates, cameras_m, options).database


def build_database(
    candidates: Sequence[FloatArray], cameras_m: FloatArray, options: DatabaseOptions
) -> LandmarkDatabaseBuild:
    """Cluster the candidates of all images and construct the mesh (sections 2.3 and 2.4).

    An image counts once for a landmark, however many of its corners are in the cluster. Clusters seen in fewer than
    ``min_observations`` images are removed before merging: by the trace criterion a large cluster absorbs any small one
    within reach, so that stray points would inflate the dispersion of good landmarks.

    ``candidates`` are the points (C, 3) of each image and ``cameras_m`` (I, 3) where the images were taken from, body
    frame, m. Raise NoProductError if there are fewer than four landmarks, or they lie in one plane.
    """
    points_m = np.concatenate([np.empty((0, 3)), *candidates])
    image_of = np.repeat(np.arange(len(candidates)), [len(points) for points in candidates])

    def seen_enough(cluster: PointCluster) -> bool:
        return len(np.unique(image_of[cluster.members])) >= options.min_observations

    stages = cluster_stages(points_m, options.clusters, keep=seen_enough)
    clusters = stages.refined
    if len(clusters) < 4:
        raise NoProductError(
            f"{len(clusters)} landmarks came out of {len(points_m)} corners in {len(candidates)} images; at least 4 are"
            f" needed: raise the options images ({options.images}) or clusters.seed_radius_m"
            f" ({options.clusters.seed_radius_m:g}) of the data base, or lower min_observations"
            f" ({options.min_observations})"
        )
    means_m = np.stack([cluster.mean_m for cluster in clusters])
    if options.position == "rays":
        means_m = _where_rays_meet(clusters, points_m, cameras_m[image_of], means_m)
    try:
        hull = concave_hull(means_m)
    except BoresightError as error:
        raise NoProductError(str(error)) from error
    # A landmark that is not on the mesh could not be tested for visibility: it is dropped.
    kept = [clusters[index] for index in hull.kept]
    database = LandmarkDatabase(
        means_m[hull.kept],
        np.stack([cluster.covariance_m2 for cluster in kept]),
        np.array([len(np.unique(image_of[cluster.members])) for cluster in kept]),
        hull.facets.astype(np.int32),
        {
            "method": METHOD.format(detector=options.corners.detector),
            "method_version": METHOD_VERSION,
            "options": options.model_dump(mode="json"),
            "images": len(candidates),
            "candidates": len(points_m),
            "dropped_by_mesh": len(hull.dropped),
        },
    )
    return LandmarkDatabaseBuild(points_m, stages, database)


def _where_rays_meet(
    clusters: Sequence[PointCluster], points_m: FloatArray, cameras_m: FloatArray, means_m: FloatArray
) -> FloatArray:
    """Return the points (L, 3) nearest to the rays of each cluster, see `triangulation_equations`.

    A ray ends at the first surface that it meets, before the ground behind a boulder or a rim. So the points of a
    cluster, and their mean, lie above the place that the corners have in common: in an oblique view the mean is further
    out than the corner. The place where rays meet does not depend on where they end.
    """
    row = np.repeat(np.arange(len(clusters)), [len(cluster.members) for cluster in clusters])
    members = np.concatenate([cluster.members for cluster in clusters])
    rays = points_m[members] - cameras_m[members]
    lines = LinesOfSight(cameras_m[members], rays / np.linalg.norm(rays, axis=1, keepdims=True))
    # The mean holds the point where all rays are parallel, and has no weight elsewhere.
    held = np.repeat(_HELD * np.eye(3)[None], len(clusters), axis=0)
    matrix, right = triangulation_equations(lines, row, (held, _HELD * means_m))
    return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])
