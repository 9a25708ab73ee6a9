"""Scenario and campaign files: inheritance, overrides, lookup, and the line that each fault gives."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import (
    canonical_json,
    digest,
    file_kind,
    load_campaign,
    load_scenario,
    names_in,
    scenario_names,
)
from boresight.scenarios.load.files import CATALOG
from boresight.scenarios.spec.brdf import HapkeSpec, LambertSpec
from boresight.scenarios.spec.distribution import Choice, Normal, Uniform
from boresight.scenarios.spec.vectors import Normal3

MINIMAL = "camera: {fov_deg: 20}\nviewpoint: {range_m: 1000}\n"
CAMPAIGN = "scenarios: [quickstart]\nestimators: [prior]\ntrials: 3\nseed: 1\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory with a function that writes files in it."""
    monkeypatch.chdir(tmp_path)

    def write(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    return write


def fault(*arguments, **keywords) -> str:
    with pytest.raises(BoresightError) as caught:
        load_scenario(*arguments, **keywords)
    return str(caught.value)


# --- the catalogue ---------------------------------------------------------------------------------------------------


def test_the_catalogue_holds_what_its_names_say():
    assert {"itokawa-2km-lambert", "navcam67p-real", "quickstart"} <= set(scenario_names())
    for name in scenario_names():
        loaded = load_scenario(name)
        assert loaded.spec.name == name
        assert loaded.spec.description
        assert loaded.search_dirs == (CATALOG.resolve(),)


def test_itokawa_is_section_4_2_of_the_paper():
    spec = load_scenario("itokawa-2km-lambert").spec
    assert (spec.camera.width_px, spec.camera.height_px, spec.camera.fov_deg) == (512, 512, 18.3)
    assert spec.viewpoint.range_m == 2000
    assert spec.lighting.phase_deg.uniform == (0, 60)
    assert spec.body.detail.facets == 3_100_000
    assert spec.pose_error.position_cam_m.uniform == ((-50, 50), (-50, 50), (-5, 5))
    assert spec.pose_error.attitude.angle_deg.uniform == (-2, 2)


def test_the_real_images_carry_their_credit():
    images = load_scenario("navcam67p-real").spec.images
    assert images.credit == "ESA/Rosetta/NAVCAM, CC BY-SA IGO 3.0"
    assert (images.truth, images.also_score, images.noise_realisations) == ("label", ("ref",), 10)


def test_a_loaded_scenario_is_hashable_and_can_be_pickled():
    loaded = load_scenario("quickstart")
    assert pickle.loads(pickle.dumps(loaded)) == loaded  # noqa: S301
    assert hash(load_scenario("quickstart")) == hash(loaded)


# --- lookup ----------------------------------------------------------------------------------------------------------


def test_names_take_hyphens_or_underscores(here):
    here("my_scene.yaml", MINIMAL)
    assert names_in(Path()) == ["my-scene"]
    assert load_scenario("my_scene.yaml").spec.name == "my-scene"
    assert load_scenario("navcam67p_real").spec.name == "navcam67p-real"


def test_a_name_is_looked_up_in_the_folder_of_the_extending_file(here):
    near = here("sub/own.yaml", MINIMAL).parent
    assert load_scenario("own", near=near).path == near / "own.yaml"
    assert load_scenario("own.yaml", near=near).path == near / "own.yaml"


def test_faults_of_lookup_and_reading(here, tmp_path):
    here("empty.yaml", "# nothing\n")
    here("list.yaml", "- 1\n")
    here("word.yaml", "hello\n")
    (tmp_path / "latin.yaml").write_bytes("description: Bézier\n".encode("latin-1"))
    (tmp_path / "folder").mkdir()
    here("long.yaml", "#" * 1_000_001)
    assert fault("quikstart") == "quikstart: no such scenario; did you mean quickstart?"
    assert fault("empti.yaml") == "empti.yaml: no such scenario; did you mean empty.yaml?"
    assert fault("zzz") == "zzz: no such scenario; give a path, or a name of: boresight list --all"
    assert fault("empty.yaml") == "empty.yaml: the file is empty: write 'key: value' lines"
    assert fault("list.yaml") == "list.yaml: the file is not a section of keys: write 'key: value' lines"
    assert fault("word.yaml") == "word.yaml: the file is not a section of keys: write 'key: value' lines"
    assert fault("latin.yaml") == "latin.yaml: not UTF-8 text (byte 14): save it as UTF-8"
    assert fault("folder") == "folder: is a folder, not a YAML file"
    assert fault("long.yaml").startswith("long.yaml: 1000001 bytes is too long")
    assert "xxx...: no such scenario" in fault("x" * 5000)
    assert "no such scenario" in fault("a\0b")


def test_file_kind_goes_by_the_keys(here, tmp_path):
    assert file_kind(here("s.yaml", MINIMAL)) == "scenario"
    assert file_kind(here("c.yaml", CAMPAIGN)) == "campaign"
    assert file_kind(CATALOG / "quickstart.yaml") == "scenario"
    for path, line in (
        (tmp_path / "none.yaml", "none.yaml: no such file, nor a name that boresight knows"),
        (Path("quikstart"), "quikstart: no such file, nor a name that boresight knows; did you mean quickstart?"),
        (Path("rowel"), "rowel: no such file, nor a name that boresight knows; did you mean rowell?"),
    ):
        with pytest.raises(BoresightError) as caught:
            file_kind(path, ["rowell"])
        assert str(caught.value) == line


# --- one line for each fault -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("camera: {width_px: 512,\n  fov_deg: 190}\n", "x.yaml:2: camera.fov_deg: 190 is not in [0.0001, 180)"),
        ("camera:\n  fov_dg: 20\n", "x.yaml:2: camera.fov_dg: unknown key; did you mean fov_deg?"),
        (
            "brdf: {kind: hapke, albedo: 0.1}",
            "x.yaml:1: brdf.albedo: unknown key; known here are kind, w, b, c, B0, h,",
        ),
        ("lightning: {}\n", "x.yaml:1: lightning: unknown key; did you mean lighting?"),
        (
            "brdf: {kind: lamber}",
            "x.yaml:1: brdf.kind: 'lamber' is not one of 'lambert', 'oren-nayar', 'hapke', 'lommel-seeliger', 'mcewen'",
        ),
        ("body: {unit: mm}", "x.yaml:1: body.unit: 'mm' is not 'm' or 'km'"),
        ("camera: {fov_deg: '20'}", "x.yaml:1: camera.fov_deg: '20' is not a number"),
        ("camera: {fov_deg: true}", "x.yaml:1: camera.fov_deg: true is not a number"),
        ("camera: {fov_deg: .nan}", "x.yaml:1: camera.fov_deg: nan is not a finite number"),
        ("camera: {fov_deg: 20, width_px: 512.5}", "x.yaml:1: camera.width_px: 512.5 is not a whole number"),
        ("camera: {fov_deg: 20, focal_px: [9, 9]}", "x.yaml:1: camera: give either fov_deg or focal_px, not both"),
        ("camera: {width_px: 64}", "x.yaml:1: camera: give either fov_deg or focal_px"),
        ("camera: {focal_px: [9]}", "x.yaml:1: camera.focal_px[1]: this value of the list is missing"),
        ("camera: {focal_px: [9, 9, 9]}", "x.yaml:1: camera.focal_px: has 3 values, not at most 2"),
        ("camera: {focal_px: [9, -9]}", "x.yaml:1: camera.focal_px[1]: -9 is not at least 1"),
        ("camera: 5", "x.yaml:1: camera: 5 is not a section of keys"),
        ("detector: {shot_noise: 1}", "x.yaml:1: detector.shot_noise: 1 is not true or false"),
        ("detector: {bits: 3}", "x.yaml:1: detector: offset_dn 10 is not below 7, the largest number of 3 bits"),
        ("rendering: {samples_per_pixel: 5}", "x.yaml:1: rendering: 5 is not a square number"),
        ("viewpoint: {}", "x.yaml:1: viewpoint: give either range_m or trajectory"),
        ("viewpoint: {range_m: 0}", "x.yaml:1: viewpoint.range_m: 0 is not above 0"),
        (
            "viewpoint: {range_m: 9, latitude_deg: {uniform: [-91, 0]}}",
            "x.yaml:1: viewpoint: latitude_deg [-91, 0] is not within [-90, 90]",
        ),
        (
            "lighting: {phase_deg: {uniform: [9, 2]}}",
            "x.yaml:1: lighting.phase_deg: the lower bound 9 is above the upper",
        ),
        (
            "lighting: {phase_deg: {uniform: [0, 200]}}",
            "x.yaml:1: lighting: phase_deg [0, 200] is not within [0, 180]",
        ),
        (
            "pose_error:\n  attitude:\n    angle_deg: two",
            "x.yaml:3: pose_error.attitude.angle_deg: 'two' is no distribution: write a number, uniform: [low,",
        ),
        (
            "pose_error: {position_cam_m: {normal: [1, 2, -3]}}",
            "x.yaml:1: pose_error.position_cam_m.normal[2]: -3 is not at least 0",
        ),
        ("name: Big Rock", "x.yaml:1: name: 'Big Rock' does not match ^[a-z0-9][a-z0-9._-]*$"),
        (
            "images: {folder: a, truth: ref, also_score: [ref]}",
            "x.yaml:1: images: ref is named twice in truth and also_",
        ),
        ("extends: [3]", "x.yaml:1: extends: [3] is not a name, a path or a list of them"),
    ],
)
def test_a_fault_is_a_line_with_file_line_key_value_and_what_is_allowed(here, text, line):
    here("x.yaml", text)
    assert any(found.startswith(line) for found in fault("x.yaml").splitlines()), fault("x.yaml")


