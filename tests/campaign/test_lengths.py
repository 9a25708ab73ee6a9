"""Lengths that are left out follow from the pixels or the body, the papers' from no more than what their files say."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tiny_campaign import SCENE

from boresight.campaign.cli import main
from boresight.campaign.imaging.preview import images_of, preview, signal_in_words
from boresight.campaign.imaging.world import check_bodies
from boresight.campaign.runs import check
from boresight.campaign.runs.read import campaign_names, read_campaign
from boresight.campaign.runs.resolve import of_scenario
from boresight.campaign.trial.kind import kind_named
from boresight.estimators.pages import FAMILIES
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.load.lengths import Scale, dotted
from boresight.scenarios.spec.base import SpecModel, rule_of
from boresight.scenarios.spec.camera import DetectorSpec

NO_DETAIL = "body.detail=null"
CORNERS_GIVEN = {"database": {"corners": {"count": 50}}}
UNUSED = {"motion_position_sigma_m"}
"""Lengths that no campaign of the catalogue makes use of: those with ``motion: constant-gain``."""


def lengths(overrides, name, options, experiment="single-image", scenario="quickstart"):
    """Lengths that a method's options leave out in a scenario, by dotted key."""
    loaded = load_scenario(scenario, overrides)
    campaign = of_scenario(loaded, {name: options}, experiment, 1, "")
    kind = kind_named(experiment)
    found = dict(dotted(kind.lengths(campaign.spec.estimators[0], loaded)))
    kind.entries(campaign, loaded)
    return found


@pytest.mark.parametrize(("range_m", "fov_deg"), [(1000.0, 5.0), (3e6, 20.0)])
def test_clusters_are_as_many_pixels_at_any_range(range_m, fov_deg):
    given = (f"viewpoint.range_m={range_m}", f"camera.fov_deg={fov_deg}")
    m_per_px = range_m * np.tan(np.radians(fov_deg / 2)) / 256
    found = lengths(given, "landmark-harris", {})
    assert found["database.clusters.seed_radius_m"] == pytest.approx(1.6 * m_per_px, rel=1e-3)
    assert found["database.clusters.sigma_floor_m"] == pytest.approx(0.08 * m_per_px, rel=1e-3)
    # A maplet of 25 nodes is no wider than a quarter of the body, which is 560 m long.
    spacing_m = lengths(given, "lmaps", {})["maplets.spacing_m"]
    assert spacing_m == pytest.approx(min(1.9 * m_per_px, 5.6), rel=1e-3)


@pytest.mark.parametrize(("range_m", "times"), [(4000.0, None), (2000.0, None), (1000.0, 4), (100.0, 4)])
def test_corners_are_as_many_for_each_area_of_the_body_in_the_image(range_m, times):
    """100 of the contact binary at 2 km, which covers 65,000 of 512 x 512 px; at 100 m it fills the frame."""
    found = lengths((f"viewpoint.range_m={range_m}", NO_DETAIL), "landmark-ransac", {"corners": {"block_px": 5}})
    assert found.get("database.corners.count") == (times and 100 * times)
    # Its default is another than that of the data base.
    assert found.get("corners.count") == (times and 250 * times)


def test_given_corners_stay():
    assert not [key for key in lengths(("viewpoint.range_m=1000",), "landmark-harris", CORNERS_GIVEN) if "count" in key]


def test_the_area_of_a_body_is_the_mean_of_its_silhouettes():
    rule = {"each_px2": 1.0, "most": 10**9}
    for sides_m, area_m2 in (
        ((200.0, 200.0, 200.0), np.pi * 100.0**2),
        # A prolate spheroid of eccentricity e has the surface 2 pi b^2 (1 + a / (b e) arcsin e).
        ((400.0, 200.0, 200.0), 0.5 * np.pi * 100.0**2 * (1.0 + 4.0 / np.sqrt(3.0) * np.arcsin(np.sqrt(0.75)))),
    ):
        scale = Scale(lambda: 2.0, lambda sides_m=sides_m: sides_m, 1e9)
        assert scale.value(rule, 1) == pytest.approx(area_m2 / 4.0, rel=0.011)
    assert scale.value({**rule, "most": 50}, 1) == 50
    assert Scale(lambda: 2.0, lambda: None, 1e9).value(rule, 1) is None


def test_a_given_length_stays_and_null_stands_for_the_default():
    options = {"database": {"clusters": {"seed_radius_m": 3.0, "sigma_floor_m": None}}}
    assert list(lengths((), "landmark-harris", options)) == ["database.clusters.sigma_floor_m"]


