"""Posed image sets: formats, the table, its faults, and the conventions on real images."""

from __future__ import annotations

import csv
import json
import re
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from astropy.io import fits
from mission_data import data_path, needs_data
from painted_bodies import correlation, painted
from scipy.spatial.transform import Rotation

from boresight.campaign.imaging.real_images import image_files
from boresight.renderers.images import PosedImageSet
from boresight.renderers.images.pixels import read_image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import load_scenario
from boresight.scenarios.load.files import CATALOG
from boresight.scenarios.spec.scenario import ImageSetSpec

CAMERA = Camera.from_fov(24, 16, 0.1)
NAVCAM, SHAPE = "images/rosetta_navcam_67p", "shapes/67p-16k.obj"
BEHIND = tuple((-6000.0 * Rotation.from_euler("xyz", [100, 20, -30], degrees=True).as_matrix()[2]).tolist())
MSI = "images/near_msi/m0126865998f4_2p_iof.fit"


def row(name, **changes):
    """A table row whose poses were made with scipy."""
    quat = Rotation.from_euler("xyz", [100, 20, -30], degrees=True).as_quat(scalar_first=True)
    cells = {"file": name, "time_s": 1.5e9, "sun_body_x": 0, "sun_body_y": 3, "sun_body_z": 4}
    for prefix, shift in (("ref", 0), ("label", 5)):
        cells |= {f"{prefix}_q{axis}": repr(float(q)) for axis, q in zip("wxyz", quat, strict=True)}
        cells |= {f"{prefix}_t{axis}_m": t + shift for axis, t in zip("xyz", (10, -20, 5000), strict=True)}
    return cells | changes


def pixels(dtype=np.uint8):
    """Every pixel different, so that no flip or shift goes unseen."""
    return np.arange(16 * 24).reshape(16, 24).astype(dtype)


