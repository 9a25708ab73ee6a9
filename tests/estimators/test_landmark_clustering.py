"""The two-stage clustering against planted clusters and a brute-force reference."""

import time

import numpy as np
import pytest

from boresight.estimators.landmark.clustering import (
    ClusterOptions,
    PointCluster,
    cluster_stages,
    grow_clusters,
    refine_clusters,
    seed_clusters,
)

OPTIONS = ClusterOptions()


def planted(n_clusters=40, members=40, strays=600, sigma=0.6, seed=11):
    """Clusters at least 25 m apart on a 300 m sphere, flattened along the normal, among strays."""
    rng = np.random.default_rng(seed)
    centres: list[np.ndarray] = []
    while len(centres) < n_clusters:
        centre = rng.normal(size=3)
        centre *= 300.0 / np.linalg.norm(centre)
        if all(np.linalg.norm(centre - other) > 25.0 for other in centres):
            centres.append(centre)
    centre = np.array(centres)
    offset = rng.normal(0.0, sigma, (n_clusters, members, 3))
    normal = centre / 300.0
    offset -= 0.8 * np.einsum("cmi,ci->cm", offset, normal)[:, :, None] * normal[:, None, :]
    stray = rng.normal(size=(strays, 3))
    stray *= 300.0 / np.linalg.norm(stray, axis=1, keepdims=True)
    points = np.concatenate([(centre[:, None] + offset).reshape(-1, 3), stray])
    return points[rng.permutation(len(points))], centre


def brute_force_seeds(points, radius):
    """The seed stage as the paper words it, without any search tree."""
    free = np.ones(len(points), dtype=bool)
    clusters = []
    for start in range(len(points)):
        if not free[start]:
            continue
        members = np.zeros(len(points), dtype=bool)
        members[start] = True
        while True:
            centroid = points[members].mean(axis=0)
            grown = members | (free & (np.linalg.norm(points - centroid, axis=1) <= radius))
            if (grown == members).all():
                break
            members = grown
        free &= ~members
        clusters.append(np.flatnonzero(members))
    return clusters


def enough(cluster):
    return len(cluster.members) >= 24


def test_planted_clusters_are_recovered():
    points, centres = planted()
    clusters = cluster_stages(points, OPTIONS, enough).refined
    assert len(clusters) == len(centres)
    means = np.stack([cluster.mean_m for cluster in clusters])
    gap = np.linalg.norm(means[:, None] - centres[None], axis=2)
    assert sorted(gap.argmin(axis=1)) == list(range(len(centres)))
    assert gap.min(axis=1).max() < 0.5
    smallest_axis = [np.linalg.eigh(cluster.covariance_m2)[1][:, 0] for cluster in clusters]
    outward = np.abs(np.einsum("ci,ci->c", smallest_axis, means / 300.0))
    assert np.median(outward) > 0.9
    sigma = np.sqrt([np.linalg.eigvalsh(cluster.covariance_m2)[1:].mean() for cluster in clusters])
    assert abs(np.median(sigma) - 0.6) < 0.08


def test_seeds_agree_with_brute_force_and_partition_the_cloud():
    points, _ = planted(12, 20, 80)
    ours = seed_clusters(points, 2.0)
    theirs = brute_force_seeds(points, 2.0)
    assert [list(cluster) for cluster in ours] == [list(cluster) for cluster in theirs]
    assert sorted(np.concatenate(ours)) == list(range(len(points)))


def test_growth_takes_what_the_seed_radius_cut_off():
    rng = np.random.default_rng(2)
    points = rng.normal(0.0, 1.2, (400, 3)) * (1.0, 1.0, 0.1)
    seeds = sorted(seed_clusters(points, 2.0), key=len, reverse=True)[:1]
    largest = seeds[0]
    rest = [np.array([row]) for row in np.setdiff1d(np.arange(400), largest)]
    grown = grow_clusters(points, [largest, *rest], OPTIONS)
    assert len(grown) == 1
    assert len(grown[0].members) > len(largest) + 20
    outside = np.setdiff1d(np.arange(400), grown[0].members)
    offset = points[outside] - grown[0].mean_m
    d2 = np.einsum("ni,ni->n", offset, np.linalg.solve(grown[0].covariance_m2, offset.T).T)
    assert (d2 >= 9.0).all()


