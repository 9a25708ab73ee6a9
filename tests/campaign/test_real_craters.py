"""Detection in the real image of Eros, beside the gazetteer's craters; prediction on a sphere by closed forms."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import trimesh
from astropy.io import fits
from mission_data import data_path, needs_data

from boresight.campaign.cli import main
from boresight.campaign.data.named_craters import (
    NamedCrater,
    camera_of_lines,
    open_msi,
    predict,
    read_gazetteer,
    square_pixels,
)
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, RadialDistortion, TriangleMesh, View, look_at

needs_eros = needs_data("images/near_msi", "spice/near_msi_m0126888978", "craters")


def test_a_crater_of_a_sphere_is_predicted_where_closed_forms_put_it():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=5e3)
    mesh = TriangleMesh(ball.vertices, ball.faces)
    pose = look_at(np.array([200e3, 0.0, 0.0]), 0.3)
    camera = Camera.from_fov(537, 412, np.radians(2.93))
    view = View(camera, pose, np.array([0.6, 0.8, 0.0]))
    craters = [
        NamedCrater("near", np.radians(10.0), np.radians(20.0), 800.0),
        NamedCrater("behind", np.radians(10.0), np.radians(170.0), 800.0),
        NamedCrater("dark", np.radians(0.0), np.radians(-50.0), 800.0),
    ]
    found = predict(craters, mesh, view)
    assert found.names == ("near", "dark")
    assert found.lit.tolist() == [True, False]
    point = 5e3 * craters[0].direction
    uv = camera.project(pose.rotation @ point + pose.translation_m)
    np.testing.assert_allclose(found.ellipses.centre_px[0], uv, atol=0.1)
    line = pose.camera_position_m - point
    cosine = craters[0].direction @ line / np.linalg.norm(line)
    longer = 400.0 * camera.fx_px / np.linalg.norm(line)
    np.testing.assert_allclose(found.ellipses.semi_axes_px[0], [longer, longer * cosine], rtol=0.02)


def test_square_pixels_show_the_same_directions():
    """An image that is the row's slope in the stored camera is the row's slope in the square one."""
    stored = Camera(60, 30, 1000.0, 500.0, 30.0, 15.0)
    rows = np.indices((30, 60))[0] + 0.5
    image, square = square_pixels(((rows - 15.0) / 500.0).astype(np.float32), stored)
    assert (square.width_px, square.height_px, square.fx_px, square.fy_px) == (60, 60, 1000.0, 1000.0)
    expected = (np.indices((60, 60))[0] + 0.5 - square.cy_px) / square.fy_px
    np.testing.assert_allclose(image[12:-12], expected[12:-12], atol=1e-5)


STORED = Camera(60, 30, 1000.0, 500.0, 30.0, 15.0, RadialDistortion(0.05))


def test_an_image_with_square_pixels_is_that_of_the_stored_one_but_for_the_resampling():
    """Of 60 lines for 30: read as one of 30 it would lose half of what it shows."""

    def slope(camera):
        rows = np.indices((camera.height_px, 60))[0] + 0.5
        return ((rows - camera.cy_px) / camera.fy_px).astype(np.float32)

    cameras = [camera_of_lines(STORED, (lines, 60), "a.fit") for lines in (30, 60)]
    assert cameras[0] == STORED
    (low, of_low), (high, of_high) = (square_pixels(slope(camera), camera) for camera in cameras)
    assert of_low == of_high
    np.testing.assert_allclose(high[12:-12], low[12:-12], atol=1e-5)


def test_an_image_of_another_size_is_refused():
    with pytest.raises(BoresightError, match=r"a.fit: the image is 60 x 45 pixels, .* 60 x 30, or 60 x 60 with square"):
        camera_of_lines(STORED, (45, 60), "a.fit")


@needs_eros
def test_a_product_with_texts_for_numbers_and_412_lines_is_the_image_that_it_is(tmp_path):
    """Each line of the real image stands nearly twice: 412 / 244 times."""
    real, path = open_msi(), data_path("images/near_msi/m0126865998f4_2p_iof.fit")
    with fits.open(path) as product:
        header, pixels = product[0].header.copy(), product[0].data.astype(np.float32)
    for key in [key for key in header if key.startswith("NEAR-0")]:
        header[key] = str(header[key])
    lines = np.floor((np.arange(412) + 0.5) * 244 / 412).astype(int)
    for name, rows in (("m.fit", slice(None)), ("square.fit", lines), ("cut.fit", slice(200))):
        fits.writeto(tmp_path / name, pixels[rows], header, output_verify="silentfix")
        (tmp_path / name).with_suffix(".lbl").write_bytes(path.with_suffix(".lbl").read_bytes())
    texts, square = (open_msi(tmp_path / name) for name in ("m.fit", "square.fit"))
    np.testing.assert_array_equal(texts.frame.image, real.frame.image)
    assert texts.view.T_cam_body.angle_to(real.view.T_cam_body) == 0.0
    assert square.frame.image.shape == real.frame.image.shape == (412, 537)
    assert np.corrcoef(square.frame.image.ravel(), real.frame.image.ravel())[0, 1] > 0.99
    with pytest.raises(BoresightError, match="537 x 200 pixels"):
        open_msi(tmp_path / "cut.fit")


@needs_eros
def test_the_sun_of_the_real_image_stands_where_its_label_says():
    """Phase angle 96.45 deg, and SUN_SC_POSITION_VECTOR runs from the Sun to the spacecraft."""
    real = open_msi()
    toward_camera = real.view.T_cam_body.camera_position_m
    cosine = real.view.sun_dir_body @ toward_camera / np.linalg.norm(toward_camera)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(96.45, abs=1.5)


@needs_eros
@pytest.mark.parametrize(
    ("detector", "certain"),
    [("crater-classic", {"Valentine", "Leander"}), ("crater-learned", {"Cupid", "Valentine", "Leander", "Casanova"})],
)
def test_named_craters_are_found_in_the_real_image(detector, certain, tmp_path, capsys):
    assert main(["craters", "--detector", detector, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    with (tmp_path / "detections.csv").open() as file:
        names = {row["name"] for row in csv.DictReader(file)} - {""}
    assert certain <= names
    for name in names:
        assert f"{name}: expected at" in said
    written = {path.name for path in tmp_path.iterdir()}
    assert written >= {"detections.png", "detections.pdf"}
    assert ("stages.png" in written) == (detector == "crater-classic")


@needs_eros
def test_the_gazetteer_is_read():
    table = {crater.name: crater for crater in read_gazetteer()}
    assert len(table) == 37
    assert table["Psyche"].diameter_m == 4800.0


def test_a_gazetteer_that_is_none_is_named(tmp_path):
    folder = tmp_path / "craters"
    folder.mkdir()
    (folder / "eros_named_craters_iau.csv").write_text("name,lat_deg\nPsyche,31.6\n")
    with pytest.raises(BoresightError, match=r"eros_named_craters_iau.csv: crater 1 is not name, lat_deg"):
        read_gazetteer([tmp_path])


def test_an_image_that_is_not_there_is_named(tmp_path, capsys):
    assert main(["craters", str(tmp_path / "no.lbl")]) == 2
    assert "no.lbl" in capsys.readouterr().err