def write_set(folder: Path, rows, images=("a.png",)) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in images:
        cv2.imwrite(str(folder / name), pixels())
    with (folder / "poses.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return folder


def open_set(folder: Path, camera=CAMERA, **keys) -> PosedImageSet:
    return PosedImageSet.open(ImageSetSpec(folder=str(folder), **{"also_score": ("label",), **keys}), camera)


# --- what is read ----------------------------------------------------------------------------------------------------


def test_a_set_gives_images_times_views_in_the_order_of_the_table(tmp_path):
    names = ["b.png", "a.png"]
    images = open_set(write_set(tmp_path, [row(names[0]), row(names[1], time_s=7)], names))
    assert len(images) == 2
    assert images.names == ("b.png", "a.png")
    assert [images.time_s(i) for i in range(2)] == [1.5e9, 7.0]
    assert images.image(0).dtype == np.float32
    assert np.array_equal(images.image(0), pixels())
    images.check_images()


def test_views_follow_the_columns(tmp_path):
    images = open_set(write_set(tmp_path, [row("a.png")]))
    view = images.view(0)
    expected = Rotation.from_euler("xyz", [100, 20, -30], degrees=True).as_matrix()
    assert np.allclose(view.T_cam_body.rotation, expected, atol=1e-12)
    assert view.T_cam_body.translation_m.tolist() == [10, -20, 5000]
    assert view.sun_dir_body.tolist() == [0, 0.6, 0.8]
    assert images.view(0, "label").T_cam_body.translation_m.tolist() == [15, -15, 5005]
    assert open_set(tmp_path, truth="label", also_score=()).view(0).T_cam_body.translation_m[0] == 15
    with pytest.raises(BoresightError, match="no poses 'other' were read, only ref, label"):
        images.view(0, "other")


def test_a_moved_shape_lies_where_its_points_lie_in_the_axes_of_the_table(tmp_path):
    place = {
        "name": "moved",
        "of": "label",
        "rotation_vector_deg": (20.0, -50.0, 70.0),
        "origin_m": (60.0, -40.0, 30.0),
    }
    images = open_set(write_set(tmp_path / "set", [row("a.png")]), also_score=("moved",), moved=(place,))
    points_m = np.random.default_rng(1).uniform(-50.0, 50.0, (20, 3))
    turn = Rotation.from_rotvec([20.0, -50.0, 70.0], degrees=True)
    cells = row("a.png")
    of_label = Rotation.from_quat([float(cells[f"label_q{axis}"]) for axis in "wxyz"], scalar_first=True)
    shift = np.array([cells[f"label_t{axis}_m"] for axis in "xyz"], dtype=float)
    expected, _ = cv2.projectPoints(
        turn.apply(points_m) + np.array([60.0, -40.0, 30.0]), of_label.as_rotvec(), shift, CAMERA.matrix, None
    )
    view = images.view(0, "moved")
    # OpenCV counts from the centre of the first pixel.
    found = CAMERA.project(view.T_cam_body.transform(points_m))
    np.testing.assert_allclose(found - expected[:, 0], (found - expected[:, 0])[:1].repeat(20, axis=0), atol=1e-9)
    np.testing.assert_allclose(view.T_cam_body.rotate(view.sun_dir_body), of_label.apply([0.0, 0.6, 0.8]), atol=1e-12)
    assert images.view(0).T_cam_body.translation_m.tolist() == [10.0, -20.0, 5000.0], "the pose ref is as it was"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"moved": ({"name": "moved", "of": "label"},)}, "moved: moved is neither truth nor in also_score"),
        ({"also_score": ("moved",), "moved": ({"name": "moved", "of": "third"},)}, "missing column third_qw"),
        ({"also_score": ("moved",), "moved": ({"name": "moved", "of": ""},)}, "at least 1 character"),
        ({"also_score": ("moved",), "moved": ({"name": "moved", "of": "label", "origin_m": (1, 2)},)}, "origin_m"),
        (
            {"also_score": ("moved",), "moved": ({"name": "moved", "of": "ref", "origin_m": BEHIND},)},
            "moved puts the body of a.png behind the camera",
        ),
        ({"also_score": ("label",), "moved": ({"name": "label", "of": "label"},)}, "both a name and the poses"),
        ({"also_score": ("moved",), "moved": 2 * ({"name": "moved", "of": "label"},)}, "two have the name moved"),
    ],
)
def test_a_moved_shape_is_named_and_complete(tmp_path, keys, message):
    folder = write_set(tmp_path / "set", [row("a.png")])
    with pytest.raises((BoresightError, ValueError), match=message):
        open_set(folder, **keys)


def adjusted_row(name, factor, **changes):
    """A row of adjusted poses, with the covariance ``factor factor^T``."""
    covariance = factor @ factor.T
    cells = {key.replace("ref_", "joint_"): value for key, value in row(name).items() if "label" not in key}
    cells |= {f"joint_cov_{i}{j}": repr(float(covariance[i, j])) for i in range(6) for j in range(i, 6)}
    return cells | {"joint_tx_m": 77, "sun_body_y": -3} | changes


def test_adjusted_poses_have_their_own_sun_and_a_covariance(tmp_path):
    names = ["b.png", "a.png"]
    factors = np.random.default_rng(2).normal(size=(2, 6, 6)) * np.repeat([1e-3, 30.0], 3)[:, None]
    folder = write_set(tmp_path / "set", [row(name) for name in names], names)
    table = write_set(tmp_path / "adjusted", [adjusted_row(*pair) for pair in zip(names, factors, strict=True)])
    adjusted = {"name": "joint", "table": str(table / "poses.csv")}
    images = open_set(folder, truth="joint", also_score=("ref",), adjusted=adjusted)
    assert images.view(1).T_cam_body.translation_m.tolist() == [77, -20, 5000]
    assert images.view(1).sun_dir_body.tolist() == [0, -0.6, 0.8]
    assert images.view(1, "ref").T_cam_body.translation_m.tolist() == [10, -20, 5000]
    for index, factor in enumerate(factors):
        np.testing.assert_allclose(images.covariance(index), factor @ factor.T, rtol=1e-12)
    assert table / "poses.csv" in images.files
    # Only the pose that is scored against has a covariance here.
    other = open_set(folder, truth="ref", also_score=("joint",), adjusted=adjusted)
    assert other.covariance(0) is None