def test_several_faults_give_several_lines(here):
    here("x.yaml", "camera: {fov_deg: 190}\nviewpoint: {range_m: -1}\nbrdff: 1\n")
    assert fault("x.yaml").splitlines() == [
        "x.yaml:1: camera.fov_deg: 190 is not in [0.0001, 180)",
        "x.yaml:2: viewpoint.range_m: -1 is not above 0",
        "x.yaml:3: brdff: unknown key; did you mean brdf?",
    ]


def test_a_file_whose_name_is_none_of_a_scenario_asks_for_one(here):
    here("MyScene.yaml", "camera: {fov_deg: 5}\nviewpoint: {range_m: 2000}\n")
    assert fault("MyScene.yaml") == (
        "MyScene.yaml: name: this key is missing (Small letters, digits and . _ -; by default the name of the file, if"
        " it has no other characters)"
    )
    assert load_scenario("MyScene.yaml", ("name=scene",)).spec.name == "scene"


def test_what_a_file_must_hold(here):
    here("x.yaml", "description: nothing else\n")
    assert fault("x.yaml") == "x.yaml: camera: this key is missing"
    here("x.yaml", "camera: {fov_deg: 20}\n")
    said = "x.yaml: give either viewpoint or images or sequence or crater_pairs or orbit (viewpoint: Where rendered"
    assert fault("x.yaml").startswith(said)


