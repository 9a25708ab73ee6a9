"""The concave hull: closed, complete and near the body that the points were taken from."""

import numpy as np
import pytest
import trimesh
from mission_data import data_file, needs_data
from scipy.spatial import ConvexHull, cKDTree

from boresight.estimators.landmark.hull import circumspheres, concave_hull
from boresight.scenarios.errors import BoresightError


def fibonacci_sphere(n):
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (1.0 + 5.0**0.5) * np.arange(n)
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=1)


def revolved(profile, n=350, length=200.0, seed=0):
    """Points on a body of revolution about x, about evenly spread, and its volume by quadrature."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-length, length, 4001)
    radius = profile(x)
    area = np.cumsum(radius * np.hypot(1.0, np.gradient(radius, x)))
    points = np.empty((0, 3))
    spacing = 0.8 * np.sqrt(2 * np.pi * area[-1] * (x[1] - x[0]) / n)
    for _ in range(15 * n):
        at = np.interp(rng.uniform(0, area[-1]), area, x)
        angle = rng.uniform(0, 2 * np.pi)
        r = np.interp(at, x, radius)
        point = np.array([at, r * np.cos(angle), r * np.sin(angle)])
        if (np.linalg.norm(points - point, axis=1) > spacing).all():
            points = np.vstack([points, point])
    return points, np.pi * np.trapezoid(radius**2, x)


def dumb_bell(x):
    lobe = np.sqrt(np.clip(90.0**2 - (np.abs(x) - 110.0) ** 2, 0.0, None))
    return np.maximum(lobe, np.where(np.abs(x) < 110.0, 25.0, 0.0))


def peanut(x):
    return np.sqrt(np.clip(1.0 - (x / 200.0) ** 2, 0.0, None)) * (
        45.0 + 50.0 * (x / 120.0) ** 2 / (1 + (x / 120.0) ** 2)
    )


def check_closed(points, hull):
    mesh = trimesh.Trimesh(points[hull.kept], hull.facets, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert len(hull.facets) == 2 * len(hull.kept) - 4
    assert len(np.unique(hull.facets)) == len(hull.kept)
    assert mesh.volume > 0.0
    assert sorted([*hull.kept, *hull.dropped]) == list(range(len(points)))
    return mesh


def test_points_on_a_sphere_give_the_convex_hull():
    points = 250.0 * fibonacci_sphere(200) + (30.0, -5.0, 8.0)
    hull = concave_hull(points)
    check_closed(points, hull)
    expected = {frozenset(facet) for facet in ConvexHull(points).simplices}
    assert {frozenset(facet) for facet in hull.facets} == expected
    normals = np.cross(
        points[hull.facets[:, 1]] - points[hull.facets[:, 0]], points[hull.facets[:, 2]] - points[hull.facets[:, 0]]
    )
    outward = points[hull.facets].mean(axis=1) - points.mean(axis=0)
    assert (np.einsum("fi,fi->f", normals, outward) > 0.0).all()


def test_an_ellipsoid_keeps_nearly_its_whole_convex_hull():
    points = fibonacci_sphere(300) * (280.0, 150.0, 120.0)
    mesh = check_closed(points, concave_hull(points))
    assert 0.97 < mesh.volume / ConvexHull(points).volume <= 1.0


@pytest.mark.parametrize("profile", [dumb_bell, peanut], ids=["dumb-bell", "peanut"])
@pytest.mark.parametrize("seed", [0, 1])
def test_concave_bodies_keep_their_necks(profile, seed):
    points, volume = revolved(profile, seed=seed)
    hull = concave_hull(points)
    mesh = check_closed(points, hull)
    assert len(hull.dropped) == 0
    convex = ConvexHull(points).volume
    assert convex > 1.09 * volume
    assert abs(mesh.volume / volume - 1.0) < 0.07


@pytest.mark.parametrize("seed", range(6))
def test_any_cloud_gives_a_closed_surface(seed):
    points = np.random.default_rng(seed).normal(size=(120, 3))
    hull = concave_hull(points)
    check_closed(points, hull)
    assert len(hull.kept) > 60


def test_repeated_points_are_dropped_and_recorded():
    points = 100.0 * fibonacci_sphere(60)
    doubled = np.concatenate([points, points[[7, 21]]])
    hull = concave_hull(doubled)
    check_closed(doubled, hull)
    assert len(hull.kept) == 60
    assert len({7, 60} & set(hull.dropped)) == 1


def test_points_on_a_grid_are_no_trouble():
    line = np.linspace(-1.0, 1.0, 5)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    shell = grid[np.abs(grid).max(axis=1) == 1.0]
    check_closed(shell, concave_hull(shell))


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.eye(3), np.random.default_rng(0).normal(size=(20, 3)) * (1, 1, 0)]
)
def test_points_without_volume_are_refused(points):
    with pytest.raises(BoresightError, match="span no volume"):
        concave_hull(points)


def test_circumspheres_touch_all_four_corners():
    corners = np.random.default_rng(1).normal(size=(50, 4, 3))
    centres, radii = circumspheres(corners)
    distance = np.linalg.norm(corners - centres[:, None], axis=2)
    np.testing.assert_allclose(distance, np.broadcast_to(radii[:, None], (50, 4)), rtol=1e-6)
    flat = corners[:1] * (1, 1, 0)
    assert np.isinf(circumspheres(flat)[1]).all()


@needs_data()
@pytest.mark.parametrize(("name", "tolerance"), [("67p-4k.obj", 0.04), ("itokawa_gaskell_q16.obj", 0.04)])
def test_real_shapes(name, tolerance):
    body = trimesh.load(data_file(f"shapes/{name}"))
    points, _ = trimesh.sample.sample_surface_even(body, 320, seed=1)
    hull = concave_hull(np.asarray(points))
    mesh = check_closed(np.asarray(points), hull)
    assert len(hull.dropped) == 0
    assert abs(mesh.volume / body.volume - 1.0) < tolerance
    surface = cKDTree(trimesh.sample.sample_surface(body, 60_000, seed=2)[0])
    gap = surface.query(trimesh.sample.sample_surface(mesh, 3000, seed=3)[0])[0]
    assert np.sqrt(np.mean(gap**2)) < 0.01 * body.scale
