"""Poses and Suns from kernels: closed forms, and camera models that USGS made of real ones."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
import spiceypy
import trimesh
from mission_data import data_path, needs_data
from scipy.spatial.transform import Rotation
from tiny_mission import KERNELS, LENGTH_S, SPICE_SECTION, START_ET, SUN_FROM_BODY_KM, TinyMission, make_mission

from boresight.renderers.images import keep_clear, open_product
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.renderers.mitsuba3.rays import outline_points
from boresight.renderers.spice import INSTRUMENTS, SpiceImageSet
from boresight.scenarios.bodies import load_body
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, RadialDistortion, TriangleMesh, View
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.brdf import LambertSpec
from boresight.scenarios.spec.scenario import ImageSetSpec
from boresight.scenarios.spice import SpiceNames, apparent_geometry, loaded_kernels

AMICA, MSI = data_path("spice/hayabusa_amica_st_2458542208"), data_path("spice/near_msi_m0126888978")
MSI_IMAGE = data_path("images/near_msi/m0126865998f4_2p_iof.lbl")
GOLDEN = data_path("golden/near_msi_pixel_to_latlon.json")
needs_amica = needs_data("spice/hayabusa_amica_st_2458542208")
needs_msi = needs_data("spice/near_msi_m0126888978")
needs_golden = needs_data("golden/near_msi_pixel_to_latlon.json")
AMICA_KERNELS = [
    "naif0012.tls", "pck00009.tpc", "itokawa_gaskell_n3.tpc", "hayabusa_hp.tf", "itokawa_fixed.tf", "amica31.ti",
    "amicaAddendum002.ti", "hayabusa.tsc", "hayabusa_itokawarendezvous_v02n_1_sliced_-130000.bc",
    "st_2458542208_v.ale_0.bsp", "st_2458542208_v.ale_1.bsp",
]  # fmt: skip
MSI_KERNELS = [
    "naif0012.tls", "pck00009.tpc", "eros_fixed.tf", "msi15.ti", "msiAddendum002.ti", "near_171.tsc",
    "near_2000056_v01_0_sliced_-93000.bc", "near_2000056_v01_1_sliced_-93000.bc", "m0126888978f7_2p_isis_0.bsp",
    "m0126888978f7_2p_isis_1.bsp",
]  # fmt: skip
HAYABUSA = SpiceNames("HAYABUSA", "HAYABUSA_AMICA", "ITOKAWA", "ITOKAWA_FIXED")
NEAR = SpiceNames("NEAR", "NEAR_MSI", "EROS", "EROS_FIXED")
LIGHT_KM_S = 299792.458


def arcsec(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)) * 3600.0)


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> TinyMission:
    return make_mission(tmp_path_factory.mktemp("mission"))


# --- geometry ----------------------------------------------------------------------------------------------------


def test_the_geometric_pose_is_the_closed_form(mission):
    et = START_ET + 1234.5
    with loaded_kernels(mission.kernels):
        found = apparent_geometry(HAYABUSA, et, "NONE")
    R_body_j2000 = mission.R_body_j2000(et)
    np.testing.assert_allclose(found.T_cam_body.rotation, mission.R_cam_j2000 @ R_body_j2000.T, atol=1e-12)
    expected_m = 1e3 * mission.R_cam_j2000 @ mission.body_from_craft_km
    np.testing.assert_allclose(found.T_cam_body.translation_m, expected_m, atol=1e-4)
    assert found.T_cam_body.translation_m[2] > 7900


def test_side_by_side_light_time_and_aberration_cancel_but_neither_is_small(mission):
    """30 km/s over 8 km of light: each alone displaces the body by 20 arcsec, both together by some (v / c)^2."""
    et = START_ET + 1234.5
    with loaded_kernels(mission.kernels):
        geometric, apparent = apparent_geometry(HAYABUSA, et, "NONE"), apparent_geometry(HAYABUSA, et)
        late, _ = spiceypy.spkpos("ITOKAWA", et, "J2000", "LT", "HAYABUSA")
    directions = [one.T_cam_body.translation_m for one in (geometric, apparent)]
    assert arcsec(*directions) < 0.02
    assert arcsec(mission.R_cam_j2000 @ late, directions[0]) > 10.0
    # The range is that of the light: longer by the part of the velocity along the line of sight over c.
    speed = np.array([10.0, 25.0, 13.0]) @ mission.body_from_craft_km / 8.0
    longer = np.linalg.norm(directions[1]) / np.linalg.norm(directions[0]) - 1.0
    assert longer == pytest.approx(-speed / LIGHT_KM_S, rel=1e-3)


def test_the_sun_is_where_it_appears_from_the_body(mission):
    """To a milliarcsecond the geometric direction turned towards the velocity by v / c of its part across."""
    et = START_ET + 1234.5
    with loaded_kernels(mission.kernels):
        found = apparent_geometry(HAYABUSA, et)
    moved = SUN_FROM_BODY_KM - 1234.5 * np.array([10.0, 25.0, 13.0])
    geometric = moved / np.linalg.norm(moved)
    aberrated = geometric + np.array([10.0, 25.0, 13.0]) / LIGHT_KM_S
    expected = mission.R_body_j2000(et - 8.0 / LIGHT_KM_S) @ (aberrated / np.linalg.norm(aberrated))
    assert arcsec(found.sun_dir_body, expected) < 0.005
    assert arcsec(geometric, aberrated) > 5.0


# --- kernels -----------------------------------------------------------------------------------------------------


def test_nothing_stays_in_the_pool(mission):
    before = spiceypy.ktotal("ALL")
    with loaded_kernels(mission.kernels):
        assert spiceypy.ktotal("ALL") == before + len(KERNELS)
    assert spiceypy.ktotal("ALL") == before
    with pytest.raises(BoresightError, match=r"SPICE: .*LEAPSECONDS"), loaded_kernels([]):
        spiceypy.str2et("2005-10-01")


def test_what_is_wrong_inside_unloads_too(mission):
    before = spiceypy.ktotal("ALL")
    with (
        pytest.raises(BoresightError, match=r"SPKINSUFFDATA.*ephemeris data") as error,
        loaded_kernels(mission.kernels),
    ):
        apparent_geometry(HAYABUSA, START_ET - 1e6)
    assert "\n" not in str(error.value)
    with pytest.raises(ZeroDivisionError), loaded_kernels(mission.kernels):
        1 / 0  # noqa: B018
    assert spiceypy.ktotal("ALL") == before


def test_files_that_are_no_kernels(mission, tmp_path):
    (tmp_path / "a.bsp").write_text("nothing")
    (tmp_path / "a.tm").write_text("KPL/MK\n")
    for path, message in (
        (tmp_path / "b.bsp", "no such kernel"), (tmp_path / "a.tm", "instead of this meta-kernel"),
        (tmp_path / "a.bsp", "not a kernel that SPICE reads"),
    ):  # fmt: skip
        with pytest.raises(BoresightError, match=message), loaded_kernels([*mission.kernels, path]):
            pass
    assert spiceypy.ktotal("ALL") == 0


def test_a_later_kernel_overrides_an_earlier(mission, tmp_path):
    other = tmp_path / "other.tpc"
    other.write_text("KPL/PCK\n\\begindata\nBODY2025143_PM = ( 0.0 0.0 0.0 )\n\\begintext\n")
    et = START_ET + 100.0
    with loaded_kernels([*mission.kernels, other]):
        still = apparent_geometry(HAYABUSA, et)
    with loaded_kernels([other, *mission.kernels]):
        turning = apparent_geometry(HAYABUSA, et)
    with loaded_kernels(mission.kernels):
        alone = apparent_geometry(HAYABUSA, et)
    np.testing.assert_array_equal(turning.T_cam_body.rotation, alone.T_cam_body.rotation)
    assert still.T_cam_body.angle_to(alone.T_cam_body) > 0.1


def test_threads_with_different_kernels_do_not_mix(mission, tmp_path):
    turned = make_mission(tmp_path / "turned", off_deg=(2.0, 1.0, -40.0))
    found: dict[int, list[np.ndarray]] = {0: [], 1: []}

    def work(which: int, one: TinyMission) -> None:
        for _ in range(20):
            with loaded_kernels(one.kernels):
                found[which].append(apparent_geometry(HAYABUSA, START_ET + 5.0, "NONE").T_cam_body.translation_m)

    threads = [threading.Thread(target=work, args=(k, one)) for k, one in enumerate((mission, turned))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for which, one in enumerate((mission, turned)):
        expected = 1e3 * one.R_cam_j2000 @ one.body_from_craft_km
        np.testing.assert_allclose(found[which], np.tile(expected, (20, 1)), atol=1e-4)


# --- image sets --------------------------------------------------------------------------------------------------

CAMERA = Camera(64, 64, 120.8 / 0.192, 120.8 / 0.192, 32.0, 32.0, RadialDistortion(-2.8e-5 * 120.8**2))


def open_set(mission: TinyMission, camera: Camera = CAMERA, **keys: object) -> SpiceImageSet:
    spice = {**SPICE_SECTION, "kernels": list(KERNELS), **keys}
    return SpiceImageSet.open(ImageSetSpec.model_validate({"folder": str(mission.folder), "spice": spice}), camera)


def pixels() -> np.ndarray:
    return np.arange(64.0 * 64.0).reshape(64, 64)


def test_views_are_those_of_the_middle_of_the_exposure(tmp_path):
    mission = make_mission(tmp_path)
    mission.write_image("st_2_v", pixels(), clock=600.0, exposure_s=100.0)
    mission.write_image("st_1_v", pixels(), clock=300.0, exposure_s=0.0)
    images = open_set(mission, aberration="NONE")
    assert images.names == ("st_1_v.fit", "st_2_v.fit")
    assert [images.time_s(k) - START_ET for k in range(2)] == pytest.approx([300.0, 650.0], abs=1e-6)
    for index, et in enumerate((300.0, 650.0)):
        expected = mission.R_cam_j2000 @ mission.R_body_j2000(START_ET + et).T
        np.testing.assert_allclose(images.view(index).T_cam_body.rotation, expected, atol=1e-10)
    np.testing.assert_array_equal(images.image(0), pixels())  # the first stored line is the top one
    assert images.view(0).camera == CAMERA
    assert spiceypy.ktotal("ALL") == 0


def test_images_that_are_of_no_use_are_left_out_with_the_reason(tmp_path):
    mission = make_mission(tmp_path)
    mission.write_image("a_good", pixels(), 10.0)
    mission.write_image("b_sky", pixels(), 20.0, target="SKY")
    mission.write_image("c_other", pixels(), 30.0, instrument="ONC-W1")
    mission.write_image("d_late", pixels(), LENGTH_S + 100.0)
    mission.write_image("e_part", pixels()[:32], 40.0, size=32)
    images = open_set(mission)
    assert images.names == ("a_good.fit",)
    reasons = dict(images.left_out)
    assert reasons["b_sky.fit"] == "its target is SKY, not ITOKAWA"
    assert reasons["c_other.fit"] == "its instrument is ONC-W1, not AMICA"
    assert "SPICE(NOFRAMECONNECT)" in reasons["d_late.fit"]
    assert reasons["e_part.fit"] == "it is 32 x 32 pixels, not the whole field"
    assert not any("\n" in reason for reason in reasons.values())
    with pytest.raises(BoresightError, match=r"none of 1 images can be used: b_sky.fit: its target is SKY"):
        open_set(mission, files="b*.lbl")


def test_faults_of_a_set(tmp_path):
    mission = make_mission(tmp_path)
    mission.write_image("a", pixels(), 10.0)
    for keys, message in (
        ({"instrument": "hayabusa2-onc"}, "hayabusa2-onc is not known; these are: hayabusa-amica, near-msi"),
        ({"files": "*.img"}, r"no file matches '\*.img'"),
        ({"kernels": ["gone.bsp"]}, "images.spice.kernels: gone.bsp was not found"),
        ({"kernels": ["naif.tls"]}, "INS-130102_PIXEL_SAMPLES: not in the kernels"),
    ):
        with pytest.raises(BoresightError, match=message):
            open_set(mission, **keys)
    with pytest.raises(BoresightError, match=r"up to .* off that of the kernels: write focal_px: \[629.16"):
        open_set(mission, CAMERA.pinhole)
    with pytest.raises(BoresightError, match="64 x 48 pixels, but hayabusa-amica has 64 x 64"):
        open_set(mission, Camera(64, 48, 600.0, 600.0, 32.0, 24.0))


def test_without_its_clock_the_time_of_an_amica_image_is_not_known(tmp_path):
    mission = make_mission(tmp_path)
    mission.write_image("a", pixels(), 10.0)
    file = tmp_path / "a.fit"
    file.write_bytes(file.read_bytes().replace(b"TI_0 ", b"TI_X "))
    with pytest.raises(BoresightError, match="no TI_0, the clock at the start"):
        open_set(mission)


def test_the_digest_covers_kernels_labels_and_pixels(tmp_path):
    mission = make_mission(tmp_path)
    mission.write_image("a", pixels(), 10.0)
    seen = {open_set(mission).content_digest()}
    for name, old, new in (
        ("a.lbl", b"0.02", b"0.03"),
        ("a.fit", b"LOSS-LESS", b"LOSSY    "),
        ("tiny.tf", b"130.0", b"131.0"),
    ):
        file = tmp_path / name
        content = file.read_bytes()
        assert old in content
        file.write_bytes(content.replace(old, new))
        seen.add(open_set(mission).content_digest())
    assert len(seen) == 4


def test_images_with_the_body_in_a_part_to_keep_clear_are_left_out(tmp_path):
    """A ball of 100 m at 8 km is 7.9 pixels wide: in the middle of the lower edge here, and gone from it there."""
    low = make_mission(tmp_path / "low", off_deg=(-2.2, 0.0, 0.0))
    low.write_image("a", pixels(), 10.0)
    images = open_set(low)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    outline = outline_points(TriangleMesh(ball.vertices, ball.faces))
    centre = CAMERA.project(images.view(0).T_cam_body.translation_m)
    assert centre[0] == pytest.approx(32.0, abs=0.01)
    edge = 64.0 - centre[1]
    assert 5.0 < edge < 10.0
    kept = keep_clear(images, outline, [(0.0, centre[1] + 4.1, 64.0, 64.0)])
    assert (kept.names, kept.left_out, len(kept)) == (images.names, (), 1)
    with pytest.raises(
        BoresightError, match=r"no image remains of 1: a.fit: the body reaches .* which must stay clear"
    ):
        keep_clear(images, outline, [(0.0, centre[1] + 3.7, 64.0, 64.0)])


# --- real kernels ------------------------------------------------------------------------------------------------


def usgs(folder: Path) -> tuple[dict, np.ndarray, Pose, np.ndarray]:
    """A camera model by USGS (ALE): instant, J2000 to body, pose, and the Sun from the body in its frame."""
    model = json.loads((folder / "isd.json").read_text())
    R_body_j2000 = spiceypy.q2m(model["body_rotation"]["quaternions"][0])
    pointing = model["instrument_pointing"]
    R_cam_j2000 = np.reshape(pointing["constant_rotation"], (3, 3)) @ spiceypy.q2m(pointing["quaternions"][0])
    rotation = R_cam_j2000 @ R_body_j2000.T
    position_m = 1e3 * R_body_j2000 @ model["instrument_position"]["positions"][0]
    sun = R_body_j2000 @ model["sun_position"]["positions"][0]
    return model, R_body_j2000, Pose(rotation, -rotation @ position_m), sun


@needs_amica
def test_amica_agrees_with_the_camera_model_of_usgs():
    """USGS takes the geometric position for AMICA; with light time and aberration 0.17 m and 0.005 arcsec differ."""
    model, _, theirs, sun = usgs(AMICA)
    et = model["center_ephemeris_time"]
    assert et == 182502855.87767982
    with loaded_kernels([AMICA / name for name in AMICA_KERNELS]):
        geometric, apparent = apparent_geometry(HAYABUSA, et, "NONE"), apparent_geometry(HAYABUSA, et)
        clock = spiceypy.scs2e(-130, "2457499394")
    assert clock + 0.5 * 0.0218 == pytest.approx(et, abs=1e-6)
    position_m = theirs.camera_position_m
    assert np.linalg.norm(geometric.T_cam_body.camera_position_m - position_m) < 1e-8
    assert np.degrees(geometric.T_cam_body.angle_to(theirs)) * 3600 < 1e-6
    assert arcsec(geometric.sun_dir_body, sun) < 1e-6
    assert np.linalg.norm(apparent.T_cam_body.camera_position_m - position_m) == pytest.approx(0.170, abs=0.001)
    assert arcsec(apparent.T_cam_body.camera_position_m, position_m) < 0.005
    assert np.degrees(apparent.T_cam_body.angle_to(theirs)) * 3600 < 0.001


@needs_amica
def test_the_order_of_kernels_decides_between_two_rotation_models():
    """pck00009.tpc and the shape's own pole disagree by far more than a pixel."""
    model, _, theirs, _ = usgs(AMICA)
    wrong = ["itokawa_gaskell_n3.tpc", *(name for name in AMICA_KERNELS if name != "itokawa_gaskell_n3.tpc")]
    with loaded_kernels([AMICA / name for name in wrong]):
        assert apparent_geometry(HAYABUSA, model["center_ephemeris_time"]).T_cam_body.angle_to(theirs) > 0.1


