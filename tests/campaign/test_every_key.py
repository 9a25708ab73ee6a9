"""Every key of the scenario schema changes the result: a dispersion that is never applied is the classic silent fault.

One key at a time is overridden as on the command line, in a scenario where it applies, and the fingerprint of what
an estimator sees (image, prior pose, its covariance, the Sun) and of the truth must change. Where another kind of trial
has no use for the key, it must be refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from functools import cache, reduce
from itertools import tee, zip_longest
from pathlib import Path
from types import UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

import pytest
from fingerprints import fingerprint
from key_scenes import FLIGHT, KERNELS, SCENES, write_scenes
from pydantic.fields import FieldInfo

from boresight.campaign.runs.unused import check_used
from boresight.campaign.trial.kind import kind_named, kind_names
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.distribution import Law
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.vectors import Law3

# Where the first scene that has the key, or a number a quarter larger or smaller, does not do: (scene, value), the
# scene alone, or the value alone.
CHANGES: dict[str, tuple[str | None, str | None]] = {
    "body.shape": (None, "sphere"),
    "body.unit": ("shape", "km"),
    "body.longitude": ("grid", "west"),
    "body.even_facets": ("ball", "2000"),
    "body.albedo_map.file": (None, "more-map.png"),
    "body.local": ("local", "[{shape: cap.ply, blend_m: 60}]"),
    "body.detail.facets": (None, "40000"),
    "body.detail.site.direction": (None, "[0, 1, 0]"),
    "camera.distortion.opencv": ("lens", "[-0.3, 0.1, 0.01, 0]"),
    "camera.principal_point_px": (None, "[25, 19]"),
    "detector.full_well_e": (None, "20000"),
    "detector.bits": (None, "8"),
    "detector.psf_wings": (None, "[{share: 0.2, sigma_px: 3}]"),
    "rendering.samples_per_pixel": (None, "9"),
    "brdf.H_function": (None, "'1981'"),
    "viewpoint.targets": (None, "[terminator]"),
    "viewpoint.keep_clear_px": (None, "[[0, 0, 48, 5]]"),
    "viewpoint.trajectory.table": ("states", "other.csv"),
    "viewpoint.trajectory.spice": ("flown", FLIGHT),
    "stars.catalog": ("stars", "stars.csv"),
    "correlated.keys": (None, "[viewpoint.range_m, lighting.phase_deg]"),
    "correlated.correlation": (None, "[[1, -1], [-1, 1]]"),
    "correlated.same_row": ("together", "true"),
    # Steps are shortened to a whole number of them: a quarter more may change nothing.
    "viewpoint.trajectory.hover.step_s": (None, "300"),
    "viewpoint.trajectory.descent.step_s": (None, "500"),
    "sequence.trajectory.table": ("free", "other.csv"),
    "sequence.trajectory.spice": ("free", FLIGHT),
    "sequence.trajectory.flyby": (
        "free",
        "{periapsis_m: 700, v_infinity_m_s: 0.2, gm_m3_s2: 20, duration_s: 900, step_s: 90}",
    ),
    "sequence.trajectory.hover": ("free", "{position_m: [500, 0, 0], duration_s: 20, step_s: 10}"),
    "sequence.trajectory.descent": (
        "free",
        "{direction: [1, 0, 0], from_altitude_m: 600, to_altitude_m: 200, rate_m_s: 1, step_s: 90}",
    ),
    "sequence.trajectory.rotation": ("free", "{pole_ra_deg: 9, pole_dec_deg: 60, rate_deg_day: 700}"),
    "sequence.trajectory.sun_dir": (None, "[0, 1, 1]"),
    "camera.spice": (None, "{instrument: '-999100', kernels: [camera.ti]}"),
    "pose_error.position_body_m": (None, "{covariance: [[9, 2, 0], [2, 9, 0], [0, 0, 4]]}"),
    "pose_error.pose_cam_deg_m": (None, f"{{covariance: {[[float(i == j) for j in range(6)] for i in range(6)]}}}"),
    "onboard.pose_error": (None, "{position_cam_m: {normal: [1, 2, 3]}}"),
    "onboard.brdf": (None, "{kind: oren-nayar}"),
    "onboard.body": (None, "{shape: sphere}"),
    "second_body.body": (None, "{shape: sphere}"),
    "onboard.facets": (None, "20000"),
    "onboard.relief": (None, "{below_m: 40, seed: 5}"),
    "onboard.height_error": (None, "{rms_m: 2, max_wavelength_m: 200, min_wavelength_m: 40}"),
    "onboard.sun_error_deg": (None, "{uniform: [5, 5]}"),
    "onboard.pole_error_deg": (None, "{uniform: [1, 1]}"),
    "onboard.rotation_error_deg": (None, "{uniform: [1, 1]}"),
    "images.folder": (None, "other"),
    "images.table": (None, "more.csv"),
    "images.colmap.images": (None, "[{image: b.png, sun_body: [0, 0.6, -0.8]}]"),
    "images.colmap.unit": (None, "km"),
    "images.sumfiles": (None, "[{image: a.png, sumfile: b.SUM}]"),
    "images.spice.files": (None, "b*.lbl"),
    "images.spice.kernels": (None, KERNELS.replace("tiny.tf", "tiny.tf, still.tf")),
    "images.spice.target_frame": (None, "J2000"),
    "images.keep_clear_px": ("real", "[[0, 39.5, 48, 40]]"),
    "images.truth": ("real", "third"),
    "images.also_score": ("real", "[third]"),
    "images.noise_realisations": ("real", "1"),
    "images.rendered": ("spice", "true"),
    "images.survey": ("real", "[a.png]"),
    "images.moved": ("moved", "[{name: placed, of: label, origin_m: [3, 0, 0]}]"),
    "images.adjusted.name": (None, "label"),
    "images.adjusted.table": (None, "set/poses.csv"),
    "crater_pairs.images.most_detections": (None, "1"),
    "sequence.vision.min_connection": ("sequence", "28"),
    "sequence.images.features": (None, "15"),
    "sequence.images.growth_max": (None, "1.01"),
    "sequence.images.spacing_px": (None, "40"),
    "sequence.tracks.table": (None, "more-tracks.csv"),
    "sequence.tracks.poses": (None, "more-poses.csv"),
    "sequence.tracks.spc": (None, "more-spc"),
    "sequence.tracks.frames": (None, "6"),
    "orbit.imaging.errors.least_radius_px": (None, "1.5"),
}
# Said in the terms of the body and its reflectance, whose keys have their own lines.
SAME_TERMS = {f"onboard.{key}" for key in ("brdf", "body", "relief", "height_error", "pose_error", "declared")}
SAME_TERMS |= {"second_body.body"}
# Filled in, or read from kernels with tests of their own: test_trajectory.py, test_spice_camera.py.
SAME_TERMS |= {"viewpoint.trajectory.read_states", "viewpoint.trajectory.spice", "camera.spice"}
SAME_TERMS |= {
    f"sequence.trajectory.{key}" for key in ("read_states", "spice", "rotation", "flyby", "hover", "descent")
}
# Keys that change no result, each with its reason.
NO_RESULT = {
    "name": "names the scenario in tables",
    "description": "prose",
    "onboard.declared": "changes rehearsals of `tuned` alone: test_tuned_campaign.py has each of its keys",
    "stars.year": "moves the stars of Hipparcos, an extra: tests/scenarios/test_star_catalogs.py",
    "stars.read_sha256": "filled in",
    "images.credit": "printed below figures",
    "images.aligned": "told in reports",
    "images.spice.instrument": "images of another camera are refused",
    "images.spice.target": "images of another body are refused",
    "body.format": "says how to read the file; a wrong one is refused",
    "body.expected_diameter_m": "a guard: a body outside is refused",
    "viewpoint.kind": "has one value",
    "viewpoint.trajectory.read_states": "filled in from the table",
    "sequence.trajectory.read_states": "filled in from the table",
    "pose_error.attitude.axis": "has one value",
}

# What is not as it is left out in the scene, but for lengths.
LEFT_OUT = ("orbit.imaging.craters.count=600", "orbit.imaging.errors.least_radius_px=6")
# Kinds of trial beside single images, each with scenes and what is overridden in these.
KINDS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("sequence", "sequence", ()),
    ("sequence", "egg", ()),
    ("sequence", "tracks", ()),
    ("sequence", "images", ("detector={psf_sigma_px: 0.3}",)),
    ("crater-matching", "pairs", ()),
    ("crater-matching", "seen-pairs", ()),
    ("orbit-determination", "orbit", ()),
    ("crater-navigation", "imaged", ("craters=null",)),
    ("crater-navigation", "imaged", ("orbit.imaging.detections=rendered", *LEFT_OUT)),
    ("image-survey", "imaged", ("craters=null",)),
    ("approach-orbit", "arriving", ()),
    ("crater-detection", "cratered", ()),
    ("landmark-database", "rendered", ()),
    ("pose-convergence", "rendered", ()),
)
# Another value of each section that scenarios of all kinds can have, and of keys in them that only images show.
ELSEWHERE = {
    "body": "{shape: itokawa-like}",
    "body.shading": "smooth",
    "body.albedo_map": "{file: map.png, left_deg: 20, unity: 90}",
    "craters": "{count: 20, min_diameter_m: 30, max_diameter_m: 120, edge_m: 6, known_diameter_m: 30, roughness: null}",
    "camera.fov_deg": "11",
    "camera.distortion": "{k1: 1.5}",
    "rendering": "{samples_per_pixel: 9}",
    "detector": "{psf_sigma_px: 0.9}",
    "brdf": "{kind: oren-nayar}",
    "lighting.phase_deg": "{uniform: [50, 80]}",
    "lighting.brightness": "0.5",
    "lighting.measure": "angle",
    "correlated": "{keys: [lighting.phase_deg, viewpoint.roll_deg], correlation: [[1, 0.9], [0.9, 1]]}",
    "stars": "{sun_distance_au: 20}",
    "second_body": "{body: {shape: dimorphos-like}, semi_major_axis_m: 800}",
    "pose_error": "{position_cam_m: {normal: [9, 9, 9]}}",
    "sensors": "{altimeter: {sigma_m: 5}}",
    **{
        f"onboard.{key}": value
        for key, value in {
            "brdf": "{kind: oren-nayar}",
            "body": "{shape: itokawa-like}",
            "facets": "20000",
            "albedo": "uniform",
            "focal_error": "0.01",
            "camera_sigma": "{focal: 0.01}",
            "distortion_error": "0.5",
            "sun_error_deg": "{uniform: [5, 5]}",
            "pole_error_deg": "{uniform: [1, 1]}",
            "rotation_error_deg": "{uniform: [1, 1]}",
            "pose_error": "{position_cam_m: {normal: [9, 9, 9]}}",
            "declared": "{facets: 3000}",
        }.items()
    },
    "viewpoint.keep_clear_px": "[[0, 0, 48, 5]]",
    "viewpoint.off_pointing_deg": "1",
    "crater_pairs.errors": "{recall: 0.4}",
    "orbit.sightings": "{per_image: 4}",
    "orbit.radiometry": "{interval_h: 2}",
    "orbit.imaging.craters": "{count: 500, min_diameter_m: 20, max_diameter_m: 100}",
    "orbit.imaging.errors": "{recall: 0.4}",
}


def leaves(model: type[SpecModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Yield the dotted name of every key of the schema that holds a value, with its field."""
    for name, field in model.model_fields.items():
        models = [] if prefix + name in SAME_TERMS else list(_models(field.annotation))
        if not models:
            yield prefix + name, field
        for inner in models:
            yield from leaves(inner, f"{prefix}{name}.")


