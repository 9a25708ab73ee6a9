"""Images of a cratered surface from the facets that rays may meet, against all as one mesh; the truth of them."""

from __future__ import annotations

import numpy as np
import pytest
from small_craters import small_ground, small_view

from boresight.renderers.mitsuba3 import MitsubaRenderer, TiledRenderer, choose_variant
from boresight.renderers.mitsuba3.tiled import tiles_casting, tiles_seen
from boresight.scenarios.craters import crater_truth
from boresight.scenarios.craters.ray_culling import RayProjection, candidate_facets
from boresight.scenarios.craters.tiles import overlap
from boresight.scenarios.craters.truth import RIM_POINTS, Rims
from boresight.scenarios.geometry import TriangleMesh, View, project_circles
from boresight.scenarios.spec.brdf import LambertSpec


@pytest.fixture(scope="module")
def renderer() -> TiledRenderer:
    return TiledRenderer(small_ground(), LambertSpec(albedo=0.3), 4, choose_variant())


@pytest.fixture(scope="module")
def whole(renderer: TiledRenderer) -> MitsubaRenderer:
    """The whole surface, fine everywhere, as one mesh for Mitsuba's own tree."""
    ground = renderer.ground
    facets = ground.tiling.facets(np.arange(len(ground.tiling.mesh.faces))).astype(np.int32)
    return MitsubaRenderer(TriangleMesh(ground.vertices_m, facets), LambertSpec(albedo=0.3), 4)


@pytest.mark.parametrize(
    ("longitude_deg", "phase_deg", "fov_deg"), [(20.0, 50.0, 18.0), (200.0, 85.0, 18.0), (80.0, 75.0, 6.0)]
)
def test_facets_found_give_the_image_of_the_whole_mesh(
    renderer: TiledRenderer, whole: MitsubaRenderer, longitude_deg: float, phase_deg: float, fov_deg: float
) -> None:
    view = small_view(longitude_deg, phase_deg, fov_deg)
    image, expected = renderer.render(view), whole.render(view)
    off = np.abs(image - expected) > 1e-4
    # Single samples at edges of facets and of shadows, and nothing else: limb and shadows are those of the fine mesh.
    assert off.mean() < 2e-3
    assert np.abs(image - expected).max() < 0.1
    assert (image > 0).mean() > 0.1


def test_every_facet_that_rays_meet_is_found_and_few_others(renderer: TiledRenderer, whole: MitsubaRenderer) -> None:
    view, ground = small_view(200.0, 85.0), renderer.ground
    uv = np.random.default_rng(3).uniform([0, 0], [160, 120], (3000, 2))
    hits = whole.surface(view, uv)
    directions = hits.points_body_m[hits.hit] - view.T_cam_body.camera_position_m
    fan = RayProjection.of_view(view)
    found = candidate_facets(ground, tiles_seen(ground, view), fan, fan.of_directions(directions))
    all_facets = ground.tiling.facets(np.arange(len(ground.tiling.mesh.faces)))
    met = ground.vertices_m[all_facets[np.unique(hits.facets[hits.hit])]].reshape(-1, 9)
    have = {row.tobytes() for row in found.reshape(-1, 9)}
    # Mitsuba decides in single precision which of two facets at a common edge it met.
    assert np.mean([np.ascontiguousarray(row).tobytes() in have for row in met]) > 0.999
    assert len(met) < len(found) < 4 * len(met)  # those behind others too, before and on the far side


@pytest.mark.parametrize("pencil", [True, False])
def test_candidates_hold_all_facets_that_contain_a_ray(renderer: TiledRenderer, pencil: bool) -> None:
    """Against each facet and ray in turn; some rays are not finite, and parallel rays start in the ground."""
    view, ground = small_view(200.0, 85.0, 18.0), renderer.ground
    points = renderer.first_points(view, np.random.default_rng(3).uniform([0, 0], [160, 120], (400, 2)))
    assert 50 < np.isnan(points[:, 0]).sum() < 350
    if pencil:
        fan = RayProjection.of_view(view)
        rays = fan.of_directions(points - view.T_cam_body.camera_position_m)
    else:
        fan = RayProjection.of_parallel(view.sun_dir_body)
        rays = fan.of_points(points)
    tiles = np.arange(len(ground.tiling.mesh.faces))
    corners = ground.vertices_m[ground.tiling.facets(tiles)]
    seen = (corners.astype(float) - fan.origin_m) @ fan.axes.T
    if pencil:
        seen[..., :2] /= seen[..., 2:]
    a, b, c = np.moveaxis(seen, 1, 0)
    (left, top), (right, bottom) = seen[..., :2].min(axis=1).T.copy(), seen[..., :2].max(axis=1).T.copy()
    needed = np.zeros(len(corners), dtype=bool)
    for x, y, from_m in rays[np.isfinite(rays).all(axis=1)]:
        near = np.flatnonzero((left <= x) & (x <= right) & (top <= y) & (y <= bottom))
        # Signed areas of the triangles that the point makes with the sides are barycentric coordinates.
        sides = ((b[near], c[near]), (c[near], a[near]), (a[near], b[near]))
        w = np.stack([(q[:, 0] - x) * (r[:, 1] - y) - (q[:, 1] - y) * (r[:, 0] - x) for q, r in sides])
        inside = (w > 0.0).all(axis=0) | (w < 0.0).all(axis=0)
        w, near = w[:, inside], near[inside]
        needed[near[(w * seen[near, :, 2].T).sum(axis=0) / w.sum(axis=0) > from_m]] = True
    have = {row.tobytes() for row in candidate_facets(ground, tiles, fan, rays).reshape(-1, 9)}
    assert needed.sum() > 100
    assert all(np.ascontiguousarray(row).tobytes() in have for row in corners[needed].reshape(-1, 9))
    assert len(have) < 3 * needed.sum()


