"""Setting a key to its present value changes nothing, at any depth."""

from __future__ import annotations

import importlib
import json
import pkgutil

import numpy as np
import pytest

from boresight import estimators
from boresight.estimators.options import parse_options
from boresight.scenarios.load import load_scenario
from boresight.scenarios.load.files import CATALOG
from boresight.scenarios.load.find import names_in
from boresight.scenarios.load.merge import on_defaults
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.scenario import ScenarioSpec

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
    values = dict(leaves(spec.model_dump(mode="json")))
    rng = np.random.default_rng(1)
    for row in rng.permutation(len(every))[:40]:
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
