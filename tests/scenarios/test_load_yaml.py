"""YAML text to entries: the core schema of YAML 1.2, places, and hostile input."""

from __future__ import annotations

import importlib
import json
import math
import pkgutil

import numpy as np
import pytest
import yaml
from ruamel.yaml import YAML

from boresight import estimators
from boresight.estimators.options import parse_options
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario, yaml_text
from boresight.scenarios.load.files import CATALOG, names_in
from boresight.scenarios.load.merge import on_defaults
from boresight.scenarios.load.yaml_text import MAX_VALUES, describe, dump_yaml, entry_of, parse_yaml, resolve_scalar
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.scenario import ScenarioSpec


@pytest.fixture(params=[yaml.CSafeLoader, yaml.SafeLoader], ids=["libyaml", "in Python"], autouse=True)
def parser(request, monkeypatch):
    """Both parsers, as a PyYAML that was built without libyaml has the second alone."""
    monkeypatch.setattr(yaml_text, "_LOADER", request.param)
    parse_yaml.cache_clear()
    yield
    parse_yaml.cache_clear()


def test_every_key_and_item_has_its_line_number():
    root = parse_yaml("a: 1\nb:\n  c: [1,\n    2]\n  d: {e: 5}\n", "x.yaml")
    section = root.section
    assert section["a"].place == "x.yaml:1"
    assert section["b"].place == "x.yaml:2"
    assert section["b"].section["c"].place == "x.yaml:3"
    assert section["b"].section["c"].value[1].place == "x.yaml:4"
    assert section["b"].section["d"].section["e"].place == "x.yaml:5"


@pytest.mark.parametrize(
    "text",
    [
        "", "~", "null", "Null", "true", "False", "TRUE", "0", "-7", "+12", "007", "0o17", "0x1F", "1.5", "-.5", "3.",
        "3.1e6", "1e3", "-2E-3", ".inf", "-.INF", "+.inf", "yes", "no", "on", "1_000", "12:30", "abc", "1e", "0x",
        "2014-08-05", "..", "+", "nul", "tRue", "1.2.3",
    ],
)  # fmt: skip
def test_scalars_resolve_as_in_yaml_1_2(text):
    """Against ruamel.yaml's own resolver, except where that one leaves the core schema: underscores and dates."""
    ours = resolve_scalar(text)
    if text in {"1_000", "2014-08-05"}:
        assert ours == text
        return
    theirs = YAML(typ="safe", pure=True).load(f"value: {text}")["value"]
    assert type(ours) is type(theirs)
    assert ours == theirs


def test_not_a_number_resolves():
    assert all(math.isnan(resolve_scalar(text)) for text in (".nan", ".NaN", ".NAN"))


def test_quoted_scalars_are_texts():
    assert parse_yaml("a: '20'\nb: \"true\"\nc: |\n  3\n", "x").plain() == {"a": "20", "b": "true", "c": "3\n"}


def test_plain_agrees_with_ruamel_on_the_catalogue():
    for path in CATALOG.glob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        assert parse_yaml(text, path.name).plain() == YAML(typ="safe", pure=True).load(text)


def test_an_alias_repeats_its_anchor():
    root = parse_yaml("a: &x {k: [1, 2]}\nb: *x\n", "x.yaml")
    assert root.plain() == {"a": {"k": [1, 2]}, "b": {"k": [1, 2]}}
    assert root.section["b"].place == "x.yaml:2"


def test_an_alias_bomb_is_refused_before_it_is_expanded():
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    with pytest.raises(BoresightError, match=rf"x\.yaml:\d+: more than {MAX_VALUES} values"):
        parse_yaml("\n".join(lines), "x.yaml")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: 1\nb: 2\na: 3\n", "x.yaml:3: a: duplicate key, first given at x.yaml:1"),
        ("a:\n  b: 1\n  b: 2\n", "x.yaml:3: b: duplicate key, first given at x.yaml:2"),
        (
            "a: !!python/object/apply:os.system [ls]\n",
            "x.yaml:1: the tag tag:yaml.org,2002:python/object/apply:os.syst",
        ),
        ("a: !!int 3\n", "x.yaml:1: the tag tag:yaml.org,2002:int is not read here"),
        ("a: 1\n---\nb: 2\n", "x.yaml:2: a second YAML document starts here"),
        ("a: 1\n? [1, 2]\n: 3\n", "x.yaml:2: a key must be a word"),
        ("a: *b\n", "x.yaml:1: the alias *b has no anchor before it"),
        ("a: &b [*b]\n", "x.yaml:1: the alias *b has no anchor before it"),
        ("a: [1, 2\nb: 3\n", "x.yaml:2: not valid YAML"),
        ("a: 'x\n", "x.yaml:2: not valid YAML"),
        ("a:\n\t- 1\n", "x.yaml:2: not valid YAML"),
        ("a: \x00", "x.yaml: not valid YAML"),
        ("a: \ud800", "x.yaml: not valid YAML"),
        ("[" * 5000, "x.yaml:1: values are nested more than 40 deep"),
    ],
)
def test_what_is_refused_is_named_in_one_line(text, line):
    with pytest.raises(BoresightError) as caught:
        parse_yaml(text, "x.yaml")
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("escape", [r"\U00110000", r"\ud800"])
def test_an_escape_of_no_character_is_refused_in_one_line(escape):
    with pytest.raises(
        BoresightError, match=r"^x\.yaml(:1)?: (not valid YAML|half of a surrogate pair is no character)"
    ):
        parse_yaml(f'a: "{escape}"', "x.yaml")