def _models(annotation: object) -> Iterator[type[SpecModel]]:
    if isinstance(annotation, type) and issubclass(annotation, Law | Law3):
        return  # a value; tests/scenarios/test_draw.py has the laws
    if isinstance(annotation, type) and issubclass(annotation, SpecModel):
        yield annotation
    elif get_origin(annotation) in (Union, UnionType, Annotated):
        for argument in get_args(annotation):
            yield from _models(argument)


LEAVES = dict(leaves(ScenarioSpec))


def others(annotation: object, value: object) -> Iterator[object]:
    """Yield other values: all words that a key takes, the other truth value, numbers a quarter larger and smaller."""
    if isinstance(value, str):
        yield from (word for word in get_args(annotation) if get_origin(annotation) is Literal and word != value)
    else:
        yield from (not value,) if isinstance(value, bool) else (_scaled(value, 1.25), _scaled(value, 0.8))


def _scaled(value: object, factor: float) -> object:
    if isinstance(value, dict):
        return {key: _scaled(one, factor) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_scaled(one, factor) for one in value]
    if isinstance(value, int):
        return round(value * factor) + (-1 if factor < 1.0 else 1)
    return value * factor if value else 0.1


@cache
def spec_of(file: Path) -> ScenarioSpec:
    return load_scenario(str(file)).spec


