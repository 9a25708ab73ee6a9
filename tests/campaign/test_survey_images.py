"""Data bases of descriptors from the real images of a survey: places of the features, and what depends on them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from tiny_campaign import compute, write_campaign

import boresight
from boresight.campaign.products import BuiltAssets
from boresight.campaign.products.assets import product_key
from boresight.campaign.store import RunFolder
from boresight.estimators.contract import NoProductError
from boresight.estimators.descriptors.database import DescriptorDatabase, DescriptorOptions
from boresight.estimators.descriptors.triangulation import triangulated_views
from boresight.estimators.maplets.build import MapletOptions
from boresight.estimators.tuned import PRODUCT as TUNING
from boresight.estimators.tuned import CovarianceTuning, Rehearsals
from boresight.renderers.images import PosedImageSet
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import look_at
from boresight.scenarios.load import load_scenario

SCENE = """
body:
  shape: contact-binary
  detail: {facets: 60000, seed: 3, craters: {count: 150, min_diameter_m: 15, max_diameter_m: 90}}
camera: {width_px: 256, height_px: 256, fov_deg: 18}
"""
IMAGES = "images: {folder: set, noise_realisations: 2%s}\n"
SURVEY = ", survey: [0.png, 2.png]"
PRIOR = (
    "pose_error: {position_cam_m: {normal: [10, 10, 10]}, attitude: {rotation_vector_deg: {normal: [0.1, 0.1, 0.1]}}}\n"
)
METHOD = "landmark-sift: {database: {source: survey}}"
MAPLETS = "lmaps: {maplets: {source: survey, spacing_m: 4, side: 25}, matching: {height_sigma_m: 1}}"
TUNED = "tuned: {base: lmaps, options: {maplets: {source: survey}}}"
SUN = np.array([0.5, -0.5, 0.7])
POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")


@pytest.fixture
def place(tmp_path):
    """Three views, 4 deg apart, of the contact binary as PNG files, with a table of their poses."""
    (tmp_path / "set").mkdir()
    (tmp_path / "bare.yaml").write_text(SCENE + "viewpoint: {range_m: 2000}\n")
    camera = load_scenario(str(tmp_path / "bare.yaml")).spec.camera.camera()
    renderer = true_renderer(tmp_path)
    rows = [",".join(["file", "time_s", "sun_body_x", "sun_body_y", "sun_body_z", *(f"ref_{one}" for one in POSE)])]
    for number, angle in enumerate(np.radians([0.0, 4.0, 8.0])):
        position_m = 2000.0 * np.array([np.cos(angle), np.sin(angle), 0.1])
        pose = look_at(position_m, np.zeros(3))
        image = renderer.render(boresight.View(camera, pose, SUN))
        cv2.imwrite(str(tmp_path / "set" / f"{number}.png"), np.round(255 * image / image.max()).astype(np.uint8))
        numbers = [number, *SUN, *pose.quat_wxyz, *pose.translation_m]
        rows.append(",".join([f"{number}.png", *map(repr, map(float, numbers))]))
    (tmp_path / "set" / "poses.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


def scene(place, images=IMAGES % SURVEY):
    (place / "scene.yaml").write_text(SCENE + images + PRIOR)
    return load_scenario(str(place / "scene.yaml"))


def true_renderer(place):
    spec = load_scenario(str(place / "bare.yaml")).spec
    return boresight.MitsubaRenderer(boresight.load_body(spec.body).mesh, spec.brdf)


def product(loaded, kind, options):
    folder = loaded.path.parent / "products"
    return BuiltAssets(loaded, folder, 1, choose_variant().name).product(kind, options.model_dump())


def move_last_image(place, across_m):
    """Move the reference of the last image across the line of sight, and across the path of the camera."""
    table = place / "set" / "poses.csv"
    *others, last = table.read_text().splitlines()
    before, y_m, z_m = last.rsplit(",", 2)
    table.write_text("\n".join([*others, f"{before},{float(y_m) + across_m},{z_m}"]))


def campaign(place, images, method=METHOD):
    text = f"scenarios: [scene]\nestimators: [prior, {{{method}}}]\ntrials: 2\nseed: 1\n"
    return write_campaign(place, text, SCENE + images + PRIOR)


def test_features_of_a_survey_lie_where_opencv_projects_their_points(place):
    database = product(scene(place), "descriptors", DescriptorOptions(kind="sift", source="survey"))
    assert isinstance(database, DescriptorDatabase)
    loaded = load_scenario(str(place / "scene.yaml")).spec
    images = PosedImageSet.open(loaded.images, loaded.camera.camera(), (place,))
    for found, index in zip(database.views, (0, 2), strict=True):
        view = images.view(index)
        turn, _ = cv2.Rodrigues(view.T_cam_body.rotation)
        uv, _ = cv2.projectPoints(found.points_m, turn, view.T_cam_body.translation_m, view.camera.matrix, None)
        nearest = np.linalg.norm(uv - opencv_features(images, index)[None], axis=2).min(axis=1)
        assert len(nearest) > 50
        assert np.median(nearest) < 0.05


def opencv_features(images, index):
    """OpenCV's own features of an image, in pixels whose first centre is at 0.5."""
    image = images.image(index)
    grey = np.clip(np.rint(200 * image / np.percentile(image[image > 0], 99)), 0, 255).astype(np.uint8)
    sift = cv2.SIFT.create(contrastThreshold=0.02, enable_precise_upscale=True)
    return np.array([point.pt for point in sift.detect(grey, None)]) + 0.5