def test_written_values_are_read_back_by_us_and_others():
    texts = ["", "~", "yes", "on", "null", "true", "1", "007", "0o17", "0x1F", "1e3", "1_000", "12:30", "2014-08-05"]
    texts += [
        ".inf",
        ".nan",
        "a: b",
        "- c",
        "# d",
        "e #f",
        "\u00e9\u4e2d",
        "'",
        '"',
        "&g",
        "*h",
        "!i",
        "two\nlines",
        " j ",
    ]
    value = {
        "texts": texts,
        "numbers": [1e-5, 1.5e300, -0.0, 3, 10**18, 0.1],
        "rest": {"none": None, "is": [True, False]},
    }
    written = dump_yaml(value)
    assert parse_yaml(written, "x").plain() == value
    assert YAML(typ="safe", pure=True).load(written) == value


def test_values_are_described_in_one_short_line():
    assert describe(entry_of({"a": [1, 2.5, None], "b": True}, "p")) == "{a: [1, 2.5, null], b: true}"
    assert len(describe(entry_of(list(range(100)), "p"))) == 60


def test_whole_floats_become_integers_and_others_stay():
    assert repr(parse_yaml("[3.1e6, 0.5, 1e300, .inf]", "x").plain()) == "[3100000, 0.5, 1e+300, inf]"


# --- Setting a key to its present value changes nothing, at any depth ------------------------------------------------


SCENARIOS = names_in(CATALOG)


def leaves(value, path=()):
    """Yield the dotted keys of a plain value with what stands there; lists are leaves."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from leaves(item, (*path, key))
    elif value is not None:
        yield path, value


def option_models():
    """All models of options of estimators that can be made without any key."""
    for module in pkgutil.walk_packages(estimators.__path__, "estimators."):
        if ".peers" not in module.name:
            importlib.import_module(module.name)
    waiting, found = [SpecModel], set()
    while waiting:
        for model in waiting.pop().__subclasses__():
            waiting.append(model)
            needs = any(field.is_required() for field in model.model_fields.values())
            if model.__module__.startswith("estimators.") and not needs:
                found.add(model)
    return sorted(found, key=lambda model: (model.__module__, model.__qualname__))


def nested(path, value):
    return nested(path[:-1], {path[-1]: value}) if path else value


@pytest.mark.parametrize("name", SCENARIOS)
def test_setting_a_key_of_a_scenario_to_its_value_changes_nothing(name):
    spec = load_scenario(name).spec
    every = [path for path, _ in leaves(spec.model_dump(mode="json")) if len(path) > 1 and path[0] != "name"]
    every = [path for path in every if "read_states" not in path]  # filled in from the table, and whole
    values = dict(leaves(spec.model_dump(mode="json")))
    rng, tried = np.random.default_rng(1), 25 if yaml_text._LOADER is yaml.CSafeLoader else 10
    for row in rng.permutation(len(every))[:tried]:
        path = every[row]
        override = f"{'.'.join(path)}={json.dumps(values[path])}"
        assert load_scenario(name, (override,)).spec == spec, override


def test_setting_a_key_of_any_options_to_its_default_changes_nothing():
    models = option_models()
    assert len(models) > 30
    tried = 0
    for model in models:
        for path, value in leaves(model().model_dump(mode="json")):
            tried += 1
            assert parse_options(model, nested(path, value), model.__name__) == model(), (model, path)
    assert tried > 300


def test_a_key_of_a_section_keeps_what_the_section_has_by_default():
    """The roughness of craters has its own Hurst exponent and wavelengths."""
    name = next(name for name in SCENARIOS if load_scenario(name).spec.craters is not None)
    before = load_scenario(name).spec.craters.roughness
    after = load_scenario(name, ("craters.roughness.rms_m=7.5",)).spec.craters.roughness
    assert after == before.model_copy(update={"rms_m": 7.5})


def test_another_kind_replaces_the_default_whole():
    spec = load_scenario("itokawa-2km-lambert", ("pose_error.position_cam_m={normal: [1, 2, 3]}",)).spec
    assert spec.pose_error.position_cam_m.model_dump() == {"normal": (1.0, 2.0, 3.0)}
    given = {"brdf": {"kind": "hapke"}, "pose_error": {"position_cam_px": {"normal": [1, 1, 1]}}}
    assert on_defaults((ScenarioSpec,), given)["pose_error"].get("position_cam_m") is None