@cache
def _unchanged(file: Path) -> Iterator[bytes]:
    return tee(fingerprint(file), 1)[0]


def before(file: Path) -> Iterator[bytes]:
    """Return the fingerprint of a scene, each part of which is made once."""
    return copy(_unchanged(file))


def differ(one: Iterator[bytes], other: Iterator[bytes]) -> bool:
    return any(mine != theirs for mine, theirs in zip_longest(one, other))


def changes(key: str, folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield scenes that have a key, and overrides by which it has another value in them."""
    scene, value = CHANGES.get(key, (None, None))
    for name in SCENES if scene is None else (scene,):
        file = folder / f"{name}.yaml"
        try:
            now = reduce(getattr, key.split("."), spec_of(file))
        except AttributeError:
            continue
        if value is not None:
            yield file, f"{key}={value}"
        elif now is not None:
            plain = now.model_dump(exclude_unset=True) if isinstance(now, SpecModel) else now
            yield from ((file, f"{key}={other}") for other in others(LEAVES[key].annotation, plain))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    write_scenes(folder)
    return folder


def test_exceptions_are_keys_of_the_schema():
    assert set(CHANGES) | set(NO_RESULT) <= set(LEAVES)


@pytest.mark.parametrize("key", sorted(set(LEAVES) - set(NO_RESULT)))
def test_changing_the_key_alone_changes_the_result(key: str, place: Path):
    for file, override in changes(key, place):
        try:
            load_scenario(str(file), (override,))
        except BoresightError:
            continue  # the value does not go with others of the scene
        assert differ(fingerprint(file, (override,)), before(file)), override
        return
    raise AssertionError(f"no scene has another value of {key}")


def test_the_fingerprint_itself_stands_still(place: Path):
    file = place / "rendered.yaml"
    assert not differ(fingerprint(file), before(file))


def test_all_kinds_and_all_sections_are_tried():
    assert {kind for kind, _, _ in KINDS} == {*kind_names()} - {"single-image"}
    tried = {key.split(".")[0] for key in ELSEWHERE}
    assert tried | {"images", "sequence", "name", "description"} == set(ScenarioSpec.model_fields)


@pytest.mark.parametrize(("kind", "scene", "base"), KINDS)
def test_a_key_reaches_the_trials_of_a_kind_or_is_refused(kind, scene, base, place: Path):
    file, ignored = place / f"{scene}.yaml", []
    loaded = load_scenario(str(file), base)
    check_used(loaded, kind_named(kind))
    before = tee(fingerprint(file, base, kind), 1)[0]
    for key, value in ELSEWHERE.items():
        section, overrides = key.split(".")[0], (*base, f"{key}={value}")
        if section in ScenarioSpec.alternatives[0] and getattr(loaded.spec, section) is None:
            continue  # it would make another kind of scenario
        try:
            check_used(load_scenario(str(file), overrides), kind_named(kind))
        except BoresightError as error:
            assert section in str(error)
        else:
            ignored += [] if differ(fingerprint(file, overrides, kind), copy(before)) else [key]
    assert ignored == []