def test_real_images_take_no_detector_and_no_light():
    assert "detector has no part" in fault("navcam67p-real", ["detector.bits=8"])
    assert "lighting has no part" in fault("navcam67p-real", ["lighting.measure=angle"])


@settings(max_examples=200, deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["lambert", "", "x"]),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["kind", "uniform", "normal", "shape", "detail", "w", "fov_deg"]), inner)
        ),
        max_leaves=6,
    ),
    st.sampled_from(
        ["camera", "body", "brdf", "viewpoint", "lighting", "pose_error", "images", "detector", "name", "x.y"]
    ),
)
def test_any_value_of_any_section_loads_or_gives_lines_with_places(value, key):
    try:
        load_scenario("quickstart", base={key: value})
    except BoresightError as error:
        assert all(": " in line for line in str(error).splitlines())


# --- extends ---------------------------------------------------------------------------------------------------------


def test_a_child_changes_one_key_and_keeps_the_rest(here):
    here("parent.yaml", MINIMAL)
    here("child.yaml", "extends: parent.yaml\ncamera: {width_px: 64}\n")
    spec = load_scenario("child.yaml").spec
    assert (spec.camera.fov_deg, spec.camera.width_px, spec.viewpoint.range_m) == (20, 64, 1000)


def test_names_and_descriptions_are_not_inherited(here):
    here("child.yaml", "extends: quickstart\n")
    spec = load_scenario("child.yaml").spec
    assert (spec.name, spec.description) == ("child", "")