def test_triangulated_features_are_where_opencv_triangulates_them_whatever_the_onboard_shape(place):
    wrong = SCENE.replace("body:", "body:\n  height_error: {rms_m: 10, max_wavelength_m: 100, min_wavelength_m: 20}")
    (place / "scene.yaml").write_text(wrong + IMAGES % SURVEY + PRIOR)
    loaded = load_scenario(str(place / "scene.yaml"))
    images = PosedImageSet.open(loaded.spec.images, loaded.spec.camera.camera(), (place,))
    renderer, away_m = true_renderer(place), {}
    for points in ("shape", "triangulated"):
        options = DescriptorOptions(kind="sift", source="survey", points=points)
        database = product(loaded, "descriptors", options)
        assert isinstance(database, DescriptorDatabase)
        points_m, view = database.views[0].points_m, images.view(0)
        ground = renderer.surface(view, view.camera.project(view.T_cam_body.transform(points_m)))
        away_m[points] = np.nanmedian(np.linalg.norm(ground.points_body_m - points_m, axis=1))
    # 0.1 px in two images 8 deg apart are 2.5 m along the line of sight.
    assert away_m["triangulated"] < 2.5
    assert away_m["shape"] > 5.0
    points_m = np.unique(database.views[0].points_m, axis=0)
    assert len(points_m) > 25
    assert (np.unique(database.views[1].points_m, axis=0) == points_m).all()
    matrices, places = [], []
    for index in (0, 2):
        view = images.view(index)
        camera_of_body = np.column_stack([view.T_cam_body.rotation, view.T_cam_body.translation_m])
        matrices.append(view.camera.matrix @ camera_of_body)
        homogeneous = matrices[-1] @ np.column_stack([points_m, np.ones(len(points_m))]).T
        theirs = opencv_features(images, index)
        apart_px = np.linalg.norm((homogeneous[:2] / homogeneous[2]).T[:, None] - theirs, axis=2)
        places.append(theirs[apart_px.argmin(axis=1)])
    found = cv2.triangulatePoints(*matrices, *(place.T for place in places))
    assert np.median(np.linalg.norm((found[:3] / found[3]).T - points_m, axis=1)) < 0.05


@pytest.mark.parametrize("method", [METHOD, MAPLETS])
def test_trials_have_the_other_images_and_are_solved_by_those_of_the_survey(place, method):
    compute(campaign(place, IMAGES % SURVEY, method), place / "run", 2)
    rows = RunFolder(place / "run").table("rows")
    assert set(rows["image"]) == {"1.png"}
    own = rows[rows["estimator"] == method.partition(":")[0]]
    assert (own["status"] == "ok").all()
    # Features are found to a pixel, 2.5 m, and the attitude of the prior is good to 0.1 deg, 3.5 m.
    assert (own["position_error_m"] < 10.0).all()


def test_features_that_do_not_meet_are_in_no_data_base(place):
    move_last_image(place, 40.0)
    options = DescriptorOptions(kind="sift", source="survey", points="triangulated")
    with pytest.raises(NoProductError, match="no feature is in two images of the survey: name others"):
        product(scene(place), "descriptors", options)


