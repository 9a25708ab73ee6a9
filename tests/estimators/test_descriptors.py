"""Features with descriptors, the data base of them, and the pose by consensus."""

import numpy as np
import pytest
from boulder_worlds import BoulderWorld, boulder_mesh
from scipy.ndimage import gaussian_filter, shift

from boresight.estimators.descriptors.database import (
    FILE,
    DescriptorDatabase,
    DescriptorOptions,
    FeatureOptions,
    ViewFeatures,
    find_features,
    match_features,
    view_features,
)
from boresight.estimators.descriptors.recognizer import (
    PRODUCT,
    DescriptorNavigatorOptions,
    OrbNavigator,
    PointMatches,
    SiftNavigator,
    find_consensus,
    near_prediction,
)
from boresight.estimators.landmark.pose.posterior import GaussianPose
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, look_at
from boresight.scenarios.observation import Frame, Observation

CAMERA = Camera.from_fov(256, 256, np.radians(18.3))
TRUE = look_at(np.array([1200.0, -1500.0, 560.0]), 0.7)
KINDS = ["sift", "orb"]
OPTIONS = DescriptorNavigatorOptions()
PRIOR_SIGMAS = [0.02] * 3 + [29.0] * 2 + [3.0]
PRIOR_COVARIANCE = np.diag(PRIOR_SIGMAS) ** 2
IMAGES = 80


def texture(seed=1):
    """A textured disc before a black sky."""
    values = gaussian_filter(np.random.default_rng(seed).normal(size=(200, 200)), 2.0)
    rows, columns = np.mgrid[:200, :200]
    disc = np.hypot(rows - 100, columns - 100) < 70
    return (np.clip(0.6 + 0.15 * values / values.std(), 0.05, None) * disc).astype(np.float32)


@pytest.mark.parametrize("kind", KINDS)
def test_features_move_with_the_image_and_keep_their_descriptors(kind):
    image = texture()
    moved = shift(image, (11, -7), order=0).astype(np.float32)
    first, second = (find_features(each, kind, FeatureOptions()) for each in (3.0 * image, 7.0 * moved))
    here, there, _ = match_features(first.descriptors, second.descriptors, kind, 0.8)
    assert len(here) > 30
    moves = second.uv_px[there] - first.uv_px[here]
    np.testing.assert_allclose(np.median(moves, axis=0), [-7.0, 11.0], atol=0.02)
    # ORB knows positions to a pixel of its pyramid's level, which is as large as 3.6 pixels.
    assert (np.linalg.norm(moves - [-7.0, 11.0], axis=1) < {"sift": 1.5, "orb": 3.6}[kind]).mean() > 0.95


@pytest.mark.parametrize("kind", KINDS)
def test_a_blob_lies_where_our_pixels_say(kind):
    """The middle of pixel (row 80, column 120) is (u, v) = (120.5, 80.5); corners of ORB lie around a blob."""
    rows, columns = np.mgrid[:200, :200]
    blobs = [(80, 120), (120, 90), (60, 60), (140, 150)]
    image = 0.2 + sum(np.exp(-((rows - r) ** 2 + (columns - c) ** 2) / 18.0) for r, c in blobs)
    image[:12], image[:, :12] = 0.0, 0.0
    found = find_features(image.astype(np.float32), kind, FeatureOptions(count=2000))
    for row, column in blobs:
        offset = found.uv_px - [column + 0.5, row + 0.5]
        distance = np.linalg.norm(offset, axis=1)
        if kind == "sift":
            assert distance.min() < 0.15
        else:
            np.testing.assert_allclose(offset[distance < 12.0].mean(axis=0), 0.0, atol=1.0)


def test_count_keeps_the_strongest():
    few, many = (find_features(texture(), "sift", FeatureOptions(count=count)) for count in (20, 200))
    assert len(few) == 20
    np.testing.assert_array_equal(few.descriptors, many.descriptors[:20])


@pytest.mark.parametrize("kind", KINDS)
def test_a_black_image_has_no_features(kind):
    found = find_features(np.zeros((64, 64), dtype=np.float32), kind, FeatureOptions())
    assert len(found) == 0
    assert match_features(found.descriptors, found.descriptors, kind, 0.8)[0].size == 0