@needs_amica
def test_amicas_camera_is_that_of_its_kernel_and_of_ishiguro():
    amica = INSTRUMENTS["hayabusa-amica"]
    with loaded_kernels([AMICA / name for name in AMICA_KERNELS]):
        camera = amica.camera(amica.constants())
        _, frame, boresight, _, corners = spiceypy.getfov(-130102, 8)
    assert frame == "HAYABUSA_AMICA"
    np.testing.assert_array_equal(boresight, [0, 0, 1])
    np.testing.assert_allclose([camera.fx_px, camera.fy_px], 120.8 / 0.012)
    # Corners of the kernel's field, whose focal length is 120.47 mm: 1.4 px further out than 120.8 mm and the lens.
    seen = camera.project(np.array(corners))
    expected = np.where(np.array(corners)[:, :2] > 0, 1024.0, 0.0)
    assert np.linalg.norm(seen - expected, axis=1).max() < 5.0
    assert np.allclose(seen + seen[[2, 3, 0, 1]], 1024.0)  # symmetric about the middle
    r_mm = np.hypot(*(camera.pinhole.project(np.array(corners[0])) - 512.0)) * 0.012
    ishiguro = 1.0 - 2.8e-5 * (np.hypot(*(seen[0] - 512.0)) * 0.012) ** 2
    assert r_mm == pytest.approx(ishiguro * np.hypot(*(seen[0] - 512.0)) * 0.012, rel=1e-9)