def test_several_parents_the_last_on_top(here):
    here("a.yaml", MINIMAL + "rendering: {samples_per_pixel: 9}\n")
    here("b.yaml", "camera: {fov_deg: 30}\n")
    here("child.yaml", "extends: [a.yaml, b.yaml]\n")
    spec = load_scenario("child.yaml").spec
    assert (spec.camera.fov_deg, spec.rendering.samples_per_pixel) == (30, 9)


def test_paths_start_from_the_extending_file_and_data_is_sought_in_both_folders(here, tmp_path):
    here("base/parent.yaml", MINIMAL)
    here("own/child.yaml", "extends: ../base/parent.yaml\n")
    loaded = load_scenario("own/child.yaml")
    assert loaded.search_dirs == (tmp_path / "own", tmp_path / "base")


def test_cycles_are_refused(here):
    here("a.yaml", "extends: b.yaml\n")
    here("b.yaml", "extends: a.yaml\n")
    here("self.yaml", "extends: self.yaml\n")
    assert fault("a.yaml") == "b.yaml:1: extends: a.yaml leads back to this file"
    assert fault("self.yaml") == "self.yaml:1: extends: self.yaml leads back to this file"


def test_an_endless_chain_is_refused(here):
    for i in range(40):
        here(f"c{i}.yaml", f"extends: c{i + 1}.yaml\n")
    assert fault("c0.yaml") == "c21.yaml: extends: a chain of more than 20 files"


def test_a_file_may_be_extended_twice_by_two_parents(here):
    here("root.yaml", MINIMAL)
    here("a.yaml", "extends: root.yaml\nrendering: {samples_per_pixel: 9}\n")
    here("b.yaml", "extends: root.yaml\ncamera: {width_px: 64}\n")
    here("child.yaml", "extends: [a.yaml, b.yaml]\n")
    spec = load_scenario("child.yaml").spec
    assert (spec.camera.width_px, spec.rendering.samples_per_pixel) == (64, 9)


def test_a_fault_in_a_parent_is_named_at_the_parent(here):
    here("parent.yaml", "viewpoint: {range_m: 1000}\ncamera:\n  fov_deg: 190\n")
    here("child.yaml", "extends: parent.yaml\n")
    assert fault("child.yaml") == "parent.yaml:3: camera.fov_deg: 190 is not in [0.0001, 180)"


# --- what replaces and what merges -----------------------------------------------------------------------------------


def test_a_new_kind_replaces_the_section(here):
    here("parent.yaml", MINIMAL + "brdf: {kind: lambert, albedo: 0.7}\n")
    here("child.yaml", "extends: parent.yaml\nbrdf: {kind: hapke, w: 0.3}\n")
    assert load_scenario("child.yaml").spec.brdf == HapkeSpec(kind="hapke", w=0.3)


def test_the_same_kind_merges(here):
    here("parent.yaml", MINIMAL + "brdf: {kind: hapke, w: 0.7}\n")
    here("child.yaml", "extends: parent.yaml\nbrdf: {kind: hapke, b: 0.1}\n")
    assert load_scenario("child.yaml", ["brdf.c=0.5"]).spec.brdf == HapkeSpec(kind="hapke", w=0.7, b=0.1, c=0.5)


def test_a_section_with_one_kind_merges_when_the_kind_is_spelled_out():
    spec = load_scenario("quickstart", ["viewpoint={kind: random-direction, roll_deg: {uniform: [0, 1]}}"]).spec
    assert spec.viewpoint.range_m == 2000


