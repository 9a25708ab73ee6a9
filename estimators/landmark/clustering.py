"""Cluster candidate points into landmarks: the two-stage clustering of section 2.3."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.spec.base import SpecModel, length

IndexArray = NDArray[np.intp]

_MIN_DISPERSION_POINTS = 4


class ClusterOptions(SpecModel):
    """Sizes and thresholds of the clustering."""

    seed_radius_m: float = length(2.0, "Radius of a seed cluster about its centroid", px=1.6, gt=0)
    growth_sigma: float = Field(3.0, ge=0, description="Dispersion-weighted distance up to which a cluster grows")
    merge_sigma: float = Field(9.0, ge=0, description="Distance, weighted by both covariances, at which two compete")
    sigma_floor_m: float = length(0.1, "Added to each axis of a dispersion, as clusters may be planar", px=0.08, gt=0)


@dataclass(frozen=True, slots=True, eq=False)
class PointCluster:
    """A cluster of candidate points, all of one surface feature.

    ``members`` (M,) are ascending rows of the cloud, ``mean_m`` (3,) is the centroid, and ``covariance_m2`` (3, 3) the
    dispersion tensor.
    """

    members: IndexArray
    mean_m: FloatArray
    covariance_m2: FloatArray

    @classmethod
    def of(cls, points_m: FloatArray, members: IndexArray, sigma_floor_m: float) -> PointCluster:
        """Construct the cluster of some rows of the cloud; ``sigma_floor_m`` adds to each axis of its dispersion."""
        ordered = np.sort(members)
        chosen = points_m[ordered]
        mean = chosen.mean(axis=0)
        centred = chosen - mean
        # Points on a plane have a singular dispersion: the floor keeps it invertible and bounds the weight of a
        # landmark.
        covariance = centred.T @ centred / max(len(ordered) - 1, 1) + sigma_floor_m**2 * np.eye(3)
        return cls(ordered, mean, covariance)

    @property
    def trace_m2(self) -> float:
        """Trace of the dispersion, which does not depend on orientation."""
        return float(np.trace(self.covariance_m2))


def seed_clusters(points_m: FloatArray, radius_m: float) -> list[IndexArray]:
    """Partition the cloud into balls about moving centroids; return the rows of each seed cluster.

    Each point without a cluster starts one with all such points within the radius. The centroid is updated and further
    points within the radius are added, until there are none.
    """
    tree = cKDTree(points_m)
    free = np.ones(len(points_m), dtype=bool)
    clusters = []
    for start in range(len(points_m)):
        if not free[start]:
            continue
        members = np.array([start], dtype=np.intp)
        centroid = points_m[start]
        while True:
            near = np.asarray(tree.query_ball_point(centroid, radius_m, return_sorted=True), dtype=np.intp)
            # Earlier members stay, even where the centroid has moved away from them.
            grown = np.union1d(members, near[free[near]])
            if len(grown) == len(members):
                break
            members = grown
            centroid = points_m[members].mean(axis=0)
        free[members] = False
        clusters.append(members)
    return clusters


def grow_clusters(points_m: FloatArray, seeds: list[IndexArray], options: ClusterOptions) -> list[PointCluster]:
    """Add free points to each seed by their distance weighted with its dispersion, until none is within reach.

    The free points are those of seeds with fewer than four points, which define no dispersion and are dissolved. The
    most populated cluster grows first.
    """
    tree = cKDTree(points_m)
    # Four points span a volume: with fewer the dispersion is singular but for its floor.
    dense = [seed for seed in seeds if len(seed) >= _MIN_DISPERSION_POINTS]
    free = np.ones(len(points_m), dtype=bool)
    for seed in dense:
        free[seed] = False
    clusters = []
    # The most populated cluster chooses first among the free points.
    for seed in sorted(dense, key=len, reverse=True):
        cluster = PointCluster.of(points_m, seed, options.sigma_floor_m)
        while (added := _within_reach(points_m, tree, free, cluster, options.growth_sigma)).size:
            free[added] = False
            cluster = PointCluster.of(points_m, np.concatenate([cluster.members, added]), options.sigma_floor_m)
        clusters.append(cluster)
    return clusters


def _within_reach(
    points_m: FloatArray, tree: cKDTree, free: NDArray[np.bool_], cluster: PointCluster, sigma: float
) -> IndexArray:
    # The largest axis of the dispersion bounds the weighted distance, so the tree finds all points that can qualify.
    reach_m = sigma * float(np.sqrt(np.linalg.eigvalsh(cluster.covariance_m2)[-1]))
    near = np.asarray(tree.query_ball_point(cluster.mean_m, reach_m, return_sorted=True), dtype=np.intp)
    near = near[free[near]]
    d2 = _squared_distance(points_m[near] - cluster.mean_m, cluster.covariance_m2)
    return near[d2 < sigma**2]


def _squared_distance(offsets_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
    weighted = np.linalg.solve(covariance_m2, offsets_m[..., None])[..., 0]
    d2: FloatArray = np.einsum("...i,...i->...", offsets_m, weighted)
    return d2


def refine_clusters(points_m: FloatArray, clusters: list[PointCluster], options: ClusterOptions) -> list[PointCluster]:
    """Merge or prune clusters that lie within ``merge_sigma`` of each other, until there are none.

    Two clusters are merged if the sum of the traces of their dispersions exceeds the trace of the merged cluster;
    otherwise the less populated one is removed. The most populated cluster is treated first, with its neighbours in
    order of distance.
    """
    while True:
        refined = _refine_once(points_m, clusters, options)
        if len(refined) == len(clusters):
            return refined
        clusters = refined


def _refine_once(points_m: FloatArray, clusters: list[PointCluster], options: ClusterOptions) -> list[PointCluster]:
    if len(clusters) < 2:
        return list(clusters)
    ordered = sorted(clusters, key=lambda cluster: (-len(cluster.members), int(cluster.members[0])))
    waiting = _ClusterIndex(ordered)
    kept = []
    for index, first in enumerate(ordered):
        if not waiting.remaining[index]:
            continue
        waiting.remaining[index] = False
        cluster = first
        # After a merger the mean and dispersion are new, and with them the distances to the remaining clusters.
        while (neighbour := waiting.nearest(cluster, options.merge_sigma)) is not None:
            waiting.remaining[neighbour] = False
            members = np.concatenate([cluster.members, ordered[neighbour].members])
            # Section 2.3: merged if one cluster is tighter than two; else the less populated one, always the neighbour,
            # is dropped.
            merged = PointCluster.of(points_m, members, options.sigma_floor_m)
            if cluster.trace_m2 + ordered[neighbour].trace_m2 > merged.trace_m2:
                cluster = merged
        kept.append(cluster)
    return kept


class _ClusterIndex:
    """Clusters that are not treated yet (``remaining``), searchable by distance."""

    def __init__(self, clusters: list[PointCluster]) -> None:
        self.remaining = np.ones(len(clusters), dtype=bool)
        self._means = np.stack([cluster.mean_m for cluster in clusters])
        self._covariances = np.stack([cluster.covariance_m2 for cluster in clusters])
        self._largest_variance = float(np.linalg.eigvalsh(self._covariances)[:, -1].max())
        self._tree = cKDTree(self._means)

    def nearest(self, cluster: PointCluster, sigma: float) -> int | None:
        """Index of the remaining cluster at the least distance weighted by both covariances, if below ``sigma``."""
        # The largest eigenvalue of a sum is at most the sum of both largest: no neighbour within reach is missed.
        largest = float(np.linalg.eigvalsh(cluster.covariance_m2)[-1]) + self._largest_variance
        reach_m = sigma * float(np.sqrt(largest))
        near = np.asarray(self._tree.query_ball_point(cluster.mean_m, reach_m, return_sorted=True), dtype=np.intp)
        near = near[self.remaining[near]]
        if not near.size:
            return None
        # Section 2.3: the covariance on both cluster positions is considered.
        d2 = _squared_distance(self._means[near] - cluster.mean_m, self._covariances[near] + cluster.covariance_m2)
        nearest = int(np.argmin(d2))
        return int(near[nearest]) if d2[nearest] < sigma**2 else None


@dataclass(frozen=True, slots=True, eq=False)
class ClusterStages:
    """Clusters of a cloud after growth, those of them that enter the refinement, and those after merging and pruning.

    The last ones are sorted by the first member.
    """

    grown: list[PointCluster]
    kept: list[PointCluster]
    refined: list[PointCluster]


def cluster_stages(
    points_m: FloatArray, options: ClusterOptions, keep: Callable[[PointCluster], bool]
) -> ClusterStages:
    """Cluster (N, 3) candidate points by seeding, growth and refinement.

    Only clusters for which ``keep`` is true after growth enter the refinement.
    """
    if not len(points_m):
        return ClusterStages([], [], [])
    grown = grow_clusters(points_m, seed_clusters(points_m, options.seed_radius_m), options)
    kept = [cluster for cluster in grown if keep(cluster)]
    refined = refine_clusters(points_m, kept, options)
    return ClusterStages(grown, kept, sorted(refined, key=lambda cluster: int(cluster.members[0])))
