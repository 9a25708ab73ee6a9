"""Keys that a kind of trial does not use are refused where they are given, in one line."""

import pytest

from boresight.campaign.cli import main
from boresight.campaign.runs.unused import check_used, widest_kind
from boresight.campaign.trial.kind import kind_named
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario

CAMERA = "detector={bits: 8, gain_e_per_dn: 400, jpeg_quality: 10}"
TRACKS = """
camera: {width_px: 64, height_px: 64, fov_deg: 30}
sequence: {sphere_radius_m: 190, orbit: {step_deg: 6, revolutions: 0.2}}
"""


def check(scenario: str, kind: str, *overrides: str) -> None:
    check_used(load_scenario(scenario, overrides), kind_named(kind))


@pytest.mark.parametrize(
    ("campaign", "kind"), [("delpech2015-smoke", "sequence"), ("orbit-smoke", "orbit-determination")]
)
def test_validate_refuses_a_detector_where_no_image_is_made(campaign, kind, capsys):
    assert main(["validate", campaign, "--set", CAMERA]) == 2
    said = capsys.readouterr().err.strip()
    assert said.endswith(f"--set {CAMERA}: detector: has no effect in {kind}: leave it out")
    assert "\n" not in said


def test_the_line_of_a_file_is_named_and_all_keys(tmp_path):
    file = tmp_path / "tracks.yaml"
    file.write_text(TRACKS + "brdf: {kind: oren-nayar}\nbody: {shape: sphere}\n")
    with pytest.raises(BoresightError, match=r"tracks.yaml:4: brdf, body: have no effect in sequence: leave them out$"):
        check(str(file), "sequence")


def test_what_is_inherited_from_a_file_of_another_kind_may_be_set_to_null(tmp_path):
    (tmp_path / "views.yaml").write_text("camera: {fov_deg: 30}\nviewpoint: {range_m: 2000}\nbrdf: {kind: mcewen}\n")
    file = tmp_path / "tracks.yaml"
    file.write_text(f"extends: views.yaml\n{TRACKS}")
    with pytest.raises(BoresightError, match=r"views.yaml:3: brdf: .*, or say brdf: null in .*tracks.yaml$"):
        check(str(file), "sequence")
    file.write_text(f"extends: views.yaml\nbrdf: null\n{TRACKS}")
    check(str(file), "sequence")


def test_the_value_of_a_key_that_is_left_out_is_no_key(tmp_path):
    file = tmp_path / "tracks.yaml"
    file.write_text(TRACKS + "rendering: {samples_per_pixel: 4}\n")
    check(str(file), "sequence")


def test_files_of_the_catalogue_are_as_they_are_and_overrides_of_them_are_not():
    check("apophis-sphere-sequence", "sequence")
    check("eros-like-navigation", "crater-navigation")
    for key in ("pose_error.attitude={angle_deg: {normal: 2}}", "lighting.phase_deg=9"):
        with pytest.raises(BoresightError, match=rf"--set {key.split('.')[0]}"):
            check("eros-like-navigation", "crater-navigation", key)


def test_a_file_may_serve_several_kinds_and_an_override_serves_one(tmp_path):
    file = tmp_path / "views.yaml"
    file.write_text("camera: {fov_deg: 30}\nviewpoint: {range_m: 2000}\ndetector: {bits: 10}\n")
    check(str(file), "landmark-database")
    with pytest.raises(BoresightError, match=r"--set detector.bits=9: detector: has no effect in landmark-database"):
        check(str(file), "landmark-database", "detector.bits=9")


@pytest.mark.parametrize(
    ("overrides", "kind"),
    [
        ((), "orbit-determination"),
        (("orbit.imaging.detections=drawn",), "crater-navigation"),
        (
            (
                "orbit.imaging.epochs=9",
                "orbit.arc.days=1",
                "orbit.arc.approach={range_m: 1e6, speed_m_s: 3, miss_m: 2000}",
            ),
            "approach-orbit",
        ),
    ],
)
def test_the_widest_kind_of_an_orbit_is_that_of_its_images(overrides, kind):
    assert widest_kind(load_scenario("eros-like-orbit", overrides).spec) == kind
