"""Build a landmark data base from images of known pose: section 2, in two steps without side effects.

The campaign draws the views, renders the images and passes ``deproject``; this module needs no renderer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import NoProductError
from boresight.estimators.landmark.clustering import ClusterOptions, ClusterStages, PointCluster, cluster_stages
from boresight.estimators.landmark.corners import CornerOptions, detect_corners
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.hull import concave_hull
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.camera import CameraSpec

METHOD = "rowell2015-{detector}"
METHOD_VERSION = 1


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


def database_from_candidates(candidates: Sequence[FloatArray], options: DatabaseOptions) -> LandmarkDatabase:
    """Return the data base of `build_database` without the intermediate results."""
    return build_database(candidates, options).database


def build_database(candidates: Sequence[FloatArray], options: DatabaseOptions) -> LandmarkDatabaseBuild:
    """Cluster the candidates of all images and construct the mesh (sections 2.3 and 2.4).

    An image counts once for a landmark, however many of its corners are in the cluster. Clusters seen in fewer than
    ``min_observations`` images are removed before merging: by the trace criterion a large cluster absorbs any small one
    within reach, so that stray points would inflate the dispersion of good landmarks.

    ``candidates`` are the points (C, 3) of each image, body frame, m. Raise NoProductError if there are fewer than four
    landmarks, or they lie in one plane.
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
    try:
        hull = concave_hull(np.stack([cluster.mean_m for cluster in clusters]))
    except BoresightError as error:
        raise NoProductError(str(error)) from error
    # A landmark that is not on the mesh could not be tested for visibility: it is dropped.
    kept = [clusters[index] for index in hull.kept]
    database = LandmarkDatabase(
        np.stack([cluster.mean_m for cluster in kept]),
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