def test_tables_of_the_same_name_are_files_of_their_own(tmp_path):
    folder = write_set(tmp_path / "set", [row("a.png")])
    table = write_set(tmp_path / "adjusted", [adjusted_row("a.png", np.eye(6))])
    spec = {"folder": str(folder), "truth": "joint", "adjusted": {"name": "joint", "table": f"{table}/poses.csv"}}
    camera = {"width_px": 24, "height_px": 16, "fov_deg": float(np.degrees(0.1))}
    (tmp_path / "scene.yaml").write_text(json.dumps({"body": {"shape": "sphere"}, "camera": camera, "images": spec}))
    files = dict(image_files(load_scenario(str(tmp_path / "scene.yaml"))))
    assert files[f"{folder}/poses.csv"] == folder / "poses.csv"
    assert files[f"{table}/poses.csv"] == table / "poses.csv"


@pytest.mark.parametrize(
    ("changes", "keys", "message"),
    [
        ({"joint_cov_33": -1.0}, {}, r"poses.csv:2: joint_cov_00 to joint_cov_55: .* not positive definite"),
        ({"file": "c.png"}, {}, "the images are not those of .* in the same order"),
        ({}, {"also_score": ()}, "adjusted: name joint in truth or also_score"),
    ],
)
def test_adjusted_poses_are_of_the_same_images_and_complete(tmp_path, changes, keys, message):
    folder = write_set(tmp_path / "set", [row("a.png")])
    table = write_set(tmp_path / "adjusted", [adjusted_row("a.png", np.eye(6), **changes)])
    with pytest.raises((BoresightError, ValueError), match=message):
        open_set(
            folder, **{"also_score": ("joint",), "adjusted": {"name": "joint", "table": f"{table}/poses.csv"}, **keys}
        )


@pytest.mark.parametrize(("name", "dtype"), [("a.png", "u1"), ("a.png", "u2"), ("a.tif", "u1"), ("a.tiff", "u2")])
def test_bitmaps_keep_their_values(tmp_path, name, dtype):
    image = pixels(dtype) * (100 if dtype == "u2" else 1)
    cv2.imwrite(str(tmp_path / name), image)
    assert np.array_equal(read_image(tmp_path / name), image)


@pytest.mark.parametrize("dtype", ["u1", ">i2", "u2", ">f4", "f8"])
def test_fits_images_keep_their_values(tmp_path, dtype):
    fits.PrimaryHDU(pixels(dtype)).writeto(tmp_path / "a.fit")
    assert np.array_equal(read_image(tmp_path / "a.fit"), pixels(dtype))


def test_an_image_may_be_in_an_extension_and_scaled(tmp_path):
    scaled = fits.ImageHDU(pixels("i2"))
    scaled.header["BSCALE"], scaled.header["BZERO"] = 0.5, 7.0
    fits.HDUList([fits.PrimaryHDU(), scaled]).writeto(tmp_path / "a.fits")
    assert np.array_equal(read_image(tmp_path / "a.fits"), pixels("f4") * 0.5 + 7)


def test_bottom_up_images_are_turned_over(tmp_path):
    folder = write_set(tmp_path, [row("a.png")])
    assert np.array_equal(open_set(folder, first_row="bottom").image(0), pixels()[::-1])


def test_another_table_may_be_named(tmp_path):
    folder = write_set(tmp_path, [row("a.png")])
    (folder / "poses.csv").rename(folder / "better.csv")
    assert len(open_set(folder, table="better.csv")) == 1


def test_a_folder_is_sought_beside_the_scenario_then_under_the_data(tmp_path, monkeypatch):
    beside, data = tmp_path / "scene", tmp_path / "data"
    write_set(data / "images" / "set", [row("a.png", time_s=1)])
    spec = ImageSetSpec(folder="set")
    monkeypatch.delenv("BORESIGHT_DATA", raising=False)
    with pytest.raises(BoresightError, match=r"images\.folder: set/poses\.csv .*BORESIGHT_DATA"):
        PosedImageSet.open(spec, CAMERA, (beside,))
    monkeypatch.setenv("BORESIGHT_DATA", str(data))
    assert PosedImageSet.open(spec, CAMERA, (beside,)).time_s(0) == 1
    write_set(beside / "set", [row("a.png", time_s=2)])
    assert PosedImageSet.open(spec, CAMERA, (beside,)).time_s(0) == 2