def test_the_base_of_an_estimator_has_its_lengths():
    given = ("sensors.altimeter.sigma_m=5",)
    assert "options.database.clusters.seed_radius_m" in lengths(given, "landmark-altimeter", {})


def test_the_gauge_of_a_sequence_is_a_share_of_a_pixel():
    found = lengths((), "ba-slam", {}, "sequence", "apophis-sphere-sequence")
    assert found["gauge_sigma_m"] == pytest.approx(0.024 * 790 * np.tan(np.radians(15)) / 512, rel=1e-3)


def test_entries_hold_what_is_filled_in_and_the_campaign_what_was_written():
    loaded = load_scenario("quickstart")
    campaign = of_scenario(loaded, {"landmark-harris": {"database": {"images": 7}}}, "single-image", 1, "")
    (entry,) = kind_named("single-image").entries(campaign, loaded)
    assert entry.options["database"]["images"] == 7
    assert entry.options["database"]["clusters"]["seed_radius_m"] == pytest.approx(2.013)
    assert campaign.spec.estimators[0].options == {"database": {"images": 7}}, "the digest is of what was written"


@pytest.mark.parametrize("radius_m", [50.0, 5e5])
def test_relief_and_craters_are_shares_of_the_body(tmp_path, radius_m):
    trimesh.creation.icosphere(2, radius_m).export(tmp_path / "ball.obj")
    (tmp_path / "scene.yaml").write_text(
        "body: {shape: ball.obj}\ncamera: {fov_deg: 10}\n"
        f"viewpoint: {{range_m: {12 * radius_m}}}\nonboard: {{height_error: {{rms_m: 1}}}}\n"
    )
    scene = str(tmp_path / "scene.yaml")
    rough = load_scenario(scene, ("body.detail={facets: 100, roughness: {rms_m: 1}, albedo: {sigma: 0.1}}",)).spec
    across_m = 2.0 * radius_m
    assert rough.body.detail.roughness.max_wavelength_m == pytest.approx(0.2 * across_m)
    assert rough.body.detail.albedo.wavelength_m == pytest.approx(0.08 * across_m)
    assert rough.onboard.height_error.min_wavelength_m == pytest.approx(0.01 * across_m)
    cratered = load_scenario(scene, ("craters={}",)).spec.craters
    assert cratered.min_diameter_m == pytest.approx(0.0024 * across_m)
    assert cratered.roughness.rms_m == pytest.approx(0.00024 * across_m)
    assert cratered.edge_m < 0.25 * cratered.min_diameter_m
    # Checked with what is filled in: 100 m and 2 m, which suit one size, would refuse these.
    of_size = f"body.detail={{facets: 100, roughness: {{rms_m: 1, min_wavelength_m: {0.15 * across_m}}}}}"
    assert load_scenario(scene, (of_size,)).spec.body.detail.roughness.max_wavelength_m == pytest.approx(0.2 * across_m)


def test_the_default_errors_of_the_pose_are_in_pixels(tmp_path):
    (tmp_path / "scene.yaml").write_text("camera: {fov_deg: 10}\nviewpoint: {range_m: 3000}\n")
    assert load_scenario(str(tmp_path / "scene.yaml")).spec.pose_error.position_cam_px is not None


@pytest.mark.parametrize("name", [name for name in campaign_names() if name != "rowell2015-real"])
def test_campaigns_of_the_catalogue_say_all_lengths(name):
    """Their rows are of the lengths that their files hold, and do not change with a rule."""
    read = read_campaign(name)
    kind = kind_named(read.loaded.spec.experiment)
    for entry in read.loaded.spec.estimators:
        said = set(dict(dotted(kind.lengths(entry, read.scenarios[0]))))
        assert said <= UNUSED, entry.label


def models(model: type[SpecModel]):
    """Yield the models of the sections of a model, itself first."""
    yield model
    for field in model.model_fields.values():
        if isinstance(field.default, SpecModel):
            yield from models(type(field.default))


def test_no_option_of_a_method_has_a_default_in_metres():
    """A length that is right on one body alone breaks on others: see `scenarios/spec/base.py`."""
    wrong = [
        f"{name}: {key}"
        for registry in FAMILIES.values()
        for name in registry.names()
        for model in models(getattr(registry.find(name), "options_model", None) or SpecModel)
        for key, field in model.model_fields.items()
        if key.endswith("_m") and field.default is not None and rule_of(field) is None
    ]
    assert wrong == []


