"""A campaign with a covariance tuned by rehearsals."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from tiny_campaign import RESULTS, SCENE, files, run, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.imaging.world import believed, open_world
from boresight.campaign.products import product_key
from boresight.campaign.products.covariance_tuning import build, rehearsed_scenario
from boresight.campaign.runs.resolve import resolve
from boresight.estimators.contract import NoProductError
from boresight.estimators.tuned import PRODUCT, Rehearsals
from boresight.reports.run.data import read_run
from boresight.scenarios.bodies import load_body
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.onboard import DeclaredSpec

CAMPAIGN = """\
title: A tiny campaign
scenarios: [scene]
estimators:
  - photometric
  - tuned: {base: photometric, tuning: {trials: 20, bodies: 2}}
trials: 6
seed: 5
"""
OPTIONS = Rehearsals(base="photometric", options={}, version=3)
METHODS = """\
    @classmethod
    def from_options(cls, options, assets): return cls()
    def estimate(self, observation, *, rng): ...
"""


def key(folder, *overrides: str) -> str:
    write_campaign(folder)
    return product_key(load_scenario(str(folder / "scene.yaml"), overrides), PRODUCT, OPTIONS, "llvm_ad_mono")


@pytest.mark.parametrize(
    "change",
    [
        "viewpoint.off_pointing_deg=1", "lighting.phase_deg={uniform: [0, 40]}", "detector.psf_sigma_px=1",
        "pose_error={position_cam_m: {normal: [1, 2, 3]}}", "body.detail.seed=4",
        "onboard.declared={sun_error_deg: {normal: 1}}",
    ],
)  # fmt: skip
def test_what_would_change_the_rehearsals_changes_the_key(tmp_path, change):
    assert key(tmp_path, change) != key(tmp_path)


@pytest.mark.parametrize(
    ("onboard", "declared"),
    [
        ({"facets": 5000}, {"facets": 20000, "relief_below_m": 30}),
        ({"relief": {"below_m": 60, "seed": 3}}, {"relief_below_m": 5}),
        ({"height_error": {"rms_m": 4}}, {"height_error": {"rms_m": 4}}),
    ],
)
def test_the_rehearsed_body_is_neither_the_true_one_nor_the_believed(tmp_path, onboard, declared):
    write_campaign(tmp_path)
    true = load_scenario(str(tmp_path / "scene.yaml"), [f"onboard={json.dumps({**onboard, 'declared': declared})}"])
    played = rehearsed_scenario(believed(true), OPTIONS, 0)
    bodies = [load_body(one.spec.body, one.search_dirs).mesh for one in (true, believed(true), played)]
    for other in bodies[:2]:
        if len(other.vertices_m) == len(bodies[2].vertices_m):
            away_m = np.linalg.norm(other.vertices_m - bodies[2].vertices_m, axis=1)
            assert np.sqrt(np.mean(away_m**2)) > 0.1
    assert sum(len(other.vertices_m) == len(bodies[2].vertices_m) for other in bodies[:2])


@pytest.mark.parametrize("onboard", [{}, {"height_error": {"rms_m": 4}}])
def test_the_method_has_the_declared_error_once_and_the_rehearsed_image_none(tmp_path, onboard):
    """An error that the shape on board has already would be relief of the rehearsed images, which tells the method."""
    write_campaign(tmp_path)
    declared = {"height_error": {"rms_m": 4}}
    true = load_scenario(str(tmp_path / "scene.yaml"), [f"onboard={json.dumps({**onboard, 'declared': declared})}"])
    played = rehearsed_scenario(believed(true), OPTIONS, 1)
    assert played.spec.body.height_error is None
    seen, known = (load_body(one.spec.body, one.search_dirs).mesh for one in (played, believed(played)))
    away_m = np.linalg.norm(known.vertices_m - seen.vertices_m, axis=1)
    assert np.sqrt(np.mean(away_m**2)) == pytest.approx(4.0, rel=0.1)


DECLARED = {
    "brdf": {"kind": "oren-nayar"}, "facets": 5000, "relief_below_m": 30.0, "height_error": {"rms_m": 4.0},
    "sun_error_deg": {"normal": 1.0}, "detail": {"facets": 9000},
}  # fmt: skip


def test_rehearsals_have_the_kind_of_the_cameras_artefacts_and_not_its_pattern(tmp_path):
    write_campaign(tmp_path)
    pixels = {"seed": 5, "hot_share": 0.01, "response_sigma": 0.02}
    true = load_scenario(str(tmp_path / "scene.yaml"), [f"detector.pixels={json.dumps(pixels)}"])
    played = [rehearsed_scenario(believed(true), OPTIONS, number).spec.detector for number in (0, 1)]
    assert len({5, *(one.pixels.seed for one in played)}) == 3
    for one in played:
        again = one.model_copy(update={"pixels": one.pixels.model_copy(update={"seed": 5})})
        assert again == true.spec.detector


def test_every_declared_error_changes_the_rehearsals(tmp_path):
    assert DECLARED.keys() == DeclaredSpec.model_fields.keys()
    write_campaign(tmp_path)
    name = str(tmp_path / "scene.yaml")
    played = [
        rehearsed_scenario(believed(load_scenario(name, overrides)), OPTIONS, 0).spec.model_dump_json()
        for overrides in [[], *([f"onboard.declared={json.dumps({key: value})}"] for key, value in DECLARED.items())]
    ]
    assert len(set(played)) == 1 + len(DECLARED)


def test_views_of_real_images_are_rendered_with_relief_that_the_shape_on_board_lacks(tmp_path):
    write_campaign(tmp_path)
    (tmp_path / "set").mkdir()
    cv2.imwrite(str(tmp_path / "set" / "a.png"), np.full((128, 128), 7, dtype=np.uint8))
    columns = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
    poses = [[f"{pose}_{name}" for name in columns] for pose in ("ref", "mine")]
    head = ",".join(["file", "time_s", *poses[0], *poses[1], "sun_body_x", "sun_body_y", "sun_body_z"])
    (tmp_path / "set" / "poses.csv").write_text(f"{head}\na.png,0{2 * ',1,0,0,0,0,0,1800'},0,0,-1\n")
    relief = {"facets": 20000, "roughness": {"rms_m": 4.0, "max_wavelength_m": 60.0, "min_wavelength_m": 20.0}}
    overrides = [
        "viewpoint=null", "lighting=null", "body.detail=null",
        "images={folder: set, also_score: [mine], aligned: [mine]}",
        f"onboard.declared={json.dumps({'detail': relief})}",
    ]  # fmt: skip
    true = load_scenario(str(tmp_path / "scene.yaml"), overrides)
    played = [rehearsed_scenario(believed(true), OPTIONS, number) for number in (0, 1)]
    world = open_world(played[0], "llvm_ad_mono")
    assert world.source.trial_image(3, 0).image.max() > 0.0
    seen = [load_body(one.spec.body, one.search_dirs).mesh for one in played]
    known, on_board = (load_body(one.spec.body, one.search_dirs).mesh for one in (believed(played[0]), true))
    np.testing.assert_array_equal(known.vertices_m, on_board.vertices_m)
    assert np.abs(seen[0].vertices_m - seen[1].vertices_m).max() > 1.0


def test_rehearsed_bodies_have_the_declared_reflectances_in_turn(tmp_path):
    write_campaign(tmp_path)
    laws = [{"kind": "oren-nayar"}, {"kind": "mcewen"}]
    true = load_scenario(str(tmp_path / "scene.yaml"), [f"onboard.declared={json.dumps({'brdf': laws})}"])
    played = [rehearsed_scenario(believed(true), OPTIONS, number).spec.brdf.kind for number in range(4)]
    assert played == ["oren-nayar", "mcewen", "oren-nayar", "mcewen"]


@pytest.mark.parametrize(
    ("laws", "refused"),
    [
        ("[]", "brdf: has no reflectance: leave it out, or give one"),
        ("{kind: x}", "brdf.kind: 'x' is not one of 'lambert'"),
        ("[{kind: mcewen}, {kind: x}]", "brdf[1].kind: 'x' is not one of 'lambert'"),
        ("[{kind: mcewen, albedo: 7}]", "brdf[0].albedo: 7 is not at most 1"),
        ("{kind: mcewen, albedo: 7}", "brdf.albedo: 7 is not at most 1"),
        ("[{kind: mcewen, alb: 0.7}]", "brdf[0].alb: unknown key"),
    ],
)
def test_a_wrong_reflectance_is_one_line(tmp_path, laws, refused):
    write_campaign(tmp_path)
    with pytest.raises(BoresightError) as caught:
        load_scenario(str(tmp_path / "scene.yaml"), [f"onboard.declared={{brdf: {laws}}}"])
    assert f"onboard.declared.{refused}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("overrides", "declared", "refused"),
    [
        ([], {"brdf": 5 * [{"kind": "oren-nayar"}]}, "5 reflectances, and each rehearsed body has one"),
        (["body.detail=null"], {"relief_below_m": 5}, "has no detail: leave facets and relief_below_m out"),
        ([], {"detail": {"facets": 9000}}, "has detail: declare facets and relief_below_m"),
    ],
)
def test_errors_that_the_shape_on_board_cannot_have_are_refused(tmp_path, overrides, declared, refused):
    write_campaign(tmp_path)
    scenario = load_scenario(str(tmp_path / "scene.yaml"), [*overrides, f"onboard.declared={json.dumps(declared)}"])
    with pytest.raises(NoProductError, match=refused):
        build(scenario, OPTIONS, tmp_path, 1, "llvm_ad_mono")


def test_a_base_that_builds_on_another_is_refused_and_one_without_its_sensor(tmp_path, capsys):
    for base, refused in (
        ("tuned", "tuned builds on another itself"),
        ("approach", "approach builds on another itself"),
        ("landmark-altimeter", "sensors.altimeter"),
    ):
        file = write_campaign(tmp_path, CAMPAIGN.replace("base: photometric", f"base: {base}"))
        assert main(["validate", str(file)]) == 2
        assert refused in capsys.readouterr().err


def test_the_file_of_a_base_decides_about_the_run(tmp_path):
    found = []
    for text in (
        "class Mine:\n    name, version = 'mine', 1\n",
        "class Mine:\n    name, version = 'mine', 1  # other\n",
    ):
        (tmp_path / "mine.py").write_text(text + METHODS)
        file = write_campaign(tmp_path, CAMPAIGN.replace("base: photometric", f"base: '{tmp_path}/mine.py:Mine'"))
        found.append(resolve(str(file)).digest)
    assert found[0] != found[1]


def test_the_pose_stays_and_the_covariance_is_scaled_whatever_the_number_of_jobs(tmp_path, monkeypatch):
    scene = SCENE + "pose_error: {position_cam_m: {normal: [20, 20, 5]}}\nonboard: {declared: {relief_below_m: 40}}\n"
    file = write_campaign(tmp_path, CAMPAIGN, scene)
    alone, both = (tmp_path / f"run-{jobs}" for jobs in (1, 2))
    for jobs, folder in ((1, alone), (2, both)):
        monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / f"cache-{jobs}"))  # each makes its own product
        assert run(file, folder, "--jobs", jobs) == 0
    assert files(alone, *RESULTS) == files(both, *RESULTS)
    found = read_run(alone)
    rows = {name: own.set_index("trial") for name, own in found.rows.groupby("estimator")}
    base, tuned = rows["photometric"], rows["tuned"]
    assert (base["status"] == "ok").all()
    for column in ("position_error_m", "attitude_error_deg"):
        np.testing.assert_array_equal(tuned[column], base[column])
    diagnostics = found.table("diagnostics")
    factors = diagnostics[diagnostics["name"] == "covariance_factor"].set_index("trial")["value"]
    assert (abs(factors - 1.0) > 0.1).all()
    # The prior is weak here: nearly all information is the image's.
    np.testing.assert_allclose(tuned["nees"], base["nees"] / factors.loc[tuned.index], rtol=0.05)