def test_a_seed_without_dispersion_dissolves():
    points = np.array([(0.0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (50, 0, 0)])
    assert grow_clusters(points, seed_clusters(points, 1.0), OPTIONS) == []


def cross(centre, half, copies=10):
    """Points at +-half on the x and y axes about a centre: covariance diag(h2, h2, 0) / 2 for many copies."""
    arms = half * np.array([(1.0, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)])
    return np.tile(arms + centre, (copies, 1))


def test_a_dispersion_is_numpys_covariance_and_the_floor():
    points = np.random.default_rng(1).normal(size=(5, 3)) * [1.0, 2.0, 3.0]
    found = PointCluster.of(points, np.array([4, 0, 2, 1]), 0.3).covariance_m2
    np.testing.assert_allclose(found, np.cov(points[[0, 1, 2, 4]].T) + 0.09 * np.eye(3))


@pytest.mark.parametrize(("gap", "merges"), [(1.0, True), (1.9, True), (2.1, False), (3.5, False)])
def test_the_trace_criterion_decides_between_merging_and_pruning(gap, merges):
    # Two equal crosses of half-width 1 have trace 1 each; merged, the trace is 1 + (gap / 2)^2: equal at gap = 2.
    first, second = cross((0.0, 0.0, 0.0), 1.0, 12), cross((gap, 0.0, 0.0), 1.0, 11)
    points = np.concatenate([first, second])
    clusters = [
        PointCluster.of(points, np.arange(len(first)), 1e-3),
        PointCluster.of(points, np.arange(len(first), len(points)), 1e-3),
    ]
    refined = refine_clusters(points, clusters, ClusterOptions(sigma_floor_m=1e-3))
    assert len(refined) == 1
    assert len(refined[0].members) == (len(points) if merges else len(first))


def test_clusters_beyond_nine_sigma_are_left_alone():
    # Along x each variance is 1/2, their sum 1: nine sigma is 9 m.
    for gap, count in ((8.5, 1), (9.5, 2)):
        points = np.concatenate([cross((0.0, 0.0, 0.0), 1.0, 30), cross((gap, 0.0, 0.0), 1.0, 30)])
        clusters = [PointCluster.of(points, np.arange(120), 1e-3), PointCluster.of(points, np.arange(120, 240), 1e-3)]
        assert len(refine_clusters(points, clusters, ClusterOptions(sigma_floor_m=1e-3))) == count


def test_no_two_refined_clusters_lie_within_the_merging_distance():
    rng = np.random.default_rng(8)
    points = rng.uniform(0.0, 60.0, (4000, 3)) * (1.0, 1.0, 0.02)
    refined = cluster_stages(points, OPTIONS, lambda cluster: len(cluster.members) >= 5).refined
    assert len(refined) > 5
    for i, first in enumerate(refined):
        for second in refined[i + 1 :]:
            offset = first.mean_m - second.mean_m
            assert offset @ np.linalg.solve(first.covariance_m2 + second.covariance_m2, offset) >= 81.0


def test_the_result_moves_with_the_cloud():
    points, _ = planted(10, 30, 100)
    shifted = points + np.array([1000.0, -500.0, 250.0])
    here, there = cluster_stages(points, OPTIONS, enough).refined, cluster_stages(shifted, OPTIONS, enough).refined
    assert [list(c.members) for c in here] == [list(c.members) for c in there]


def test_every_option_changes_the_clusters():
    rng = np.random.default_rng(4)
    points = rng.uniform(0.0, 50.0, (3000, 3)) * (1.0, 1.0, 0.02)

    def run(**changes):
        return [
            (tuple(c.members), c.trace_m2)
            for c in cluster_stages(points, ClusterOptions(**changes), lambda c: len(c.members) >= 4).refined
        ]

    changes = {"seed_radius_m": 3.0, "growth_sigma": 2.0, "merge_sigma": 2.0, "sigma_floor_m": 0.5}
    assert set(changes) == set(ClusterOptions.model_fields)
    reference = run()
    for key, value in changes.items():
        assert run(**{key: value}) != reference, key


def test_fifty_thousand_points_take_seconds():
    points, centres = planted(400, 60, 26_000, sigma=0.5)
    start = time.perf_counter()
    clusters = cluster_stages(points, OPTIONS, enough).refined
    assert time.perf_counter() - start < 15.0
    assert abs(len(clusters) - len(centres)) <= 8


def test_an_empty_cloud_has_no_clusters():
    assert cluster_stages(np.empty((0, 3)), OPTIONS, enough).refined == []