def test_the_signal_is_that_of_the_detector():
    ideal = {"white_e_per_s": 1e6, "dark_e_per_s": 0.0, "read_noise_e": 0.0, "gain_e_per_dn": 1e-3, "bits": 16}
    flat, weight = np.full(100, 0.1), np.ones(100)
    # 0.1 of 1e4 electrons: the signal to noise is the root of 1000.
    dim = signal_in_words(DetectorSpec(exposure_s=0.01, full_well_e=40.0, offset_dn=0.0, **ideal), flat, weight)
    assert "signal to noise 31.6" in dim
    assert "100 % is saturated, lower detector.exposure_s" in dim
    plain = {**ideal, "gain_e_per_dn": 1.0}
    dark = signal_in_words(DetectorSpec(exposure_s=0.01, offset_dn=10.0, **plain), flat, weight)
    assert dark.startswith("lit surface: median 1010 DN of 65535, signal to noise 31.6")
    assert dark.endswith("too dark for most methods, raise detector.exposure_s")
    assert signal_in_words(DetectorSpec(exposure_s=0.1, **plain), flat, weight).endswith("of saturation")


def test_the_preview_of_a_lambert_sphere_is_as_bright_as_its_formula():
    """At full phase I/F is albedo x cos i, and the median of the disk is at cos^2 i = 1/2."""
    given = ("body={shape: sphere}", "viewpoint.range_m=1e5", "camera.fov_deg=1", "lighting.phase_deg=0")
    detector = "detector={white_e_per_s: 1.0e+5, exposure_s: 1, gain_e_per_dn: 1, offset_dn: 0, bits: 16}"
    median = float(preview(load_scenario("quickstart", (*given, detector)))[3].split("median ")[1].split()[0])
    assert median == pytest.approx(1e5 * 0.3 * np.sqrt(0.5), rel=0.01)


@pytest.mark.parametrize(
    ("scenario", "overrides", "key"),
    [
        ("quickstart", ("viewpoint.range_m=1e6", NO_DETAIL), "viewpoint: at 1e\\+06 m the body is 0.8"),
        ("apophis-sphere-sequence", ("sequence.orbit.radius_m=1e6",), "sequence: at 1e\\+06 m"),
        (
            "apophis-sphere-sequence",
            ("sequence.orbit.radius_m=20", "sequence.sphere_radius_m=null"),
            "sequence: the camera comes to 20 m from the origin",
        ),
        (
            "approach-orbit",
            ("orbit.arc.approach.range_m=1e10",),
            "orbit.arc.approach.range_m: in the middle of the approach, at ",
        ),
        ("eros-like-orbit", ("orbit.arc.semi_major_axis_m=2000",), "orbit.arc.semi_major_axis_m: the camera comes to"),
    ],
)
def test_what_cannot_work_is_refused_with_its_key(scenario, overrides, key):
    with pytest.raises(BoresightError, match=key):
        check_bodies(load_scenario(scenario, overrides))


def test_show_and_validate_print_the_preview_and_the_lengths(tmp_path, monkeypatch, capsys):
    # Times are known by the name of a campaign, and other tests run one called c.
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "c.yaml").write_text(
        "scenarios: [scene.yaml]\nestimators: [landmark-harris, landmark-ransac]\ntrials: 2\nseed: 1\n"
    )
    for command in ("show", "validate"):
        assert main([command, str(tmp_path / "c.yaml")]) == 0
        said = capsys.readouterr().out.replace("\n", " ")
        assert "field of view 18.3 x 18.3 deg" in said
        told = "landmark-ransac: sizes from the pixels and the body, database.clusters.seed_radius_m 8.053"
        assert told in said.replace("# ", "")
        assert "2 trials x 1 scenario: time not known before a first run here, data bases aside" in said


def test_time_is_that_of_the_last_run_and_images_are_counted_uncompressed(monkeypatch):
    monkeypatch.setattr(check, "core_seconds", lambda name: 7200.0 if name == "quickstart" else None)
    monkeypatch.setattr(check, "cores", lambda: 4)
    files = read_campaign("quickstart")
    assert check.preflight(files.scenarios, files.loaded.spec)[3].startswith(
        "60 trials x 1 scenario: 30 h on 4 core(s) by the last run here, data bases aside; rendered images take 0.063"
    )
    assert "8 trials x 1 scenario: 4 h" in check.preflight(files.scenarios, files.loaded.spec, trials=8)[3]


@pytest.mark.parametrize(
    ("scenario", "count"),
    [
        ("quickstart", 7),
        ("approach-orbit", 140),
        ("eros-like-orbit", 0),
        ("eros-crater-pairs", 0),
        ("eros-like-crater-images", 14),
        ("apophis-sphere-sequence", 0),
        ("apophis-sphere-images", 72),  # one revolution in steps of 5 deg
    ],
)
def test_images_of_seven_trials(scenario, count):
    assert images_of(load_scenario(scenario).spec, 7) == count