def test_one_key_of_a_default_section_can_be_set(here):
    here("x.yaml", MINIMAL)
    spec = load_scenario("x.yaml", ["brdf.albedo=0.9", "pose_error.attitude.angle_deg.normal=1"]).spec
    assert spec.brdf == LambertSpec(albedo=0.9)
    assert spec.pose_error.attitude.angle_deg == Normal(normal=1)
    assert spec.pose_error.position_cam_px.uniform[2] == (-4, 4)


def test_another_form_of_a_distribution_replaces_it(here):
    here("x.yaml", MINIMAL + "pose_error: {position_cam_m: {normal: [1, 2, 3]}}\n")
    assert load_scenario("x.yaml").spec.pose_error.position_cam_m == Normal3(normal=(1, 2, 3))


def test_a_key_replaces_its_alternative(here):
    spec = load_scenario("quickstart", ["camera.focal_px=[800, 800]"]).spec
    assert (spec.camera.fov_deg, spec.camera.focal_px) == (None, (800, 800))
    spec = load_scenario("navcam67p-real", ["camera.fov_deg=5", "pose_error.position_cam_m.normal=[1, 1, 1]"]).spec
    assert spec.camera.focal_px is None
    assert spec.pose_error.position_cam_px is None
    here("child.yaml", "extends: navcam67p-real\nviewpoint: {range_m: 9000}\n")
    assert load_scenario("child.yaml").spec.images is None


def test_lists_replace():
    spec = load_scenario("navcam67p-real", ["images.also_score=[]", "images.aligned=[]"]).spec
    assert spec.images.also_score == ()


# --- overrides -------------------------------------------------------------------------------------------------------


def test_the_order_is_defaults_extends_file_campaign_command_line(here):
    here("parent.yaml", MINIMAL + "rendering: {samples_per_pixel: 16}\n")
    here("child.yaml", "extends: parent.yaml\nviewpoint: {range_m: 2}\n")
    base = {"viewpoint.range_m": 3, "camera.fov_deg": 3}
    loaded = load_scenario("child.yaml", ["camera.fov_deg=4"], base=base)
    assert loaded.spec.rendering.samples_per_pixel == 16
    assert loaded.spec.viewpoint.range_m == 3
    assert loaded.spec.camera.fov_deg == 4
    assert load_scenario("child.yaml").spec.viewpoint.range_m == 2
    assert load_scenario("child.yaml").spec.lighting.phase_deg == Uniform(uniform=(0, 60))


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("camera.fov_deg=190", "--set camera.fov_deg=190: camera.fov_deg: 190 is not in [0.0001, 180)"),
        ("camera.fov=20", "--set camera.fov=20: camera.fov: unknown key; did you mean fov_deg?"),
        ("camera.fov_deg", "--set camera.fov_deg: write it as key=value"),
        ("=3", "--set =3: write it as key=value"),
        ("a..b=3", "--set a..b=3: write it as key=value"),
        ("camera.fov_deg=[", "--set camera.fov_deg=[: not valid YAML"),
        ("camera={fov_deg: 1, fov_deg: 2}", "--set camera={fov_deg: 1, fov_deg: 2}: fov_deg: duplicate key"),
    ],
)
def test_a_fault_of_an_override_is_named_at_the_override(override, line):
    assert fault("quickstart", [override]).startswith(line)


# --- campaigns -------------------------------------------------------------------------------------------------------


