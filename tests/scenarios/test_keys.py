"""Keys of models in words: type, unit, default and meaning."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from boresight.scenarios.load.keys import Key, keys_of, unit_of_key
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.camera import CameraSpec
from boresight.scenarios.spec.campaign import CampaignSpec, GridSpec
from boresight.scenarios.spec.orbit import ImagingSpec, OrbitSpec
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.world import PoseErrorSpec, ViewpointSpec


def every_key(model: type[SpecModel], path: str = "") -> Iterator[tuple[str, Key]]:
    for key in keys_of(model):
        yield f"{path}{key.name}", key
        for section in key.sections:
            yield from every_key(section, f"{path}{key.name}.")


def key(model: type[SpecModel], name: str) -> Key:
    return next(one for one in keys_of(model) if one.name == name)


@pytest.mark.parametrize(
    ("model", "name", "type_", "unit", "default"),
    [
        (CameraSpec, "fov_deg", "number in [0.0001, 180)", "deg", "left out"),
        (CameraSpec, "width_px", "whole number in [16, 8192]", "px", "512"),
        (CameraSpec, "focal_px", "list of 2 numbers in [1, 1e+09]", "px", "left out"),
        (BodySpec, "shading", "flat or smooth", "", "flat"),
        (BodySpec, "expected_diameter_m", "list of 2 numbers", "m", "[1, 2000000]"),
        (ViewpointSpec, "range_m", "number above 0 or distribution", "m", "left out"),
        (ViewpointSpec, "keep_clear_px", "list of lists of 4 numbers at least 0", "px", "[]"),
        (ViewpointSpec, "roll_deg", "number or distribution", "deg", "{uniform: [-180, 180]}"),
        (PoseErrorSpec, "attitude", "section", "", "{angle_deg: {uniform: [-2, 2]}}"),
        (OrbitSpec, "imaging", "section", "", "left out"),
        (ImagingSpec, "craters", "section", "", "{count: 600}"),
        (ScenarioSpec, "name", "text", "", "the name of the file"),
        (ScenarioSpec, "camera", "section", "", None),
        (ScenarioSpec, "rendering", "section", "", "the defaults of its keys"),
        (ScenarioSpec, "brdf", "section", "", "{kind: lambert}"),
        (CampaignSpec, "set", "section of names", "", "{}"),
        (CampaignSpec, "estimators", "list of texts or section of names", "", None),
        (GridSpec, "axes", "section of names", "", None),
    ],
)  # fmt: skip
def test_a_key_in_words(model, name, type_, unit, default):
    found = key(model, name)
    assert (found.type, found.unit, found.default) == (type_, unit, default)


def test_alternatives_and_named_sections_are_followed():
    assert len(key(ScenarioSpec, "brdf").sections) == 5
    assert [one.__name__ for one in key(GridSpec, "axes").sections] == ["AxisSpec"]
    # A distribution is a value, and an estimator is written by its name.
    assert key(ViewpointSpec, "roll_deg").sections == key(CampaignSpec, "estimators").sections == ()


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("gm_m3_s2", "m³/s²"), ("noise_m_s2", "m/s²"), ("velocity_sigma_m_s", "m/s"), ("phase_deg_max", "deg"),
        ("days", "days"), ("h", ""), ("white_e_per_s", "electrons/s"), ("false_share", ""),
    ],
)  # fmt: skip
def test_the_unit_is_the_end_of_the_name(name, unit):
    assert unit_of_key(name) == unit


@pytest.mark.parametrize("model", [ScenarioSpec, CampaignSpec])
def test_every_key_has_a_meaning_and_a_type(model):
    found = dict(every_key(model))
    assert len(found) > 10
    assert [path for path, one in found.items() if not one.meaning or not one.type] == []
    assert [path for path, one in found.items() if one.type == "any value"] == []
    # "Of the rotation", "The same of y": phrases that need their neighbours.
    assert [path for path, one in found.items() if one.meaning.startswith(("Of ", "The same", "Its "))] == []