@needs_msi
def test_msi_agrees_with_the_camera_model_of_usgs():
    """Light time and aberration as USGS; its body is not turned back by the light time, 0.08 arcsec of Eros' spin."""
    model, _, theirs, sun = usgs(MSI)
    et = model["center_ephemeris_time"]
    with loaded_kernels([MSI / name for name in MSI_KERNELS]):
        apparent = apparent_geometry(NEAR, et)
        start = spiceypy.str2et("2000-02-25T11:39:11.972")
        _, light_s = spiceypy.spkpos("EROS", et, "J2000", "LT+S", "NEAR")
    assert start + 0.5 * 0.765 == pytest.approx(et, abs=1e-3)
    difference_m = apparent.T_cam_body.camera_position_m - theirs.camera_position_m
    assert np.linalg.norm(apparent.T_cam_body.translation_m) == pytest.approx(np.linalg.norm(theirs.translation_m))
    spin_rad_s = np.radians(1639.38864745) / 86400.0
    assert apparent.T_cam_body.angle_to(theirs) == pytest.approx(spin_rad_s * light_s, rel=1e-3)
    assert np.linalg.norm(difference_m) < 1.01 * spin_rad_s * light_s * np.linalg.norm(theirs.translation_m)
    assert arcsec(apparent.sun_dir_body, sun) < 0.1


