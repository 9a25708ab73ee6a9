"""SUM files of stereophotoclinometry: against OpenCV's projection, a real MapCam image of Bennu, and damaged files."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from mission_data import data_path, needs_data
from painted_bodies import correlation, painted
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from boresight.renderers.images import PosedImageSet
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.geometry.camera import pixel_to_opencv
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spc import read_sumfile, sumfile_text
from boresight.scenarios.spec.scenario import ImageSetSpec

BENNU = "images/bennu_mapcam"
SHAPE = f"{BENNU}/g_12570mm_alt_obj_0000n00000_v014.obj"
AXES = Rotation.from_euler("xyz", [100, 20, -30], degrees=True).as_matrix()
SCOBJ_KM = np.array([0.02, -0.03, 4.0]) @ AXES
FOCAL_MM, CENTRE, PITCHES = 50.0, (13.5, 6.0), (20.0, 18.0)
SIZE = (24, 16)


def text(down: float = -PITCHES[1], **changes: str) -> str:
    """A SUM file of a small camera; ``down`` is the second diagonal element of K."""
    numbers = {
        "NPX, NLN, THRSH": "24 16 30 65535",
        "MMFL, CTR": f"{FOCAL_MM} {CENTRE[0]} {CENTRE[1]}",
        "SCOBJ": " ".join(f"{x:.12e}" for x in SCOBJ_KM),
        **{name: " ".join(f"{x:.12e}" for x in row) for name, row in zip(("CX", "CY", "CZ"), AXES, strict=True)},
        "SZ": "0 0.6 0.8",
        "K-MATRIX": f"{PITCHES[0]} 0 0 0 {down} 0",
        "DISTORTION": "0 0 0 0",
        "SIGMA_VSO": "1 1 1",
    }
    lines = [f"  {line}  {name}  " for name, line in {**numbers, **changes}.items() if line]
    return "\n".join(["M1", "2019 MAR 14 19:01:23.961", *lines, "LANDMARKS", "END FILE"]) + "\n"


def written(folder: Path, content: str) -> Path:
    path = folder / "M1.SUM"
    path.write_text(content)
    return path


def open_set(folder: Path, camera: Camera, **keys) -> PosedImageSet:
    spec = {"folder": str(folder), "sumfiles": [{"image": "a.png", "sumfile": "M1.SUM"}], "truth": "spc", **keys}
    return PosedImageSet.open(ImageSetSpec.model_validate(spec), camera)


@pytest.mark.parametrize("down", [PITCHES[1], -PITCHES[1]])
def test_points_are_where_opencv_projects_them_in_samples_and_lines(tmp_path, down):
    """Lines that count against CY count from the bottom of the image; the first pixel is (1, 1) in the file."""
    read = read_sumfile(written(tmp_path, text(down)))
    points_m = np.random.default_rng(1).uniform(-30, 30, (40, 3))
    matrix = np.array([[FOCAL_MM * PITCHES[0], 0, CENTRE[0]], [0, FOCAL_MM * down, CENTRE[1]], [0, 0, 1]])
    rotation, _ = cv2.Rodrigues(AXES)
    sample, line = cv2.projectPoints(points_m, rotation, 1e3 * AXES @ SCOBJ_KM, matrix, None)[0][:, 0].T
    row = line - 1 if down > 0 else SIZE[1] - line
    uv = pixel_to_opencv(read.camera.project(read.T_cam_body.transform(points_m)))
    np.testing.assert_allclose(uv, np.stack([sample - 1, row], axis=1), atol=1e-6)
    assert np.linalg.det(read.T_cam_body.rotation) == pytest.approx(1)


def test_a_set_has_image_view_and_epoch_of_a_sumfile(tmp_path):
    path = written(tmp_path, text())
    pixels = np.arange(16 * 24, dtype=np.uint8).reshape(16, 24)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    camera = read_sumfile(path).camera
    images = open_set(tmp_path, camera)
    images.check_images()
    assert images.names == ("a.png",)
    assert images.files == (path, tmp_path / "a.png")
    assert np.array_equal(images.image(0), pixels)
    assert np.array_equal(open_set(tmp_path, camera, first_row="bottom").image(0), pixels[::-1])
    # The number in the name of the real file, M605862153F5, is the epoch in TDB: 69.2 s more.
    assert images.time_s(0) == pytest.approx(605862083.961)
    assert images.view(0).sun_dir_body.tolist() == [0, 0.6, 0.8]
    assert images.view(0, "spc").T_cam_body.camera_position_m == pytest.approx(-1e3 * SCOBJ_KM)
    digest = images.content_digest()
    written(tmp_path, text(SZ="0 0.8 0.6"))
    assert open_set(tmp_path, camera).content_digest() != digest


def test_numbers_of_fortran_are_read(tmp_path):
    plain, fortran = (text(**{"MMFL, CTR": f"{one} 13.5 6"}) for one in ("0.5e+02", ".5D+02"))
    assert read_sumfile(written(tmp_path, plain)).camera == read_sumfile(written(tmp_path, fortran)).camera


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"SCOBJ": ""}, "SCOBJ: missing: no SUM file, or cut short"),
        ({"SCOBJ": "1 2"}, "SCOBJ: 2 numbers, not 3"),
        ({"SCOBJ": "1 2 nan"}, "SCOBJ: 'nan' is not a number"),
        ({"SCOBJ": "1 2 1e99"}, "SCOBJ: '1e99' is not a number"),
        ({"SCOBJ": " ".join(str(-x) for x in SCOBJ_KM)}, "SCOBJ: -4000 m along CZ puts the body behind the camera"),
        ({"CX": "1 0 0"}, "CX, CY, CZ: not right-handed unit vectors"),
        ({"CY": " ".join(str(-x) for x in AXES[1])}, "CX, CY, CZ: not right-handed unit vectors"),
        ({"SZ": "0 0 0"}, "SZ: the length is 0, not 1"),
        ({"K-MATRIX": "20 0 0 0.1 -18 0"}, "K-MATRIX: only (a, 0, 0)"),
        ({"K-MATRIX": "-20 0 0 0 18 0"}, "K-MATRIX: only (a, 0, 0)"),
        ({"DISTORTION": "0 1e-5 0 0"}, "DISTORTION: only zeros"),
        ({"NPX, NLN, THRSH": "24.5 16 0 1"}, "24.5 x 16 pixels"),
        ({"MMFL, CTR": "0 1 1"}, "focal lengths of 0 and 0 px"),
        ({"SIGMA_VSO": "1 1 1  SIGMA_VSO\n 0 0 1 SZ\n 1 1 1"}, "SZ: appears twice"),
    ],
)
def test_a_wrong_sumfile_is_refused_with_its_keyword(tmp_path, changes, said):
    path = written(tmp_path, text(**changes))
    with pytest.raises(BoresightError, match=re.escape(f"{path}: ") + ".*" + re.escape(said)):
        read_sumfile(path)


def test_a_sumfile_that_is_cut_short_anywhere_is_refused_or_read_whole(tmp_path):
    content = text()
    whole = content.index("DISTORTION") + len("DISTORTION")
    for end in range(whole):
        with pytest.raises(BoresightError):
            read_sumfile(written(tmp_path, content[:end]))
    read_sumfile(written(tmp_path, content[:whole]))


def test_two_images_have_not_the_same_file():
    both = [{"image": name, "sumfile": "M1.SUM"} for name in ("a.png", "b.png")]
    with pytest.raises(ValidationError, match=r"sumfiles: M1\.SUM is the file of two images"):
        ImageSetSpec.model_validate({"folder": ".", "sumfiles": both})


def test_other_times_and_missing_files_are_refused(tmp_path):
    with pytest.raises(BoresightError, match=r"line 2: '2019 MAR 34 .*' is not a time such as"):
        read_sumfile(written(tmp_path, text().replace("MAR 14", "MAR 34")))
    with pytest.raises(BoresightError, match="no such SUM file"):
        read_sumfile(tmp_path / "gone.SUM")
    with pytest.raises(BoresightError, match="no such SUM file"):
        read_sumfile(tmp_path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"fx_px": 1001.0}, r"camera: up to .* pixels off that of .*M1\.SUM: write focal_px: \[1000\.000000, 900"),
        ({"cy_px": 5.5}, r"principal_point_px: \[13, 10\.5\]"),
        ({"width_px": 16}, r"camera: 16 x 16 pixels, but .*M1\.SUM has 24 x 16"),
    ],
)
def test_a_scenario_with_another_camera_is_refused(tmp_path, changes, said):
    camera = {"width_px": 24, "height_px": 16, "fx_px": 1000.0, "fy_px": 900.0, "cx_px": 13.0, "cy_px": 10.5}
    written(tmp_path, text())
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((16, 24), np.uint8))
    open_set(tmp_path, Camera(**camera))
    with pytest.raises(BoresightError, match=said):
        open_set(tmp_path, Camera(**{**camera, **changes}))


@pytest.mark.parametrize(
    ("gone", "said"),
    [
        ("set/a.png", r"^images\.sumfiles: image: a\.png is not in .*set \(1 missing in all\)"),
        ("set/M1.SUM", r"^images\.sumfiles: .*M1\.SUM was not found"),
        ("set", r"^images\.folder: .*M1\.SUM was not found"),
    ],
)
def test_a_missing_file_is_named_with_the_key_that_asks_for_it(tmp_path, gone, said):
    (tmp_path / "set").mkdir()
    written(tmp_path / "set", text())
    cv2.imwrite(str(tmp_path / "set" / "a.png"), np.zeros((16, 24), np.uint8))
    (tmp_path / gone).rename(tmp_path / "elsewhere")
    with pytest.raises(BoresightError, match=said):
        open_set(tmp_path / "set", Camera(24, 16, 1000.0, 900.0, 13.0, 10.5))


@needs_data(BENNU)
def test_no_other_order_of_samples_and_lines_fits_the_image_of_bennu():
    """The shape, painted with OpenCV at the pose of the SUM file, against the image in all eight orders.

    Compared are the whole images, outlines, and within the outline of the image what is 8 to 40 pixels large.
    """
    spec = load_scenario("bennu-mapcam-real").spec
    images = PosedImageSet.open(spec.images, spec.camera.camera())
    shape = trimesh.load(data_path(SHAPE), process=False)
    image, view = images.image(0), images.view(0)
    lambert = painted(np.asarray(shape.vertices) * 1e3, np.asarray(shape.faces), view)
    orders = [np.ascontiguousarray(np.rot90(turned, k)) for turned in (lambert, lambert.T) for k in range(4)]
    inner = cv2.erode(cv2.morphologyEx(np.uint8(image > 8000), cv2.MORPH_CLOSE, np.ones((41, 41))), np.ones((121, 121)))
    detail = _detail(np.minimum(image, 40000))[inner > 0]
    whole, outline, within = (
        [correlation(image, order) for order in orders],
        [np.sum((order > 0) & (image > 5000)) / np.sum((order > 0) | (image > 5000)) for order in orders],
        [correlation(detail, _detail(order)[inner > 0]) for order in orders],
    )
    for scores, own, others in ((whole, 0.75, 0.65), (outline, 0.96, 0.9), (within, 0.3, 0.1)):
        assert scores[0] > own
        assert max(scores[1:]) < others


def _detail(image):
    return cv2.GaussianBlur(image, None, 8) - cv2.GaussianBlur(image, None, 40)


@needs_data(BENNU)
def test_a_real_file_comes_back_from_what_is_written(tmp_path):
    """Lines count from the top in what is written, and from the bottom in the original; the rest are its digits."""
    original = read_sumfile(data_path(f"{BENNU}/M605862153F5.SUM"))
    path = written(tmp_path, sumfile_text("M605862153F5", original))
    again = read_sumfile(path)
    assert again.time_s == original.time_s
    np.testing.assert_allclose(again.T_cam_body.rotation, original.T_cam_body.rotation, atol=1e-10)
    np.testing.assert_allclose(again.T_cam_body.translation_m, original.T_cam_body.translation_m, atol=1e-6)
    np.testing.assert_allclose(again.sun_dir_body, original.sun_dir_body, atol=1e-10)
    points_m = np.array([[200.0, 10.0, -30.0], [-100.0, 150.0, 60.0]])
    pixels = [one.camera.project(one.T_cam_body.transform(points_m)) for one in (original, again)]
    np.testing.assert_allclose(pixels[1], pixels[0], atol=1e-5)
    theirs = data_path(f"{BENNU}/M605862153F5.SUM").read_text().splitlines()
    ours = path.read_text().splitlines()
    assert ours[:2] == theirs[:2]
    for name in ("SCOBJ", "CX", "CZ", "SZ"):
        told = [next(line for line in lines if line.split()[-1] == name) for lines in (ours, theirs)]
        numbers = [[float(cell.replace("D", "E")) for cell in line.split()[:3]] for line in told]
        np.testing.assert_allclose(*numbers, rtol=2e-10)
        assert told[0].index(name) == told[1].index(name)