def test_a_campaign_names_estimators_with_options_and_labels(here, tmp_path):
    here(
        "c.yaml",
        "scenarios: [quickstart]\ntrials: 3\nseed: 1\n"
        "estimators:\n- prior\n- landmark-harris: {label: big-kernel, ksize: 5}\n- landmark-harris:\n",
    )
    entries = load_campaign("c.yaml", tmp_path / "none").spec.estimators
    assert [(e.name, e.label, e.options) for e in entries] == [
        ("prior", "prior", {}),
        ("landmark-harris", "big-kernel", {"ksize": 5}),
        ("landmark-harris", "landmark-harris", {}),
    ]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("estimators: [prior, prior]", "c.yaml: labels must differ, but prior appears twice; give an estimator that"),
        (
            "estimators: [{a: 1, b: 2}]",
            "c.yaml:2: estimators[0]: write an estimator as its name, or as {name: {option:",
        ),
        ("estimators: [{a: 1}]", "c.yaml:2: estimators[0]: the options of 'a' are not a mapping"),
        ("estimators: [{a: {label: 'x y'}}]", "c.yaml:2: estimators[0]: the label 'x y' of a may hold letters"),
        ("estimators: []", "c.yaml:2: estimators: has 0 values, not at least 1"),
        ("estimators: [prior]\nscenario: [x]", "c.yaml:3: scenario: unknown key; did you mean scenarios?"),
        ("estimators: [prior]\ntrails: 0", "c.yaml:3: trails: unknown key; did you mean trials?"),
        ("estimators: [prior]\nset: 3", "c.yaml:3: set: 3 is not a section of keys"),
    ],
)
def test_faults_of_a_campaign(here, tmp_path, change, line):
    here("c.yaml", f"scenarios: [quickstart]\n{change}\ntrials: 3\nseed: 1\n")
    with pytest.raises(BoresightError) as caught:
        load_campaign("c.yaml", tmp_path)
    assert any(found.startswith(line) for found in str(caught.value).splitlines()), str(caught.value)


def test_overrides_of_a_campaign_and_of_its_scenarios(here, tmp_path):
    here("c.yaml", CAMPAIGN + "set:\n  camera.fov_deg: 30\n  camera: {width_px: 64}\n  viewpoint.range_m: -5\n")
    loaded = load_campaign("c", tmp_path, ["trials=9"])
    assert loaded.spec.trials == 9
    spec = load_scenario("quickstart", ["viewpoint.range_m=7"], base=loaded.overrides).spec
    assert (spec.camera.fov_deg, spec.camera.width_px, spec.camera.height_px, spec.viewpoint.range_m) == (
        30,
        64,
        512,
        7,
    )
    assert fault("quickstart", base=loaded.overrides) == "c.yaml:8: viewpoint.range_m: -5 is not above 0"
    assert fault("quickstart", base=loaded.spec.overrides) == "set: viewpoint.range_m: -5 is not above 0"
    twice = {"camera": {"fov_deg": 40}, "camera.fov_deg": 50}  # the later line wins, as on the command line
    assert load_scenario("quickstart", base=twice).spec.camera.fov_deg == 50


def test_a_campaign_extends_another(here, tmp_path):
    here("c.yaml", CAMPAIGN + "title: long\nreport: rowell2015-simulated\n")
    here("d.yaml", "extends: c.yaml\ntrials: 5\n")
    spec = load_campaign("d.yaml", tmp_path / "none").spec
    assert (spec.name, spec.trials, spec.seed, spec.title) == ("d", 5, 1, "")
    assert spec.report == "rowell2015-simulated"


# --- the digest ------------------------------------------------------------------------------------------------------


def test_the_digest_depends_on_values_and_not_on_how_they_are_written(here):
    here("a.yaml", "name: a\ndescription: one\n" + MINIMAL + "body: {detail: {facets: 5.0e4}}\n")
    here(
        "b.yaml",
        "body: {detail: {facets: 50000}}\nviewpoint: {range_m: 1.0e+3}\ncamera: {fov_deg: 20.0, width_px: 512}\n",
    )
    assert digest(load_scenario("a.yaml").spec) == digest(load_scenario("b.yaml").spec)
    assert digest(load_scenario("a.yaml").spec) != digest(load_scenario("a.yaml", ["camera.fov_deg=20.0001"]).spec)


def test_a_credit_line_changes_no_result():
    assert digest(load_scenario("navcam67p-real", ["images.credit=me"]).spec) == digest(
        load_scenario("navcam67p-real").spec
    )
    assert '"credit":"me"' in canonical_json(load_scenario("navcam67p-real", ["images.credit=me"]).spec)


def test_the_digest_is_the_same_in_another_process():
    code = "from boresight.scenarios.load import *; print(digest(load_scenario('quickstart').spec))"
    run = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONHASHSEED": "77", "PYTHONPATH": str(CATALOG.parents[1])},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert run.stdout.strip() == digest(load_scenario("quickstart").spec)