def msi_camera() -> Camera:
    msi = INSTRUMENTS["near-msi"]
    with loaded_kernels([MSI / "msi15.ti", MSI / "msiAddendum002.ti"]):
        return msi.camera(msi.constants())


def golden_views() -> tuple[dict, View]:
    model = json.loads(data_path(json.loads(GOLDEN.read_text())["isd"]).read_text())
    R_body_j2000 = spiceypy.q2m(model["body_rotation"]["quaternions"][0])
    pointing = model["instrument_pointing"]
    R_cam_j2000 = np.reshape(pointing["constant_rotation"], (3, 3)) @ spiceypy.q2m(pointing["quaternions"][0])
    rotation = R_cam_j2000 @ R_body_j2000.T
    position_m = 1e3 * R_body_j2000 @ model["instrument_position"]["positions"][0]
    return json.loads(GOLDEN.read_text()), View(msi_camera(), Pose(rotation, -rotation @ position_m), position_m)


def golden_pixel(point: dict) -> np.ndarray:
    """From ISIS, which has 412 lines counted from 1 at the other end, to the lines of the file."""
    return np.array([point["sample"] - 0.5, (412.5 - point["line"]) * 244 / 412])


def lat_lon_deg(point: np.ndarray) -> np.ndarray:
    return np.degrees([np.arctan2(point[2], np.hypot(point[0], point[1])), np.arctan2(point[1], point[0])])


