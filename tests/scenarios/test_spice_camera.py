"""Cameras of instrument kernels, against closed forms and OpenCV's pinhole."""

from __future__ import annotations

import numpy as np
import pytest
from mission_data import data_path, needs_data

from boresight.renderers.spice import INSTRUMENTS
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import canonical_json, load_scenario
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spice import loaded_kernels

# 1024 x 512 pixels of 14 um behind 150 mm; the boresight is a quarter of the height above the middle.
FOCAL = 150.0 / 0.014
CORNERS = [(u, v) for u in (-512.0, 512.0) for v in (-128.0, 384.0)]
NUMBERS = {
    "FOV_FRAME": "'J2000'",
    "FOV_SHAPE": "'RECTANGLE'",
    "BORESIGHT": "( 0 0 2 )",
    "FOV_BOUNDARY_CORNERS": "\n".join(["(", *(f"{u} {v} {FOCAL!r}" for u, v in CORNERS), ")"]),
    "PIXEL_SAMPLES": "( 1024 )",
    "PIXEL_LINES": "( 512 )",
    "FOCAL_LENGTH": "( 150.0 )",
    "PIXEL_SIZE": "( 14 )",
}
NAME = "NAIF_BODY_NAME += ( 'TINY_CAMERA' )\nNAIF_BODY_CODE += ( -999100 )\n"


@pytest.fixture
def camera_of(tmp_path):
    """Load a scenario with the camera of a kernel whose numbers differ by ``changes``; None takes one out."""

    def make(instrument: str = "-999100", more: str = "", **changes: str | None) -> Camera:
        numbers = {key: value for key, value in {**NUMBERS, **changes}.items() if value is not None}
        lines = "".join(f"INS-999100_{key} = {value}\n" for key, value in numbers.items())
        (tmp_path / "tiny.ti").write_text(f"KPL/IK\n\\begindata\n{NAME}{lines}\\begintext\n")
        section = f"{{spice: {{instrument: '{instrument}', kernels: [tiny.ti]}}{more}}}"
        (tmp_path / "scene.yaml").write_text(f"extends: quickstart\ncamera: {section}\n")
        return load_scenario(str(tmp_path / "scene.yaml")).spec.camera.camera()

    return make


def test_size_field_and_boresight_are_those_of_the_kernel(camera_of):
    camera = camera_of()
    assert (camera.width_px, camera.height_px) == (1024, 512)
    assert (camera.fx_px, camera.fy_px) == pytest.approx((FOCAL, FOCAL), rel=1e-12)
    assert (camera.cx_px, camera.cy_px) == pytest.approx((512.0, 128.0), abs=1e-9)
    assert camera.distortion is None
    corners = camera.project(np.array([[u, v, FOCAL] for u, v in CORNERS]))
    assert corners == pytest.approx(np.array([[0, 0], [0, 512], [1024, 0], [1024, 512]]), abs=1e-9)


def test_an_instrument_has_a_name_as_well(camera_of):
    assert camera_of("TINY_CAMERA").fx_px == camera_of().fx_px


@pytest.mark.parametrize(
    ("focal", "pixel"), [("( 150.0 )", "( 0.014 )"), ("( 0.150 )", "( 0.000014 )"), ("( 0.150 )", "( 14 )")]
)
def test_units_of_focal_length_and_pixel_are_found_by_the_field(camera_of, focal, pixel):
    assert camera_of(FOCAL_LENGTH=focal, PIXEL_SIZE=None, PIXEL_PITCH=pixel).fx_px == pytest.approx(FOCAL, rel=1e-12)


def test_a_calibrated_focal_length_counts_more_than_the_field(camera_of):
    assert camera_of(FOCAL_LENGTH="( 151.5 )").fx_px == pytest.approx(151.5 / 0.014, rel=1e-12)


def test_without_a_focal_length_the_field_has_it(camera_of):
    assert camera_of(FOCAL_LENGTH=None).fx_px == pytest.approx(FOCAL, rel=1e-12)


@pytest.mark.parametrize("focal", ["( 150.0 )", "( 0.150 )"])
def test_distortion_is_in_millimetres_whatever_the_unit_of_the_focal_length(camera_of, focal):
    camera = camera_of(FOCAL_LENGTH=focal, OD_K="( 0.0 1.0e-5 2.0e-9 )")
    seen_px = np.array([900.0, 400.0])
    seen_mm = (seen_px - [512.0, 128.0]) * 0.014
    r2 = seen_mm @ seen_mm
    ideal_mm = seen_mm * (1.0 - 1.0e-5 * r2 - 2.0e-9 * r2 * r2)
    ray = camera.unproject(seen_px)
    assert ray[:2] / ray[2] == pytest.approx(ideal_mm / 150.0, rel=1e-12)


def test_pixels_that_are_not_square_have_a_focal_length_each(camera_of):
    camera = camera_of(PIXEL_SIZE="( 14.004, 13.995 )")
    assert (camera.fx_px, camera.fy_px) == pytest.approx((150.0 / 0.014004, 150.0 / 0.013995), rel=1e-12)


def test_the_radial_coefficient_of_dawn_goes_from_the_ideal_position_to_the_seen_one(camera_of):
    camera = camera_of(PIXEL_SIZE="( 14.004, 13.995 )", RAD_DIST_COEFF="( 8.4e-6 )")
    ideal_mm = 150.0 * np.array([0.03, -0.008])
    seen_mm = ideal_mm * (1.0 + 8.4e-6 * (ideal_mm @ ideal_mm))
    seen_px = np.array([512.0, 128.0]) + seen_mm / [0.014004, 0.013995]
    assert camera.project(np.array([0.03, -0.008, 1.0])) == pytest.approx(seen_px, abs=1e-9)