def test_an_almost_unit_quaternion_is_normalised(tmp_path):
    quat = {f"ref_q{axis}": 0.5002 for axis in "wxyz"}
    rotation = open_set(write_set(tmp_path, [row("a.png", **quat)])).view(0).T_cam_body.rotation
    assert np.allclose(rotation, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)


# --- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"ref_qw": "nan"}, r"poses\.csv:2: ref_qw: 'nan' is not a finite number"),
        ({"label_tx_m": ""}, r"poses\.csv:2: label_tx_m: '' is not a finite number"),
        ({"time_s": "noon"}, r"poses\.csv:2: time_s: 'noon' is not a finite number"),
        ({"sun_body_x": "inf"}, r"poses\.csv:2: sun_body_x: 'inf' is not a finite number"),
        (
            {"sun_body_y": 0, "sun_body_z": 0},
            r"poses\.csv:2: sun_body_x, _y, _z: \[0\.0, 0\.0, 0\.0\] has no direction",
        ),
        ({"ref_qw": 2}, r"poses\.csv:2: ref_qw, _qx, _qy, _qz: the length is 2\.\d+, not 1 within 0\.001"),
        ({"ref_tz_m": -5}, r"poses\.csv:2: ref_tz_m: -5 puts the body behind the camera"),
        ({"file": ""}, r"poses\.csv:2: file: no file name"),
        ({"file": "../a.png"}, r"poses\.csv:2: file: '\.\./a\.png' leads out of the folder"),
        ({"file": "x/../../a.png"}, r"poses\.csv:2: file: .* leads out of the folder"),
        ({"file": "/etc/passwd"}, r"poses\.csv:2: file: '/etc/passwd' leads out of the folder"),
        ({"file": "C:\\a.png"}, r"poses\.csv:2: file: .* leads out of the folder"),
        ({"file": "..\\a.png"}, r"poses\.csv:2: file: .* leads out of the folder"),
        ({"file": "b.png"}, r"poses\.csv: file: b\.png is not in .* \(1 missing in all\)"),
    ],
)
def test_a_wrong_cell_is_named_with_file_line_and_column(tmp_path, changes, line):
    folder = write_set(tmp_path, [row("a.png", **changes)])
    with pytest.raises(BoresightError, match=line) as caught:
        open_set(folder)
    assert "\n" not in str(caught.value)


def test_the_line_of_a_fault_counts_the_heading_and_blank_lines(tmp_path):
    folder = write_set(tmp_path, [row("a.png"), row("b.png", ref_qw="x")], ("a.png", "b.png"))
    text = (folder / "poses.csv").read_text(encoding="utf-8").replace("\n", "\n\n", 1)
    (folder / "poses.csv").write_text(text, encoding="utf-8")
    with pytest.raises(BoresightError, match=r"poses\.csv:4: ref_qw"):
        open_set(folder)


def test_an_image_counts_once(tmp_path):
    folder = write_set(tmp_path, [row("a.png"), row("a.png", time_s=9)])
    with pytest.raises(BoresightError, match=r"poses\.csv:3: file: a\.png appears twice, first at .*poses\.csv:2"):
        open_set(folder)