@needs_golden
@needs_msi
def test_msi_pixels_fall_where_isis_says_on_the_ellipsoid():
    """Latitude and longitude of ISIS's own tests, to its 1e-5 deg: 3 m of 17 km, a twentieth of a pixel."""
    golden, view = golden_views()
    radii = np.array([17e3, 5.5e3, 5.5e3])
    for point in golden["points"]:
        origin = view.T_cam_body.camera_position_m
        direction = view.T_cam_body.rotation.T @ view.camera.unproject(golden_pixel(point))
        p, d = origin / radii, direction / radii
        t = (-(p @ d) - np.sqrt((p @ d) ** 2 - (d @ d) * (p @ p - 1.0))) / (d @ d)
        np.testing.assert_allclose(lat_lon_deg(origin + t * direction), [point["lat"], point["lon_e"]], atol=2e-5)


@needs_golden
@needs_msi
def test_msi_pixels_fall_there_through_the_ray_tracer_too():
    """The same ellipsoid as a mesh of 81,920 facets; on the shape of Eros the points are elsewhere."""
    golden, view = golden_views()
    ball = trimesh.creation.icosphere(subdivisions=6)
    ellipsoid = TriangleMesh(ball.vertices * [17e3, 5.5e3, 5.5e3], ball.faces)
    uv = np.array([golden_pixel(point) for point in golden["points"]])
    hits = MitsubaRenderer(ellipsoid, LambertSpec(), 1).surface(view, uv)
    for point, seen in zip(golden["points"], hits.points_body_m, strict=True):
        np.testing.assert_allclose(lat_lon_deg(seen), [point["lat"], point["lon_e"]], atol=0.05)