# Dawn's FC2 with the clear filter, of dawn_fc_v10.ti (Schroeder et al. 2013): 1024 x 1024 pixels of 14.004 x 13.995 um.
DAWN_FC2 = {
    "FOV_BOUNDARY_CORNERS": None,
    "FOV_CLASS_SPEC": "'ANGLES'",
    "FOV_REF_VECTOR": "( 1.0, 0.0, 0.0 )",
    "FOV_REF_ANGLE": "( 2.7353005 )",
    "FOV_CROSS_ANGLE": "( 2.7335816 )",
    "FOV_ANGLE_UNITS": "'DEGREES'",
    "BORESIGHT": "( 0.0, 0.0, 150.07 )",
    "PIXEL_LINES": "( 1024 )",
    "FOCAL_LENGTH": "( 150.07 )",
    "PIXEL_SIZE": "( 14.004, 13.995 )",
    "RAD_DIST_COEFF": "( 0.0000084 )",
}


@needs_data("images/dawn_fc_vesta")
def test_dawn_is_the_camera_of_its_images_of_vesta(camera_of):
    camera = camera_of(**DAWN_FC2)
    # COLMAP's model of four images: one pinhole, adjusted with the poses.
    fx, fy = np.frombuffer(data_path("images/dawn_fc_vesta/cameras.bin").read_bytes()[32:48])
    assert camera.fx_px == pytest.approx(fx, rel=2e-4)
    assert camera.fy_px / camera.fx_px == pytest.approx(fy / fx, rel=1e-6)
    assert (camera.cx_px, camera.cy_px) == pytest.approx((512.0, 512.0), abs=1e-6)
    # The corner is 10.1 mm from the axis: 0.62 px outwards.
    corner = np.array([512.0 / camera.fx_px, 512.0 / camera.fy_px, 1.0])
    assert camera.project(corner) - 1024.0 == pytest.approx(0.44, abs=0.005)


def test_sizes_of_the_scenario_serve_where_the_kernel_has_none(camera_of):
    camera = camera_of(more=", width_px: 1024, height_px: 512", PIXEL_SAMPLES=None, PIXEL_LINES=None)
    assert (camera.width_px, camera.height_px) == (1024, 512)


def test_a_stored_scenario_needs_no_kernel(camera_of, tmp_path):
    camera = camera_of()
    spec = load_scenario(str(tmp_path / "scene.yaml")).spec
    (tmp_path / "tiny.ti").unlink()
    assert ScenarioSpec.model_validate_json(canonical_json(spec)).camera.camera() == camera


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"BORESIGHT": "( 1 0 0 )"}, "not the z axis of its frame"),
        ({"FOV_SHAPE": "'CIRCLE'", "FOV_BOUNDARY_CORNERS": "( 0.1 0 1 )"}, "is a circle, not a rectangle"),
        ({"FOV_SHAPE": None}, "SPICE"),
        ({"FOCAL_LENGTH": "( 130.0 )"}, "do not agree with its field of view"),
        ({"FOCAL_LENGTH": "( -1 )"}, "FOCAL_LENGTH"),
        ({"OD_K": "( 0.1 0 0 )"}, "k0 = 0.1 would change the focal length"),
        ({"PIXEL_LINES": "( 0 )"}, "PIXEL_LINES"),
        ({"PIXEL_SIZE": "( 14, -14 )"}, "PIXEL_SIZE: -14 is not above 0"),
        ({"PIXEL_SIZE": "( 14, 14, 14 )"}, "is not one number or 2 numbers of any use"),
        ({"OD_K": "( 0 1e-5 0 )", "RAD_DIST_COEFF": "( 1e-5 )"}, "two distortions"),
        ({"instrument": "NO_CAMERA"}, "do not have an instrument NO_CAMERA"),
        ({"more": ", principal_point_px: [3, 3]"}, "principal_point_px has no part"),
        ({"more": ", width_px: 640"}, "width_px 640 is not the kernel's 1024"),
        ({"more": ", fov_deg: 5"}, "not both"),
    ],
)
def test_a_kernel_that_is_no_camera_is_one_line(camera_of, changes, said):
    with pytest.raises(BoresightError, match=said) as caught:
        camera_of(**changes)
    assert "scene.yaml" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@needs_data("spice/hayabusa_amica_st_2458542208")
def test_amica_is_the_camera_of_its_images():
    folder = data_path("spice/hayabusa_amica_st_2458542208")
    files = [folder / name for name in ("amica31.ti", "amicaAddendum002.ti")]
    kernels = ", ".join(map(str, files))
    spec = load_scenario("quickstart", [f"camera={{spice: {{instrument: '-130102', kernels: [{kernels}]}}}}"]).spec
    with loaded_kernels(files):
        known = INSTRUMENTS["hayabusa-amica"].camera(INSTRUMENTS["hayabusa-amica"].constants())
    found = spec.camera.camera()
    for name in ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px"):
        assert getattr(found, name) == pytest.approx(getattr(known, name), rel=1e-4)
    assert found.distortion.k1 == pytest.approx(known.distortion.k1, rel=1e-12)