def test_the_ratio_test_by_hand():
    known = np.zeros((3, 32), dtype=np.uint8)
    known[1, :2] = 255  # 16 bits from the first
    known[2, 20:] = 255
    observed = np.zeros((2, 32), dtype=np.uint8)
    observed[0, 0] = 1  # 1 bit from the first, 15 from the second
    observed[1, 0] = 255  # 8 bits from both
    here, there, distance = match_features(observed, known, "orb", 0.8)
    np.testing.assert_array_equal(here, [0])
    np.testing.assert_array_equal(there, [0])
    np.testing.assert_array_equal(distance, [1.0])


def matched_scene(seed, inliers=40, outliers=30):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(inliers + outliers, 3))
    points *= 150.0 / np.linalg.norm(points, axis=1, keepdims=True)
    uv = CAMERA.project(TRUE.transform(points)) + rng.normal(0.0, 0.3, (len(points), 2))
    uv[inliers:] = rng.uniform(90.0, 166.0, (outliers, 2))
    return PointMatches(uv, points)


def test_consensus_finds_the_pose_among_outliers_and_repeats_itself():
    matched = matched_scene(3)
    pose, kept = find_consensus(matched, CAMERA, OPTIONS, 7)
    assert np.degrees(pose.angle_to(TRUE)) < 0.5
    assert len(kept) >= 36
    again, _ = find_consensus(matched, CAMERA, OPTIONS, 7)
    assert again.rotation.tobytes() == pose.rotation.tobytes()


def test_too_little_agreement_says_so():
    assert "3 features matched" in find_consensus(matched_scene(1, 3, 0), CAMERA, OPTIONS, 1)
    chaos = find_consensus(matched_scene(1, 0, 8), CAMERA, OPTIONS, 1)
    assert isinstance(chaos, str) or len(chaos[1]) < 8


def test_matches_far_from_their_prediction_are_dropped():
    matched = matched_scene(5, 50, 0)
    frame = Frame(np.zeros((256, 256), dtype=np.float32), np.array([0.0, 0.0, -1.0]), TRUE, PRIOR_COVARIANCE)
    far = PointMatches(matched.uv_px + np.where(np.arange(50) < 10, 80.0, 0.0)[:, None], matched.points_m)
    # 29 m are 11.5 px here: 80 px along both axes are almost ten sigmas, 4 are allowed.
    np.testing.assert_array_equal(near_prediction(far, CAMERA, frame, 4.0), np.arange(50) >= 10)


def stored(kind="sift"):
    rng = np.random.default_rng(1)
    width = {"sift": 128, "orb": 32}[kind]
    views = []
    for n in (5, 0, 7):
        direction, sun = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        descriptors = rng.integers(0, 256, (n, width), dtype=np.uint8)
        views.append(ViewFeatures(direction, sun, rng.normal(0.0, 100.0, (n, 3)), descriptors))
    return DescriptorDatabase(kind, tuple(views), {"options": {"images": 3}})


@pytest.mark.parametrize("kind", KINDS)
def test_a_stored_data_base_is_the_same(kind, tmp_path):
    database = stored(kind)
    database.save(tmp_path)
    again = DescriptorDatabase.load(tmp_path)
    assert (again.kind, again.n_features, again.provenance) == (kind, 12, database.provenance)
    for old, new in zip(database.views, again.views, strict=True):
        np.testing.assert_array_equal(old.descriptors, new.descriptors)
        np.testing.assert_allclose(old.points_m, new.points_m, rtol=1e-6)
        np.testing.assert_array_equal(old.sun_dir_body, new.sun_dir_body)


def test_a_damaged_file_is_named(tmp_path):
    for content in (None, b"no archive"):
        if content is not None:
            (tmp_path / FILE).write_bytes(content)
        with pytest.raises(BoresightError, match=r"descriptors\.npz: cannot be read .*build it again"):
            DescriptorDatabase.load(tmp_path)
    np.savez_compressed(tmp_path / FILE, head=np.frombuffer(b'{"format": "x", "version": 1}', dtype=np.uint8))
    with pytest.raises(BoresightError, match="it is not format"):
        DescriptorDatabase.load(tmp_path)