def test_features_seen_from_almost_one_direction_have_no_point(place):
    camera, renderer = load_scenario(str(place / "bare.yaml")).spec.camera.camera(), true_renderer(place)
    images = []
    # Of the ground, which is nearer than the origin, the directions are 1.8 deg apart.
    for angle in np.radians([0.0, 1.5]):
        view = boresight.View(camera, look_at(2000.0 * np.array([np.cos(angle), np.sin(angle), 0.0]), 0.0), SUN)
        images.append((renderer.render(view), view))
    options = DescriptorOptions(kind="sift", source="survey", points="triangulated")
    for shown, why in (
        (images, "no feature is in two images"),
        (images[:1], "needs two images of the survey, here is 1"),
    ):
        with pytest.raises(NoProductError, match=why):
            triangulated_views(shown, options)


SURVEYED = Rehearsals(base="landmark-sift", options={"database": {"source": "survey"}}, version=7, trials=20)


def test_a_survey_tunes_a_covariance_by_its_own_images_and_their_reference(place):
    before = product(scene(place), TUNING, SURVEYED)
    assert isinstance(before, CovarianceTuning)
    assert before.solved == 20
    # The image of the trials is not looked at.
    cv2.imwrite(str(place / "set" / "1.png"), np.zeros((256, 256), np.uint8))
    assert product(scene(place), TUNING, SURVEYED) == before
    # The reference of one image is off by 5 m, 2 px.
    move_last_image(place, 5.0)
    assert product(scene(place), TUNING, SURVEYED).factors[0] > 5.0 * before.factors[0]


FEATURES = {"survey": DescriptorOptions(kind="sift", source="survey"), "own": DescriptorOptions(kind="sift")}
CUT = {"survey": MapletOptions(source="survey"), "own": MapletOptions()}


@pytest.mark.parametrize(("kind", "options"), [("descriptors", FEATURES), ("maplets", CUT)])
def test_the_images_of_the_survey_change_the_product_and_rendered_ones_do_not(place, kind, options):
    variant = choose_variant().name

    def keys(images):
        loaded = scene(place, images)
        return [product_key(loaded, kind, options[source], variant) for source in ("survey", "own")]

    before = keys(IMAGES % SURVEY)
    assert before[0] != keys(IMAGES % ", survey: [1.png, 2.png]")[0]
    cv2.imwrite(str(place / "set" / "0.png"), np.zeros((256, 256), np.uint8))
    again = keys(IMAGES % SURVEY)
    assert before[0] != again[0]
    assert before[1] == again[1]


def test_a_survey_of_one_image_tunes_nothing(place):
    with pytest.raises(NoProductError, match=r"each image is placed by the others, and 0\.png is alone: name two"):
        product(scene(place, IMAGES % ", survey: [0.png]"), TUNING, SURVEYED)


@pytest.mark.parametrize(
    ("images", "method", "said"),
    [
        (IMAGES % ", survey: [7.png]", METHOD, r"images\.survey: no image is called 7\.png"),
        (IMAGES % ", survey: [0.png, 1.png, 2.png]", METHOD, r"images\.survey: no image remains"),
        (IMAGES % "", METHOD, "images.survey: names no images, but landmark-sift has source: survey"),
        (IMAGES % "", MAPLETS, "images.survey: names no images, but lmaps has source: survey"),
        (IMAGES % "", TUNED, "images.survey: names no images, but tuned has source: survey"),
        (IMAGES % ", survey: [0.png, 0.png]", METHOD, "an image appears twice"),
        (IMAGES % SURVEY + "onboard: {focal_error: 0.001}\n", METHOD, "its images have the true camera"),
        (IMAGES % ", rendered: true, survey: [0.png]", METHOD, "images of a survey are real ones, not rendered"),
        (
            IMAGES % SURVEY,
            METHOD.replace("survey", "survey, images: 9"),
            "images has no meaning for images of a survey",
        ),
        (
            IMAGES % SURVEY,
            "landmark-sift: {database: {points: triangulated}}",
            "points: triangulated: features of rendered images are on the shape: set source: survey",
        ),
    ],
)
def test_surveys_that_cannot_be_are_refused(place, images, method, said):
    with pytest.raises(BoresightError, match=said):
        boresight.run(campaign(place, images, method), out=place / "run", jobs=1)
