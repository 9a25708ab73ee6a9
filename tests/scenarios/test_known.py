"""Records of a priori knowledge follow the scenario: no part with an onboard error is listed as exact."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.known import Item, Known, known_on_board, merged
from boresight.scenarios.load import load_scenario, scenario_names
from boresight.scenarios.spec.onboard import OnboardSpec
from boresight.scenarios.spec.orbit import CraterSightingSpec, OrbitKnowledgeSpec, PointingSpec
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.sequence import SequenceKnowledgeSpec
from boresight.scenarios.spec.vision import VisionSpec

# A wrong value of every key of ``onboard``, and what is then no longer known exactly.
WRONG = {
    "brdf": ({"kind": "lambert", "albedo": 0.123}, "reflectance"),
    "body": ({"shape": "contact-binary", "expected_diameter_m": [1, 2]}, "shape"),
    "facets": (777, "shape"),
    "relief": ({"below_m": 10, "seed": 99}, "shape"),
    "height_error": ({"rms_m": 0.123}, "shape"),
    "albedo": ("uniform", "albedo variation"),
    "focal_error": (1e-3, "camera"),
    "principal_point_error_px": ((1.0, 0.0), "camera"),
    "camera_sigma": ({"focal": 1e-3}, "camera"),
    "distortion_error": (0.5, "lens"),
    "sun_error_deg": ({"normal": 1.0}, "Sun"),
    "pole_error_deg": ({"uniform": [0.0, 1.0]}, "spin"),
    "rotation_error_deg": ({"normal": 0.1}, "spin"),
    "pose_error": ({"position_cam_m": {"normal": [1, 2, 3]}}, "law of the pose errors"),
}
NEEDS = {"distortion_error": "camera.distortion={k1: -0.1}", "albedo": "body.detail.albedo={sigma: 0.1}"}
LENT_SHAPE = frozenset({"body", "facets", "relief", "height_error"})
OF_DETAIL = frozenset({"facets", "relief", "albedo"})


def line_of(name: str, *overrides: str, experiment: str = "", short: bool = False) -> str:
    return known_on_board(load_scenario(name, overrides).spec, experiment).line(short)


def with_onboard(spec: ScenarioSpec, key: str) -> ScenarioSpec:
    said = spec.model_dump(mode="json")
    # Another body is whole: these are given in it, not beside it.
    beside = LENT_SHAPE | OF_DETAIL if key == "body" else frozenset()
    said["onboard"] = {one: value for one, value in said["onboard"].items() if one not in beside}
    said["onboard"] |= {key: WRONG[key][0]}
    return ScenarioSpec.model_validate(said)


def heard(spec: ScenarioSpec) -> frozenset[str]:
    """Keys of ``onboard`` that apply to the trials of a scenario."""
    shape = LENT_SHAPE if spec.crater_pairs is not None else frozenset()
    keys = frozenset(WRONG) if spec.viewpoint is not None or spec.images is not None else shape
    keys = keys if spec.body.detail is not None else keys - OF_DETAIL
    return keys if spec.onboard.body is None else keys - (LENT_SHAPE | OF_DETAIL) | {"body"}


def standing(known: Known, name: str) -> str:
    """Standing of an item, under its name for cratered bodies and real images."""
    named = {one.name.removeprefix("smooth ").split(" as the pose")[0]: one.standing for one in known.items}
    return named[name]


def names(known: Known, standing: str) -> tuple[str, ...]:
    return tuple(item.name for item in known.items if item.standing == standing)


CASES = [(name, key) for name in scenario_names() for key in sorted(heard(load_scenario(name).spec))]


def test_every_key_of_onboard_is_here():
    # What is declared makes nothing wrong.
    assert WRONG.keys() | {"declared"} == OnboardSpec.model_fields.keys()


@pytest.mark.parametrize(("name", "key"), CASES)
def test_parts_with_onboard_errors_are_not_listed_as_exact(name: str, key: str):
    spec = load_scenario(name, [NEEDS[key]] if key in NEEDS else []).spec
    item = WRONG[key][1]
    before, after = (standing(known_on_board(one), item) for one in (spec, with_onboard(spec, key)))
    told_before = spec.images is None and spec.onboard == OnboardSpec()
    assert after == "not"
    assert before == "exactly" or not told_before
    if item == "Sun":
        assert before == "exactly"


@pytest.mark.parametrize("name", scenario_names())
def test_onboard_keys_without_effect_are_refused(name: str):
    """A key of ``onboard`` that does not apply to a kind of trial is an error, not ignored."""
    spec = load_scenario(name).spec
    for key in WRONG.keys() - heard(spec) - {"albedo"}:
        with pytest.raises(ValidationError, match="onboard"):
            with_onboard(spec, key)


# Keys of what is known in a sequence whose other value is no number, or not twice the one that stands there.
SEQUENCE = {"range_to": "lasting", "ranges": 0, "dynamics": "true"}
FORCES = ("gm_sigma", "radiation_sigma", "velocity_sigma_m_s", "noise_m_s2")
SPINS = ("sequence.body_motion.kind=spin", "sequence.orbit.model=propagated")


# How often says nothing of how well.
@pytest.mark.parametrize("key", sorted(SequenceKnowledgeSpec.model_fields.keys() - {"range_every"}))
def test_every_key_of_sequence_knowledge_changes_the_line(key: str):
    name, forces = "apophis-sphere-sequence", ("sequence.knowledge.dynamics=true",) if key in FORCES else ()
    now = getattr(load_scenario(name).spec.sequence.knowledge, key)
    wrong = f"sequence.knowledge.{key}={SEQUENCE[key] if key in SEQUENCE else 2 * (now or 0) or 0.1}"
    assert line_of(name, *SPINS, *forces, wrong) != line_of(name, *SPINS, *forces)


@pytest.mark.parametrize(
    ("key", "value"), [("mismatch_share", 0.1), ("outlier_share", 0.1), ("noise_px", 0), ("mistaken", 0.1)]
)
def test_wrong_tracks_are_stated(key: str, value: float):
    assert key in VisionSpec.model_fields
    base = line_of("apophis-sphere-sequence", "sequence.vision.field=fixed")
    assert line_of("apophis-sphere-sequence", "sequence.vision.field=fixed", f"sequence.vision.{key}={value}") != base


@pytest.mark.parametrize(
    ("section", "model", "silent"),
    [
        ("knowledge", OrbitKnowledgeSpec, set()),
        ("pointing", PointingSpec, set()),
        (
            "sightings",
            CraterSightingSpec,
            {
                "images", "craters", "per_image", "per_image_shape", "emission_max_deg", "incidence_max_deg",
                "margin_px", "noise_px", "wrong_within_px",
            },
        ),
    ],
)  # fmt: skip
def test_every_key_of_orbit_knowledge_changes_the_line(section: str, model: type, silent: set[str]):
    spec = load_scenario("eros-orbit").spec
    for key in model.model_fields.keys() - silent:
        value = getattr(getattr(spec.orbit, section), key)
        other = 7 if isinstance(value, int) else 0.013 if value < 1 else 2 * value
        assert line_of("eros-orbit", f"orbit.{section}.{key}={other}") != line_of("eros-orbit"), key


def test_exact_items_of_the_crater_navigation_chain():
    known = known_on_board(load_scenario("eros-like-navigation").spec, "crater-navigation")
    assert {"spin", "centre of mass", "RMS error of the shape on board"} <= set(names(known, "exactly"))
    assert {"orbit", "shape", "gravity", "attitude", "which crater is which", "noise"} <= set(names(known, "not"))


def test_the_line_of_an_ideal_world():
    assert line_of("itokawa-2km-lambert") == (
        "Perfect knowledge of: shape, reflectance, camera, Sun, spin, renderer, law of the pose errors; no albedo"
        " variation; no blur; no noise (no `detector`). Imperfect or no knowledge of: pose."
    )


UNIFORM = "no albedo variation"
VARYING = "body.detail.albedo={sigma: 0.1}"


@pytest.mark.parametrize(
    ("name", "experiment"),
    [
        ("itokawa-2km-lambert", ""),
        ("itokawa-2km-lambert", "landmark-database"),
        ("quickstart", ""),
        ("eros-like-msi", ""),
        ("eros-like-msi", "crater-detection"),
        ("eros-like-crater-images", "crater-matching"),
        ("eros-like-navigation", "crater-navigation"),
    ],
)
def test_images_of_a_body_of_one_albedo_say_so(name: str, experiment: str):
    assert UNIFORM in line_of(name, experiment=experiment)


@pytest.mark.parametrize("name", ["eros-crater-pairs", "eros-orbit", "itokawa-amica-real", "apophis-sphere-sequence"])
def test_trials_that_render_no_image_say_nothing_of_albedo(name: str):
    assert UNIFORM not in line_of(name)


@pytest.mark.parametrize(
    ("changes", "standing_of_it"),
    [
        ((VARYING,), "exactly"),
        ((VARYING, "onboard.albedo=uniform"), "not"),
        (("body.detail.albedo={sigma: 0}",), "absent"),
    ],
)
def test_an_albedo_that_varies_is_known_or_not(changes: tuple[str, ...], standing_of_it: str):
    known = known_on_board(load_scenario("itokawa-2km-lambert", changes).spec)
    assert standing(known, "albedo variation") == standing_of_it


def test_a_variation_is_known_if_it_is_exact_or_absent_everywhere():
    name = "itokawa-2km-lambert"
    several = [known_on_board(load_scenario(name, changes).spec) for changes in ((), (VARYING,))]
    assert "albedo variation" in names(merged(several), "exactly")
    wrong = known_on_board(load_scenario(name, (VARYING, "onboard.albedo=uniform")).spec)
    assert "In some scenarios only: no albedo variation." in merged([several[0], wrong]).line()


def test_details_are_for_the_long_line():
    coarse = "onboard={facets: 196000, height_error: {rms_m: 0.5}}"
    long, short = (line_of("itokawa-2km-lambert", coarse, short=short) for short in (False, True))
    assert "Imperfect or no knowledge of: shape (196,000 facets of 3,100,000, heights wrong by 0.5 m), pose." in long
    assert short.endswith("Imperfect or no knowledge of: shape, pose.")


def test_an_error_of_zero_is_none():
    zero = "onboard={focal_error: 0, sun_error_deg: {normal: 0}, height_error: {rms_m: 0}, facets: 190000}"
    assert line_of("quickstart", zero) == line_of("quickstart")


def test_a_detector_adds_blur_and_noise_as_not_known():
    assert "blur (0.8 px), noise" in line_of("quickstart", "detector={psf_sigma_px: 0.8}")
    sharp = line_of("quickstart", "detector={psf_sigma_px: 0}")
    assert "; no blur. Imperfect or no knowledge of: pose, noise." in sharp
    drawn = line_of("quickstart", "detector={exposure_s: {uniform: [0.1, 0.2]}}")
    assert "noise, exposure." in drawn


def test_kinds_of_trials_have_different_knowledge():
    kinds = ("single-image", "crater-detection", "landmark-database", "pose-convergence")
    assert len({line_of("eros-like-msi", experiment=kind) for kind in kinds}) == len(kinds)
    assert line_of("eros-survey", experiment="image-survey") != line_of("eros-survey")


def test_a_pose_without_error_is_known():
    exact = ("pose_error={position_cam_m: {normal: [0, 0, 0]}, attitude: {angle_deg: {normal: 0}}}",)
    assert line_of("quickstart", *exact).endswith("Imperfect or no knowledge of: nothing.")


def test_real_images_have_only_the_reference_pose_as_exact_knowledge():
    known = known_on_board(load_scenario("navcam67p-real").spec)
    assert names(known, "exactly") == ("Sun as the pose label has it", "law of the pose errors")
    assert known.line(short=True).endswith(
        "Errors against ref are correlated with those of methods that align renderings of the shape, for ref was found"
        " by doing so."
    )


def test_renderings_of_the_views_of_real_images_are_a_simulated_world():
    told = ("images={truth: ref, also_score: [], aligned: [], rendered: true}", "detector={psf_sigma_px: 1}")
    known = known_on_board(load_scenario("navcam67p-real", told).spec)
    assert {"shape", "reflectance", "camera", "Sun"} < set(names(known, "exactly"))
    assert known.remarks == known.aligned == ()
    assert "noise" in names(known, "not")


def test_real_tracks_have_a_reference_and_no_known_law_of_pixels():
    known = known_on_board(load_scenario("vesta-real-tracks").spec)
    assert "camera" not in names(known, "exactly")
    assert "laws of all errors but those of pixels" in names(known, "exactly")
    assert known.line().endswith(
        "The tracks are real: errors are against reference poses, which are not exact, and what is told beside the"
        " tracks is drawn about them."
    )


def test_errors_that_accumulate_along_a_track_are_not_known():
    errors = "sequence.vision.track_errors={walk_px: 0.4}"
    known = known_on_board(load_scenario("apophis-sphere-sequence", [errors]).spec)
    assert "laws of all errors but those of pixels" in names(known, "exactly")
    assert "pixel noise (0.6667 px are told, and nothing of errors that accumulate)" in known.line()


@pytest.mark.parametrize("errors", ["{}", "{vision: {track_errors: {walk_px: 0.4}}}"])
def test_what_is_stated_of_errors_that_accumulate_is_listed(errors: str):
    stated = "sequence.knowledge={walk_px: 0.4, drift_px: 0.3, contraction: 1.0e-3}"
    known = known_on_board(load_scenario("apophis-sphere-sequence", [f"sequence={errors}", stated]).spec)
    told = "0.6667 px are told, and errors that accumulate by 0.5 px and 0.001 of the distance from the centre a frame"
    assert f"pixel noise ({told})" in known.line()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("images.rendered=true", "leave also_score and aligned empty"),
        ("detector={psf_sigma_px: 1}", "detector has no part in a scenario with images"),
    ],
)
def test_real_images_and_renderings_of_their_views_are_not_mixed(override: str, message: str):
    with pytest.raises(BoresightError, match=message):
        load_scenario("navcam67p-real", [override])


def test_only_poses_that_are_scored_can_be_called_aligned():
    with pytest.raises(BoresightError, match="aligned names third, which is neither truth nor in also_score"):
        load_scenario("navcam67p-real", ["images.aligned=[third]"])


def test_lines_of_several_scenarios_are_merged():
    one = Known((Item("a", "exactly"), Item("b", "exactly"), Item("c", "not", "1 m"), Item("d", "absent")), ("R",))
    other = Known(
        (Item("a", "exactly"), Item("b", "not"), Item("c", "not", "2 m"), Item("d", "not"), Item("e", "not")),
        ("R",),
        ("ref",),
    )
    both = merged([one, other])
    assert both.line().startswith(
        "Perfect knowledge of: a. In some scenarios only: b, no d. Imperfect or no knowledge of: c, e. R. Errors"
        " against ref"
    )
    assert merged([one, one]) == one
    assert (
        merged([Known((Item("a", "exactly"),)), Known(())])
        .line()
        .startswith("Perfect knowledge of: nothing. In some scenarios only: a.")
    )