def test_the_nearest_views_look_from_there_under_that_sun():
    x, y, z = np.eye(3)
    empty = (np.empty((0, 3)), np.empty((0, 32), dtype=np.uint8))
    views = tuple(ViewFeatures(c, s, *empty) for c, s in ((x, y), (x, z), (y, z), (-x, y)))
    found = DescriptorDatabase("orb", views).nearest(x, z, 2)
    assert found[0] is views[1]
    assert found[1] in (views[0], views[2])


class World(BoulderWorld):
    """Lends data bases of features of its images."""

    def __init__(self):
        super().__init__(CAMERA, boulder_mesh(90_000), PRIOR_SIGMAS)
        self.seen = list(self.images(IMAGES))
        self.databases = {}

    def product(self, kind, options):
        assert kind == PRODUCT
        parsed = DescriptorOptions.model_validate(options)
        if parsed.kind not in self.databases:
            views = tuple(
                view_features(image, view, lambda uv, view=view: self.renderer.surface(view, uv).points_body_m, parsed)
                for view, image in self.seen
            )
            self.databases[parsed.kind] = DescriptorDatabase(parsed.kind, views)
        return self.databases[parsed.kind]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BORESIGHT_CACHE", str(tmp_path_factory.mktemp("cache")))
        return World()


@pytest.mark.parametrize("navigator", [SiftNavigator, OrbNavigator])
def test_recognition_improves_on_the_prior(world, navigator):
    estimator = navigator.from_options({}, world)
    before, after = [], []
    for trial in range(10):
        view, frame = world.frame(trial)
        result = estimator.estimate(Observation(CAMERA, frame), rng=np.random.default_rng(trial))
        prior = frame.prior_T_cam_body
        final = result.pose if result.status == "ok" else prior
        position = view.T_cam_body.camera_position_m
        before.append(np.linalg.norm(prior.camera_position_m - position))
        after.append(np.linalg.norm(final.camera_position_m - position))
    assert np.median(after) < 0.75 * np.median(before)


def test_the_points_of_a_view_are_where_its_features_are(world):
    view, image = world.seen[0]
    options = DescriptorOptions(kind="sift")
    found = view_features(image, view, lambda uv: world.renderer.surface(view, uv).points_body_m, options)
    features = find_features(image, "sift", options.features)
    uv = CAMERA.project(view.T_cam_body.transform(found.points_m))
    distance = np.linalg.norm(uv[:, None] - features.uv_px[None], axis=2).min(axis=1)
    assert len(found.points_m) > 30
    assert distance.max() < 1e-3
    np.testing.assert_allclose(found.camera_dir_body, view.T_cam_body.camera_position_m / 2000.0, atol=1e-9)


def test_a_solution_that_contradicts_the_prior_is_refused(world):
    estimator = SiftNavigator.from_options({"prior_sigma": 1e6}, world)
    view, frame = world.frame(0)
    sure = GaussianPose(view.T_cam_body.perturbed(np.array([0.0, 0.0, 0.05]), np.zeros(3)), 1e-6 * PRIOR_COVARIANCE)
    wrong = Frame(frame.image, frame.sun_dir_cam, sure.T_cam_body, np.diag([3e-3] * 3 + [1.0] * 3) ** 2)
    result = estimator.estimate(Observation(CAMERA, wrong), rng=np.random.default_rng(1))
    assert result.status == "failed"
    assert "contradicts the prior" in result.reason


def test_wrong_input_is_refused(world):
    with pytest.raises(BoresightError, match="estimator landmark-sift: ratio_max"):
        SiftNavigator.from_options({"ratio_max": 2.0}, world)
    of_orb = type("Wrong", (), {"product": lambda self, kind, options: stored("orb")})()
    with pytest.raises(BoresightError, match="landmark-sift: the product"):
        SiftNavigator.from_options({}, of_orb)
    with pytest.raises(BoresightError, match="of no use"):
        DescriptorDatabase("sift", ())