@needs_msi
def test_the_state_of_the_catalogue_is_that_of_the_kernels():
    """The table of near-eros against kernels in its place, to its rounding: 5 m, a microradian, and the Sun."""
    at = "2000-02-25T11:39:12.3545"
    flown = {
        "spice": {
            "kernels": [f"near_msi_m0126888978/{name}" for name in MSI_KERNELS], "observer": "NEAR", "target": "EROS",
            "target_frame": "EROS_FIXED", "camera_frame": "NEAR_MSI", "start_utc": at, "stop_utc": at, "step_s": 1,
        }
    }  # fmt: skip
    table = load_scenario("near-eros").spec.viewpoint.states
    kernels = load_scenario("near-eros", [f"viewpoint.trajectory={json.dumps(flown)}"]).spec.viewpoint.states
    np.testing.assert_allclose(table.time_s, kernels.time_s, atol=6e-3)
    np.testing.assert_allclose(table.position_m, kernels.position_m, atol=6.0)
    np.testing.assert_allclose(table.velocity_m_s, kernels.velocity_m_s, atol=6e-4)
    np.testing.assert_allclose(table.attitude, kernels.attitude, atol=1e-6)
    np.testing.assert_allclose(table.sun_dir, kernels.sun_dir, atol=6e-5)


def eros() -> TriangleMesh:
    return load_body(BodySpec(shape="eros022540.tab", unit="km", expected_diameter_m=(1e4, 5e4))).mesh


