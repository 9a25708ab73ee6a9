"""Sequences of tracks against OpenCV, brute-force ray tests, closed forms and the stated statistics."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from boresight.scenarios.geometry import Camera, TriangleMesh, View
from boresight.scenarios.load import load_scenario
from boresight.scenarios.sequences import FrameTracks, MeshGround, SphereGround, draw_sequence, measured_ranges
from boresight.scenarios.sequences.track_simulation import Visibility, sphere_share
from boresight.scenarios.sequences.trajectory import (
    circular_poses,
    frame_times_s,
    inertial_from_body,
)
from boresight.scenarios.spec.sequence import SequenceKnowledgeSpec, SequenceOrbitSpec, SequenceSpec

CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))
RADIUS_M = 190.0
SPHERE = SphereGround(RADIUS_M)


def spec(vision=None, knowledge=None, **orbit):
    return SequenceSpec.model_validate(
        {
            "sphere_radius_m": RADIUS_M,
            "orbit": {"revolutions": 0.5, **orbit},
            "vision": vision or {},
            "knowledge": knowledge or {},
        }
    )


def drawn(trial=0, vision=None, knowledge=None, seed=5, ground=SPHERE, **orbit):
    return draw_sequence(spec(vision, knowledge, **orbit), CAMERA, ground, seed, trial)


def look(camera, pose):
    return View(camera, pose, np.array([0.0, 0.0, 1.0]))


def positions(truth):
    return np.array([pose.camera_position_m for pose in truth.poses])


def test_the_orbit_is_a_circle_about_its_normal_and_the_boresight_meets_the_centre():
    orbit = SequenceOrbitSpec(normal_body=(1.0, 2.0, -0.5), start_deg=30.0, revolutions=1.0)
    path = circular_poses(orbit)
    at = np.array([pose.camera_position_m for pose in path])
    np.testing.assert_allclose(np.linalg.norm(at, axis=1), 790.0, rtol=1e-12)
    np.testing.assert_allclose(at @ np.array(orbit.normal_body), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(np.diff(at, axis=0), axis=1), 2 * 790.0 * np.sin(np.radians(1.0)))
    for pose in path:
        np.testing.assert_allclose(CAMERA.project(pose.translation_m), [512.0, 512.0])
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    velocity = at[2] - at[0]
    np.testing.assert_allclose(path[1].rotation[0], velocity / np.linalg.norm(velocity), atol=1e-12)
    # Kepler: 790 m about 3.54 m^3/s^2.
    assert frame_times_s(orbit)[-1] == pytest.approx(2 * np.pi * np.sqrt(790.0**3 / 3.54))


def test_bearings_are_those_of_opencv_but_for_the_noise():
    truth, sequence = drawn(vision={"noise_px": 0.0})
    for pose, frame in zip(truth.poses, sequence.frames, strict=True):
        rotation = cv2.Rodrigues(frame.R_cam_body)[0]
        points = truth.points_m[frame.tracks]
        expected = cv2.projectPoints(points, rotation, pose.translation_m, CAMERA.matrix, None)[0][:, 0]
        np.testing.assert_allclose(frame.uv_px, expected, atol=1e-6)


def test_the_noise_has_the_asked_deviation_and_changes_nothing_else():
    _, clean = drawn(vision={"noise_px": 0.0, "landmarks_per_frame": 60})
    _, noisy = drawn(vision={"noise_px": 2.0 / 3.0, "landmarks_per_frame": 60})
    errors = np.concatenate([b.uv_px - a.uv_px for a, b in zip(clean.frames, noisy.frames, strict=True)])
    assert len(errors) > 4000
    assert np.std(errors) == pytest.approx(2.0 / 3.0, rel=0.04)
    assert all(np.array_equal(a.tracks, b.tracks) for a, b in zip(clean.frames, noisy.frames, strict=True))
    assert all(np.array_equal(a.motion_m, b.motion_m) for a, b in zip(clean.frames, noisy.frames, strict=True))


def test_visible_points_of_a_sphere_are_first_ray_intersections():
    rng = np.random.default_rng(3)
    points, normals = SPHERE.sample(3000, rng)
    pose = circular_poses(SequenceOrbitSpec())[17]
    camera_m = pose.camera_position_m
    ray = points - camera_m
    # |c + t ray| = R: the smaller root is the first meeting; the landmark itself stands at t = 1.
    a, b, c = np.sum(ray**2, axis=1), ray @ camera_m, camera_m @ camera_m - RADIUS_M**2
    first = (-b - np.sqrt(np.maximum(b * b - a * c, 0.0))) / a
    expected = first > 1.0 - 1e-9
    assert 0.3 < expected.mean() < 0.45
    np.testing.assert_array_equal(Visibility(SPHERE).visible(points, normals, look(CAMERA, pose)), expected)
    narrow = Camera.from_fov(1024, 1024, np.radians(10.0))
    slope = np.abs(pose.transform(points)[:, :2] / pose.transform(points)[:, 2:]).max(axis=1)
    expected &= slope <= np.tan(np.radians(5.0))
    np.testing.assert_array_equal(Visibility(SPHERE).visible(points, normals, look(narrow, pose)), expected)


def test_a_mesh_occludes_points_and_is_sampled_by_area():
    torus = trimesh.creation.torus(150.0, 60.0, major_sections=24, minor_sections=12)
    ground = MeshGround(TriangleMesh(torus.vertices, torus.faces))
    points, normals = ground.sample(400, np.random.default_rng(1))
    camera_m = np.array([700.0, 100.0, 150.0])
    seen = ground.in_sight(points, normals, camera_m)
    facing = np.einsum("ni,ni->n", normals, camera_m - points) > 0.0
    hidden = np.array([_stands_before(torus.triangles, camera_m, point) for point in points])
    assert (facing & hidden).sum() > 20
    np.testing.assert_array_equal(seen, facing & ~hidden)
    many, their_normals = ground.sample(40000, np.random.default_rng(2))
    outer = np.einsum("ni,ni->n", their_normals[:, :2], many[:, :2]) > 0.0
    outer_faces = np.einsum("ni,ni->n", torus.face_normals[:, :2], torus.triangles_center[:, :2]) > 0.0
    expected = torus.area_faces[outer_faces].sum() / torus.area
    assert expected > 0.6
    assert outer.mean() == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / 40000))
    np.testing.assert_allclose(many.mean(axis=0), torus.centroid, atol=4 * 150.0 / np.sqrt(40000))


def _stands_before(triangles, camera_m, point):
    """Solve camera + t ray = a + u e1 + v e2 for every triangle; trimesh needs another package for rays."""
    ray = point - camera_m
    edges = triangles[:, 1:] - triangles[:, :1]
    columns = np.stack([edges[:, 0], edges[:, 1], np.broadcast_to(-ray, (len(triangles), 3))], axis=2)
    u, v, t = np.linalg.solve(columns, (camera_m - triangles[:, 0])[..., None])[..., 0].T
    return bool(((u > 0) & (v > 0) & (u + v < 1) & (t < 1 - 1e-7)).any())


@pytest.mark.parametrize(("step_deg", "k"), [(2.0, 0.9), (4.0, 0.81)])
def test_visible_tracks_survive_with_the_repeatability(step_deg, k):
    lived = could = 0
    for trial in range(6):
        truth, sequence = drawn(trial, vision={"landmarks_per_frame": 60}, step_deg=step_deg)
        sight = Visibility(SPHERE)
        for before, after, pose in zip(sequence.frames, sequence.frames[1:], truth.poses[1:], strict=False):
            points = truth.points_m[before.tracks]
            visible = sight.visible(points, points / RADIUS_M, look(CAMERA, pose))
            stayed = np.isin(before.tracks, after.tracks)
            assert not (stayed & ~visible).any()
            lived, could = lived + stayed.sum(), could + visible.sum()
    assert lived / could == pytest.approx(k, abs=4 * np.sqrt(k * (1 - k) / could))


def test_a_lost_track_never_returns_and_each_is_observed_once_a_frame():
    _, sequence = drawn(revolutions=2.0)
    last: dict[int, int] = {}
    for i, frame in enumerate(sequence.frames):
        assert len(np.unique(frame.tracks)) == len(frame.tracks)
        for track in frame.tracks:
            assert last.get(track, i - 1) == i - 1
            last[track] = i


def test_the_density_gives_n_landmarks_on_average_and_a_uniform_field():
    counts, depths = [], []
    for trial in range(60):
        truth, sequence = drawn(trial, vision={"landmarks_per_frame": 15}, revolutions=0.2)
        counts.append([len(sequence.frames[i].tracks) for i in (0, -1)])
        frame = sequence.frames[-1]
        depths.append(truth.points_m[frame.tracks] @ truth.poses[-1].camera_position_m / (790.0 * RADIUS_M))
    # Poisson at the first frame and after births and deaths alike.
    first, last = np.array(counts).T
    for sample in (first, last):
        assert np.mean(sample) == pytest.approx(15.0, abs=4 * np.sqrt(15.0 / 60))
        assert 0.5 < np.var(sample) / 15.0 < 1.8
    # Uniform over the area of a cap is uniform in the cosine, from the limb at R / r to 1.
    cosine = np.concatenate(depths)
    middle, width = 0.5 * (1 + RADIUS_M / 790.0), 1 - RADIUS_M / 790.0
    assert cosine.min() >= RADIUS_M / 790.0
    assert cosine.mean() == pytest.approx(middle, abs=4 * width / np.sqrt(12 * len(cosine)))


@pytest.mark.parametrize(
    "camera",
    [CAMERA, Camera.from_fov(1024, 1024, np.radians(20.0)), Camera(1000, 600, 2500.0, 2400.0, 300.0, 400.0)],
    ids=["whole", "narrow", "off-centre"],
)
@pytest.mark.parametrize("sun", [(0.0, 0.0, 1.0), (0.3, -0.2, 0.6)], ids=["terminator", "oblique"])
def test_the_visible_share_of_a_sphere_is_that_of_a_million_points(camera, sun):
    view = View(camera, circular_poses(SequenceOrbitSpec())[17], np.array(sun))
    points, normals = SPHERE.spread(1_000_000)
    for lit_only in (False, True):
        counted = Visibility(SPHERE, lit_only).visible(points, normals, view).mean()
        assert sphere_share(RADIUS_M, view, lit_only) == pytest.approx(counted, abs=3e-5)
    if camera is CAMERA:
        assert sphere_share(RADIUS_M, view, False) == pytest.approx(0.5 * (1 - RADIUS_M / 790.0), abs=1e-9)
    if camera is CAMERA and sun == (0.0, 0.0, 1.0):
        assert sphere_share(RADIUS_M, view, True) == pytest.approx(0.25 * (1 - RADIUS_M / 790.0), abs=1e-6)


def test_a_mesh_has_its_landmarks_spread_evenly_and_as_many_as_asked():
    egg = trimesh.creation.icosphere(subdivisions=2, radius=180.0).apply_scale([1.3, 1.0, 0.8])
    ground = MeshGround(TriangleMesh(egg.vertices, egg.faces))
    points, _ = ground.spread(4096)
    np.testing.assert_allclose(points.mean(axis=0), egg.centroid, atol=0.5)
    middles = egg.triangles_center
    expected = (egg.area_faces @ middles**2) / egg.area
    np.testing.assert_allclose((points**2).mean(axis=0), expected, rtol=0.01)
    section = SequenceSpec.model_validate({"orbit": {"revolutions": 0.5, "step_deg": 12}})
    counts = [
        np.mean([len(frame.tracks) for frame in draw_sequence(section, CAMERA, ground, 5, trial)[1].frames])
        for trial in range(12)
    ]
    assert np.mean(counts) == pytest.approx(15.0, abs=4 * np.std(counts) / np.sqrt(12))
    assert np.std(counts) < 2.0


FIXED = {"field": "fixed", "landmarks_per_frame": 30, "recognised": 0.7, "mistaken": 0.05}


def test_a_fixed_field_keeps_n_in_a_frame_and_its_repeatability():
    counts, lived, could = [], 0, 0
    sight = Visibility(SPHERE)
    trials = 16
    for trial in range(trials):
        truth, sequence = drawn(trial, vision={**FIXED, "tracked_share": 0.6}, revolutions=0.25)
        counts.append([len(sequence.frames[i].tracks) for i in (0, 30, -1)])
        for before, after, pose in zip(sequence.frames, sequence.frames[1:], truth.poses[1:], strict=False):
            points = truth.points_m[before.tracks]
            visible = sight.visible(points, points / RADIUS_M, look(CAMERA, pose))
            lived, could = lived + np.isin(before.tracks, after.tracks).sum(), could + visible.sum()
    assert lived / could == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / could))
    for sample in np.transpose(counts):
        assert np.mean(sample) == pytest.approx(30.0, abs=4 * np.sqrt(30.0 / trials))


def test_lost_landmarks_are_found_again_under_new_numbers_and_recognised_as_often_as_asked():
    right = wrong = returned = born = 0
    for trial in range(2):
        truth, sequence = drawn(trial, vision=FIXED, revolutions=1.5)
        place = [point.tobytes() for point in truth.points_m]
        last: dict[bytes, int] = {}
        before: set[int] = set()
        for frame in sequence.frames:
            new = [track for track in frame.tracks.tolist() if track not in before]
            named = dict(frame.again.tolist())
            assert set(named) <= set(new)
            assert not set(named.values()) & set(frame.tracks.tolist())
            right += sum(last.get(place[track]) == older for track, older in named.items())
            wrong += sum(place[track] != place[older] for track, older in named.items())
            returned, born = returned + sum(place[track] in last for track in new), born + len(new)
            last.update((place[track], track) for track in new)
            before = set(frame.tracks.tolist())
    assert returned > 0.5 * born, "after a revolution nearly all come back"
    assert right / returned == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / returned))
    assert wrong / born == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / born) + 0.005)
    assert all(not frame.again.size for frame in drawn()[1].frames)


def test_recognition_changes_nothing_but_the_pairs():
    (a, one), (b, two) = drawn(vision=FIXED), drawn(vision={**FIXED, "recognised": 0.2})
    assert a.points_m.tobytes() == b.points_m.tobytes()
    assert all(f.uv_px.tobytes() == g.uv_px.tobytes() for f, g in zip(one.frames, two.frames, strict=True))
    assert sum(len(f.again) for f in one.frames) > sum(len(f.again) for f in two.frames) > 0


def test_a_constant_count_fills_up_every_frame_and_three_tracks_connect_the_frames():
    _, sequence = drawn(vision={"count": "constant", "landmarks_per_frame": 4, "repeatability": 0.2})
    assert {len(frame.tracks) for frame in sequence.frames} == {4}
    shared = [
        len(np.intersect1d(a.tracks, b.tracks)) for a, b in zip(sequence.frames, sequence.frames[1:], strict=False)
    ]
    _, loose = drawn(vision={"count": "constant", "landmarks_per_frame": 4, "repeatability": 0.2, "min_connection": 0})
    unshared = [len(np.intersect1d(a.tracks, b.tracks)) for a, b in zip(loose.frames, loose.frames[1:], strict=False)]
    # Fewer only where fewer were still visible: a landmark may leave over the limb.
    assert np.mean(np.array(shared) >= 3) > 0.8 > 0.2 > np.mean(np.array(unshared) >= 3)


def test_the_motion_error_has_the_length_lambda_times_the_displacement_and_no_direction():
    directions = []
    for trial in range(10):
        truth, sequence = drawn(trial)
        true = np.diff(positions(truth), axis=0)
        error = np.array([frame.motion_m for frame in sequence.frames[1:]]) - true
        length = 0.5 * np.linalg.norm(true, axis=1)
        np.testing.assert_allclose(np.linalg.norm(error, axis=1), length, rtol=1e-12)
        directions.append(error / length[:, None])
        assert sequence.frames[1].motion_covariance_m2 == pytest.approx(np.eye(3) * length[0] ** 2 / 3)
    unit = np.concatenate(directions)
    np.testing.assert_allclose(unit.mean(axis=0), 0.0, atol=4 / np.sqrt(3 * len(unit)))
    np.testing.assert_allclose(unit.T @ unit / len(unit), np.eye(3) / 3, atol=0.05)
    assert not sequence.frames[0].motion_m.any()


def test_one_range_to_the_landmark_nearest_the_boresight_fixes_the_scale():
    truth, sequence = drawn(vision={"noise_px": 0.0}, knowledge={"range_sigma_m": 1e-9})
    (measured,) = sequence.frames[0].ranges
    off = np.linalg.norm(sequence.frames[0].uv_px - 512.0, axis=1)
    assert measured.track == sequence.frames[0].tracks[off.argmin()]
    true = np.linalg.norm(truth.points_m[measured.track] - truth.poses[0].camera_position_m)
    assert measured.range_m == pytest.approx(true, abs=1e-7)
    assert all(not frame.ranges for frame in sequence.frames[1:])
    assert np.array_equal(sequence.position_m, truth.poses[0].camera_position_m)


def test_the_ranged_landmark_is_chosen_by_the_first_frame_alone():
    """Only ``lasting``, a bound for studies, uses the later frames."""
    chosen = {"central": [], "lasting": []}
    for trial in range(10):
        truth, sequence = drawn(trial)
        seen = [FrameTracks(f.tracks, f.uv_px, truth.points_m[f.tracks]) for f in sequence.frames]
        for range_to, same in chosen.items():
            knowledge = SequenceKnowledgeSpec(range_to=range_to)
            one, all_of_them = (
                measured_ranges(some, truth.poses[0], CAMERA, knowledge, np.random.default_rng(1))[0].track
                for some in (seen[:1], seen)
            )
            same.append(one == all_of_them)
    assert all(chosen["central"])
    assert not all(chosen["lasting"])
    assert load_scenario("apophis-sphere-sequence").spec.sequence.knowledge.range_to == "central"


def test_outliers_have_the_given_share_and_are_displaced():
    vision = {"noise_px": 0.0, "landmarks_per_frame": 80, "mismatch_share": 0.05, "outlier_share": 0.03}
    truth, sequence = drawn(vision=vision)
    wrong = np.concatenate(truth.wrong)
    older = [np.isin(b.tracks, a.tracks) for a, b in zip(sequence.frames, sequence.frames[1:], strict=False)]
    tracked = sum(o.sum() for o in older)
    assert wrong.sum() / tracked == pytest.approx(0.08, abs=4 * np.sqrt(0.08 * 0.92 / tracked))
    for pose, frame, bad in zip(truth.poses, sequence.frames, truth.wrong, strict=True):
        true = CAMERA.project(pose.transform(truth.points_m[frame.tracks]))
        np.testing.assert_array_equal(np.linalg.norm(frame.uv_px - true, axis=1) > 1e-9, bad)


def test_lit_only_keeps_the_sunny_side_of_a_terminator_orbit():
    truth, _ = drawn(vision={"lit_only": True}, normal_body=(0.0, 1.0, 0.0))
    assert (truth.points_m[:, 1] > 0.0).all()
    dark, _ = drawn(normal_body=(0.0, 1.0, 0.0))
    assert (dark.points_m[:, 1] < 0.0).any()


def test_the_same_address_gives_the_same_bits_and_another_trial_another_field():
    (a, one), (b, two), (c, _) = drawn(3), drawn(3), drawn(4)
    assert a.points_m.tobytes() == b.points_m.tobytes() != c.points_m.tobytes()
    assert all(f.uv_px.tobytes() == g.uv_px.tobytes() for f, g in zip(one.frames, two.frames, strict=True))


def test_attitude_and_first_position_have_the_stated_errors():
    truth, sequence = drawn(knowledge={"attitude_sigma_deg": 0.1, "position_sigma_m": 2.0})
    angle = [
        np.linalg.norm(cv2.Rodrigues(frame.R_cam_body @ pose.rotation.T)[0])
        for frame, pose in zip(sequence.frames, truth.poses, strict=True)
    ]
    assert np.degrees(np.sqrt(np.mean(np.square(angle)) / 3)) == pytest.approx(0.1, rel=0.2)
    assert 0.0 < np.linalg.norm(sequence.position_m - truth.poses[0].camera_position_m) < 12.0
    np.testing.assert_array_equal(sequence.position_covariance_m2, 4.0 * np.eye(3))
    assert not any(frame.attitude_bias_sigma_rad for frame in sequence.frames)


def test_misalignment_is_the_same_rotation_in_all_frames():
    errors = []
    for trial in range(60):
        truth, sequence = drawn(trial, knowledge={"misalignment_sigma_deg": 0.2}, revolutions=0.05)
        turns = [f.R_cam_body @ pose.rotation.T for f, pose in zip(sequence.frames, truth.poses, strict=True)]
        np.testing.assert_allclose(turns, np.tile(turns[0], (len(turns), 1, 1)), atol=1e-12)
        errors.append(cv2.Rodrigues(turns[0])[0][:, 0])
    assert np.degrees(np.std(errors)) == pytest.approx(0.2, rel=0.25)
    assert [frame.attitude_sigma_rad for frame in sequence.frames] == pytest.approx([np.radians(0.2)] * 10)
    assert [frame.attitude_bias_sigma_rad for frame in sequence.frames] == pytest.approx([np.radians(0.2)] * 10)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"orbit": {"radius_m": 100}, "sphere_radius_m": 190}, "is not above the sphere"),
        ({"orbit": {"normal_body": [0, 0, 0]}}, "normal_body is zero"),
        ({"orbit": {"revolutions": 0.001}}, "less than a step"),
        ({"vision": {"recognised": 0.5}}, "say field: fixed"),
        ({"vision": {"field": "fixed", "count": "constant"}}, "say count: average"),
        ({"vision": {"field": "fixed", "recognised": 0.6, "mistaken": 0.5}}, "are more than all"),
        ({"sphere_radius_m": 190, "vision": {"field": "fixed", "tracked_share": 0.95}}, "at most 0.909"),
    ],
)
def test_a_wrong_section_is_refused_with_its_reason(section, said):
    with pytest.raises(ValidationError, match=said):
        SequenceSpec.model_validate(section)


# --- The paper's frames against what its section 3.1 says of them, and against scipy ---------------------------------


def test_body_and_inertial_axes_differ_by_the_body_s_rotation():
    turns = Rotation.random(4, rng=np.random.default_rng(2))  # x_body = R x_inertial
    inertial = np.random.default_rng(3).normal(size=(4, 3))
    np.testing.assert_allclose(inertial_from_body(turns.apply(inertial), turns.as_matrix()), inertial, atol=1e-14)
