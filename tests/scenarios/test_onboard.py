from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.scenarios.bodies.embedded import EMBEDDED
from boresight.scenarios.bodies.load import with_height_error
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import look_at
from boresight.scenarios.load import load_scenario
from boresight.scenarios.onboard import onboard_attitude, onboard_camera, onboard_spec, onboard_sun_dir
from boresight.scenarios.spec.body import HeightErrorSpec
from boresight.scenarios.spec.onboard import OnboardSpec

SUN = np.array([0.48, 0.36, -0.8])


def quickstart(*overrides: str):
    return load_scenario("quickstart", overrides).spec


def test_onboard_model_is_the_truth_by_default():
    spec = quickstart()
    believed = onboard_spec(spec)
    assert believed == spec
    assert onboard_camera(spec) == spec.camera.camera()


def test_only_the_given_keys_differ_on_board():
    spec = quickstart("onboard.facets=50000", "onboard.brdf={kind: oren-nayar}", "onboard.focal_error=0.01")
    believed = onboard_spec(spec)
    assert believed.body.detail.facets == 50000
    assert believed.body.detail.boulders == spec.body.detail.boulders
    assert believed.brdf.kind == "oren-nayar"
    np.testing.assert_allclose(believed.camera.camera().fx_px, 1.01 * spec.camera.camera().fx_px)
    assert believed.viewpoint == spec.viewpoint


def test_small_relief_on_board_may_be_another():
    spec = quickstart("onboard.relief={below_m: 9, seed: 4}")
    believed = onboard_spec(spec).body.detail
    assert (believed.redrawn.below_m, believed.redrawn.seed) == (9.0, 4)
    assert spec.body.detail == believed.model_copy(update={"redrawn": None})


def test_the_lens_may_be_known_wrongly_or_not_at_all():
    lens = "camera.distortion={k1: -0.4, k2: 0.1}"
    half = onboard_camera(quickstart(lens, "onboard.distortion_error=-0.5", "onboard.focal_error=0.01"))
    assert (half.distortion.k1, half.distortion.k2) == pytest.approx((-0.2, 0.05))
    none = onboard_camera(quickstart(lens, "onboard.distortion_error=-1"))
    uv = np.array([[3.0, 500.0]])
    np.testing.assert_allclose(none.distorted(uv), uv, atol=1e-9)
    with pytest.raises(BoresightError, match="camera has no distortion"):
        quickstart("onboard.distortion_error=-1")


@pytest.mark.parametrize(
    "overrides",
    [
        ("onboard.body={shape: sphere}", "onboard.facets=5000"),
        ("onboard.facets=5000", "body={shape: sphere, detail: null}"),
        ("onboard.body={shape: sphere}", "onboard.relief={below_m: 9, seed: 4}"),
        ("onboard.relief={below_m: 9, seed: 4}", "body={shape: sphere, detail: null}"),
    ],
)
def test_an_onboard_shape_given_twice_is_refused(overrides):
    with pytest.raises(BoresightError, match="onboard"):
        quickstart(*overrides)


def test_the_sun_is_wrong_by_the_angle_in_all_directions():
    onboard = OnboardSpec.model_validate({"sun_error_deg": {"uniform": [3.0, 3.0]}})
    suns = np.array([onboard_sun_dir(SUN, onboard, np.random.default_rng(seed)) for seed in range(400)])
    np.testing.assert_allclose(np.linalg.norm(suns, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.degrees(np.arccos(suns @ SUN)), 3.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(suns.mean(axis=0) / np.cos(np.radians(3.0)) - SUN), 0.0, atol=0.01)


def test_a_phase_error_turns_about_the_pole_and_a_tilt_moves_it():
    pose = look_at(np.array([1500.0, 800.0, 300.0]), 0.3)
    phase = OnboardSpec.model_validate({"rotation_error_deg": {"uniform": [2.0, 2.0]}})
    turned = onboard_attitude(pose, phase, np.random.default_rng(1))
    between = Rotation.from_matrix(pose.rotation.T @ turned.rotation).as_rotvec(degrees=True)
    np.testing.assert_allclose(between, [0.0, 0.0, 2.0], atol=1e-9)
    np.testing.assert_array_equal(turned.translation_m, pose.translation_m)
    tilt = OnboardSpec.model_validate({"pole_error_deg": {"uniform": [2.0, 2.0]}})
    tilted = onboard_attitude(pose, tilt, np.random.default_rng(1))
    pole = pose.rotation.T @ tilted.rotation @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(np.degrees(np.arccos(pole[2])), 2.0, atol=1e-6)


def test_heights_are_wrong_by_their_rms_along_the_normals():
    mesh = EMBEDDED["sphere"]()
    wrong = with_height_error(mesh, HeightErrorSpec(rms_m=2.0, max_wavelength_m=200.0, min_wavelength_m=50.0))
    moved = np.linalg.norm(wrong.vertices_m, axis=1) - np.linalg.norm(mesh.vertices_m, axis=1)
    assert moved.std() == pytest.approx(2.0, rel=0.05)
    assert np.linalg.norm(wrong.vertices_m - mesh.vertices_m, axis=1).std() > 0.0
    # Waves that are too short for the mesh are left out, and the others have the whole RMS.
    coarse = with_height_error(
        mesh, HeightErrorSpec(rms_m=2.0, max_wavelength_m=200.0, min_wavelength_m=0.5, hurst=0.1)
    )
    assert np.linalg.norm(coarse.vertices_m - mesh.vertices_m, axis=1).std() > 0.0
    moved = np.linalg.norm(coarse.vertices_m, axis=1) - np.linalg.norm(mesh.vertices_m, axis=1)
    assert moved.std() == pytest.approx(2.0, rel=0.05)
    again = with_height_error(mesh, HeightErrorSpec(rms_m=2.0, max_wavelength_m=200.0, min_wavelength_m=50.0))
    np.testing.assert_array_equal(again.vertices_m, wrong.vertices_m)