def test_faults_of_the_table_as_a_whole(tmp_path):
    folder = write_set(tmp_path, [row("a.png")])
    with pytest.raises(BoresightError, match=r"missing column best_qw, .* \(prefixes with poses: ref, label\)"):
        open_set(folder, truth="best")
    table = folder / "poses.csv"
    text = table.read_text(encoding="utf-8")
    heading, cells = text.splitlines()
    for content, line in (
        (heading + "\n", "the table has no rows"),
        ("", "missing column file"),
        (f"{heading},time_s\n{cells},3\n", "column time_s appears twice"),
        (f"{heading}\n{cells},3\n", r"poses\.csv:2: more cells than the \d+ columns"),
        (f"{heading}\n{cells.rsplit(',', 1)[0]}\n", r"poses\.csv:2: \w+: '' is not a finite number"),
        (f'{heading}\n"a.png', "cannot be read as a CSV table"),
    ):
        table.write_text(content, encoding="utf-8")
        with pytest.raises(BoresightError, match=line):
            open_set(folder)
    table.write_bytes(text.replace("a.png", "ä.png").encode("latin-1"))
    with pytest.raises(BoresightError, match="cannot be read as a CSV table"):
        open_set(folder)
    with pytest.raises(BoresightError, match=r"none/poses\.csv"):
        open_set(tmp_path / "none")


def test_an_image_of_another_size_is_refused(tmp_path):
    images = open_set(write_set(tmp_path, [row("a.png")]), camera=Camera.from_fov(16, 24, 0.1))
    with pytest.raises(BoresightError, match=r"a\.png: the image is 24 x 16 pixels, but the camera has 16 x 24"):
        images.check_images()


def test_grey_images_are_read_that_are_stored_in_colour(tmp_path):
    grey = np.arange(16, dtype=np.uint8).reshape(4, 4)
    opaque = np.full_like(grey, 255)
    for name, channels in {"rgb": (grey, grey, grey), "rgba": (grey, grey, grey, opaque)}.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.dstack(channels))
        np.testing.assert_array_equal(read_image(tmp_path / f"{name}.png"), grey)
    cv2.imwrite(str(tmp_path / "clear.png"), np.dstack([grey, grey, grey, grey]))
    with pytest.raises(BoresightError, match="a grey image has rows and columns alone"):
        read_image(tmp_path / "clear.png")


def test_unreadable_images_are_named(tmp_path):
    cv2.imwrite(str(tmp_path / "colour.png"), np.eye(4, dtype=np.uint8)[..., None] * np.uint8([1, 2, 1]))
    fits.PrimaryHDU(np.full((2, 3), np.nan)).writeto(tmp_path / "nan.fits")
    large = np.zeros((2, 3))
    large[1, 2] = 1e300
    fits.PrimaryHDU(large).writeto(tmp_path / "large.fits")
    fits.PrimaryHDU().writeto(tmp_path / "none.fits")
    fits.PrimaryHDU(np.zeros((2, 3, 4))).writeto(tmp_path / "cube.fits")
    for name in ("text.png", "text.tif", "text.fits", "a.gif"):
        (tmp_path / name).write_text("not an image", encoding="utf-8")
    for name in ("empty.png", "empty.fits"):
        (tmp_path / name).touch()
    for name, line in {
        "colour.png": "a grey image has rows and columns alone, this one has shape (4, 4, 3)",
        "cube.fits": "a grey image has rows and columns alone, this one has shape (2, 3, 4)",
        "large.fits": "1 pixels are not finite, the first in row 1, column 2",
        "nan.fits": "6 pixels are not finite, the first in row 0, column 0",
        "none.fits": "holds no image",
        "text.png": "not a readable PNG image",
        "text.tif": "not a readable TIF image",
        "text.fits": "not a readable FITS file",
        "empty.png": "",
        "empty.fits": "",
        "a.gif": "not a format that is read: .png, .tif, .tiff, .fits, .fit, .fts",
        "gone.png": "cannot be read: No such file",
    }.items():
        with pytest.raises(BoresightError, match=re.escape(f"{name}: {line}")) as caught:
            read_image(tmp_path / name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", [".png", ".tif", ".fits"])
def test_half_an_image_is_never_taken_for_a_whole_one(tmp_path, kind):
    image = np.random.default_rng(0).integers(0, 255, (64, 64), dtype=np.uint8)
    whole, part = tmp_path / f"whole{kind}", tmp_path / f"part{kind}"
    if kind == ".fits":
        fits.PrimaryHDU(image).writeto(whole)
    else:
        cv2.imwrite(str(whole), image)
    content = whole.read_bytes()
    for fraction in (0.1, 0.3, 0.5, 0.7):
        part.write_bytes(content[: int(len(content) * fraction)])
        with pytest.raises(BoresightError, match="not a readable"):
            read_image(part)


def test_a_header_that_claims_a_huge_image_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), pixels())
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[16:24] = struct.pack(">II", 2**30, 2**30)
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(BoresightError, match=r"a\.png: "):
        read_image(tmp_path / "a.png")