@needs_data("images/near_msi/m0126865998f4_2p_iof.lbl")
@needs_msi
def test_the_stored_order_of_an_msi_image_is_that_of_the_camera_and_not_that_of_its_display():
    """A rendering of Eros at the pose of the header, against the real image in the four orders there are."""
    product = open_product(MSI_IMAGE)
    header = product.keywords
    quaternion = [header[f"NEAR-0{k}"] for k in (19, 20, 21, 22)]
    craft, target = ([header[f"NEAR-0{k}"] for k in axes] for axes in ((23, 24, 25), (27, 28, 29)))
    msi = INSTRUMENTS["near-msi"]
    with loaded_kernels([MSI / name for name in MSI_KERNELS[:6]]):
        et = msi.middle_et(product)
        R_body_j2000 = spiceypy.pxform("J2000", "EROS_FIXED", et)
        R_msi_craft = spiceypy.pxform("NEAR_SC_BUS_PRIME", "NEAR_MSI", et)
    rotation = R_msi_craft @ spiceypy.q2m(quaternion) @ R_body_j2000.T
    position_m = 1e3 * R_body_j2000 @ np.subtract(craft, target)
    view = View(msi_camera(), Pose(rotation, -rotation @ position_m), -R_body_j2000 @ np.array(target))
    rendered = MitsubaRenderer(eros(), LambertSpec()).render(view)
    image = product.pixels()
    assert product.metadata().line_display == "up"

    def best(order: np.ndarray) -> float:
        """Largest correlation within 20 pixels: the header's pose is about a pixel off."""
        part = rendered[20:-20, 20:-20]
        return float(cv2.matchTemplate(np.ascontiguousarray(order), part, cv2.TM_CCOEFF_NORMED).max())

    assert best(image) > 0.97
    assert max(best(image[::-1]), best(image[:, ::-1]), best(image[::-1, ::-1])) < 0.6


@needs_amica
def test_kernels_of_two_missions_take_turns():
    et = usgs(AMICA)[0]["center_ephemeris_time"]
    other = usgs(MSI)[0]["center_ephemeris_time"]
    poses = []
    for _ in range(2):
        with loaded_kernels([AMICA / name for name in AMICA_KERNELS]):
            poses.append(apparent_geometry(HAYABUSA, et).T_cam_body.rotation)
        with loaded_kernels([MSI / name for name in MSI_KERNELS]):
            apparent_geometry(NEAR, other)
            with pytest.raises(BoresightError, match="INS-130102_FOCAL_LENGTH: not in the kernels"):
                INSTRUMENTS["hayabusa-amica"].constants().number("FOCAL_LENGTH")
    np.testing.assert_array_equal(*poses)


def test_rotations_of_the_tiny_mission_are_spices(mission):
    """The closed form of the tests against SPICE itself."""
    with loaded_kernels(mission.kernels):
        theirs = spiceypy.pxform("J2000", "ITOKAWA_FIXED", START_ET + 77.0)
    assert Rotation.from_matrix(theirs @ mission.R_body_j2000(START_ET + 77.0).T).magnitude() < 1e-11
