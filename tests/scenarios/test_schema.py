"""The JSON Schema against an independent validator, and against what the loader itself accepts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from ruamel.yaml import YAML

from boresight import campaign
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import json_schema, load_campaign, load_scenario
from boresight.scenarios.load.files import CATALOG
from boresight.scenarios.spec.camera import CameraSpec

CAMPAIGNS = Path(campaign.__file__).parent / "catalog"
MINIMAL = {"camera": {"fov_deg": 20}, "viewpoint": {"range_m": 1000}}


@pytest.fixture(scope="module")
def validators():
    return {kind: Draft202012Validator(json_schema(kind)) for kind in ("scenario", "campaign")}


@pytest.mark.parametrize("kind", ["scenario", "campaign"])
def test_it_is_a_json_schema(kind):
    Draft202012Validator.check_schema(json_schema(kind))


@pytest.mark.parametrize(
    "path", sorted(CATALOG.glob("*.yaml")) + sorted(CAMPAIGNS.glob("*.yaml")), ids=lambda p: p.stem
)
def test_it_accepts_the_catalogue(validators, path):
    kind = "scenario" if path.parent == CATALOG else "campaign"
    errors = list(validators[kind].iter_errors(YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))))
    assert not errors


@pytest.mark.parametrize(
    ("change", "good"),
    [
        ({}, True),
        ({"detector": {"bits": 8}}, True),
        ({"detector": None}, True),
        ({"brdf": {"albedo": 0.5}}, True),
        ({"brdf": {"kind": "hapke", "w": 0.5}}, True),
        ({"body": {"detail": {"facets": 3.1e6}}}, True),
        ({"pose_error": {"attitude": {"angle_deg": {"normal": 1}}}}, True),
        ({"pose_error": {"attitude": {"rotation_vector_deg": {"normal": [1, 1, 1]}}}}, True),
        ({"camera": {"fov_deg": 190}}, False),
        ({"camera": {"fov_deg": "20"}}, False),
        ({"camera": {"fov_dg": 20}}, False),
        ({"camera": {"fov_deg": 20, "focal_px": [9, 9]}}, False),
        ({"camera": {"focal_px": [9, 9, 9]}}, False),
        ({"brdf": {"kind": "lambert", "w": 0.5}}, False),
        ({"brdf": {"kind": "phong"}}, False),
        ({"viewpoint": {}}, False),
        ({"viewpoint": {"range_m": 0}}, False),
        ({"images": {"folder": "x"}}, False),
        ({"lighting": {"phase_deg": {"uniform": [1]}}}, False),
        ({"lightning": {}}, False),
        ({"name": "Big Rock"}, False),
    ],
)
def test_it_agrees_with_the_loader(validators, tmp_path, change, good):
    content = {**MINIMAL, **change}
    path = tmp_path / "x.yaml"
    with path.open("w", encoding="utf-8") as stream:
        YAML(typ="safe", pure=True).dump(content, stream)
    assert validators["scenario"].is_valid(content) is good
    if good:
        load_scenario(str(path))
    else:
        with pytest.raises(BoresightError):
            load_scenario(str(path))


def test_a_file_that_extends_may_leave_out_any_key_but_not_write_a_wrong_one(validators):
    assert not validators["scenario"].is_valid({"brdf": {"kind": "hapke"}})
    for part in ({}, {"images": {"noise_realisations": 2}}, {"brdf": {"w": 0.2}}, {"camera": {"width_px": 64}}):
        assert validators["scenario"].is_valid({"extends": "quickstart", **part})
        assert validators["scenario"].is_valid({"extends": ["quickstart", "a.yaml"], **part})
    for part in ({"camera": {"fov_deg": 190}}, {"lightning": {}}, {"brdf": {"ww": 1}}, {"images": {"folder": 3}}):
        assert not validators["scenario"].is_valid({"extends": "quickstart", **part})


@pytest.mark.parametrize(
    ("estimators", "good"),
    [
        (["prior"], True),
        (["prior", {"landmark-harris": {"database": {"images": 3}, "label": "x"}}], True),
        ([{"prior": None}], True),
        ([], False),
        ([3], False),
        ([{"prior": 3}], False),
    ],
)
def test_estimators_of_a_campaign(validators, tmp_path, estimators, good):
    content = {
        "scenarios": ["quickstart"],
        "estimators": estimators,
        "trials": 1,
        "seed": 0,
        "set": {"camera.fov_deg": 3},
    }
    assert validators["campaign"].is_valid(content) is good
    path = tmp_path / "c.yaml"
    with path.open("w", encoding="utf-8") as stream:
        YAML(typ="safe", pure=True).dump(content, stream)
    if good:
        load_campaign(str(path), CAMPAIGNS)
    else:
        with pytest.raises(BoresightError):
            load_campaign(str(path), CAMPAIGNS)


def test_keys_are_described_for_the_editor():
    definitions = json_schema("scenario")["$defs"]
    for name in ("CameraSpec", "DetectorSpec", "ViewpointSpec", "LightingSpec", "PoseErrorSpec", "ImageSetSpec"):
        for key, schema in definitions[name + "Part"]["properties"].items():
            assert key in {"kind", "attitude"} or schema.get("description"), f"{name}.{key} has no description"


@pytest.mark.parametrize(
    ("optics", "pixels", "field_deg"),
    [
        ({"focal_mm": 150.07, "pixel_um": 14.0}, 1024, 5.47),  # Framing Camera of Dawn, Sierks et al. (2011)
        ({"focal_mm": 717.4, "pixel_um": 13.5}, 2048, 2.21),  # narrow-angle camera of OSIRIS, Keller et al. (2007)
        ({"focal_mm": 120.8, "pixel_um": 12.0}, 1024, 5.83),  # AMICA, Ishiguro et al. (2010)
    ],
)
def test_a_data_sheet_gives_the_field_of_view_of_the_camera(optics, pixels, field_deg):
    camera = CameraSpec(width_px=pixels, height_px=pixels, optics=optics).camera()
    assert np.degrees(2.0 * np.arctan(0.5 * pixels / camera.fx_px)) == pytest.approx(field_deg, abs=0.01)


def test_pixels_need_not_be_square():
    camera = CameraSpec(width_px=537, height_px=244, optics={"focal_mm": 167.35, "pixel_um": (16.0, 27.0)}).camera()
    fields = np.degrees(2.0 * np.arctan([0.5 * 537 / camera.fx_px, 0.5 * 244 / camera.fy_px]))
    assert fields == pytest.approx([2.93, 2.26], abs=0.015), "NEAR's imager, Hawkins et al. (1997)"
    for wrong in ({"focal_mm": 0.0, "pixel_um": 1.0}, {"focal_mm": 1.0, "pixel_um": -1.0}, {"focal_mm": 1.0}):
        with pytest.raises(ValueError, match=r"optics"):
            CameraSpec(optics=wrong)