# --- real data -------------------------------------------------------------------------------------------------------


@needs_data(NAVCAM, SHAPE)
def test_the_conventions_hold_on_real_images():
    """The shape, projected with OpenCV from the poses of the table, lies on the comet without a flip or a shift.

    The shift that correlates best comes from a parabola through the correlations at -1, 0 and 1 pixel. The
    reference poses are good to about a pixel each; a wrong half pixel would move the median of all.
    """
    spec = load_scenario("navcam67p-real").spec
    images = PosedImageSet.open(spec.images, spec.camera.camera(), (CATALOG,))
    shape = trimesh.load(data_path(SHAPE), process=False)
    rendered = {"right": [], "mirrored": [], "upside down": []}
    shifts = []
    for index in range(0, len(images), 3):
        image, view = images.image(index), images.view(index, "ref")
        lambert = painted(np.asarray(shape.vertices) * 1e3, np.asarray(shape.faces), view)
        rendered["right"].append(correlation(image, lambert))
        rendered["mirrored"].append(correlation(image, lambert[:, ::-1]))
        rendered["upside down"].append(correlation(image, lambert[::-1]))
        scores = {
            (du, dv): correlation(image, np.roll(lambert, (dv, du), (0, 1))) for du in (-1, 0, 1) for dv in (-1, 0, 1)
        }
        shifts.append(
            [_peak(scores[-1, 0], scores[0, 0], scores[1, 0]), _peak(scores[0, -1], scores[0, 0], scores[0, 1])]
        )
    assert min(rendered["right"]) > 0.9
    assert max(rendered["mirrored"] + rendered["upside down"]) < 0.9
    assert np.abs(np.median(shifts, axis=0)).max() < 0.35, shifts


def _peak(left, middle, right):
    """Vertex of the parabola through three scores at -1, 0, 1."""
    return 0.5 * (left - right) / (left - 2 * middle + right)


@needs_data(NAVCAM)
def test_the_navcam_set_is_what_its_notes_say():
    spec = load_scenario("navcam67p-real").spec
    images = PosedImageSet.open(spec.images, spec.camera.camera(), ())
    images.check_images()
    views = [images.view(i) for i in range(len(images))]
    ranges_km = np.array([np.linalg.norm(v.T_cam_body.translation_m) for v in views]) / 1e3
    phases_deg = np.degrees([v.phase_angle_rad for v in views])
    assert len(images) == 60
    assert [round(ranges_km.min()), round(ranges_km.max())] == [81, 131]
    assert [round(phases_deg.min()), round(phases_deg.max())] == [30, 55]


@needs_data(NAVCAM, SHAPE)
def test_one_place_of_the_shape_brings_the_poses_of_the_mission_onto_all_images():
    spec = load_scenario("navcam67p-views").spec
    images = PosedImageSet.open(spec.images, spec.camera.camera(), (CATALOG,))
    shape = trimesh.load(data_path(SHAPE), process=False)
    found = {"label": [], "moved": [], "joint": []}
    for index in range(5, len(images), 11):
        for name in found:
            lambert = painted(np.asarray(shape.vertices) * 1e3, np.asarray(shape.faces), images.view(index, name))
            found[name].append(correlation(images.image(index), lambert))
    assert all(np.array(found["moved"]) > np.array(found["label"]))
    assert all(np.array(found["joint"]) > np.array(found["label"]))
    assert np.median(found["moved"]) > 0.9
    assert np.median(found["joint"]) > np.median(found["moved"])


@needs_data(MSI)
def test_a_near_msi_image_is_read():
    image = read_image(data_path(MSI))
    assert image.ndim == 2
    assert image.max() > 0