def test_tiles_overlap_the_frame_by_their_bounding_boxes() -> None:
    rng = np.random.default_rng(6)
    corners = rng.uniform(-150.0, 250.0, (300, 2))
    corners[::17] = np.nan
    faces = rng.integers(0, 300, (2000, 3))
    boxes = corners[faces]
    expected = ((boxes.max(axis=1) > -5.0) & (boxes.min(axis=1) < np.array([85.0, 65.0]))).all(axis=1)
    assert 300 < expected.sum() < 1700
    assert np.array_equal(overlap(faces, corners, np.array([80.0, 60.0]), 5.0), expected)


def test_sun_rays_are_blocked_by_the_facets_found_as_by_all(renderer: TiledRenderer, whole: MitsubaRenderer) -> None:
    view = small_view(20.0, 80.0)
    hits = whole.surface(view, np.random.default_rng(4).uniform([0, 0], [160, 120], (3000, 2)))
    towards_sun = hits.normals_body @ view.sun_dir_body > 0.05
    start = hits.points_body_m[towards_sun] + 0.01 * hits.normals_body[towards_sun]
    assert np.mean(renderer.clear(view, start, view.sun_dir_body) != hits.lit[towards_sun]) < 2e-3
    assert np.mean(~hits.lit[towards_sun]) > 0.02


def test_of_facets_that_rays_leave_behind_none_is_tried(renderer: TiledRenderer, whole: MitsubaRenderer) -> None:
    view, ground = small_view(20.0, 80.0), renderer.ground
    hits = whole.surface(view, np.random.default_rng(4).uniform([0, 0], [160, 120], (3000, 2)))
    towards_sun = hits.normals_body @ view.sun_dir_body > 0.05
    start = hits.points_body_m[towards_sun] + 0.01 * hits.normals_body[towards_sun]
    fan, tiles = RayProjection.of_parallel(view.sun_dir_body), tiles_casting(ground, view)
    rays = fan.of_points(start)
    found = candidate_facets(ground, tiles, fan, rays)
    from_below = candidate_facets(ground, tiles, fan, rays - [0.0, 0.0, 1e4])
    # Each ray leaves a facet, which is among those that it would meet if it came from below the body.
    assert 0 < len(found) < 0.5 * len(from_below)
    have = {row.tobytes() for row in from_below.reshape(-1, 9)}
    assert all(row.tobytes() in have for row in found.reshape(-1, 9))


def test_tiles_that_face_away_wholly_are_left_out_and_no_others(renderer: TiledRenderer) -> None:
    view, ground = small_view(40.0, 60.0, fov_deg=18.0), renderer.ground
    tiling = ground.tiling
    facing: dict[str, set[int]] = {"seen": set(), "casting": set()}
    for tile in range(len(tiling.mesh.faces)):
        a, b, c = np.moveaxis(ground.vertices_m[tiling.facets(np.array([tile]))].astype(float), 1, 0)
        normal = np.cross(b - a, c - a)
        if np.einsum("ni,ni->n", normal, view.T_cam_body.camera_position_m - a).max() > 0.0:
            facing["seen"].add(tile)
        if (normal @ view.sun_dir_body).max() > 0.0:
            facing["casting"].add(tile)
    for name, tiles in (("seen", tiles_seen(ground, view)), ("casting", tiles_casting(ground, view))):
        assert facing[name] <= set(tiles.tolist())
        assert len(facing[name]) > 0.5 * len(tiles)
    assert len(tiles_seen(ground, small_view(fov_deg=4.0))) < 0.2 * len(tiling.mesh.faces)


def test_image_does_not_depend_on_what_was_seen_before(renderer: TiledRenderer) -> None:
    view = small_view(130.0)
    fresh = TiledRenderer(renderer.ground, renderer.brdf, 4, renderer.variant)
    renderer.render(small_view(10.0))
    assert np.array_equal(fresh.render(view), renderer.render(view))


def test_lines_of_sight_meet_what_the_whole_mesh_has(renderer: TiledRenderer, whole: MitsubaRenderer) -> None:
    view = small_view()
    rng = np.random.default_rng(1)
    uv = rng.uniform([0, 0], [160, 120], (400, 2))
    ours, theirs = renderer.surface(view, uv), whole.surface(view, uv)
    assert np.array_equal(ours.hit, theirs.hit)
    apart = np.linalg.norm(ours.points_body_m - theirs.points_body_m, axis=1)[ours.hit]
    assert np.quantile(apart, 0.99) < 0.01
    assert np.mean(ours.lit != theirs.lit) < 0.01


