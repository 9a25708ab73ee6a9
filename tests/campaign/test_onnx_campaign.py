"""A network in an ONNX file as a detector of campaigns and pictures."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from onnx_graphs import node, write_model
from tiny_campaign import RESULTS, files, run

from boresight.campaign.cli import main
from boresight.campaign.runs.resolve import reload, resolve
from boresight.campaign.store import RunFolder
from boresight.scenarios.errors import BoresightError

pytest.importorskip("onnxruntime", reason='onnxruntime is absent: pip install -e ".[onnxruntime]"')

SCENE = """\
body: {shape: sphere}
craters:
  {seed: 5, count: 150, min_diameter_m: 20, max_diameter_m: 120, known_diameter_m: 30, edge_m: 4, roughness: null}
camera: {width_px: 200, height_px: 160, fov_deg: 12}
viewpoint: {range_m: 2000, targets: [nadir]}
lighting: {phase_deg: {uniform: [30, 70]}, measure: angle}
"""
CAMPAIGN = """\
title: Bright walls of a small sphere
experiment: crater-detection
scenarios: [scene]
estimators:
  - crater-onnx: {model: nets/bright.onnx, output: heat-map, score_min: 0.8, label: bright}
trials: 12
seed: 2
"""


def write_bright(path: Path, width: int = 5) -> Path:
    """Write a network that returns the mean brightness around each pixel."""
    kernel = np.full((1, 1, width, width), 1.0 / width**2, np.float32)
    nodes = [node("Conv", "x kernel", "heat", pads=[width // 2] * 4)]
    return write_model(path, nodes, [1, 1, 96, 96], {"heat": [1, 1, 96, 96]}, {"kernel": kernel})


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / "nets").mkdir()
    write_bright(tmp_path / "nets" / "bright.onnx")
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "tiny.yaml").write_text(CAMPAIGN)
    return tmp_path / "tiny.yaml"


def test_rows_do_not_depend_on_the_number_of_jobs(campaign: Path, tmp_path: Path) -> None:
    alone, both = (tmp_path / f"run-{jobs}" for jobs in (1, 2))
    for jobs, folder in ((1, alone), (2, both)):
        assert run(campaign, folder, "--jobs", jobs, "--no-report") == 0
    tables = (*RESULTS, "detections")
    assert files(alone, *tables) == files(both, *tables)
    found = RunFolder(alone)
    assert found.table("rows")["status"].eq("ok").all()
    detections = found.table("detections")
    assert set(detections["trial"]) == set(range(12)), "each image has something bright"
    # The network sees tiles of 96 pixels of an image of 200 x 160.
    assert detections["u_px"].max() > 104 and detections["v_px"].max() > 64


def test_the_content_of_the_file_decides_about_the_run_and_its_folder_does_not(campaign: Path, tmp_path: Path) -> None:
    shutil.copytree(tmp_path, tmp_path.parent / f"{tmp_path.name}-moved")
    one, moved = (resolve(str(at / "tiny.yaml")) for at in (tmp_path, tmp_path.parent / f"{tmp_path.name}-moved"))
    assert one.digest == moved.digest
    assert one.spec.estimators[0].options["model"] == str(tmp_path / "nets" / "bright.onnx")
    assert run(campaign, tmp_path / "run", "--no-report", "--trials", 1) == 0
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    again = reload(manifest)
    assert again is not None and again.digest == resolve(str(campaign), variant=again.variant).digest
    write_bright(tmp_path / "nets" / "bright.onnx", 3)
    assert resolve(str(campaign)).digest != one.digest
    assert reload(manifest) is None
    (tmp_path / "nets" / "bright.onnx").unlink()
    with pytest.raises(BoresightError, match=r"bright\.onnx: cannot be read"):
        reload(manifest)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("model: nets/no.onnx, output: heat-map", "nets/no.onnx: cannot be read: No such file"),
        ("model: tiny.yaml, output: heat-map", "tiny.yaml: no ONNX model that onnxruntime can run: "),
        ("model: nets/bright.onnx, output: boxes-xyxy", "floating-point outputs are (1, 1, 96, 96)"),
        ("model: nets/bright.onnx, output: boxes", "output: "),
        ("model: nets/bright.onnx, output: heat-map, input: {size_px: 64}", "input.size_px: 64: "),
        ("model: 3, output: heat-map", "model: "),
        ("output: heat-map", "model: "),
    ],
)
def test_validate_refuses_in_one_line_with_the_place(campaign: Path, wrong: str, said: str, capsys) -> None:
    text = CAMPAIGN.replace("model: nets/bright.onnx, output: heat-map", wrong)
    campaign.write_text(text)
    assert main(["validate", str(campaign)]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert f"{campaign}:5: " in told
    assert len(told.strip().splitlines()) == 1


def test_a_picture_is_searched_by_a_network(tmp_path: Path, capsys) -> None:
    image = np.zeros((150, 130), np.uint8)
    for u, v in ((30, 40), (90, 100)):
        cv2.circle(image, (u, v), 9, 200, -1)
    cv2.imwrite(str(tmp_path / "moon.png"), image)
    model = write_bright(tmp_path / "bright.onnx", 3)
    given = ["--option", f"model={model}", "--option", "output=heat-map", "--option", "input.white=200"]
    asked = ["craters", str(tmp_path / "moon.png"), "--sun", "0", "--detector", "crater-onnx", "--out", str(tmp_path)]
    assert main([*asked, *given, "--option", "score_min=0.5"]) == 0
    assert "2 craters by crater-onnx" in capsys.readouterr().out
    found = pd.read_csv(tmp_path / "detections.csv").sort_values("u_px")
    # OpenCV counts from the centre of the first pixel.
    np.testing.assert_allclose(found[["u_px", "v_px"]], [[30.5, 40.5], [90.5, 100.5]], atol=0.1)
    np.testing.assert_allclose(found[["a_px", "b_px"]], np.sqrt(np.count_nonzero(image) / 2 / np.pi), atol=0.1)
    assert main([*asked, *given, "--option", "score"]) == 2
    assert "--option score: write it as key=value" in capsys.readouterr().err
    assert main([*asked, *given, "--option", "scores_min=0.5"]) == 2
    assert "scores_min: unknown key" in capsys.readouterr().err
    assert main(asked) == 2
    assert "crater-onnx: model: " in capsys.readouterr().err
