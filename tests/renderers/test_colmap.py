"""Models of COLMAP: against OpenCV's projection, the sightings of a model of Dawn at Vesta, and damaged files."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from colmap_models import PINHOLE, sightings, write_model, write_text_model
from mission_data import data_path, needs_data
from painted_bodies import correlation, painted
from scipy.spatial.transform import Rotation

from boresight.renderers.images import PosedImageSet
from boresight.renderers.images.colmap import read_colmap
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, OpenCVDistortion
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.scenario import ImageSetSpec

VESTA = "images/dawn_fc_vesta"
CAMERA = {"width_px": 1000, "height_px": 800, "fx_px": 1500.0, "fy_px": 1490.0, "cx_px": 500.0, "cy_px": 380.0}
TURN = Rotation.from_euler("xyz", [100, 20, -30], degrees=True)
POSE = (*TURN.as_quat(scalar_first=True), 0.02, -0.03, 4.0)


def open_set(folder, camera=CAMERA, image="images/a.png", **keys):
    (folder / "images").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "images" / "a.png"), np.zeros((800, 1000), np.uint8))
    colmap = {"unit": "km", "images": [{"image": image, "sun_body": [0, 3, 4], "time_s": 7}], **keys}
    spec = ImageSetSpec.model_validate({"folder": str(folder), "colmap": colmap, "truth": "sfm"})
    return PosedImageSet.open(spec, Camera(**camera))


@pytest.mark.parametrize("name", ["a.png", "images/a.png"])
def test_points_are_where_opencv_projects_them(tmp_path, name):
    write_model(tmp_path, {"other.png": (1, 0, 0, 0, 0, 0, 1), name: POSE})
    images = open_set(tmp_path)
    view, points_m = images.view(0), np.random.default_rng(1).normal(0, 300, (9, 3))
    matrix = np.array([[1500.0, 0, 500], [0, 1490, 380], [0, 0, 1]])
    there, _ = cv2.projectPoints(points_m, TURN.as_rotvec(), 1e3 * np.array(POSE[4:]), matrix, None)
    np.testing.assert_allclose(view.camera.project(view.T_cam_body.transform(points_m)), there[:, 0], atol=1e-9)
    np.testing.assert_allclose(view.sun_dir_body, [0, 0.6, 0.8], atol=1e-15)
    assert images.time_s(0) == 7
    assert [path.name for path in images.files] == ["cameras.bin", "images.bin", "a.png"]


def test_a_camera_with_one_focal_length_is_read(tmp_path):
    write_model(tmp_path, {"a.png": POSE}, (0, (1500.0, 500.0, 380.0)))
    ((camera, _),) = read_colmap(tmp_path / "images.bin", 1.0).values()
    assert camera == Camera(**{**CAMERA, "fy_px": 1500.0})


@pytest.mark.parametrize(
    ("poses", "camera", "said"),
    [
        ({"b.png": POSE}, PINHOLE, r"images\.bin: holds no pose of images/a\.png, of 1 images"),
        ({"a.png": (*POSE[:6], -4.0)}, PINHOLE, r"images\.bin: images/a\.png: the body is behind the camera"),
        ({"a.png": (1, 1, *POSE[2:])}, PINHOLE, r"images\.bin: a\.png: the quaternion does not have length 1"),
        ({"a.png": (*POSE[:6], np.nan)}, PINHOLE, r"images\.bin: byte 8: a number that is not finite"),
        ({"a.png": POSE}, (5, (1500.0, 1490.0, 500.0, 380.0, 0, 0, 0, 0)), "camera 7 has the lens OPENCV_FISHEYE"),
        ({"a.png": POSE}, (99, (1500.0,)), "camera 7 has the lens number 99, which is none of SIMPLE_PINHOLE, PINHOLE"),
        ({"a.png": POSE}, (1, (1500.0, 1490.0, 501.0, 380.0)), "principal_point_px: \\[501, 380\\]"),
        ({"a.png": POSE}, (1, (-5.0, 1490.0, 500.0, 380.0)), "no camera has 1000 x 800 pixels and focal lengths of -5"),
    ],
)
def test_models_that_do_not_fit_are_refused(tmp_path, poses, camera, said):
    write_model(tmp_path, poses, camera)
    with pytest.raises(BoresightError, match=said):
        open_set(tmp_path)


def test_two_images_have_not_the_same_pose(tmp_path):
    write_model(tmp_path, {"a.png": POSE})
    (tmp_path / "other").mkdir()
    cv2.imwrite(str(tmp_path / "other" / "a.png"), np.zeros((800, 1000), np.uint8))
    both = [{"image": name, "sun_body": [0, 3, 4]} for name in ("images/a.png", "other/a.png")]
    with pytest.raises(BoresightError, match=r"images/a\.png and other/a\.png have the same pose, that of a\.png"):
        open_set(tmp_path, images=both)


def test_two_images_have_one_camera(tmp_path):
    write_text_model(tmp_path, {"a.png": POSE, "b.png": (1, 0, 0, 0, 1, 2, 3)})
    cameras, images = tmp_path / "cameras.txt", tmp_path / "images.txt"
    cameras.write_text(cameras.read_text() + "8 PINHOLE 1000 800 1400 1490 500 380\n")
    images.write_text(images.read_text().replace("7 b.png", "8 b.png"))
    both = [{"image": f"images/{name}", "sun_body": [0, 3, 4]} for name in ("a.png", "b.png")]
    with pytest.raises(BoresightError, match=r"images/b\.png and images/a\.png have other cameras: a scenario has one"):
        open_set(tmp_path, images=both)
    # Cameras that were adjusted image by image are one within the tolerance.
    cameras.write_text(cameras.read_text().replace("1400", "1500.001"))
    cv2.imwrite(str(tmp_path / "images" / "b.png"), np.zeros((800, 1000), np.uint8))
    assert open_set(tmp_path, images=both).names == ("images/a.png", "images/b.png")


LENSES = (
    (2, "SIMPLE_RADIAL", (1500.0, 500.0, 380.0, -0.3), (-0.3, 0, 0, 0)),
    (3, "RADIAL", (1500.0, 500.0, 380.0, -0.3, 0.2), (-0.3, 0.2, 0, 0)),
    (4, "OPENCV", (1500.0, 1490.0, 500.0, 380.0, -0.3, 0.2, 0.01, -0.02), (-0.3, 0.2, 0.01, -0.02)),
    (
        6,
        "FULL_OPENCV",
        (1500.0, 1490.0, 500.0, 380.0, -0.3, 0.2, 0.01, -0.02, 0.1, 0.3, 0.05, 0.02),
        (-0.3, 0.2, 0.01, -0.02, 0.1, 0.3, 0.05, 0.02),
    ),
)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(("number", "model", "parameters", "coefficients"), LENSES)
def test_points_through_a_lens_are_where_opencv_projects_them(tmp_path, text, number, model, parameters, coefficients):
    if text:
        write_text_model(tmp_path, {"a.png": POSE}, (model, parameters))
    else:
        write_model(tmp_path, {"a.png": POSE}, (number, parameters))
    fy_px = 1490.0 if number > 3 else 1500.0
    lens = OpenCVDistortion(*coefficients)
    view = open_set(tmp_path, CAMERA | {"fy_px": fy_px, "distortion": lens}).view(0)
    ((camera, pose),) = read_colmap(tmp_path / f"images.{'txt' if text else 'bin'}", 1e3).values()
    points_m = np.random.default_rng(1).normal(0, 300, (9, 3))
    matrix = np.array([[1500.0, 0, 500], [0, fy_px, 380], [0, 0, 1]])
    turn, shift = TURN.as_rotvec(), 1e3 * np.array(POSE[4:])
    there, _ = cv2.projectPoints(points_m, turn, shift, matrix, np.array(coefficients, dtype=float))
    np.testing.assert_allclose(camera.project(pose.transform(points_m)), there[:, 0], atol=1e-9)
    np.testing.assert_array_equal(view.T_cam_body.translation_m, pose.translation_m)
    with pytest.raises(BoresightError, match=r"cameras\.(txt|bin): write focal_px: .* distortion: \{opencv: \[-0\.3, "):
        open_set(tmp_path)


def test_a_text_model_is_the_binary_one_and_read_where_that_is_missing(tmp_path):
    poses = {"a.png": POSE, "b c.png": (1, 0, 0, 0, 1, 2, 3)}
    write_model(tmp_path, poses)
    write_text_model(tmp_path, poses)
    binary, text = (read_colmap(tmp_path / name, 1.0) for name in ("images.bin", "images.txt"))
    assert list(binary) == list(text) == list(poses)
    for name, (camera, pose) in binary.items():
        assert text[name][0] == camera
        np.testing.assert_array_equal(text[name][1].quat_wxyz, pose.quat_wxyz)
        np.testing.assert_array_equal(text[name][1].translation_m, pose.translation_m)
    assert [path.name for path in open_set(tmp_path).files] == ["cameras.bin", "images.bin", "a.png"]
    for name in ("cameras.bin", "images.bin"):
        (tmp_path / name).unlink()
    assert [path.name for path in open_set(tmp_path).files] == ["cameras.txt", "images.txt", "a.png"]


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        (
            "cameras.txt",
            "PINHOLE",
            "FOV",
            r"cameras\.txt:2: camera 7 has the lens FOV, which is none",
        ),
        ("cameras.txt", "1490.0 ", "", r"cameras\.txt:2: camera 7: 3 parameters, not the 4 of PINHOLE"),
        ("cameras.txt", "7 PINHOLE 1000", "7 PINHOLE", r"cameras\.txt:2: camera 7: 3 parameters"),
        ("cameras.txt", "1000", "1000.5", r"cameras\.txt:2: camera 7: no camera has 1000\.5 x 800 pixels"),
        ("cameras.txt", "1500.0", "x", r"cameras\.txt:2: 'x' is not a number that this can be"),
        ("cameras.txt", "7 PINHOLE 1000 800", "7 PINHOLE #", r"cameras\.txt:2: '#' is not a number"),
        (
            "cameras.txt",
            "1500.0",
            "1500.0 1490.0 500.0 380.0\n7 PINHOLE 1000 800 1400.0",
            r"cameras\.txt:3: camera 7 appears",
        ),
        ("images.txt", "4.0 7", "nan 7", r"images\.txt:2: 'nan' is not a number that this can be"),
        ("images.txt", "4.0 7", "4.0 8", r"images\.txt:2: a\.png: camera 8 of image 1 is not in cameras\.txt"),
        ("images.txt", " 7 a.png", " 7", r"images\.txt:2: not IMAGE_ID, QW, .* NAME of an image"),
        ("images.txt", "1.5 2.5 3 1.5", "1.5 7", r"images\.txt:3: not X, Y, POINT3D_ID"),
        ("images.txt", "b.png", "a.png", r"images\.txt:4: a\.png appears twice"),
        ("images.txt", "2 1.0", "2 1.1", r"images\.txt:4: b\.png: the quaternion does not have length 1"),
    ],
)
def test_a_wrong_line_of_a_text_model_is_named(tmp_path, name, old, new, said):
    write_text_model(tmp_path, {"a.png": POSE, "b.png": (1, 0, 0, 0, 1, 2, 3)})
    text = (tmp_path / name).read_text()
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new))
    with pytest.raises(BoresightError, match=said) as refused:
        open_set(tmp_path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_no_part_of_a_file_may_be_missing(tmp_path, name):
    write_model(tmp_path, {"a.png": POSE})
    content = (tmp_path / name).read_bytes()
    for size in range(len(content)):
        (tmp_path / name).write_bytes(content[:size])
        with pytest.raises(BoresightError, match=rf"{name}: cut short, or not a binary model of COLMAP"):
            read_colmap(tmp_path / "images.bin", 1.0)


@needs_data(VESTA)
def test_the_sightings_of_vesta_are_where_the_poses_of_the_model_project_its_points():
    spec = load_scenario("dawn-vesta-real").spec
    images = PosedImageSet.open(spec.images, spec.camera.camera())
    seen = sightings(data_path(VESTA))
    for index, name in enumerate(images.names):
        points_km, uv_px = seen[name.removeprefix("images/")]
        view = images.view(index)
        assert len(points_km) > 1000
        # The camera of the scenario has four decimals.
        np.testing.assert_allclose(view.camera.project(view.T_cam_body.transform(1e3 * points_km)), uv_px, atol=1e-3)


@needs_data(VESTA)
def test_no_other_order_of_rows_and_columns_fits_the_images_of_vesta():
    """The shape, painted with OpenCV at the pose of the model, against each image in all eight orders.

    Lambert's law is not that of Vesta, so that even in the right order the images differ.
    """
    spec = load_scenario("dawn-vesta-real").spec
    images = PosedImageSet.open(spec.images, spec.camera.camera())
    shape = trimesh.load(data_path(f"{VESTA}/vesta_5002.ply"), process=False)
    for index in range(len(images)):
        lambert = painted(np.asarray(shape.vertices) * 1e3, np.asarray(shape.faces), images.view(index))
        orders = [np.rot90(turned, k) for turned in (lambert, lambert.T) for k in range(4)]
        scores = [correlation(images.image(index), order) for order in orders]
        assert scores[0] > 0.75
        assert max(scores[1:]) < 0.6