class _Open:
    """A world in which nothing hides anything."""

    def first_points(self, view: View, uv_px: np.ndarray) -> np.ndarray:
        return np.full((len(uv_px), 3), np.nan)

    def clear(self, view: View, points_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return np.ones(len(points_m), dtype=bool)


def flat_rims(centre: np.ndarray, normal: np.ndarray, radius: np.ndarray) -> Rims:
    """Rims of ideal craters: circles in planes."""
    n = len(radius)
    first = np.cross(normal, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    t = np.arange(RIM_POINTS) * 2.0 * np.pi / RIM_POINTS
    ring = np.cos(t)[:, None] * first[:, None] + np.sin(t)[:, None] * second[:, None]
    crest = centre[:, None] + radius[:, None, None] * ring
    return Rims(
        np.arange(n), crest, np.zeros((n, RIM_POINTS), dtype=bool), normal, 2 * radius, 0.3 * radius, np.full(n, 0.3)
    )


def test_truth_of_flat_circles_is_their_projection() -> None:
    view = small_view()
    rng = np.random.default_rng(2)
    towards = view.T_cam_body.camera_position_m / 2000.0
    normal = towards + rng.normal(0.0, 0.25, (20, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radius = rng.uniform(8.0, 30.0, 20)
    truth = crater_truth(flat_rims(250.0 * normal, normal, radius), view, _Open())
    ideal = project_circles(view, 250.0 * normal, normal, radius)[truth.crater]
    assert len(truth) == 20
    np.testing.assert_allclose(truth.ellipses.centre_px, ideal.centre_px, atol=1e-6)
    np.testing.assert_allclose(truth.ellipses.semi_axes_px, ideal.semi_axes_px, atol=1e-6)
    assert truth.deviation.max() < 1e-6
    emission = np.degrees(
        np.arccos(
            np.einsum("ni,ni->n", normal, towards * 2000.0 - 250.0 * normal)
            / np.linalg.norm(towards * 2000.0 - 250.0 * normal, axis=1)
        )
    )
    np.testing.assert_allclose(truth.emission_deg, emission, atol=1e-6)
    np.testing.assert_allclose(truth.incidence_deg, np.degrees(np.arccos(normal @ view.sun_dir_body)), atol=1e-6)


def test_truth_knows_what_is_hidden_and_dark(renderer: TiledRenderer, whole: MitsubaRenderer) -> None:
    view = small_view(phase_deg=80.0, fov_deg=18.0)
    rims = renderer.ground.rims
    truth = crater_truth(rims, view, renderer)
    assert len(truth) > 5
    assert truth.visible.min() < 0.9 < truth.visible.max()
    assert truth.lit.min() < 0.2
    assert truth.lit.max() == 1.0
    # The same by the whole mesh: a point of a crest is seen where the line of sight to it ends there.
    seen = []
    for number in truth.crater:
        crest = rims.crest_m[rims.crater == number][0]
        hits = whole.surface(view, view.camera.project(view.T_cam_body.transform(crest)))
        seen.append(np.mean(~(np.linalg.norm(hits.points_body_m - crest, axis=1) > 16.0 + 15.0)))
    assert np.corrcoef(seen, truth.visible)[0, 1] > 0.95
    outside = crater_truth(rims, small_view(phase_deg=80.0, fov_deg=3.0), renderer)
    assert outside.in_frame.min() < 1.0


def test_flags_follow_their_definition(renderer: TiledRenderer) -> None:
    detectable = clean = 0
    for longitude_deg in (20.0, 140.0, 260.0):
        view = small_view(longitude_deg, phase_deg=45.0, fov_deg=11.0)
        truth = crater_truth(renderer.ground.rims, view, renderer)
        expected = [
            2.0 * truth.ellipses[np.array([k])].radius_px[0] >= 12.0
            and truth.visible[k] >= 0.9
            and truth.in_frame[k] >= 0.95
            and truth.lit[k] >= 0.5
            and truth.emission_deg[k] < 60.0
            and 20.0 <= truth.incidence_deg[k] <= 75.0
            and truth.degradation[k] <= 0.6
            and truth.cut[k] <= 0.25
            for k in range(len(truth))
        ]
        assert truth.detectable.tolist() == expected
        assert not (truth.clean & ~truth.detectable).any()
        assert np.all(truth.deviation[truth.clean] <= 0.01)
        detectable, clean = detectable + int(truth.detectable.sum()), clean + int(truth.clean.sum())
    assert 0 < clean < detectable


def test_a_view_of_the_night_side_is_black(renderer: TiledRenderer) -> None:
    view = small_view()
    behind = view.T_cam_body.inverse().rotate(np.array([0.0, 0.0, 1.0]))
    assert not renderer.render(View(view.camera, view.T_cam_body, behind)).any()
    assert len(crater_truth(renderer.ground.rims, View(view.camera, view.T_cam_body, behind), renderer)) > 0