def test_null_takes_a_section_back_to_its_default(tmp_path):
    (tmp_path / "parent.yaml").write_text(
        "camera: {fov_deg: 10}\nviewpoint: {range_m: 900}\nlighting: {phase_deg: {uniform: [5, 9]}}\ndetector: {}\n"
    )
    (tmp_path / "child.yaml").write_text("extends: parent.yaml\nlighting: null\ndetector: null\n")
    spec = load_scenario(str(tmp_path / "child.yaml")).spec
    assert spec.lighting.phase_deg.uniform == (0.0, 60.0)
    assert spec.detector is None


# --- values of tables ------------------------------------------------------------------------------------------------

_LAW = "pose_error: {{position_cam_m: {{choice: {}}}}}\n"


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_values_of_a_table_are_those_of_the_scenario(tmp_path, ending):
    errors = pd.DataFrame({"t": [0.0, 1.0], "x_m": [1.0, 4.0], "y_m": [2, 5], "z_m": [3.5, -6.0]})
    (errors.to_csv if ending == "csv" else errors.to_parquet)(tmp_path / f"errors.{ending}", index=False)
    law = _LAW.format(f"{{table: errors.{ending}, columns: [x_m, y_m, z_m]}}")
    (tmp_path / "base.yaml").write_text(f"extends: quickstart\n{law}")
    (tmp_path / "written.yaml").write_text("extends: quickstart\n" + _LAW.format("[[1, 2, 3.5], [4, 5, -6]]"))
    read, written = (load_scenario(str(tmp_path / name)).spec for name in ("base.yaml", "written.yaml"))
    assert digest(read) == digest(written)
    assert read.pose_error == written.pose_error
    errors["x_m"] += 1.0
    (errors.to_csv if ending == "csv" else errors.to_parquet)(tmp_path / f"errors.{ending}", index=False)
    assert digest(load_scenario(str(tmp_path / "base.yaml")).spec) != digest(read), "the values are part of the digest"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_column_of_a_table_is_a_law_of_a_number(tmp_path, encoding):
    (tmp_path / "ranges.csv").write_text("# of an orbit\nrange_m\n1000\n3000\n2500\n", encoding=encoding)
    law = f"viewpoint.range_m={{choice: {{table: {tmp_path / 'ranges.csv'}, columns: range_m}}}}"
    assert load_scenario("quickstart", [law]).spec.viewpoint.range_m == Choice(choice=(1000.0, 3000.0, 2500.0))


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ("{table: none.csv, columns: [x, y, z]}", "none.csv was not found"),
        ("{table: errors.csv, columns: [x, y, q]}", "no column q; it has x, x2, y, z"),
        ("{table: errors.csv, columns: [x, y, z]}", r"row 1 \(from 0\) of x, y, z is not all numbers"),
        ("{table: errors.csv, columns: [x, x2]}", "columns: name 3"),
        ("{table: errors.csv}", "nor {table: FILE, columns: NAMES}"),
        ("{table: words.csv, columns: [x, y, z]}", "words.csv cannot be used: could not convert string to float"),
        (
            "{table: scene.yaml, columns: [x, y, z]}",
            "scene.yaml cannot be used: row 0 .* has 4 values, not 1 as the header",
        ),
    ],
)
def test_tables_that_cannot_be_used_are_one_line(tmp_path, law, said):
    (tmp_path / "errors.csv").write_text("x,x2,y,z\n1,1,2,3\n4,4,,6\n")
    (tmp_path / "words.csv").write_text("x,y,z\n1,2,three\n")
    (tmp_path / "scene.yaml").write_text("extends: quickstart\n" + _LAW.format(law))
    with pytest.raises(BoresightError, match=said) as caught:
        load_scenario(str(tmp_path / "scene.yaml"))
    assert all("scene.yaml:2: pose_error.position_cam_m.choice" in line for line in str(caught.value).splitlines())


def test_null_takes_an_optional_section_away():
    assert load_scenario("quickstart", ["detector.bits=8"]).spec.detector.bits == 8
    assert load_scenario("quickstart", ["detector.bits=8", "detector=null"]).spec.detector is None
